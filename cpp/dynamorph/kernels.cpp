// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/kernels.hpp"

#include <cmath>

#include "dynamorph/lanes.hpp"

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
using FloatChunk = float __attribute__((vector_size(16), aligned(4), may_alias));
using Order = std::int64_t __attribute__((vector_size(32)));

DYNAMORPH_INLINE Chunk column(const float* A, int c) {
  return __builtin_convertvector(*reinterpret_cast<const FloatChunk*>(A + kChunk * c), Chunk);
}

/// The sum of each of four vectors.
DYNAMORPH_INLINE Chunk sums_of(const Chunk& a, const Chunk& b, const Chunk& c, const Chunk& d) {
  const Order even = {0, 4, 2, 6}, odd = {1, 5, 3, 7}, low = {0, 1, 4, 5}, high = {2, 3, 6, 7};
  const Chunk ab = __builtin_shuffle(a, b, even) + __builtin_shuffle(a, b, odd);
  const Chunk cd = __builtin_shuffle(c, d, even) + __builtin_shuffle(c, d, odd);
  return __builtin_shuffle(ab, cd, low) + __builtin_shuffle(ab, cd, high);
}

DYNAMORPH_MULTIVERSION
void symmetric(const float* __restrict A, Eigen::Index chunks, const double* __restrict x, double* __restrict y) {
  const Chunk* X = reinterpret_cast<const Chunk*>(x);
  Chunk* Y = reinterpret_cast<Chunk*>(y);
  for (Eigen::Index c = 0; c < chunks; ++c) {
    const double x0 = x[4 * c], x1 = x[4 * c + 1], x2 = x[4 * c + 2], x3 = x[4 * c + 3];
    Y[c] += column(A, 0) * x0 + column(A, 1) * x1 + (column(A, 2) * x2 + column(A, 3) * x3);
    A += kChunk * kChunk;
    Chunk s0 = {}, s1 = {}, s2 = {}, s3 = {};
    for (Eigen::Index i = c + 1; i < chunks; ++i, A += kChunk * kChunk) {
      const Chunk a0 = column(A, 0), a1 = column(A, 1), a2 = column(A, 2), a3 = column(A, 3);
      const Chunk xi = X[i];
      Y[i] += a0 * x0 + a1 * x1 + (a2 * x2 + a3 * x3);
      s0 += a0 * xi;
      s1 += a1 * xi;
      s2 += a2 * xi;
      s3 += a3 * xi;
    }
    Y[c] += sums_of(s0, s1, s2, s3);
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
  int k = 0;
  for (Eigen::Index i = 0; i < size; ++i) out[i] = float(weights[0]) * tables[0][i];
  for (k = 1; k + 2 <= count; k += 2) {
    const float *a = tables[k], *b = tables[k + 1];
    const float wa = float(weights[k]), wb = float(weights[k + 1]);
    for (Eigen::Index i = 0; i < size; ++i) out[i] += wa * a[i] + wb * b[i];
  }
  for (; k < count; ++k)
    for (Eigen::Index i = 0; i < size; ++i) out[i] += float(weights[k]) * tables[k][i];
}

/// Left-looking: column j less the earlier columns, then scaled.
DYNAMORPH_MULTIVERSION
bool cholesky(double* __restrict A, Eigen::Index n) {
  for (Eigen::Index j = 0; j < n; ++j) {
    double* column = A + j * n;
    Eigen::Index k = 0;
    for (; k + 4 <= j; k += 4) {
      const double *a0 = A + k * n, *a1 = a0 + n, *a2 = a1 + n, *a3 = a2 + n;
      const double x0 = a0[j], x1 = a1[j], x2 = a2[j], x3 = a3[j];
      for (Eigen::Index i = j; i < n; ++i) column[i] -= a0[i] * x0 + a1[i] * x1 + (a2[i] * x2 + a3[i] * x3);
    }
    for (; k < j; ++k)
      for (Eigen::Index i = j; i < n; ++i) column[i] -= A[k * n + i] * A[k * n + j];
    if (!(column[j] > 0) || !std::isfinite(column[j])) return false;
    const double scale = 1 / std::sqrt(column[j]);
    for (Eigen::Index i = j; i < n; ++i) column[i] *= scale;
  }
  return true;
}

DYNAMORPH_MULTIVERSION
void substitute(const double* __restrict L, Eigen::Index n, double* __restrict x) {
  for (Eigen::Index j = 0; j < n; ++j) {
    x[j] /= L[j * n + j];
    for (Eigen::Index i = j + 1; i < n; ++i) x[i] -= L[j * n + i] * x[j];
  }
  for (Eigen::Index j = n - 1; j >= 0; --j)
    x[j] = (x[j] - sum_products(L + j * n + j + 1, x + j + 1, n - j - 1)) / L[j * n + j];
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
  blend(tables, weights, count, size, out);
}

bool factorize(double* A, Eigen::Index n) { return cholesky(A, n); }

void solve_factorized(const double* L, Eigen::Index n, double* x) { substitute(L, n, x); }

}  // namespace dynamorph
