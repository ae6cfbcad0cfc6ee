// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/kernels.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

namespace {

template <class Real>
DYNAMORPH_INLINE void sum_columns(const Real* __restrict A, Eigen::Index rows, const double* __restrict x,
                                  Eigen::Index columns, double* __restrict y) {
  Eigen::Index c = 0;
  for (; c + 4 <= columns; c += 4) {  // four columns a sweep: y is loaded and stored a quarter as often
    const Real *a0 = A + c * rows, *a1 = a0 + rows, *a2 = a1 + rows, *a3 = a2 + rows;
    const double x0 = x[c], x1 = x[c + 1], x2 = x[c + 2], x3 = x[c + 3];
    for (Eigen::Index i = 0; i < rows; ++i) y[i] += a0[i] * x0 + a1[i] * x1 + (a2[i] * x2 + a3[i] * x3);
  }
  for (; c < columns; ++c)
    for (Eigen::Index i = 0; i < rows; ++i) y[i] += A[c * rows + i] * x[c];
}

DYNAMORPH_MULTIVERSION
void columns(const double* __restrict A, Eigen::Index rows, const double* __restrict x, Eigen::Index columns,
             double* __restrict y) {
  sum_columns(A, rows, x, columns, y);
}

DYNAMORPH_MULTIVERSION
void columns(const float* __restrict A, Eigen::Index rows, const double* __restrict x, Eigen::Index columns,
             double* __restrict y) {
  sum_columns(A, rows, x, columns, y);
}

/// Independent sums, because the compiler may not reassociate one.
DYNAMORPH_INLINE double sum_products(const double* __restrict a, const double* __restrict b, Eigen::Index size) {
  double sums[16] = {};
  Eigen::Index i = 0;
  for (; i + 16 <= size; i += 16)
    for (int k = 0; k < 16; ++k) sums[k] += a[i + k] * b[i + k];
  double sum = 0;
  for (; i < size; ++i) sum += a[i] * b[i];
  for (int k = 0; k < 16; ++k) sum += sums[k];
  return sum;
}

DYNAMORPH_MULTIVERSION
double dot(const double* __restrict a, const double* __restrict b, Eigen::Index size) {
  return sum_products(a, b, size);
}

using Chunk = double __attribute__((vector_size(32), aligned(8), may_alias));
using SingleChunk = float __attribute__((vector_size(32), may_alias));
using Order = std::int64_t __attribute__((vector_size(32)));

/// Eight entries of a column.
DYNAMORPH_INLINE Doubles column(const float* A, int c) {
  const Floats entries = *reinterpret_cast<const SingleChunk*>(A + kChunk * c);
  return to_double(entries);
}

/// The sum of each of four vectors.
DYNAMORPH_INLINE Chunk sums_of(const Chunk* v) {
  const Order even = {0, 4, 2, 6}, odd = {1, 5, 3, 7}, low = {0, 1, 4, 5}, high = {2, 3, 6, 7};
  const Chunk ab = __builtin_shuffle(v[0], v[1], even) + __builtin_shuffle(v[0], v[1], odd);
  const Chunk cd = __builtin_shuffle(v[2], v[3], even) + __builtin_shuffle(v[2], v[3], odd);
  return __builtin_shuffle(ab, cd, low) + __builtin_shuffle(ab, cd, high);
}

DYNAMORPH_MULTIVERSION
void symmetric(const float* __restrict A, Eigen::Index chunks, const double* __restrict x, double* __restrict y) {
  const Chunk* X = reinterpret_cast<const Chunk*>(x);
  Chunk* Y = reinterpret_cast<Chunk*>(y);
  for (Eigen::Index panel = 0; panel < 2 * chunks; ++panel) {  // of four columns
    const Eigen::Index diagonal = panel / 2;
    Chunk sums[4] = {};
    for (Eigen::Index i = diagonal; i < chunks; ++i, A += 4 * kChunk) {
      Chunk below = Y[2 * i], above = Y[2 * i + 1];
      for (int c = 0; c < 4; ++c) {
        const Doubles entries = column(A, c);
        below += entries.low * x[4 * panel + c];
        above += entries.high * x[4 * panel + c];
        if (i == diagonal) continue;  // stored whole
        sums[c] += entries.low * X[2 * i];
        sums[c] += entries.high * X[2 * i + 1];
      }
      Y[2 * i] = below;
      Y[2 * i + 1] = above;
    }
    Y[panel] += sums_of(sums);
  }
}

DYNAMORPH_MULTIVERSION
double contract(const double* __restrict constant, const double* __restrict linear, const double* __restrict quadratic,
                const double* __restrict v, Eigen::Index r, double* __restrict force, double* __restrict stiffness) {
  double energy = 0;
  for (Eigen::Index k = 0; k < r; ++k) force[k] = 0;
  for (Eigen::Index k = 0; k < r; constant += r - k, linear += r - k, quadratic += r - k, ++k) {
    double* column = stiffness + k * r + k;
    double f[4] = {}, e[4] = {};  // of four entries in turn: independent sums
    for (Eigen::Index i = 0; i < r - k; ++i) column[i] = constant[i] + linear[i] + quadratic[i];
    for (Eigen::Index i = 1; i < r - k; ++i)
      force[k + i] += (constant[i] + 1 / 2. * linear[i] + 1 / 3. * quadratic[i]) * v[k];
    Eigen::Index i = 1;
    for (; i + 4 <= r - k; i += 4)
      for (int lane = 0; lane < 4; ++lane) {
        const double c = constant[i + lane], l = linear[i + lane], q = quadratic[i + lane], x = v[k + i + lane];
        f[lane] += (c + 1 / 2. * l + 1 / 3. * q) * x;
        e[lane] += (c + 1 / 3. * l + 1 / 6. * q) * x;
      }
    for (; i < r - k; ++i) {
      f[0] += (constant[i] + 1 / 2. * linear[i] + 1 / 3. * quadratic[i]) * v[k + i];
      e[0] += (constant[i] + 1 / 3. * linear[i] + 1 / 6. * quadratic[i]) * v[k + i];
    }
    force[k] += (f[0] + f[1]) + (f[2] + f[3]) + (*constant + 1 / 2. * *linear + 1 / 3. * *quadratic) * v[k];
    energy +=
        v[k] * ((e[0] + e[1]) + (e[2] + e[3]) + 1 / 2. * (*constant + 1 / 3. * *linear + 1 / 6. * *quadratic) * v[k]);
  }
  for (Eigen::Index k = 0; k < r; ++k)
    for (Eigen::Index l = k + 1; l < r; ++l) stiffness[l * r + k] = stiffness[k * r + l];
  return energy;
}

DYNAMORPH_MULTIVERSION
void blend(const float* const* __restrict tables, const double* __restrict weights, int count, Eigen::Index size,
           float* __restrict out) {
  for (Eigen::Index i = 0; i < size; ++i) out[i] = float(weights[0]) * tables[0][i];
  int k = 1;
  for (; k + 2 <= count; k += 2) {
    const float *a = tables[k], *b = tables[k + 1];
    const float wa = float(weights[k]), wb = float(weights[k + 1]);
    for (Eigen::Index i = 0; i < size; ++i) out[i] += wa * a[i] + wb * b[i];
  }
  for (; k < count; ++k)
    for (Eigen::Index i = 0; i < size; ++i) out[i] += float(weights[k]) * tables[k][i];
}

}  // namespace

void add_product(const double* A, Eigen::Index rows, const double* x, Eigen::Index count, double* y) {
  columns(A, rows, x, count, y);
}

void add_product(const float* A, Eigen::Index rows, const double* x, Eigen::Index count, double* y) {
  columns(A, rows, x, count, y);
}

void add_symmetric_product(const float* A, Eigen::Index size, const double* x, double* y) {
  symmetric(A, size / kChunk, x, y);
}

void transposed_product(const MatrixXd& A, const double* x, double* y) {
  for (Eigen::Index c = 0; c < A.cols(); ++c) y[c] = dot(A.data() + c * A.rows(), x, A.rows());
}

double contract_orders(const double* constant, const double* linear, const double* quadratic, const double* v,
                       Eigen::Index r, double* force, double* stiffness) {
  return contract(constant, linear, quadratic, v, r, force, stiffness);
}

void blend_tables(const float* const* tables, const double* weights, int count, Eigen::Index size, float* out) {
  if (count == 0) {
    std::fill_n(out, size, 0.0F);
    return;
  }
  blend(tables, weights, count, size, out);
}

}  // namespace dynamorph
