// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/dents.hpp"

#include <cmath>
#include <utility>

#include "dynamorph/contact/contact_law.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr int kIterations = 50, kHalvings = 20;
constexpr double kTolerance = 1e-13;  // of the forces that cancel: their differences are a step's Hessian
constexpr double kRounded = 1e-9;     // of the forces: round-off may leave as much
constexpr double kHard = 1000;        // times a patch's own stiffness, where it gives way no further
constexpr double kRounding = 1e-13;   // of an energy

}  // namespace

void Dents::begin(std::vector<int> patches, const MatrixXd& rows, const MatrixXd& stiffness, VectorXd most) {
  patches_ = std::move(patches);
  most_ = std::move(most);
  hardness_ = kHard * stiffness.diagonal();
  const Eigen::LLT<MatrixXd> factor(stiffness);
  back_ = factor.matrixU().solve(MatrixXd::Identity(stiffness.rows(), stiffness.cols()));
  rows_ = rows * back_;
  b_.setZero(rows_.cols());
  a_ = b_;
  given_.setZero(rows_.rows());
  energy_ = 0;
}

/// Sets the forces and the stiffness of the contacts and of the patches where they give way by b, and returns the
/// energy.
double Dents::evaluate(const VectorXd& depths, const VectorXd& stiffness, double width) {
  given_.noalias() = rows_ * b_;
  a_.noalias() = back_ * b_;
  force_.resize(depths.size());
  slope_.resize(depths.size());
  hard_force_.resize(a_.size());
  hard_slope_.resize(a_.size());
  energy_ = 0.5 * b_.squaredNorm();
  for (Index m = 0; m < a_.size(); ++m) {
    const ContactRamp ramp = contact_ramp(std::abs(a_(m)) - most_(m), 0.5 * most_(m));
    energy_ += hardness_(m) * ramp.energy;
    hard_force_(m) = std::copysign(hardness_(m) * ramp.force, a_(m));
    hard_slope_(m) = hardness_(m) * ramp.stiffness;
  }
  double out = energy_;
  for (Index i = 0; i < depths.size(); ++i) {
    const ContactRamp ramp = contact_ramp(depths(i) - given_(i), width);
    out += stiffness(i) * ramp.energy;
    force_(i) = stiffness(i) * ramp.force;
    slope_(i) = stiffness(i) * ramp.stiffness;
  }
  return out;
}

MatrixXd Dents::own_stiffness() const {
  MatrixXd out = MatrixXd::Identity(b_.size(), b_.size());
  for (Index m = 0; m < a_.size(); ++m)
    if (hard_slope_(m) > 0) out += hard_slope_(m) * back_.row(m).transpose() * back_.row(m);
  return out;
}

void Dents::settle(const VectorXd& depths, const VectorXd& stiffness, double width) {
  // The energy is convex, with a continuous Hessian: Newton's method finds the only minimum.
  double now = evaluate(depths, stiffness, width), before = kInfinity;
  for (int iteration = 0; iteration < kIterations && (slope_.array() > 0).any(); ++iteration) {
    const VectorXd resisting = b_ + back_.transpose() * hard_force_, pushing = rows_.transpose() * force_;
    const VectorXd downhill = pushing - resisting;
    const double left = downhill.norm(), forces = pushing.norm() + resisting.norm();
    if (left <= kTolerance * forces || (left > 0.5 * before && left <= kRounded * forces)) return;
    before = left;
    const VectorXd step =
        (own_stiffness() + MatrixXd(rows_.transpose() * slope_.asDiagonal() * rows_)).llt().solve(downhill);
    const VectorXd from = b_;
    const double descent = downhill.dot(step), start = now;
    double length = 1;
    for (int halving = 0; halving < kHalvings; ++halving, length /= 2) {
      b_ = from + length * step;
      now = evaluate(depths, stiffness, width);
      if (now <= start - 1e-4 * length * descent + kRounding * start) break;
    }
  }
  if (!(slope_.array() > 0).any()) {  // nothing holds it
    b_.setZero();
    evaluate(depths, stiffness, width);
  }
}

void Dents::soften(const std::vector<int>& contacts, Eigen::Ref<RowMajor> rows, Eigen::Ref<VectorXd> stiffness) const {
  MatrixXd some(Index(contacts.size()), rows_.cols());
  for (std::size_t i = 0; i < contacts.size(); ++i) some.row(Index(i)) = rows_.row(contacts[i]);
  MatrixXd series = some * own_stiffness().llt().solve(some.transpose());
  series.diagonal() += stiffness.cwiseInverse();
  series.llt().matrixL().solveInPlace(rows);
  stiffness.setOnes();
}

void Dents::amplitudes(VectorXd& all) const {
  all.setZero();
  if (patches_.empty()) return;
  for (std::size_t m = 0; m < patches_.size(); ++m) all(patches_[m]) = a_(Index(m));
}

}  // namespace dynamorph
