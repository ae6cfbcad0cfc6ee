// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/polynomial_kernels.hpp"

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

template <class Real>
DYNAMORPH_INLINE void sum_columns(const Real* __restrict A, Index rows, const double* __restrict x, Index columns,
                                  double* __restrict y) {
  Index c = 0;
  for (; c + 4 <= columns; c += 4) {  // four columns per sweep: y is loaded and stored a quarter as often
    const Real *a0 = A + c * rows, *a1 = a0 + rows, *a2 = a1 + rows, *a3 = a2 + rows;
    const double x0 = x[c], x1 = x[c + 1], x2 = x[c + 2], x3 = x[c + 3];
    Index i = 0;
    for (; i + 4 <= rows; i += 4)
      store(mul_add(mul_add(load(y + i), x0, load_doubles(a0 + i)), x1, load_doubles(a1 + i)) +
                mul_add(x2 * load_doubles(a2 + i), x3, load_doubles(a3 + i)),
            y + i);
    for (; i < rows; ++i)
      y[i] = mul_add(mul_add(y[i], double(a0[i]), x0), double(a1[i]), x1) + mul_add(a2[i] * x2, double(a3[i]), x3);
  }
  for (; c < columns; ++c)
    for (Index i = 0; i < rows; ++i) y[i] = mul_add(y[i], double(A[c * rows + i]), x[c]);
}

/// Uses independent sums, because the compiler may not reassociate a single one.
DYNAMORPH_INLINE double dot(const double* __restrict a, const double* __restrict b, Index size) {
  Double4 sums[4] = {};
  Index i = 0;
  for (; i + 16 <= size; i += 16)
    for (int k = 0; k < 4; ++k) sums[k] = mul_add(sums[k], load(a + i + 4 * k), load(b + i + 4 * k));
  double sum = 0;
  for (; i < size; ++i) sum = mul_add(sum, a[i], b[i]);
  return sum + sum_of((sums[0] + sums[1]) + (sums[2] + sums[3]));
}

/// The sum of each of four vectors.
DYNAMORPH_INLINE Double4 sums_of(const Double4* v) {
  const Double4 ab = __builtin_shufflevector(v[0], v[1], 0, 4, 2, 6) + __builtin_shufflevector(v[0], v[1], 1, 5, 3, 7);
  const Double4 cd = __builtin_shufflevector(v[2], v[3], 0, 4, 2, 6) + __builtin_shufflevector(v[2], v[3], 1, 5, 3, 7);
  return __builtin_shufflevector(ab, cd, 0, 1, 4, 5) + __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
}

/// constant + linear / f + quadratic / g.
template <class Real>
DYNAMORPH_INLINE Real weighted(const Real& constant, const Real& linear, const Real& quadratic, double f, double g) {
  return mul_add(mul_add(constant, 1 / f, linear), 1 / g, quadratic);
}

constexpr int kTogether = kManyRegisters ? 3 : 1;  ///< pairs of modes that `couple` takes together

/// `couple` for a mode k and kPairs modes after it, or for k itself (kSame): they share what is loaded of k and y.
template <int kPairs, bool kSame>
DYNAMORPH_INLINE void couple_pairs(const float* S, Index h, double vk, const double* v, const double* y, double* slope,
                                   double* others, double* products) {
  DoubleW sums[kPairs] = {};
  for (Index i = 0; i < h; i += kChunk) {
    DoubleW own = load_wide(slope + i);
    const DoubleW answer = load_wide(y + i);
    for (int l = 0; l < kPairs; ++l) {
      const DoubleW entries = load_wide(S + l * h + i);
      sums[l] = mul_add(sums[l], entries, answer);
      own = mul_add(own, kSame ? vk : v[l], entries);
      if (kSame) continue;
      double* other = others + l * h + i;
      store(mul_add(load(other), vk, entries.low), other);
      store(mul_add(load(other + 4), vk, entries.high), other + 4);
    }
    store(own.low, slope + i);
    store(own.high, slope + i + 4);
  }
  for (int l = 0; l < kPairs; ++l) products[l] = sum_of(sums[l].low + sums[l].high);
}

}  // namespace

void add_product(const double* A, Index rows, const double* x, Index columns, double* y) {
  sum_columns(A, rows, x, columns, y);
}

void add_single_product(const float* A, Index rows, const double* x, Index columns, double* y) {
  sum_columns(A, rows, x, columns, y);
}

void add_dots(const double* A, Index rows, Index columns, const double* x, double* y) {
  for (Index c = 0; c < columns; ++c) y[c] += dot(A + c * rows, x, rows);
}

