// SPDX-License-Identifier: GPL-3.0-or-later
// Every vector type of the engine: several numbers that go through the same arithmetic. They are the vectors of GCC and
// Clang, which use whatever the processor has. Like kernels (dispatch.hpp), this file does not use the standard
// library.
//
// mul_add and mul_sub are a fused multiply-add where the instruction set has one; otherwise they round twice. The
// engine is compiled with -ffp-contract=off, so that nothing else depends on the compiler's choice.
#pragma once

#include "dynamorph/simd/compiler.hpp"

#if defined(__FMA__)
#include <immintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif

// Only inlined functions pass vectors wider than the baseline's registers by value, so this warning does not apply.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpsabi"

namespace dynamorph {

// --- Vectors ---------------------------------------------------------------------------------------------------------

typedef float Float8 __attribute__((vector_size(32)));
typedef double Double4 __attribute__((vector_size(32)));
typedef double Double8 __attribute__((vector_size(64)));

// Vectors in an array, where they need not begin at a multiple of their size. (Clang ignores `aligned` in an alias
// declaration.)
typedef float UnalignedFloat4 __attribute__((vector_size(16), aligned(4), may_alias));
typedef float UnalignedFloat8 __attribute__((vector_size(32), aligned(4), may_alias));
typedef double UnalignedDouble4 __attribute__((vector_size(32), aligned(8), may_alias));
static_assert(sizeof(UnalignedFloat8) == 32 && alignof(UnalignedFloat8) == 4, "read from any array of floats");
static_assert(sizeof(UnalignedDouble4) == 32 && alignof(UnalignedDouble4) == 8, "read from any array of doubles");

DYNAMORPH_INLINE Float8 load(const float* from) { return *reinterpret_cast<const UnalignedFloat8*>(from); }
DYNAMORPH_INLINE Double4 load(const double* from) { return *reinterpret_cast<const UnalignedDouble4*>(from); }
DYNAMORPH_INLINE void store(const Float8& v, float* to) { *reinterpret_cast<UnalignedFloat8*>(to) = v; }
DYNAMORPH_INLINE void store(const Double4& v, double* to) { *reinterpret_cast<UnalignedDouble4*>(to) = v; }

/// The vector that `load` returns for an array of Real.
template <class Real>
struct VectorOf;
template <>
struct VectorOf<float> {
  typedef Float8 Type;
};
template <>
struct VectorOf<double> {
  typedef Double4 Type;
};

DYNAMORPH_INLINE double sum_of(const Double4& v) { return v[0] + v[1] + (v[2] + v[3]); }

/// c + a b.
DYNAMORPH_INLINE float mul_add(float c, float a, float b) {
#if defined(__FMA__) || defined(__ARM_NEON)
  return __builtin_fmaf(a, b, c);
#else
  return c + a * b;
#endif
}
DYNAMORPH_INLINE double mul_add(double c, double a, double b) {
#if defined(__FMA__) || defined(__ARM_NEON)
  return __builtin_fma(a, b, c);
#else
  return c + a * b;
#endif
}
DYNAMORPH_INLINE Float8 mul_add(const Float8& c, const Float8& a, const Float8& b) {
#if defined(__FMA__)
  return Float8(_mm256_fmadd_ps(__m256(a), __m256(b), __m256(c)));
#elif defined(__ARM_NEON)
  const auto half = [](const Float8& v, int i) { return float32x4_t{v[i], v[i + 1], v[i + 2], v[i + 3]}; };
  const float32x4_t low = vfmaq_f32(half(c, 0), half(a, 0), half(b, 0));
  const float32x4_t high = vfmaq_f32(half(c, 4), half(a, 4), half(b, 4));
  return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
#else
  return c + a * b;
#endif
}
DYNAMORPH_INLINE Double4 mul_add(const Double4& c, const Double4& a, const Double4& b) {
#if defined(__FMA__)
  return Double4(_mm256_fmadd_pd(__m256d(a), __m256d(b), __m256d(c)));
#elif defined(__ARM_NEON)
  const auto half = [](const Double4& v, int i) { return float64x2_t{v[i], v[i + 1]}; };
  const float64x2_t low = vfmaq_f64(half(c, 0), half(a, 0), half(b, 0));
  const float64x2_t high = vfmaq_f64(half(c, 2), half(a, 2), half(b, 2));
  return __builtin_shufflevector(low, high, 0, 1, 2, 3);
#else
  return c + a * b;
#endif
}

/// c - a b.
DYNAMORPH_INLINE float mul_sub(float c, float a, float b) {
#if defined(__FMA__) || defined(__ARM_NEON)
  return __builtin_fmaf(-a, b, c);
#else
  return c - a * b;
#endif
}
DYNAMORPH_INLINE double mul_sub(double c, double a, double b) {
#if defined(__FMA__) || defined(__ARM_NEON)
  return __builtin_fma(-a, b, c);
#else
  return c - a * b;
#endif
}
DYNAMORPH_INLINE Float8 mul_sub(const Float8& c, const Float8& a, const Float8& b) {
#if defined(__FMA__)
  return Float8(_mm256_fnmadd_ps(__m256(a), __m256(b), __m256(c)));
#elif defined(__ARM_NEON)
  return mul_add(c, -a, b);
#else
  return c - a * b;
#endif
}
DYNAMORPH_INLINE Double4 mul_sub(const Double4& c, const Double4& a, const Double4& b) {
#if defined(__FMA__)
  return Double4(_mm256_fnmadd_pd(__m256d(a), __m256d(b), __m256d(c)));
#elif defined(__ARM_NEON)
  return mul_add(c, -a, b);
#else
  return c - a * b;
#endif
}

DYNAMORPH_INLINE Float8 all_of(float x) { return Float8{x, x, x, x, x, x, x, x}; }
DYNAMORPH_INLINE Double4 all_of(double x) { return Double4{x, x, x, x}; }
DYNAMORPH_INLINE Float8 mul_add(const Float8& c, float a, const Float8& b) { return mul_add(c, all_of(a), b); }
DYNAMORPH_INLINE Float8 mul_sub(const Float8& c, float a, const Float8& b) { return mul_sub(c, all_of(a), b); }
DYNAMORPH_INLINE Double4 mul_add(const Double4& c, double a, const Double4& b) { return mul_add(c, all_of(a), b); }
DYNAMORPH_INLINE Double4 mul_sub(const Double4& c, double a, const Double4& b) { return mul_sub(c, all_of(a), b); }

// --- Lanes -----------------------------------------------------------------------------------------------------------
// One number for each of eight pairs of bones or nodes. These are structs so that they are aligned alike for every
// instruction set, even in containers, where GCC's baseline would ask for 16 bytes.

constexpr int kLanes = 8;

struct alignas(32) FloatW {
  typedef float All __attribute__((vector_size(32), may_alias));
  All all;

