// SPDX-License-Identifier: GPL-3.0-or-later
// Reads a model file (docs/file_format.md): named arrays and a description, in the layout of safetensors.
//
// A file may come from anyone. Memory is allocated only once the file is known to be that large. Every array carries
// its SHA-256, and so does the header. So no byte of a file can change unnoticed.
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
  std::string dtype;  ///< the safetensors name: F64, F32, I64 ... U8, BOOL
  std::vector<std::int64_t> shape;
  std::vector<unsigned char> bytes;
};

struct Content {
  std::vector<std::pair<std::string, Array>> arrays;  ///< by name, in file order
  std::string meta;                                   ///< JSON: settings, names of the bones, what the model depends on

  const Array* find(const std::string& name) const;  ///< null if there is none
};

/// Unpacks the bytes of a model file. Throws Error, which says what to do, when they are not a complete and undamaged
/// model of the one version that this engine reads.
Content unpack(const unsigned char* bytes, std::size_t size);

/// The content of a file. Throws Error like `unpack`, and when the file cannot be read.
Content read(const std::filesystem::path& path);

}  // namespace dynamorph::file