void add_symmetric_product(const float* __restrict A, Index size, const double* __restrict x, double* __restrict y) {
  const Index chunks = size / kChunk;
  for (Index panel = 0; panel < 2 * chunks; ++panel) {  // of four columns
    const Index diagonal = panel / 2;
    Double4 sums[4] = {};
    for (Index i = diagonal; i < chunks; ++i, A += 4 * kChunk) {
      double* to = y + kChunk * i;
      const Double4 x_low = load(x + kChunk * i), x_high = load(x + kChunk * i + 4);
      Double4 low = load(to), high = load(to + 4);
      for (int c = 0; c < 4; ++c) {
        const DoubleW entries = load_wide(A + kChunk * c);
        low = mul_add(low, x[4 * panel + c], entries.low);
        high = mul_add(high, x[4 * panel + c], entries.high);
        if (i == diagonal) continue;  // stored in full
        sums[c] = mul_add(sums[c], entries.low, x_low);
        sums[c] = mul_add(sums[c], entries.high, x_high);
      }
      store(low, to);
      store(high, to + 4);
    }
    store(load(y + 4 * panel) + sums_of(sums), y + 4 * panel);
  }
}

void add_short_product(const float* __restrict A, Index rows, const float* __restrict x, Index columns,
                       double* __restrict y) {
  for (Index i = 0; i < rows; i += kChunk) {
    DoubleW sum = {load(y + i), load(y + i + 4)};
    for (Index c = 0; c < columns; c += 4) {
      Float8 block = {};
      for (Index k = c; k < columns && k < c + 4; ++k) block = mul_add(block, x[k], load(A + k * rows + i));
      sum += to_double(block);
    }
    store(sum.low, y + i);
    store(sum.high, y + i + 4);
  }
}

void multiply_row_blocks(const float* __restrict A, Index blocks, const float* __restrict x, Index columns,
                         double* __restrict y) {
  for (Index block = 0; block < blocks; ++block, y += kRowBlock) {
    Float8 even[4] = {}, odd[4] = {};  // so many that no sum waits for itself
    Index c = 0;
    for (; c + 2 <= columns; c += 2, A += 2 * kRowBlock)
      for (int i = 0; i < 4; ++i) {
        even[i] = mul_add(even[i], x[c], load(A + kChunk * i));
        odd[i] = mul_add(odd[i], x[c + 1], load(A + kRowBlock + kChunk * i));
      }
    for (; c < columns; ++c, A += kRowBlock)
      for (int i = 0; i < 4; ++i) even[i] = mul_add(even[i], x[c], load(A + kChunk * i));
    for (int i = 0; i < 4; ++i) {
      const DoubleW sum = to_double(even[i] + odd[i]);
      store(sum.low, y + kChunk * i);
      store(sum.high, y + kChunk * i + 4);
    }
  }
}

void multiply_row_blocks_twice(const float* __restrict A, Index blocks, const float* __restrict x, Index columns,
                               double* __restrict y) {
  for (Index block = 0; block < blocks; ++block, y += kRowBlock) {
    Float8 first[4] = {}, second[4] = {};
    for (Index c = 0; c < columns; ++c, A += kRowBlock)
      for (int i = 0; i < 4; ++i) {
        const Float8 rows = load(A + kChunk * i);
        first[i] = mul_add(first[i], x[2 * c], rows);
        second[i] = mul_add(second[i], x[2 * c + 1], rows);
      }
    for (int i = 0; i < 4; ++i) {
      const DoubleW one = to_double(first[i]), two = to_double(second[i]);
      store(one.low, y + kChunk * i);
      store(one.high, y + kChunk * i + 4);
      store(two.low, y + kRowBlock * blocks + kChunk * i);
      store(two.high, y + kRowBlock * blocks + kChunk * i + 4);
    }
  }
}

