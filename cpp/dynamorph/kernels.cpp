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
inline __attribute__((always_inline)) void sum_columns(const Real* __restrict A, Eigen::Index rows, const double* __restrict x, Eigen::Index columns,
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
void add_columns(const double* __restrict A, Eigen::Index rows, const double* __restrict x, Eigen::Index columns,
                 double* __restrict y) {
  sum_columns(A, rows, x, columns, y);
}

DYNAMORPH_MULTIVERSION
void add_columns(const float* __restrict A, Eigen::Index rows, const double* __restrict x, Eigen::Index columns,
                 double* __restrict y) {
  sum_columns(A, rows, x, columns, y);
}

DYNAMORPH_MULTIVERSION
double dot(const double* __restrict a, const double* __restrict b, Eigen::Index size) {
  double sums[16] = {};  // independent sums vectorise without reassociating the whole
  Eigen::Index i = 0;
  for (; i + 16 <= size; i += 16)
    for (int k = 0; k < 16; ++k) sums[k] += a[i + k] * b[i + k];
  double sum = 0;
  for (; i < size; ++i) sum += a[i] * b[i];
  for (int k = 0; k < 16; ++k) sum += sums[k];
  return sum;
}

DYNAMORPH_MULTIVERSION
void axpy(double s, const double* __restrict x, Eigen::Index size, double* __restrict y) {
  for (Eigen::Index i = 0; i < size; ++i) y[i] += s * x[i];
}

}  // namespace

void add_product(const MatrixXd& A, Eigen::Index first_column, const double* x, Eigen::Index columns, double* y) {
  add_columns(A.data() + first_column * A.rows(), A.rows(), x, columns, y);
}

void add_product(const Eigen::MatrixXf& A, Eigen::Index first_column, const double* x, Eigen::Index columns, double* y) {
  add_columns(A.data() + first_column * A.rows(), A.rows(), x, columns, y);
}

void transposed_product(const MatrixXd& A, const double* x, double* y) {
  for (Eigen::Index c = 0; c < A.cols(); ++c) y[c] = dot(A.data() + c * A.rows(), x, A.rows());
}

void add_scaled(double s, const double* x, Eigen::Index size, double* y) { axpy(s, x, size, y); }

}  // namespace dynamorph
