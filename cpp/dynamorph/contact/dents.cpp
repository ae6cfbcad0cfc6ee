// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/dents.hpp"

#include <utility>

#include "dynamorph/contact/contact_law.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr int kIterations = 50, kHalvings = 20;
constexpr double kTolerance = 1e-13;  // of the forces that cancel: their differences are a step's Hessian
constexpr double kRounded = 1e-9;     // of the forces: round-off may leave as much
constexpr double kRounding = 1e-13;   // of an energy

}  // namespace

void Dents::begin(std::vector<int> patches, const MatrixXd& rows, const MatrixXd& stiffness) {
  patches_ = std::move(patches);
  factor_.compute(stiffness);
  rows_ = factor_.matrixL().solve(rows.transpose()).transpose();
  b_.setZero(rows_.cols());
  given_.setZero(rows_.rows());
}

/// Sets the forces and the stiffness of the contacts where they give way by b, and returns the energy.
double Dents::evaluate(const VectorXd& depths, const VectorXd& stiffness, double width) {
  given_.noalias() = rows_ * b_;
  force_.resize(depths.size());
  slope_.resize(depths.size());
  pressed_.clear();
  double out = energy();
  for (Index i = 0; i < depths.size(); ++i) {
    const ContactRamp ramp = contact_ramp(depths(i) - given_(i), width);
    out += stiffness(i) * ramp.energy;
    force_(i) = stiffness(i) * ramp.force;
    slope_(i) = stiffness(i) * ramp.stiffness;
    if (slope_(i) > 0) pressed_.push_back(int(i));
  }
  return out;
}

MatrixXd Dents::series(const std::vector<int>& contacts, const VectorXd& stiffness) const {
  MatrixXd some(Index(contacts.size()), rows_.cols());
  for (std::size_t i = 0; i < contacts.size(); ++i) some.row(Index(i)) = rows_.row(contacts[i]);
  MatrixXd out = some * some.transpose();
  out.diagonal() += stiffness.cwiseInverse();
  return out;
}

void Dents::settle(const VectorXd& depths, const VectorXd& stiffness, double width) {
  // The energy is convex, with a continuous Hessian: Newton's method finds the only minimum.
  double now = evaluate(depths, stiffness, width), before = kInfinity;
  for (int iteration = 0; iteration < kIterations && !pressed_.empty(); ++iteration) {
    double forces = b_.norm();
    downhill_ = -b_;
    VectorXd slopes(Index(pressed_.size())), answers(slopes.size());
    for (std::size_t i = 0; i < pressed_.size(); ++i) {
      slopes(Index(i)) = slope_(pressed_[i]);
      downhill_ += force_(pressed_[i]) * rows_.row(pressed_[i]).transpose();
    }
    forces += (downhill_ + b_).norm();
    const double left = downhill_.norm();
    if (left <= kTolerance * forces || (left > 0.5 * before && left <= kRounded * forces)) return;
    before = left;
    for (std::size_t i = 0; i < pressed_.size(); ++i) answers(Index(i)) = rows_.row(pressed_[i]).dot(downhill_);
    series(pressed_, slopes).llt().solveInPlace(answers);
    step_ = downhill_;
    for (std::size_t i = 0; i < pressed_.size(); ++i) step_ -= answers(Index(i)) * rows_.row(pressed_[i]).transpose();
    const double descent = downhill_.dot(step_), start = now;
    from_ = b_;
    double length = 1;
    for (int halving = 0; halving < kHalvings; ++halving, length /= 2) {
      b_ = from_ + length * step_;
      now = evaluate(depths, stiffness, width);
      if (now <= start - 1e-4 * length * descent + kRounding * start) break;
    }
  }
  if (pressed_.empty()) {  // nothing holds it
    b_.setZero();
    given_.setZero();
  }
}

void Dents::soften(const std::vector<int>& contacts, Eigen::Ref<RowMajor> rows, Eigen::Ref<VectorXd> stiffness) const {
  const Eigen::LLT<MatrixXd> factor(series(contacts, stiffness));
  factor.matrixL().solveInPlace(rows);
  stiffness.setOnes();
}

void Dents::amplitudes(VectorXd& all) const {
  all.setZero();
  if (patches_.empty()) return;
  const VectorXd a = factor_.matrixU().solve(b_);
  for (std::size_t m = 0; m < patches_.size(); ++m) all(patches_[m]) = a(Index(m));
}

}  // namespace dynamorph
