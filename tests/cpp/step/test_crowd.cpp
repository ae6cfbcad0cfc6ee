// SPDX-License-Identifier: GPL-3.0-or-later
// Characters stepped together move as each would alone.
#include <doctest/doctest.h>

#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/step/crowd.hpp"
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
      const auto model = scenes::reduced_model(body, targets, law, blending, 12);
      StepOptions options{1 / 120., Scheme::bdf2, Vector3d(0, 0, -9.81)};
      options.teleport = 2;
      Crowd crowd(model, options, kCharacters);
      const std::vector<Transforms> standing(3, rig(0, 0));
      crowd.balance_targets(standing);
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
        simulation.balance_targets(standing);
        simulation.start(rig(i, 0), rig(i, 1), weights(i, 0));
        for (int step = 1; step <= 25; ++step) simulation.step(rig(i, step), weights(i, step));
        const VectorXd expected = simulation.coordinates();
        CHECK((crowd.coordinates(i) - expected).norm() < 1e-4 * expected.norm());
      }
    }
}

namespace {

std::shared_ptr<const ReducedModel> linear_model() {
  const auto body = scenes::two_bone_bar(2);
  return scenes::reduced_model(body, scenes::targets(*body, 1), Law::linear, Blending::even, 8);
}

}  // namespace

TEST_CASE("a crowd of any size takes the iterations of its characters, and one is enough where one is") {
  const auto model = linear_model();
  for (int size : {1, 8, 9}) {
    StepOptions options{1 / 120.};
    options.teleport = 2;
    options.max_iterations = 1;
    Crowd crowd(model, options, size);
    const auto at = [&](int character, int step) {
      Transforms bones = rig(character, step);
      if (character == size - 1 && step >= 6) bones.col(7).array() += 50;  // the last one jumps
      return bones;
    };
    const auto poses = [&](int step, std::vector<double>& bones, std::vector<double>& w) {
      bones.clear();
      w.clear();
      for (int i = 0; i < size; ++i) {
        const Transforms frame = at(i, step);
        const VectorXd own = weights(i, step);
        bones.insert(bones.end(), frame.data(), frame.data() + frame.size());
        w.insert(w.end(), own.data(), own.data() + own.size());
      }
    };
    std::vector<double> now, next, w, ignored;
    poses(1, next, ignored);
    poses(0, now, w);
    CHECK(crowd.start(now.data(), next.data(), w.data()).converged);
    int iterations = 0, alone = 0, expected = 0;
    for (int step = 1; step <= 11; ++step) {
      poses(step, now, w);
      const CrowdReport report = crowd.step(now.data(), w.data());
      CHECK(report.converged);
      iterations += report.iterations;
      alone += report.alone;
    }
    for (int i = 0; i < size; ++i) {
      Simulation<ReducedModel> simulation(model, options);
      simulation.start(at(i, 0), at(i, 1), weights(i, 0));
      for (int step = 1; step <= 11; ++step) expected += simulation.step(at(i, step), weights(i, step)).iterations;
      CHECK((crowd.coordinates(i) - simulation.coordinates()).norm() < 1e-4 * simulation.coordinates().norm());
    }
    CHECK(alone == 1);
    CHECK(iterations == expected);
  }
}

TEST_CASE("bad input is refused before anyone moves, and a crowd that could not start has not started") {
  Crowd crowd(linear_model(), {}, kCharacters);
  Poses good(0), bad(0);
  bad.bones[24 * 7 + 5] = NAN;
  CHECK_THROWS_AS(crowd.start(bad.bones.data(), bad.next.data(), bad.weights.data()), Error);
  CHECK_THROWS_AS(crowd.step(good.bones.data(), good.weights.data()), std::invalid_argument);
  crowd.start(good.bones.data(), good.next.data(), good.weights.data());
  const VectorXd before = crowd.coordinates(0);
  CHECK_THROWS_AS(crowd.step(bad.bones.data(), bad.weights.data()), Error);
  bad = good;
  bad.weights[3 * 7] += 0.5;
  CHECK_THROWS_AS(crowd.step(bad.bones.data(), bad.weights.data()), std::invalid_argument);
  CHECK(crowd.coordinates(0) == before);
  CHECK(crowd.step(good.bones.data(), good.weights.data()).converged);
}

