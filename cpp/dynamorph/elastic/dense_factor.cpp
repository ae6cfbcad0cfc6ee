// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/dense_factor.hpp"

#include "dynamorph/elastic/dense_kernels.hpp"

namespace dynamorph {

bool DenseFactor::compute(const MatrixXd& H) {
  const Eigen::Index n = H.rows();
  columns_.resize(whole_vectors(n), n);
  columns_.topRows(n) = H;
  columns_.bottomRows(columns_.rows() - n).setZero();
  inverse_.resize(n);
  return decompose_dense(columns_.data(), n, inverse_.data());
}

void DenseFactor::solve(const VectorXd& b, VectorXd& x) {
  const Eigen::Index n = b.size();
  padded_.setZero(columns_.rows());
  padded_.head(n) = b;
  substitute_dense(columns_.data(), inverse_.data(), n, padded_.data());
  x = padded_.head(n);
}

}  // namespace dynamorph