void add_short_symmetric_product(const float* __restrict A, Index size, const float* __restrict x,
                                 double* __restrict y) {
  const Index chunks = size / kChunk;
  for (Index panel = 0; panel < 2 * chunks; ++panel) {  // of four columns
    const Index diagonal = panel / 2;
    const float* entries = x + 4 * panel;
    Float8 sums[4] = {};
    for (Index i = diagonal; i < chunks; ++i, A += 4 * kChunk) {
      const Float8 x8 = load(x + kChunk * i),
                   columns[4] = {load(A), load(A + kChunk), load(A + 2 * kChunk), load(A + 3 * kChunk)};
      Float8 block = entries[0] * columns[0];
      for (int c = 1; c < 4; ++c) block = mul_add(block, entries[c], columns[c]);
      if (i > diagonal)  // the diagonal chunk is stored in full
        for (int c = 0; c < 4; ++c) sums[c] = mul_add(sums[c], columns[c], x8);
      const DoubleW added = to_double(block);
      double* to = y + kChunk * i;
      store(load(to) + added.low, to);
      store(load(to + 4) + added.high, to + 4);
    }
    Double4 halves[4];
    for (int c = 0; c < 4; ++c) {
      const DoubleW sum = to_double(sums[c]);
      halves[c] = sum.low + sum.high;
    }
    store(load(y + 4 * panel) + sums_of(halves), y + 4 * panel);
  }
}

double contract_orders(const double* __restrict constant, const double* __restrict linear,
                       const double* __restrict quadratic, const double* __restrict v, Index r,
                       double* __restrict force, double* __restrict stiffness) {
  double energy = 0;
  for (Index k = 0; k < r; ++k) force[k] = 0;
  for (Index k = 0; k < r; constant += r - k, linear += r - k, quadratic += r - k, ++k) {
    double* column = stiffness + k * r + k;
    Double4 f4 = {}, e4 = {};
    Index i = 1;
    for (; i + 4 <= r - k; i += 4) {
      const Double4 c = load(constant + i), l = load(linear + i), q = load(quadratic + i), x = load(v + k + i);
      const Double4 secant = weighted(c, l, q, 2, 3);
      store(c + l + q, column + i);
      store(mul_add(load(force + k + i), v[k], secant), force + k + i);
      f4 = mul_add(f4, secant, x);
      e4 = mul_add(e4, weighted(c, l, q, 3, 6), x);
    }
    double f = sum_of(f4), e = sum_of(e4);
    for (; i < r - k; ++i) {
      const double secant = weighted(constant[i], linear[i], quadratic[i], 2, 3);
      column[i] = constant[i] + linear[i] + quadratic[i];
      force[k + i] = mul_add(force[k + i], v[k], secant);
      f = mul_add(f, secant, v[k + i]);
      e = mul_add(e, weighted(constant[i], linear[i], quadratic[i], 3, 6), v[k + i]);
    }
    column[0] = *constant + *linear + *quadratic;
    force[k] += mul_add(f, weighted(*constant, *linear, *quadratic, 2, 3), v[k]);
    energy += v[k] * mul_add(e, 0.5 * weighted(*constant, *linear, *quadratic, 3, 6), v[k]);
  }
  for (Index k = 0; k < r; ++k)
    for (Index l = k + 1; l < r; ++l) stiffness[l * r + k] = stiffness[k * r + l];
  return energy;
}

void blend_tables(const float* const* __restrict tables, const double* __restrict weights, int count, Index size,
                  float* __restrict out) {
  constexpr Index kBlock = 1024;  // what is written stays in the cache while all tables are added
  for (Index begin = 0; begin < size; begin += kBlock) {
    const Index end = begin + kBlock < size ? begin + kBlock : size;
    for (Index i = begin; i < end; ++i) out[i] = 0;
    int k = 0;
    for (; k + 3 <= count; k += 3) {
      const float *a = tables[k], *b = tables[k + 1], *c = tables[k + 2];
      const float wa = float(weights[k]), wb = float(weights[k + 1]), wc = float(weights[k + 2]);
      for (Index i = begin; i < end; ++i) out[i] = mul_add(mul_add(mul_add(out[i], wa, a[i]), wb, b[i]), wc, c[i]);
    }
    for (; k < count; ++k)
      for (Index i = begin; i < end; ++i) out[i] = mul_add(out[i], float(weights[k]), tables[k][i]);
  }
}

void couple(const float* __restrict S, Index h, Index r, const double* __restrict v, const double* __restrict y,
            double* __restrict slopes, double* __restrict products) {
  for (Index k = 0; k < r; ++k) {
    couple_pairs<1, true>(S, h, v[k], v + k, y, slopes + k * h, slopes + k * h, products);
    Index l = k + 1;
    S += h, ++products;
    for (; l + kTogether <= r; l += kTogether, S += kTogether * h, products += kTogether)
      couple_pairs<kTogether, false>(S, h, v[k], v + l, y, slopes + k * h, slopes + l * h, products);
    for (; l < r; ++l, S += h, ++products)
      couple_pairs<1, false>(S, h, v[k], v + l, y, slopes + k * h, slopes + l * h, products);
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
