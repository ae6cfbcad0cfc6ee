// SPDX-License-Identifier: GPL-3.0-or-later
// Characters stepped together move as each would alone.
#include <doctest/doctest.h>

#include "dynamorph/basis.hpp"
#include "dynamorph/crowd.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

constexpr int kCharacters = 11;  // one whole set of lanes and some

/// Each character bends its own way; from step 12 on, character 4 stands somewhere else.
Transforms rig(int character, int step) {
  Transforms bones = scenes::bent(0.3 * std::sin(0.1 * step * (1 + 0.1 * character)) + 0.05 * character);
  if (character == 4 && step >= 12) bones.col(3).array() += 20;
  return bones;
}

VectorXd weights(int character, int step) {
  VectorXd w(3);
  w(1) = 0.5 + 0.5 * std::sin(0.2 * step + character);
  if (character == 7) w(1) = 0;
  w(0) = 1 - w(1);
  w(2) = 1;
  return w;
}

struct Poses {
  std::vector<double> bones, next, weights;
  explicit Poses(int step) {
    for (int i = 0; i < kCharacters; ++i) {
      const Transforms now = rig(i, step), then = rig(i, step + 1);
      const VectorXd w = ::weights(i, step);
      bones.insert(bones.end(), now.data(), now.data() + now.size());
      next.insert(next.end(), then.data(), then.data() + then.size());
      weights.insert(weights.end(), w.data(), w.data() + w.size());
    }
  }
};

}  // namespace

TEST_CASE("a crowd moves as its characters do alone") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  for (Law law : {Law::linear, Law::stvk, Law::stable_stvk})
    for (Blending blending : {Blending::forces, Blending::even}) {
      const FullModel full(body, targets, law, blending);
      const auto model = std::make_shared<ReducedModel>(body, targets, reduce(full, make_basis(full, 12).U), blending);
      StepOptions options{1 / 120., Scheme::bdf2, Vector3d(0, 0, -9.81)};
      options.teleport = 2;
      Crowd crowd(model, options, kCharacters);
      const std::vector<Transforms> held(3, rig(0, 0));
      crowd.hold_targets(held);
      const Poses begin(0);
      crowd.start(begin.bones.data(), begin.next.data(), begin.weights.data());
      int alone = 0;
      for (int step = 1; step <= 25; ++step) {
        const Poses poses(step);
        const CrowdReport report = crowd.step(poses.bones.data(), poses.weights.data());
        CHECK(report.converged);
        alone += report.alone;
      }
      CHECK(alone >= 1);   // the one that jumps
      CHECK(alone <= 10);  // and hardly any other
      for (int i = 0; i < kCharacters; ++i) {
        Simulation<ReducedModel> simulation(model, options);
        simulation.hold_targets(held);
        simulation.start(rig(i, 0), rig(i, 1), weights(i, 0));
        for (int step = 1; step <= 25; ++step) simulation.step(rig(i, step), weights(i, step));
        const VectorXd expected = simulation.coordinates();
        CHECK((crowd.coordinates(i) - expected).norm() < 1e-4 * expected.norm());
      }
    }
}

TEST_CASE("a crowd that was not started, or has no one in it, says so") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const FullModel full(body, targets, Law::linear, Blending::even);
  const auto model = std::make_shared<ReducedModel>(body, targets, reduce(full, make_basis(full, 8).U), Blending::even);
  CHECK_THROWS_AS(Crowd(model, {}, 0), std::invalid_argument);
  Crowd crowd(model, {}, 2);
  CHECK_THROWS_AS(crowd.step(nullptr, nullptr), std::invalid_argument);
  CHECK_THROWS_AS(crowd.coordinates(0), std::invalid_argument);
}
