// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/arrow_matrix.hpp"

#include <Eigen/Cholesky>

#include "dynamorph/elastic/dense_kernels.hpp"
#include "dynamorph/reduced/modes/polynomial_kernels.hpp"

namespace dynamorph {

VectorXd ArrowMatrix::diagonal() const {
  VectorXd out(rows());
  out << corner().diagonal(), rest();
  return out;
}

void ArrowMatrix::add_to_diagonal(double factor, const VectorXd& values) {
  corner().diagonal() += factor * values.head(r_);
  rest() += factor * values.tail(h_);
}

void ArrowMatrix::multiply(const VectorXd& x, VectorXd& y) const {
  y.resize(rows());
  y.head(r_).noalias() = corner() * x.head(r_);
  if (h_ == 0) return;
  y.tail(h_) = rest().cwiseProduct(x.tail(h_));
  add_product(border().data(), h_, x.data(), r_, y.data() + r_);
  add_dots(border().data(), h_, r_, x.data() + r_, y.data());
}

MatrixXd ArrowMatrix::dense() const {
  MatrixXd out;
  dense(out);
  return out;
}

void ArrowMatrix::dense(MatrixXd& out) const {
  out.setZero(rows(), rows());
  out.topLeftCorner(r_, r_) = corner();
  out.bottomLeftCorner(h_, r_) = border();
  out.topRightCorner(r_, h_) = border().transpose();
  out.bottomRightCorner(h_, h_).diagonal() = rest();
}

bool ArrowFactor::compute(const ArrowMatrix& H) {
  H_ = &H;
  schur_ = H.corner();
  const auto d = H.rest();
  if (d.size() > 0) {
    if (!(d.minCoeff() > 0) || !d.allFinite()) return false;
    inverse_ = d.cwiseInverse();
    subtract_squares(H.border().data(), inverse_.data(), d.size(), schur_.rows(), schur_.data());
  }
  return factor_.compute(schur_);
}

void ArrowFactor::solve(const VectorXd& b, VectorXd& x) {
  const Eigen::Index r = H_->corner_size(), h = b.size() - r;
  if (h == 0) return factor_.solve(b, x);
  corner_ = b.head(r);
  rest_ = -inverse_.cwiseProduct(b.tail(h));
  add_dots(H_->border().data(), h, r, rest_.data(), corner_.data());
  factor_.solve(corner_, solved_);
  x.resize(b.size());
  x.head(r) = solved_;
  x.tail(h) = -b.tail(h);
  add_product(H_->border().data(), h, solved_.data(), r, x.data() + r);
  x.tail(h).array() *= -inverse_.array();
}

namespace {

/// Multiplications of a solve with `k` rows of points: by the arrow's own factor, row by row, and by the factor of the
/// dense matrix. The loops of the latter are kernels: kSlow says how much longer each of the others takes.
double work_by_rows(double r, double h, double k) {
  constexpr double kSlow = 2.5;
  const double n = r + h, factor = r * r * r / 6 + r * r * h / 2, solve = r * r + 2 * r * h;
  return kSlow * (factor + k * solve + k * k * n / 2 + k * k * k / 6);
}
double work_dense(double n, double k) { return n * n * n / 6 + k * n * n / 2; }

}  // namespace

bool ArrowSolver::solve(const ArrowMatrix& H, const std::vector<const DensePoints*>& points, const VectorXd& b,
                        VectorXd& x) {
  if (!gather(points, H.rows(), b)) return false;
  if (softened_.empty()) return solve_reduced(H, x);
  if (!solve_reduced(H, reduced_x_)) return false;
  solve_own(points, b, x);
  return true;
}

/// Sets the rows with a stiffness, and the right side, without the unknowns that points have of their own.
bool ArrowSolver::gather(const std::vector<const DensePoints*>& points, Eigen::Index size, const VectorXd& b) {
  Eigen::Index count = 0;
  for (const DensePoints* each : points) count += (each->stiffness.array() > 0).count();
  rows_.resize(count, size);
  stiffness_.resize(count);
  reduced_b_ = b.head(size);
  softened_.clear();
  Eigen::Index row = 0, own = size;
  for (const DensePoints* each : points) {
    const Eigen::Index first = row, m = each->own_rows.cols();
    for (Eigen::Index i = 0; i < each->stiffness.size(); ++i) {
      if (!(each->stiffness(i) > 0)) continue;
      rows_.row(row) = each->rows.row(i);
      stiffness_(row++) = each->stiffness(i);
    }
    if (m > 0 && !soften(*each, b.segment(own, m), first)) return false;
    own += m;
  }
  return true;
}

bool ArrowSolver::soften(const DensePoints& points, const Eigen::Ref<const VectorXd>& own_b, Eigen::Index first_row) {
  const RowMajor& R = points.own_rows;
  if (R.rows() == 0) {  // nothing presses there
    softened_.push_back({{}, {}, first_row});
    return true;
  }
  const auto own = points.own_factor.triangularView<Eigen::Lower>();
  const MatrixXd given = own.solve(R.transpose());  // L^-1 R^T
  softened_.push_back({MatrixXd::Zero(R.rows(), R.rows()), given.transpose() * own.solve(own_b), first_row});
  Softened& softened = softened_.back();
  softened.lower.selfadjointView<Eigen::Lower>().rankUpdate(given.transpose());
  softened.lower.diagonal() += points.stiffness.head(R.rows()).cwiseInverse();
  if (Eigen::LLT<Eigen::Ref<MatrixXd>>(softened.lower).info() != Eigen::Success) return false;
  const auto lower = softened.lower.triangularView<Eigen::Lower>();
  auto rows = rows_.middleRows(first_row, R.rows());
  lower.solveInPlace(rows);
  lower.solveInPlace(softened.forces);
  stiffness_.segment(first_row, R.rows()).setOnes();
  reduced_b_.noalias() -= rows.transpose() * softened.forces;
  return true;
}

/// x from that without the unknowns of points.
void ArrowSolver::solve_own(const std::vector<const DensePoints*>& points, const VectorXd& b, VectorXd& x) const {
  x.resize(b.size());
  x.head(reduced_x_.size()) = reduced_x_;
  Eigen::Index own = reduced_x_.size();
  auto softened = softened_.begin();
  for (const DensePoints* each : points) {
    const RowMajor& R = each->own_rows;
    if (R.cols() == 0) continue;
    auto own_x = x.segment(own, R.cols());
    own_x = b.segment(own, R.cols());
    if (R.rows() > 0) {
      VectorXd forces = softened->forces + rows_.middleRows(softened->first_row, R.rows()) * reduced_x_;
      softened->lower.triangularView<Eigen::Lower>().adjoint().solveInPlace(forces);
      own_x -= R.transpose() * forces;
    }
    each->own_factor.triangularView<Eigen::Lower>().solveInPlace(own_x);
    each->own_factor.triangularView<Eigen::Lower>().adjoint().solveInPlace(own_x);
    own += R.cols();
    ++softened;
  }
}

bool ArrowSolver::solve_reduced(const ArrowMatrix& H, VectorXd& x) {
  const double r = double(H.corner_size()), n = double(H.rows()), k = double(stiffness_.size());
  if (k == 0) {
    if (!arrow_.compute(H)) return false;
    arrow_.solve(reduced_b_, x);
    return true;
  }
  if (work_by_rows(r, n - r, k) < work_dense(n, k) && solve_by_rows(H, reduced_b_, x)) return true;
  return solve_dense(H, reduced_b_, x);  // also where H alone is not positive definite
}

bool ArrowSolver::solve_by_rows(const ArrowMatrix& H, const VectorXd& b, VectorXd& x) {
  if (!arrow_.compute(H)) return false;
  const Eigen::Index k = rows_.rows();
  answers_.resize(H.rows(), k);
  for (Eigen::Index i = 0; i < k; ++i) {
    right_ = rows_.row(i);
    arrow_.solve(right_, one_);
    answers_.col(i) = one_;
  }
  small_.noalias() = rows_ * answers_;
  small_.diagonal() += stiffness_.cwiseInverse();
  if (!factor_.compute(small_)) return false;
  arrow_.solve(b, x);
  right_.noalias() = rows_ * x;
  factor_.solve(right_, forces_);
  x.noalias() -= answers_ * forces_;
  return true;
}

bool ArrowSolver::solve_dense(const ArrowMatrix& H, const VectorXd& b, VectorXd& x) {
  H.dense(dense_);
  add_squares(rows_.data(), stiffness_.data(), rows_.rows(), rows_.cols(), dense_.data());
  if (!factor_.compute(dense_)) return false;
  factor_.solve(b, x);
  return true;
}

}  // namespace dynamorph