TEST_CASE("inertia of eight characters is that of each") {
  const auto body = scenes::chain_bar(6);  // more terms than lanes
  MorphTarget target;
  target.displacement = VectorXd::Zero(3 * body->mesh.nodes.rows());
  target.lame = {2e4, 1e4};
  const auto model = scenes::reduced_model(body, {target}, Law::linear, Blending::even, 9);
  const ModalInertia& inertia = model->modal_inertia();
  const Eigen::Index r = model->dofs(), used = Eigen::Index(inertia.used_bones().size());
  std::array<InertialTarget, kLanes> single;
  std::array<std::array<VectorXd, InertialTarget::kMoments>, kLanes> q;
  std::array<std::array<Transforms, InertialTarget::kPoses>, kLanes> bones;
  std::array<LaneVector<DoubleW>, InertialTarget::kMoments> q_lanes;
  std::array<LaneVector<DoubleW>, InertialTarget::kPoses> bone_lanes;
  ModalInertia::EightInertialTarget eight;
  eight.coefficients = StepRule(StepOptions{1 / 120.}).coefficients();
  eight.gravity_offset = Vector3d(0, 0, 1e-4);
  for (int m = 0; m < InertialTarget::kMoments; ++m) q_lanes[m].resize(r);
  for (int n = 0; n < InertialTarget::kPoses; ++n) bone_lanes[n].resize(12 * used);
  for (int lane = 0; lane < kLanes; ++lane) {
    single[lane].coefficients = eight.coefficients;
    single[lane].gravity_offset = eight.gravity_offset;
    for (int m = 0; m < InertialTarget::kMoments; ++m) {
      q[lane][m] = VectorXd::LinSpaced(r, -1, 1 + lane) * 1e-3 * (m + 1);
      single[lane].q[m] = &q[lane][m];
      for (Eigen::Index k = 0; k < r; ++k) q_lanes[m][k][lane] = q[lane][m](k);
    }
    for (int n = 0; n < InertialTarget::kPoses; ++n) {
      bones[lane][n].resize(6, 12);
      for (int b = 0; b < 6; ++b)  // bent well apart, so that no term is left out for one and not for another
        bones[lane][n].row(b) = scenes::bent(0.2 * (b + 1) * (lane + 1) - 0.01 * n).row(1);
      single[lane].bones[n] = &bones[lane][n];
      for (Eigen::Index b = 0; b < used; ++b)
        for (int e = 0; e < 12; ++e) bone_lanes[n][12 * b + e][lane] = bones[lane][n](inertia.used_bones()[b], e);
    }
  }
  for (int m = 0; m < InertialTarget::kMoments; ++m) eight.q[m] = q_lanes[m].data();
  for (int n = 0; n < InertialTarget::kPoses; ++n) eight.bones[n] = bone_lanes[n].data();
  const DoubleW density = DoubleW{} + 1000, damping = DoubleW{} + 30;
  ModalInertia::EightInertia found;
  inertia.evaluate(eight, &density, &damping, found);
  for (int lane = 0; lane < kLanes; ++lane) {
    ModalInertia::Result expected;
    inertia.evaluate(single[lane], {VectorXd::Constant(1, 1000), VectorXd::Constant(1, 30)}, expected);
    for (Eigen::Index k = 0, p = 0; k < r; ++k) {
      CHECK(std::abs(found.force[k][lane] - expected.force(k)) <= 3e-6 * expected.force.norm());
      for (Eigen::Index l = k; l < r; ++l, ++p) {
        CHECK(std::abs(found.mass[p][lane] - expected.mass(l, k)) <= 3e-6 * expected.mass.norm());
        CHECK(std::abs(found.damped[p][lane] - expected.damped(l, k)) <= 3e-6 * expected.damped.norm());
      }
    }
  }
}

TEST_CASE("a crowd that was not started, or has no one in it, says so") {
  const auto model = linear_model();
  CHECK_THROWS_AS(Crowd(model, {}, 0), std::invalid_argument);
  Crowd crowd(model, {}, 2);
  CHECK_THROWS_AS(crowd.step(nullptr, nullptr), std::invalid_argument);
  CHECK_THROWS_AS(crowd.coordinates(0), std::invalid_argument);
}