  DYNAMORPH_INLINE float operator[](int lane) const { return all[lane]; }
  DYNAMORPH_INLINE float& operator[](int lane) { return reinterpret_cast<float*>(this)[lane]; }
  DYNAMORPH_INLINE FloatW& operator+=(const FloatW& b) {
    all += b.all;
    return *this;
  }
};
static_assert(sizeof(FloatW) == 32 && alignof(FloatW) == 32, "kernels of all instruction sets read the same memory");
DYNAMORPH_INLINE FloatW operator+(const FloatW& a, const FloatW& b) { return {a.all + b.all}; }
DYNAMORPH_INLINE FloatW operator-(const FloatW& a, const FloatW& b) { return {a.all - b.all}; }
DYNAMORPH_INLINE FloatW operator*(const FloatW& a, const FloatW& b) { return {a.all * b.all}; }
DYNAMORPH_INLINE FloatW operator*(float a, const FloatW& b) { return {a * b.all}; }
DYNAMORPH_INLINE FloatW operator+(float a, const FloatW& b) { return {a + b.all}; }

/// Eight doubles as two vectors, because GCC 12 keeps a vector of 64 bytes in memory if the registers have 32.
struct alignas(64) DoubleW {
  typedef double Half __attribute__((vector_size(32), may_alias));
  Half low, high;

