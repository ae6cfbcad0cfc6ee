// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>

#include "dynamorph/core/types.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph {

/// The target that inertia pulls the body toward, as a sum of posed positions,
///
///   sum_mn coefficients(m, n) x(q_m, bones_n) - gravity_offset,
///
/// in the pose of bones[0]. Models turn it into a force. It owns nothing.
struct InertialTarget {
  static constexpr int kMoments = 4, kPoses = 5;
  std::array<const VectorXd*, kMoments> q{};      ///< coordinates of consecutive steps, newest first
  std::array<const Transforms*, kPoses> bones{};  ///< (B) each; the first is at the end of the step
  /// One for each pair of coordinates and bones.
  Eigen::Matrix<double, kMoments, kPoses> coefficients = Eigen::Matrix<double, kMoments, kPoses>::Zero();
  Vector3d gravity_offset = Vector3d::Zero();  ///< meters, the same for every node
};

}  // namespace dynamorph
