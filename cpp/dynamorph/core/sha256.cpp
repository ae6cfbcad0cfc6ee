// SPDX-License-Identifier: GPL-3.0-or-later
// Names follow FIPS 180-4, section 6.2.
#include "dynamorph/core/sha256.hpp"

#include <array>
#include <cstdint>
#include <cstring>

namespace dynamorph {

namespace {

using Hash = std::array<std::uint32_t, 8>;
constexpr std::size_t kBlock = 64;  ///< bytes

constexpr std::array<std::uint32_t, 64> K{
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

std::uint32_t rotated(std::uint32_t x, int right) { return x >> right | x << (32 - right); }

void add_block(const unsigned char* block, Hash& H) {
  std::uint32_t W[64];
  for (int t = 0; t < 16; ++t, block += 4)
    W[t] = std::uint32_t(block[0]) << 24 | std::uint32_t(block[1]) << 16 | std::uint32_t(block[2]) << 8 | block[3];
  for (int t = 16; t < 64; ++t) {
    const std::uint32_t x = W[t - 15], y = W[t - 2];
    W[t] =
        W[t - 16] + W[t - 7] + (rotated(x, 7) ^ rotated(x, 18) ^ x >> 3) + (rotated(y, 17) ^ rotated(y, 19) ^ y >> 10);
  }
  auto [a, b, c, d, e, f, g, h] = H;
  for (int t = 0; t < 64; ++t) {
    const std::uint32_t T1 = h + (rotated(e, 6) ^ rotated(e, 11) ^ rotated(e, 25)) + ((e & f) ^ (~e & g)) + K[t] + W[t];
    const std::uint32_t T2 = (rotated(a, 2) ^ rotated(a, 13) ^ rotated(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
    h = g, g = f, f = e, e = d + T1, d = c, c = b, b = a, a = T1 + T2;
  }
  const Hash sum{a, b, c, d, e, f, g, h};
  for (int i = 0; i < 8; ++i) H[i] += sum[i];
}

}  // namespace

std::string sha256(const void* bytes, std::size_t size) {
  Hash H{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
  const auto* next = static_cast<const unsigned char*>(bytes);
  std::size_t left = size;
  for (; left >= kBlock; left -= kBlock, next += kBlock) add_block(next, H);
  // The last blocks hold the remaining bytes, a one bit, zeros and, at the end, the number of bits, big-endian.
  unsigned char end[2 * kBlock] = {};
  if (left) std::memcpy(end, next, left);
  end[left] = 0x80;
  const std::size_t padded = left + 9 <= kBlock ? kBlock : 2 * kBlock;
  for (int i = 0; i < 8; ++i) end[padded - 1 - i] = (unsigned char)(std::uint64_t(size) * 8 >> 8 * i);
  for (std::size_t at = 0; at < padded; at += kBlock) add_block(end + at, H);

  std::string digits;
  for (std::uint32_t word : H)
    for (int shift = 28; shift >= 0; shift -= 4) digits += "0123456789abcdef"[word >> shift & 15];
  return digits;
}

}  // namespace dynamorph
