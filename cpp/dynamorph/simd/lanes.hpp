// SPDX-License-Identifier: GPL-3.0-or-later
// Eight numbers that go through the same arithmetic. GCC's vectors: whatever the processor has carries them out.
#pragma once

#include <new>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/simd/multiversion.hpp"

// Vectors wider than the baseline's registers are passed by value only between functions that are inlined; by reference
// they must be aligned by hand, as the baseline's alignof is 16: LaneVector, alignas(64).
#pragma GCC diagnostic ignored "-Wpsabi"

namespace dynamorph {

constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(32)));

/// Eight doubles, as two vectors: GCC 12 keeps one of 64 bytes in memory where the registers have 32.
struct alignas(64) Doubles {
  using Half = double __attribute__((vector_size(32), may_alias));
  Half low, high;

  DYNAMORPH_INLINE double operator[](int lane) const { return lane < 4 ? low[lane] : high[lane - 4]; }
  DYNAMORPH_INLINE double& operator[](int lane) { return reinterpret_cast<double*>(this)[lane]; }
  DYNAMORPH_INLINE Doubles& operator+=(const Doubles& b) {
    low += b.low;
    high += b.high;
    return *this;
  }
  DYNAMORPH_INLINE Doubles& operator-=(const Doubles& b) {
    low -= b.low;
    high -= b.high;
    return *this;
  }
};
static_assert(alignof(Doubles) == 64, "the clones of a function load whole vectors, whatever the baseline asks for");
DYNAMORPH_INLINE Doubles operator+(const Doubles& a, const Doubles& b) { return {a.low + b.low, a.high + b.high}; }
DYNAMORPH_INLINE Doubles operator-(const Doubles& a, const Doubles& b) { return {a.low - b.low, a.high - b.high}; }
DYNAMORPH_INLINE Doubles operator*(const Doubles& a, const Doubles& b) { return {a.low * b.low, a.high * b.high}; }
DYNAMORPH_INLINE Doubles operator/(const Doubles& a, const Doubles& b) { return {a.low / b.low, a.high / b.high}; }
DYNAMORPH_INLINE Doubles operator+(const Doubles& a, double b) { return {a.low + b, a.high + b}; }
DYNAMORPH_INLINE Doubles operator-(const Doubles& a, double b) { return {a.low - b, a.high - b}; }
DYNAMORPH_INLINE Doubles operator*(const Doubles& a, double b) { return {a.low * b, a.high * b}; }
DYNAMORPH_INLINE Doubles operator/(const Doubles& a, double b) { return {a.low / b, a.high / b}; }
DYNAMORPH_INLINE Doubles operator+(double a, const Doubles& b) { return b + a; }
DYNAMORPH_INLINE Doubles operator*(double a, const Doubles& b) { return b * a; }
DYNAMORPH_INLINE Doubles operator/(double a, const Doubles& b) { return {a / b.low, a / b.high}; }

inline bool all_zero(const Doubles& v) {
  for (int lane = 0; lane < kLanes; ++lane)
    if (v[lane] != 0) return false;
  return true;
}

/// Of lanes, aligned as every instruction set wants it: the baseline alone would ask for less.
template <class T>
struct CacheAligned {
  using value_type = T;
  CacheAligned() = default;
  template <class U>
  CacheAligned(const CacheAligned<U>&) {}
  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(64))); }
  void deallocate(T* p, std::size_t) { ::operator delete(p, std::align_val_t(64)); }
  bool operator==(const CacheAligned&) const { return true; }
  bool operator!=(const CacheAligned&) const { return false; }
};
template <class T>
using LaneVector = std::vector<T, CacheAligned<T>>;

DYNAMORPH_INLINE void to_single(const double& from, float& to) { to = float(from); }
DYNAMORPH_INLINE void to_single(const Doubles& from, Floats& to) {
  using Half = float __attribute__((vector_size(16)));
  const Half low = __builtin_convertvector(from.low, Half), high = __builtin_convertvector(from.high, Half);
  to = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
}
DYNAMORPH_INLINE Doubles to_double(const Floats& from) {
  using Whole = double __attribute__((vector_size(64)));
  const Whole all = __builtin_convertvector(from, Whole);
  return {__builtin_shufflevector(all, all, 0, 1, 2, 3), __builtin_shufflevector(all, all, 4, 5, 6, 7)};
}

}  // namespace dynamorph
