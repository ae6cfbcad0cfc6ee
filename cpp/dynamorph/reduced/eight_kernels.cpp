// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/eight_kernels.hpp"

#include "dynamorph/reduced/polynomial_kernels.hpp"

namespace dynamorph::DYNAMORPH_ISA {

void add_scaled(const Doubles& a, const double* x, Index size, Doubles* y) {
  for (Index i = 0; i < size; ++i) y[i] = mul_add(y[i], x[i], a);
}

void add_up(const Doubles* mass, const Doubles* damped, double inertial, double rate, Index size, Doubles* damping,
            Doubles* H) {
  for (Index p = 0; p < size; ++p) {
    damping[p] += damped[p];
    H[p] = mul_add(inertial * mass[p], rate, damping[p]);
  }
}

void packed_product(const Doubles* __restrict S, const Doubles* __restrict x, Index r, Doubles* __restrict y) {
  for (Index k = 0; k < r; ++k) y[k] = Doubles{};
  for (Index k = 0; k < r; ++k) {
    Doubles sum = *S++ * x[k];
    for (Index l = k + 1; l < r; ++l, ++S) {
      sum = mul_add(sum, *S, x[l]);
      y[l] = mul_add(y[l], *S, x[k]);
    }
    y[k] += sum;
  }
}

void dot(const Doubles* a, const Doubles* b, Index size, Doubles& out) {
  Doubles sums[4] = {};  // independent, or each addition would wait for the one before
  Index i = 0;
  for (; i + 4 <= size; i += 4)
    for (int k = 0; k < 4; ++k) sums[k] = mul_add(sums[k], a[i + k], b[i + k]);
  for (; i < size; ++i) sums[0] = mul_add(sums[0], a[i], b[i]);
  out = (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

void expand(const Doubles* q, const Doubles* centre, Index r, Floats* v, Floats* pairs) {
  for (Index k = 0; k < r; ++k) to_single(q[k] - centre[k], v[k]);
  for (Index k = 0; k < r; ++k) {
    const Floats twice = v[k] + v[k];
    *pairs++ = v[k] * v[k];
    for (Index l = k + 1; l < r; ++l) *pairs++ = twice * v[l];
  }
}

void add_orders(const float* __restrict table, Index rows, Index r, const Floats& w, const Floats* __restrict v,
                const Floats* __restrict pairs, Floats* __restrict product, Floats* __restrict linear,
                Floats* __restrict quadratic) {
  for (Index p = 0; p < rows; p += 4) {  // four sums at a time, or each addition would wait for the one before
    Floats sums[4] = {};
    for (Index m = 0; m < r; ++m)
      for (int i = 0; i < 4; ++i) sums[i] = mul_add(sums[i], table[m * rows + p + i], v[m]);
    for (int i = 0; i < 4; ++i) linear[p + i] = mul_add(linear[p + i], w, sums[i]);
    for (int i = 0; i < 4; ++i) product[p + i] = Floats{};
  }
  table += rows * r;
  const Index chunks = rows / kChunk;
  for (Index panel = 0; panel < 2 * chunks; ++panel) {  // of four columns
    const Floats x0 = pairs[4 * panel], x1 = pairs[4 * panel + 1], x2 = pairs[4 * panel + 2], x3 = pairs[4 * panel + 3];
    Floats s0 = {}, s1 = {}, s2 = {}, s3 = {};
    const Index diagonal = panel / 2;
    for (Index chunk = diagonal; chunk < chunks; ++chunk, table += 4 * kChunk) {
      const bool whole = chunk == diagonal;  // stored whole, and so counted once
      for (Index i = 0; i < kChunk; ++i) {
        const float a0 = table[i], a1 = table[kChunk + i], a2 = table[2 * kChunk + i], a3 = table[3 * kChunk + i];
        product[kChunk * chunk + i] += mul_add(a0 * x0, a1, x1) + mul_add(a2 * x2, a3, x3);
        if (whole) continue;
        const Floats x = pairs[kChunk * chunk + i];
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

void contract(const Doubles* constant, const Floats* linear, const Floats* quadratic, const Doubles* q,
              const Doubles* centre, const Doubles* rest_force, Index r, Doubles* force, Doubles* tangent,
              Doubles& energy) {
  energy = Doubles{};
  for (Index k = 0; k < r; ++k) {
    force[k] = rest_force[k];
    energy = mul_add(energy, rest_force[k], q[k] - centre[k]);
  }
  for (Index k = 0; k < r; ++k) {
    const Doubles own = q[k] - centre[k];
    for (Index l = k; l < r; ++l, ++constant, ++linear, ++quadratic, ++tangent) {
      const Doubles a = to_double(*linear), b = to_double(*quadratic);
      const Doubles other = q[l] - centre[l], f = mul_add(mul_add(*constant, 1 / 2., a), 1 / 3., b);
      *tangent = *constant + a + b;
      force[k] = mul_add(force[k], f, other);
      if (l > k) force[l] = mul_add(force[l], f, own);
      const Doubles weighted = mul_add(mul_add(*constant, 1 / 3., a), 1 / 6., b);
      energy = mul_add(energy, (l > k ? 1 : 0.5) * weighted * own, other);
    }
  }
}

void factorize(Doubles* V, Index r, Doubles* inverse) {
  for (Index j = 0; j < r; ++j) {
    Doubles* own = V + j * r - j * (j - 1) / 2 - j;  // entry i of column j is own[i]
    const Doubles* earlier = V;
    for (Index k = 0; k < j; earlier += r - k, ++k) {
      const Doubles* column = earlier - k;
      const Doubles x = column[j] * inverse[k];
      for (Index i = j; i < r; ++i) own[i] = mul_sub(own[i], column[i], x);
    }
    inverse[j] = 1 / own[j];
  }
}

void substitute(const Doubles* V, const Doubles* inverse, Index r, Doubles* x) {
  for (Index j = 0; j < r; ++j) {
    const Doubles* column = V + j * r - j * (j - 1) / 2 - j;
    const Doubles own = x[j] * inverse[j];
    for (Index i = j + 1; i < r; ++i) x[i] = mul_sub(x[i], column[i], own);
  }
  for (Index j = r - 1; j >= 0; --j) {
    const Doubles* column = V + j * r - j * (j - 1) / 2 - j;
    Doubles sum = x[j];
    for (Index i = j + 1; i < r; ++i) sum = mul_sub(sum, column[i], x[i]);
    x[j] = sum * inverse[j];
  }
}

bool all_finite(const double* transforms, const int* bones, Index count) {
  double nothing[4] = {};
  for (Index b = 0; b < count; ++b)
    for (int e = 0; e < 12; ++e) nothing[e % 4] += 0 * transforms[12 * bones[b] + e];  // not a number if that is not
  return nothing[0] + nothing[1] + nothing[2] + nothing[3] == 0;
}

void add_jump(const Doubles* now, const Doubles* last, const Doubles* before, const double* moments,
              const double* centre, Doubles& jump) {
  for (int i = 0; i < 3; ++i) {
    Doubles off[4];
    for (int j = 0; j < 4; ++j) off[j] = now[4 * i + j] - 2 * last[4 * i + j] + before[4 * i + j];
    off[3] += off[0] * centre[0] + off[1] * centre[1] + off[2] * centre[2];
    for (int j = 0; j < 4; ++j)
      for (int k = 0; k < 4; ++k) jump = mul_add(jump, moments[4 * j + k] * off[j], off[k]);
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
