// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/step_options.hpp"

#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>

namespace dynamorph {

namespace {

[[noreturn]] void refuse(const char* option, const char* expected, double actual) {
  char number[32];  // std::to_string would print 0 for a small tolerance, and a stream is large in WebAssembly
  std::snprintf(number, sizeof number, "%g", actual);
  throw std::invalid_argument(std::string(option) + ": expected " + expected + ", got " + number);
}

}  // namespace

void check(const StepOptions& options) {
  if (!(options.h > 0 && std::isfinite(options.h))) refuse("h", "a positive number of seconds", options.h);
  if (options.integrator != Integrator::implicit_euler && options.integrator != Integrator::bdf2)
    refuse("integrator", "one of Integrator's values", int(options.integrator));
  if (!options.gravity.allFinite()) throw std::invalid_argument("gravity: expected three finite numbers");
  if (!(options.tolerance >= 1e-100 && options.tolerance < 1))  // it divides by it
    refuse("tolerance", "between 1e-100 and 1", options.tolerance);
  if (options.max_iterations < 1) refuse("max_iterations", "at least 1", options.max_iterations);
  if (!(options.teleport >= 0)) refuse("teleport", "0, for never, or a distance in meters", options.teleport);
}

StepRule::StepRule(const StepOptions& options) {
  const bool euler = options.integrator == Integrator::implicit_euler;
  past = euler ? std::array<double, 4>{2, -1, 0, 0} : std::array<double, 4>{24 / 9., -22 / 9., 8 / 9., -1 / 9.};
  velocity = euler ? std::array<double, 3>{1, -1, 0} : std::array<double, 3>{1.5, -2, 0.5};
  square = options.h * options.h * (euler ? 1 : 4 / 9.);
}

Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses> StepRule::coefficients() const {
  Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses> coefficients;
  coefficients.setZero();
  coefficients(0, 0) = 2;
  coefficients(1, 0) = -1;
  for (int m = 0; m < InertialTarget::kMoments; ++m) coefficients(m, m + 1) = -past[m];
  return coefficients;
}

}  // namespace dynamorph
