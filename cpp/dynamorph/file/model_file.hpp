// SPDX-License-Identifier: GPL-3.0-or-later
// Reading a model file (docs/file_format.md): named arrays and a description, in the layout of safetensors.
//
// A file may come from anybody. Nothing is allocated for a size before the file is seen to be that large; every array
// carries its SHA-256, the header its own, and the header must be to the byte what the add-on would have written. So no
// byte of a file can change unnoticed.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "dynamorph/core/errors.hpp"

namespace dynamorph::file {

/// Numbers, little-endian, C order.
struct Array {
  std::string dtype;  ///< as safetensors calls it: F64, F32, I64 ... U8, BOOL
  std::vector<std::int64_t> shape;
  std::vector<unsigned char> bytes;
};

struct Content {
  std::vector<std::pair<std::string, Array>> arrays;  ///< by name, in the order of the file
  std::string meta;                                   ///< JSON: settings, names of the bones, what the model depends on

  const Array* find(const std::string& name) const;  ///< or null
};

/// What `bytes` hold. What an older version wrote comes out as the present one would have written it.
/// Throws Error, saying what to do, when they are not a whole and undamaged model that this version can read.
Content unpack(const unsigned char* bytes, std::size_t size);

/// The content of a file. Throws Error as `unpack`, and when the file cannot be read.
Content read(const std::filesystem::path& path);

}  // namespace dynamorph::file
