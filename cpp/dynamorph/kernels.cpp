// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/kernels.hpp"

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__)
#define DYNAMORPH_MULTIVERSION __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define DYNAMORPH_MULTIVERSION
#endif

namespace dynamorph {

namespace {

template <class Real>
inline __attribute__((always_inline)) void sum_columns(const Real* __restrict A, Eigen::Index rows,
                                                       const double* __restrict x, Eigen::Index columns,
                                                       double* __restrict y) {
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
inline __attribute__((always_inline)) double sum_products(const double* __restrict a, const double* __restrict b,
                                                          Eigen::Index size) {
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

DYNAMORPH_MULTIVERSION
void symmetric(const double* __restrict A, Eigen::Index size, const double* __restrict x, double* __restrict y) {
  for (Eigen::Index c = 0; c < size; A += size - c, ++c) {  // column c from the diagonal down
    const double xc = x[c];
    const double above = sum_products(A + 1, x + c + 1, size - c - 1);
    for (Eigen::Index i = 0; i < size - c; ++i) y[c + i] += A[i] * xc;
    y[c] += above;
  }
}

}  // namespace

void add_product(const double* A, Eigen::Index rows, const double* x, Eigen::Index count, double* y) {
  columns(A, rows, x, count, y);
}

void add_product(const float* A, Eigen::Index rows, const double* x, Eigen::Index count, double* y) {
  columns(A, rows, x, count, y);
}

void add_symmetric_product(const double* A, Eigen::Index size, const double* x, double* y) { symmetric(A, size, x, y); }

void transposed_product(const MatrixXd& A, const double* x, double* y) {
  for (Eigen::Index c = 0; c < A.cols(); ++c) y[c] = dot(A.data() + c * A.rows(), x, A.rows());
}

}  // namespace dynamorph
