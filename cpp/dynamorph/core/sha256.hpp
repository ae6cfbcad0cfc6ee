// SPDX-License-Identifier: GPL-3.0-or-later
// SHA-256 (FIPS 180-4). It is implemented here because packaged implementations are libraries to link (OpenSSL, Nettle,
// Crypto++). The artist's machine, or another system that wheels are built for, may not have them.
#pragma once

#include <cstddef>
#include <string>

namespace dynamorph {

/// The digest of `size` bytes, as 64 lower-case hexadecimal digits.
std::string sha256(const void* bytes, std::size_t size);

}  // namespace dynamorph
