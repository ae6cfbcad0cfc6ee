// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/dents.hpp"

#include <Eigen/Cholesky>
#include <cmath>
#include <utility>

#include "dynamorph/contact/choices.hpp"
#include "dynamorph/contact/contact_law.hpp"

namespace dynamorph {

using Eigen::Index;

void Dents::clear() {
  patches_.clear();
  b_.resize(0);
}

void Dents::begin(std::vector<int> patches, const MatrixXd& rows, const MatrixXd& stiffness, const RowMajor& held,
                  VectorXd most, const VectorXd& pressures) {
  patches_ = std::move(patches);
  most_ = std::move(most);
  hardness_ = kPatchHard * stiffness.diagonal();
  stiffness_ = stiffness.diagonal().mean();
  const Eigen::LLT<MatrixXd> factor(stiffness);
  const Index m = stiffness.rows();
  back_ = factor.matrixU().solve(std::sqrt(stiffness_) * MatrixXd::Identity(m, m));
  rows_.noalias() = rows * back_;
  held_.resize(2 * m, m);
  held_ << back_, held * back_;
  at(rows_.transpose() * pressures / stiffness_);
}

void Dents::at(const Eigen::Ref<const VectorXd>& b) {
  b_ = b;
  given_.noalias() = rows_ * b_;
  a_.noalias() = back_ * b_;
  together_.noalias() = held_ * b_;
  hard_force_.resize(together_.size());
  hard_slope_.resize(together_.size());
  energy_ = 0.5 * stiffness_ * b_.squaredNorm();
  for (Index i = 0; i < together_.size(); ++i) {
    const Index m = i % a_.size();
    const ContactRamp ramp = contact_ramp(std::abs(together_(i)) - most_(m), 0.5 * most_(m));
    energy_ += hardness_(m) * ramp.energy;
    hard_force_(i) = std::copysign(hardness_(m) * ramp.force, together_(i));
    hard_slope_(i) = hardness_(m) * ramp.stiffness;
  }
  force_ = stiffness_ * b_;
  force_.noalias() += held_.transpose() * hard_force_;
}

void Dents::amplitudes(VectorXd& all) const {
  all.setZero();
  for (std::size_t m = 0; m < patches_.size(); ++m) all(patches_[m]) = a_(Index(m));
}

}  // namespace dynamorph
