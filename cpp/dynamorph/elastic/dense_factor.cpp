// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/dense_factor.hpp"

#include <cmath>

#include "dynamorph/simd/multiversion.hpp"

namespace dynamorph {

namespace {

using Chunk = double __attribute__((vector_size(32), aligned(8), may_alias));

DYNAMORPH_INLINE Chunk& at(double* x) { return *reinterpret_cast<Chunk*>(x); }
DYNAMORPH_INLINE const Chunk& at(const double* x) { return *reinterpret_cast<const Chunk*>(x); }

/// Rows of the columns in whole vectors.
DYNAMORPH_INLINE Eigen::Index whole_vectors(Eigen::Index size) { return (size + 3) / 4 * 4; }

/// Columns V = L D of L D L^T, each less what the earlier ones make of it, in whole vectors of rows from the one that
/// holds the diagonal; zero on and above the diagonal when done.
DYNAMORPH_MULTIVERSION
bool decompose(double* __restrict V, Eigen::Index n, double* __restrict inverse) {
  const Eigen::Index stride = whole_vectors(n);
  for (Eigen::Index j = 0; j < n; ++j) {
    double* own = V + j * stride;
    const Eigen::Index first = j / 4 * 4;
    Eigen::Index k = 0;
    for (; k + 4 <= j; k += 4) {
      const double *v0 = V + k * stride, *v1 = v0 + stride, *v2 = v1 + stride, *v3 = v2 + stride;
      const double x0 = v0[j] * inverse[k], x1 = v1[j] * inverse[k + 1];
      const double x2 = v2[j] * inverse[k + 2], x3 = v3[j] * inverse[k + 3];
      for (Eigen::Index i = first; i < stride; i += 4)
        at(own + i) -= at(v0 + i) * x0 + at(v1 + i) * x1 + (at(v2 + i) * x2 + at(v3 + i) * x3);
    }
    for (; k < j; ++k) {
      const double x = V[k * stride + j] * inverse[k];
      for (Eigen::Index i = first; i < stride; i += 4) at(own + i) -= at(V + k * stride + i) * x;
    }
    if (!(own[j] > 0) || !std::isfinite(own[j])) return false;
    inverse[j] = 1 / own[j];
    for (Eigen::Index i = first; i <= j; ++i) own[i] = 0;
  }
  return true;
}

/// L y = x, then L^T x = D^-1 y.
DYNAMORPH_MULTIVERSION
void substitute(const double* __restrict V, const double* __restrict inverse, Eigen::Index n, double* __restrict x) {
  const Eigen::Index stride = whole_vectors(n);
  for (Eigen::Index j = 0; j < n; ++j) {
    const double own = x[j] * inverse[j];
    for (Eigen::Index i = j / 4 * 4; i < stride; i += 4) at(x + i) -= at(V + j * stride + i) * own;
  }
  for (Eigen::Index j = n - 1; j >= 0; --j) {
    Chunk sum = {};
    for (Eigen::Index i = j / 4 * 4; i < stride; i += 4) sum += at(V + j * stride + i) * at(x + i);
    x[j] = (x[j] - ((sum[0] + sum[1]) + (sum[2] + sum[3]))) * inverse[j];
  }
}

}  // namespace

bool DenseFactor::compute(const MatrixXd& H) {
  const Eigen::Index n = H.rows();
  columns_.resize(whole_vectors(n), n);
  columns_.topRows(n) = H;
  columns_.bottomRows(columns_.rows() - n).setZero();
  inverse_.resize(n);
  return decompose(columns_.data(), n, inverse_.data());
}

void DenseFactor::solve(const VectorXd& b, VectorXd& x) {
  const Eigen::Index n = b.size();
  padded_.setZero(columns_.rows());
  padded_.head(n) = b;
  substitute(columns_.data(), inverse_.data(), n, padded_.data());
  x = padded_.head(n);
}

}  // namespace dynamorph
