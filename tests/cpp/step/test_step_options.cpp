// SPDX-License-Identifier: GPL-3.0-or-later
// What no step can be taken with is refused when a simulation is made, of both kinds of models.
#include <doctest/doctest.h>

#include <limits>

#include "dynamorph/step/simulation.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// The defaults but for one option.
template <class Value>
StepOptions with(Value StepOptions::* option, const Value& value) {
  StepOptions options;
  options.*option = value;
  return options;
}

}  // namespace

TEST_CASE("options that no step can be taken with are refused by name") {
  const auto refused = [](const char* name, const StepOptions& options) {
    try {
      check(options);
    } catch (const std::invalid_argument& error) {
      return std::string(error.what()).rfind(name, 0) == 0;
    }
    return false;
  };
  CHECK_NOTHROW(check(StepOptions{}));
  for (double h : {0.0, -1.0, kNaN, kInfinity}) CHECK(refused("h:", with(&StepOptions::h, h)));
  for (double tolerance : {0.0, -1e-6, 1.0, kNaN})
    CHECK(refused("tolerance:", with(&StepOptions::tolerance, tolerance)));
  for (int iterations : {0, -1}) CHECK(refused("max_iterations:", with(&StepOptions::max_iterations, iterations)));
  for (double jump : {-1.0, kNaN}) CHECK(refused("teleport:", with(&StepOptions::teleport, jump)));
  CHECK(refused("gravity:", with(&StepOptions::gravity, Vector3d(0, kNaN, 0))));
  CHECK(refused("integrator:", with(&StepOptions::integrator, Integrator(7))));
}

TEST_CASE("simulations check their options") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const auto full = std::make_shared<FullModel>(body, targets, MaterialModel::linear, Blending::even);
  const auto reduced = scenes::reduced_model(body, targets, MaterialModel::linear, Blending::even, 8);
  const StepOptions impossible = with(&StepOptions::tolerance, 0.0);
  CHECK_THROWS_AS(MovingBody<FullModel>(full, impossible), std::invalid_argument);
  CHECK_THROWS_AS(MovingBody<ReducedModel>(reduced, impossible), std::invalid_argument);
}
