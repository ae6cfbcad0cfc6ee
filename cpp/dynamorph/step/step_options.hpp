// SPDX-License-Identifier: GPL-3.0-or-later
// How a soft skin is stepped through time, and the numbers of each integrator (moving_body.hpp has their formulas).
#pragma once

#include <array>
#include <functional>

#include "dynamorph/core/types.hpp"
#include "dynamorph/pose/inertial_target.hpp"

namespace dynamorph {

enum class Integrator { implicit_euler, bdf2 };

struct StepOptions {
  double h = 1.0 / 120;  ///< seconds
  Integrator integrator = Integrator::bdf2;
  Vector3d gravity = Vector3d::Zero();  ///< m/s^2, world
  double tolerance = 1e-6;              ///< on the gradient, relative to the largest force term
  int max_iterations = 30;
  /// Jump of the skin off its course in one step, meters (root mean square), above which the past is carried along.
  /// 0: never.
  double teleport = 0;
  /// Called before every Newton iteration. Returning false throws Cancelled; after that, start() must be called first
  /// again.
  std::function<bool()> keep_going = {};
};

/// Throws std::invalid_argument, which names the option, unless a step can be taken with these options.
void check(const StepOptions& options);

/// The numbers of an integrator at one step size.
struct StepRule {
  explicit StepRule(const StepOptions& options);
  std::array<double, InertialTarget::kMoments> past;  ///< coefficients of x^
  double square;                                      ///< h^2 c^2, s^2
  std::array<double, 3> velocity;                     ///< h u' = sum velocity[m] u(n+1-m)
  /// Coefficients of the motion that inertia acts on: 2 q(n) - q(n-1), posed by the bones at the end of the step, minus
  /// x^.
  Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses> coefficients() const;
};

}  // namespace dynamorph
