// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/eight_kernels.hpp"

#include "dynamorph/reduced/polynomial_kernels.hpp"

namespace dynamorph::DYNAMORPH_ISA {

void add_scaled(const DoubleW& a, const double* x, Index size, DoubleW* y) {
  for (Index i = 0; i < size; ++i) y[i] = mul_add(y[i], x[i], a);
}

void add_up(const DoubleW* mass, const DoubleW* damped, double inertial, double rate, Index size, DoubleW* damping,
            DoubleW* H) {
  for (Index p = 0; p < size; ++p) {
    damping[p] += damped[p];
    H[p] = mul_add(inertial * mass[p], rate, damping[p]);
  }
}

void packed_product(const DoubleW* __restrict S, const DoubleW* __restrict x, Index r, DoubleW* __restrict y) {
  for (Index k = 0; k < r; ++k) y[k] = DoubleW{};
  for (Index k = 0; k < r; ++k) {
    DoubleW sum = *S++ * x[k];
    for (Index l = k + 1; l < r; ++l, ++S) {
      sum = mul_add(sum, *S, x[l]);
      y[l] = mul_add(y[l], *S, x[k]);
    }
    y[k] += sum;
  }
}

void dot(const DoubleW* a, const DoubleW* b, Index size, DoubleW& out) {
  DoubleW sums[4] = {};  // independent, so that no addition waits for the one before
  Index i = 0;
  for (; i + 4 <= size; i += 4)
    for (int k = 0; k < 4; ++k) sums[k] = mul_add(sums[k], a[i + k], b[i + k]);
  for (; i < size; ++i) sums[0] = mul_add(sums[0], a[i], b[i]);
  out = (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

void expand(const DoubleW* q, const DoubleW* centre, Index r, FloatW* v, FloatW* pairs) {
  for (Index k = 0; k < r; ++k) to_single(q[k] - centre[k], v[k]);
  for (Index k = 0; k < r; ++k) {
    const FloatW twice = v[k] + v[k];
    *pairs++ = v[k] * v[k];
    for (Index l = k + 1; l < r; ++l) *pairs++ = twice * v[l];
  }
}

void add_orders(const float* __restrict table, Index rows, Index r, const FloatW& w, const FloatW* __restrict v,
                const FloatW* __restrict pairs, FloatW* __restrict product, FloatW* __restrict linear,
                FloatW* __restrict quadratic) {
  for (Index p = 0; p < rows; p += 4) {  // four sums at a time, so that no addition waits for the one before
    FloatW sums[4] = {};
    for (Index m = 0; m < r; ++m)
      for (int i = 0; i < 4; ++i) sums[i] = mul_add(sums[i], table[m * rows + p + i], v[m]);
    for (int i = 0; i < 4; ++i) linear[p + i] = mul_add(linear[p + i], w, sums[i]);
    for (int i = 0; i < 4; ++i) product[p + i] = FloatW{};
  }
  table += rows * r;
  const Index chunks = rows / kChunk;
  for (Index panel = 0; panel < 2 * chunks; ++panel) {  // of four columns
    const FloatW x0 = pairs[4 * panel], x1 = pairs[4 * panel + 1], x2 = pairs[4 * panel + 2], x3 = pairs[4 * panel + 3];
    FloatW s0 = {}, s1 = {}, s2 = {}, s3 = {};
    const Index diagonal = panel / 2;
    for (Index chunk = diagonal; chunk < chunks; ++chunk, table += 4 * kChunk) {
      const bool whole = chunk == diagonal;  // stored in full, so counted once
      for (Index i = 0; i < kChunk; ++i) {
        const float a0 = table[i], a1 = table[kChunk + i], a2 = table[2 * kChunk + i], a3 = table[3 * kChunk + i];
        product[kChunk * chunk + i] += mul_add(a0 * x0, a1, x1) + mul_add(a2 * x2, a3, x3);
        if (whole) continue;
        const FloatW x = pairs[kChunk * chunk + i];
        s0 = mul_add(s0, a0, x);
        s1 = mul_add(s1, a1, x);
        s2 = mul_add(s2, a2, x);
        s3 = mul_add(s3, a3, x);
      }
    }
    product[4 * panel] += s0;
    product[4 * panel + 1] += s1;
    product[4 * panel + 2] += s2;
    product[4 * panel + 3] += s3;
  }
  for (Index p = 0; p < rows; ++p) quadratic[p] = mul_add(quadratic[p], w, product[p]);
}

void contract(const DoubleW* constant, const FloatW* linear, const FloatW* quadratic, const DoubleW* q,
              const DoubleW* centre, const DoubleW* rest_force, Index r, DoubleW* force, DoubleW* tangent,
              DoubleW& energy) {
  energy = DoubleW{};
  for (Index k = 0; k < r; ++k) {
    force[k] = rest_force[k];
    energy = mul_add(energy, rest_force[k], q[k] - centre[k]);
  }
  for (Index k = 0; k < r; ++k) {
    const DoubleW own = q[k] - centre[k];
    for (Index l = k; l < r; ++l, ++constant, ++linear, ++quadratic, ++tangent) {
      const DoubleW a = to_double(*linear), b = to_double(*quadratic);
      const DoubleW other = q[l] - centre[l], f = mul_add(mul_add(*constant, 1 / 2., a), 1 / 3., b);
      *tangent = *constant + a + b;
      force[k] = mul_add(force[k], f, other);
      if (l > k) force[l] = mul_add(force[l], f, own);
      const DoubleW weighted = mul_add(mul_add(*constant, 1 / 3., a), 1 / 6., b);
      energy = mul_add(energy, (l > k ? 1 : 0.5) * weighted * own, other);
    }
  }
}

void factorize(DoubleW* V, Index r, DoubleW* inverse) {
  for (Index j = 0; j < r; ++j) {
    DoubleW* own = V + j * r - j * (j - 1) / 2 - j;  // entry i of column j is own[i]
    const DoubleW* earlier = V;
    for (Index k = 0; k < j; earlier += r - k, ++k) {
      const DoubleW* column = earlier - k;
      const DoubleW x = column[j] * inverse[k];
      for (Index i = j; i < r; ++i) own[i] = mul_sub(own[i], column[i], x);
    }
    inverse[j] = 1 / own[j];
  }
}

void substitute(const DoubleW* V, const DoubleW* inverse, Index r, DoubleW* x) {
  for (Index j = 0; j < r; ++j) {
    const DoubleW* column = V + j * r - j * (j - 1) / 2 - j;
    const DoubleW own = x[j] * inverse[j];
    for (Index i = j + 1; i < r; ++i) x[i] = mul_sub(x[i], column[i], own);
  }
  for (Index j = r - 1; j >= 0; --j) {
    const DoubleW* column = V + j * r - j * (j - 1) / 2 - j;
    DoubleW sum = x[j];
    for (Index i = j + 1; i < r; ++i) sum = mul_sub(sum, column[i], x[i]);
    x[j] = sum * inverse[j];
  }
}

bool all_finite(const double* transforms, const int* bones, Index count) {
  double nothing[4] = {};
  for (Index b = 0; b < count; ++b)
    for (int e = 0; e < 12; ++e) nothing[e % 4] += 0 * transforms[12 * bones[b] + e];  // NaN if the entry is not finite
  return nothing[0] + nothing[1] + nothing[2] + nothing[3] == 0;
}

void add_jump(const DoubleW* now, const DoubleW* last, const DoubleW* before, const double* moments,
              const double* centre, DoubleW& jump) {
  for (int i = 0; i < 3; ++i) {
    DoubleW off[4];
    for (int j = 0; j < 4; ++j) off[j] = now[4 * i + j] - 2 * last[4 * i + j] + before[4 * i + j];
    off[3] += off[0] * centre[0] + off[1] * centre[1] + off[2] * centre[2];
    for (int j = 0; j < 4; ++j)
      for (int k = 0; k < 4; ++k) jump = mul_add(jump, moments[4 * j + k] * off[j], off[k]);
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
