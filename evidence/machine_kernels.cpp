// SPDX-License-Identifier: GPL-3.0-or-later
#include "machine_kernels.hpp"

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

template <class Lane>
DYNAMORPH_INLINE double multiply_and_add(int rounds) {
  Lane sums[kChains] = {}, factor, term;
  for (size_t i = 0; i < sizeof(Lane) / sizeof factor[0]; ++i) factor[i] = 0.5, term[i] = 1;
  for (int k = 0; k < kChains; ++k) sums[k][0] = k;  // or the compiler would find that they are all the same
  for (int k = 0; k < rounds; ++k)
    for (Lane& sum : sums) sum = mul_add(term, sum, factor);
  double total = 0;
  for (Lane& sum : sums) total += sum[0];
  return total;
}

}  // namespace

double operate_on_floats(int rounds) { return multiply_and_add<Float8>(rounds); }
double operate_on_doubles(int rounds) { return multiply_and_add<Double4>(rounds); }

double read_through(const double* data, Index size) {
  Double4 sums[8] = {};
  for (Index i = 0; i + 32 <= size; i += 32)
    for (int k = 0; k < 8; ++k) sums[k] += load(data + i + 4 * k);
  double total = 0;
  for (const Double4& sum : sums) total += sum_of(sum);
  return total;
}

}  // namespace dynamorph::DYNAMORPH_ISA
