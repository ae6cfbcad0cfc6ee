// SPDX-License-Identifier: GPL-3.0-or-later
// SHA-256 (FIPS 180-4). Written here because what is packaged comes as a library to link (OpenSSL, Nettle, Crypto++),
// which the artist's machine or the other systems that wheels are built for may not have.
#pragma once

#include <cstddef>
#include <string>

namespace dynamorph {

/// The digest of `size` bytes, as 64 lower-case hexadecimal digits.
std::string sha256(const void* bytes, std::size_t size);

}  // namespace dynamorph
