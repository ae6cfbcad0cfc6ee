// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/dents.hpp"

#include <Eigen/Cholesky>
#include <cmath>
#include <utility>

#include "dynamorph/contact/contact_law.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr double kHard = 1000;  // times a patch's own stiffness, beyond its bound

}  // namespace

void Dents::clear() {
  patches_.clear();
  b_.resize(0);
}

void Dents::begin(std::vector<int> patches, const MatrixXd& rows, const MatrixXd& stiffness, const RowMajor& together,
                  VectorXd most, const VectorXd& pressures) {
  patches_ = std::move(patches);
  most_ = std::move(most);
  hardness_ = kHard * stiffness.diagonal();
  stiffness_ = stiffness.diagonal().mean();
  const Eigen::LLT<MatrixXd> factor(stiffness);
  const Index m = stiffness.rows();
  const MatrixXd back = factor.matrixU().solve(std::sqrt(stiffness_) * MatrixXd::Identity(m, m));
  rows_.noalias() = rows * back;
  bounded_rows_.resize(2 * m, m);
  bounded_rows_ << back, together * back;
  at(rows_.transpose() * pressures / stiffness_);
}

void Dents::at(const Eigen::Ref<const VectorXd>& b) {
  b_ = b;
  given_.noalias() = rows_ * b_;
  bounded_.noalias() = bounded_rows_ * b_;
  hard_force_.resize(bounded_.size());
  hard_slope_.resize(bounded_.size());
  energy_ = 0.5 * stiffness_ * b_.squaredNorm();
  for (Index i = 0; i < bounded_.size(); ++i) {
    const Index m = i % b_.size();
    const ContactRamp ramp = contact_ramp(std::abs(bounded_(i)) - most_(m), 0.5 * most_(m));
    energy_ += hardness_(m) * ramp.energy;
    hard_force_(i) = std::copysign(hardness_(m) * ramp.force, bounded_(i));
    hard_slope_(i) = hardness_(m) * ramp.stiffness;
  }
  force_ = stiffness_ * b_;
  force_.noalias() += bounded_rows_.transpose() * hard_force_;
}

void Dents::amplitudes(VectorXd& all) const {
  all.setZero();
  for (std::size_t m = 0; m < patches_.size(); ++m) all(patches_[m]) = bounded_(Index(m));
}

}  // namespace dynamorph
