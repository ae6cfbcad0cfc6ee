// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/sparse_solver.hpp"

#include <algorithm>

#include "dynamorph/elastic/dense_kernels.hpp"
#include "dynamorph/elastic/sparse_kernels.hpp"

namespace dynamorph {

namespace {

constexpr double kAccuracy = 1e-4;  // an iteration costs much less than the Newton iterations that accuracy saves
// An iteration waits for memory: per multiplication it takes about this many times as long as a factorization.
constexpr double kWait = 2;
constexpr int kMostIterations = 100;      // with H's own factor, rounded; after that the result is good enough
constexpr Eigen::Index kMostApart = 192;  // rows of points beside the factor: with more it is cheaper to factor again

}  // namespace

bool SparseSolver::solve(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b,
                         VectorXd& x) {
  Eigen::Index rows = 0;
  for (const SparsePoints* each : points) rows += each->rows.rows();
  const bool within = rows > kMostApart;  // the factor
  fit_ &= within == has_points_;
  if (fit_) {
    set_apart(points, b.size(), within ? 0 : rows);
    if (iterate(H, points, b, x, factoring_)) return true;
  }
  has_points_ = within;
  if (within) majorized_ = H;
  for (const SparsePoints* each : points)
    if (within) add_majorant(*each, majorized_);
  fit_ = factor_.factorize(within ? majorized_ : H);
  if (!fit_) return false;
  set_apart(points, b.size(), within ? 0 : rows);
  solves_ = iterations_ = 0;
  factoring_ = int(factor_.factorization_work() / (kWait * (2 * double(factor_.size()) + double(H.nonZeros()))));
  return iterate(H, points, b, x, kMostIterations) || b.dot(x) > 0;
}

void SparseSolver::set_apart(const std::vector<const SparsePoints*>& points, Eigen::Index size, Eigen::Index rows) {
  W_.resize(0, rows);
  if (rows == 0) return;
  MatrixXd transposed = MatrixXd::Zero(size, rows);
  VectorXd stiffness(rows);
  Eigen::Index row = 0;
  for (const SparsePoints* each : points)
    for (Eigen::Index k = 0; k < each->rows.rows(); ++k, ++row) {
      each->rows.add(k, 1, transposed.col(row));
      stiffness(row) = each->stiffness(k);
    }
  const auto W = factor_.forward(transposed);
  reached_.clear();
  for (Eigen::Index i = 0; i < size; ++i)
    if (!W.row(i).isZero(0)) reached_.push_back(int(i));
  W_ = W(reached_, Eigen::all).cast<double>();
  MatrixXd sum = stiffness.cwiseInverse().asDiagonal();  // the lower half is enough
  add_squares(W_.data(), VectorXd::Ones(W_.rows()).eval().data(), W_.rows(), rows, sum.data());
  capacitance_.compute(sum);
}

void SparseSolver::precondition() {
  factor_.forward(residual_, half_);
  if (W_.cols() > 0) {
    Eigen::Map<Eigen::VectorXf> y(half_.data(), residual_.size());
    pushed_.noalias() = W_.transpose() * y(reached_).cast<double>();
    capacitance_.solveInPlace(pushed_);
    y(reached_) -= (W_ * pushed_).cast<float>();
  }
  factor_.backward(half_, preconditioned_);
}

bool SparseSolver::iterate(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b,
                           VectorXd& x, int most) {
  x.setZero(b.size());
  const double size = b.norm();
  if (size == 0) return true;
  residual_ = b / size;  // scaled to the range of single precision
  double product = 0;
  for (int i = 1; i <= most; ++i) {
    precondition();
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
