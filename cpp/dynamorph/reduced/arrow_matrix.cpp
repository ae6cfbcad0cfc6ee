// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/arrow_matrix.hpp"

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
  y.head(r_).noalias() += border().transpose() * x.tail(h_);
  y.tail(h_) = rest().cwiseProduct(x.tail(h_));
  y.tail(h_).noalias() += border() * x.head(r_);
}

MatrixXd ArrowMatrix::dense() const {
  MatrixXd out = MatrixXd::Zero(rows(), rows());
  out.topLeftCorner(r_, r_) = corner();
  out.bottomLeftCorner(h_, r_) = border();
  out.topRightCorner(r_, h_) = border().transpose();
  out.bottomRightCorner(h_, h_).diagonal() = rest();
  return out;
}

bool ArrowFactor::compute(const ArrowMatrix& H) {
  H_ = &H;
  schur_ = H.corner();
  const auto d = H.rest();
  if (d.size() > 0) {
    if (!(d.minCoeff() > 0) || !d.allFinite()) return false;
    inverse_ = d.cwiseInverse();
    scaled_.noalias() = inverse_.cwiseSqrt().asDiagonal() * H.border();
    schur_.noalias() -= scaled_.transpose() * scaled_;
  }
  return factor_.compute(schur_);
}

void ArrowFactor::solve(const VectorXd& b, VectorXd& x) {
  const Eigen::Index r = H_->corner_size(), h = b.size() - r;
  if (h == 0) return factor_.solve(b, x);
  corner_ = b.head(r);
  corner_.noalias() -= H_->border().transpose() * inverse_.cwiseProduct(b.tail(h));
  factor_.solve(corner_, solved_);
  x.resize(b.size());
  x.head(r) = solved_;
  x.tail(h) = b.tail(h);
  x.tail(h).noalias() -= H_->border() * solved_;
  x.tail(h).array() *= inverse_.array();
}

}  // namespace dynamorph