  DYNAMORPH_INLINE double operator[](int lane) const { return lane < 4 ? low[lane] : high[lane - 4]; }
  DYNAMORPH_INLINE double& operator[](int lane) { return reinterpret_cast<double*>(this)[lane]; }
  DYNAMORPH_INLINE DoubleW& operator+=(const DoubleW& b) {
    low += b.low;
    high += b.high;
    return *this;
  }
};
static_assert(sizeof(DoubleW) == 64 && alignof(DoubleW) == 64, "kernels of all instruction sets read the same memory");
DYNAMORPH_INLINE DoubleW operator+(const DoubleW& a, const DoubleW& b) { return {a.low + b.low, a.high + b.high}; }
DYNAMORPH_INLINE DoubleW operator*(const DoubleW& a, const DoubleW& b) { return {a.low * b.low, a.high * b.high}; }
DYNAMORPH_INLINE DoubleW operator-(const DoubleW& a, double b) { return {a.low - b, a.high - b}; }
DYNAMORPH_INLINE DoubleW operator*(const DoubleW& a, double b) { return {a.low * b, a.high * b}; }

DYNAMORPH_INLINE FloatW mul_add(const FloatW& c, const FloatW& a, const FloatW& b) {
  return {mul_add(c.all, a.all, b.all)};
}
DYNAMORPH_INLINE FloatW mul_sub(const FloatW& c, const FloatW& a, const FloatW& b) {
  return {mul_sub(c.all, a.all, b.all)};
}
DYNAMORPH_INLINE FloatW mul_add(const FloatW& c, float a, const FloatW& b) { return {mul_add(c.all, a, b.all)}; }
DYNAMORPH_INLINE FloatW mul_sub(const FloatW& c, float a, const FloatW& b) { return {mul_sub(c.all, a, b.all)}; }
DYNAMORPH_INLINE DoubleW mul_add(const DoubleW& c, const DoubleW& a, const DoubleW& b) {
  return {mul_add(c.low, a.low, b.low), mul_add(c.high, a.high, b.high)};
}
DYNAMORPH_INLINE DoubleW mul_add(const DoubleW& c, double a, const DoubleW& b) {
  return {mul_add(c.low, a, b.low), mul_add(c.high, a, b.high)};
}

/// Numbers of an array, in single precision converted as they are read: GCC would read more, and take that apart.
DYNAMORPH_INLINE Double4 load_doubles(const double* from) { return load(from); }
DYNAMORPH_INLINE Double4 load_doubles(const float* from) {
#if defined(__FMA__)
  return Double4(_mm256_cvtps_pd(_mm_loadu_ps(from)));
#else
  return __builtin_convertvector(*reinterpret_cast<const UnalignedFloat4*>(from), Double4);
#endif
}
DYNAMORPH_INLINE DoubleW load_wide(const double* from) { return {load(from), load(from + 4)}; }
DYNAMORPH_INLINE DoubleW load_wide(const float* from) { return {load_doubles(from), load_doubles(from + 4)}; }

DYNAMORPH_INLINE DoubleW to_double(const Float8& from) {
#if defined(__FMA__)
  const __m256 all = __m256(from);
  return {Double4(_mm256_cvtps_pd(_mm256_castps256_ps128(all))),
          Double4(_mm256_cvtps_pd(_mm256_extractf128_ps(all, 1)))};
#else
  const Double8 all = __builtin_convertvector(from, Double8);
  return {__builtin_shufflevector(all, all, 0, 1, 2, 3), __builtin_shufflevector(all, all, 4, 5, 6, 7)};
#endif
}

}  // namespace dynamorph

#pragma GCC diagnostic pop
