// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/dents.hpp"

#include <cmath>
#include <utility>

#include "dynamorph/contact/contact_law.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

// Times a patch's own stiffness, beyond its bound. With 100 a deep press goes farther, with 1000 Newton's method takes
// more iterations for the same.
constexpr double kHard = 300;

}  // namespace

void Dents::clear() {
  patches_.clear();
  a_.resize(0);
}

void Dents::begin(std::vector<int> patches, RowMajor rows, MatrixXd stiffness, const RowMajor& together, VectorXd most,
                  const VectorXd& amplitudes) {
  patches_ = std::move(patches);
  most_ = std::move(most);
  hardness_ = kHard * stiffness.diagonal();
  stiffness_ = std::move(stiffness);
  rows_ = std::move(rows);
  const Index m = stiffness_.rows();
  bounded_rows_.resize(2 * m, m);
  bounded_rows_ << RowMajor::Identity(m, m), together;
  at(amplitudes(patches_));
}

void Dents::at(const Eigen::Ref<const VectorXd>& a) {
  a_ = a;
  given_.noalias() = rows_ * a_;
  bounded_.noalias() = bounded_rows_ * a_;
  hard_force_.resize(bounded_.size());
  hard_slope_.resize(bounded_.size());
  force_.noalias() = stiffness_ * a_;
  energy_ = 0.5 * a_.dot(force_);
  for (Index i = 0; i < bounded_.size(); ++i) {
    const Index m = i % a_.size();
    const ContactRamp ramp = contact_ramp(std::abs(bounded_(i)) - most_(m), 0.5 * most_(m));
    energy_ += hardness_(m) * ramp.energy;
    hard_force_(i) = std::copysign(hardness_(m) * ramp.force, bounded_(i));
    hard_slope_(i) = hardness_(m) * ramp.stiffness;
  }
  force_.noalias() += bounded_rows_.transpose() * hard_force_;
}

void Dents::amplitudes(VectorXd& all) const {
  all.setZero();
  all(patches_) = a_;
}

}  // namespace dynamorph
