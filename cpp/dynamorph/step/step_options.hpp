// SPDX-License-Identifier: GPL-3.0-or-later
// How a soft skin is stepped through time, and the numbers of each scheme (simulation.hpp has their formulas).
#pragma once

#include <array>
#include <functional>

#include "dynamorph/core/types.hpp"
#include "dynamorph/pose/inertial_target.hpp"

namespace dynamorph {

enum class Scheme { implicit_euler, bdf2 };

struct StepOptions {
  double h = 1.0 / 120;  ///< seconds
  Scheme scheme = Scheme::bdf2;
  Vector3d gravity = Vector3d::Zero();  ///< m/s^2, world
  double tolerance = 1e-6;              ///< on the gradient, relative to the largest force term
  int max_iterations = 30;
  /// Jump of the skin off its course in one step, metres (root mean square), above which the past is carried along.
  /// 0: never.
  double teleport = 0;
  /// Asked before every Newton iteration; false throws Cancelled, after which start() must come first again.
  std::function<bool()> keep_going = {};
};

/// Throws std::invalid_argument, naming the option, unless a step can be taken with these.
void check(const StepOptions& options);

/// The numbers of a scheme at one step size.
struct StepRule {
  explicit StepRule(const StepOptions& options);
  std::array<double, InertialTarget::kMoments> past;  ///< of x^
  double square;                                      ///< h^2 c^2, s^2
  std::array<double, 3> velocity;                     ///< h u' = sum velocity[m] u(n+1-m)
  /// Of the motion that inertia acts on: 2 q(n) - q(n-1), as the bones pose it at the end of the step, less x^.
  Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses> coefficients() const;
};

}  // namespace dynamorph
