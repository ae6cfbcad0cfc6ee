// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/sparse_solver.hpp"

#include <algorithm>

#include "dynamorph/elastic/sparse_kernels.hpp"

namespace dynamorph {

namespace {

constexpr double kAccuracy = 1e-4;  // an iteration costs much less than the Newton iterations that accuracy saves
// An iteration waits for memory: per multiplication it takes about this many times as long as a factorization.
constexpr double kWait = 2;
constexpr int kMostIterations = 100;  // with H's own factor, rounded; after that the result is good enough

}  // namespace

bool SparseSolver::solve(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b,
                         VectorXd& x) {
  if (fit_ && iterate(H, points, b, x, factoring_)) return true;
  if (!points.empty()) majorized_ = H;
  for (const SparsePoints* each : points) add_majorant(*each, majorized_);
  fit_ = factor_.factorize(points.empty() ? H : majorized_);
  if (!fit_) return false;
  solves_ = iterations_ = 0;
  factoring_ = int(factor_.factorization_work() / (kWait * (2 * double(factor_.size()) + double(H.nonZeros()))));
  return iterate(H, points, b, x, kMostIterations) || b.dot(x) > 0;
}

bool SparseSolver::iterate(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b,
                           VectorXd& x, int most) {
  x.setZero(b.size());
  const double size = b.norm();
  if (size == 0) return true;
  residual_ = b / size;  // scaled to the range of single precision
  double product = 0;
  for (int i = 1; i <= most; ++i) {
    factor_.solve(residual_, preconditioned_, scratch_);
    const double before = product;
    product = residual_.dot(preconditioned_);
    if (i == 1)
      d_ = preconditioned_;
    else
      d_ = preconditioned_ + product / before * d_;
    multiply_symmetric(H, d_, Hd_);
    for (const SparsePoints* each : points) add_stiffness_product(*each, d_, Hd_);
    const double curvature = d_.dot(Hd_);
    if (!(curvature > 0)) return false;
    x += size * product / curvature * d_;
    residual_ -= product / curvature * Hd_;
    if (residual_.norm() > kAccuracy) continue;
    ++solves_;
    iterations_ += i;
    fit_ = i * solves_ <= factoring_ + iterations_;
    return true;
  }
  return false;
}

void multiply_symmetric(const SparseMatrix& H, const VectorXd& x, VectorXd& y) {
  thread_local std::vector<double> gathered;
  gathered.resize(H.cols());
  y.resize(H.cols());
  multiply_blocks(H.outerIndexPtr(), H.innerIndexPtr(), H.valuePtr(), H.cols(), x.data(), gathered.data(), y.data());
}

}  // namespace dynamorph
