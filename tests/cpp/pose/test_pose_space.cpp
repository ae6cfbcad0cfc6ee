// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <Eigen/Geometry>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/pose/pose_space.hpp"

using namespace dynamorph;

namespace {

Pose hinge(double angle, double second = 0) {
  Pose pose{Rotations(2, 4)};
  pose.rotations << std::cos(angle / 2), std::sin(angle / 2), 0, 0, std::cos(second / 2), 0, std::sin(second / 2), 0;
  return pose;
}

/// The same with values of two channels.
Pose with_channels(double angle, double first, double second = 0) {
  Pose pose = hinge(angle);
  pose.channels = Eigen::Vector2d(first, second);
  return pose;
}

TargetSet elbow() { return {{0}, {"straight", "half", "flexed"}, {hinge(0), hinge(1), hinge(2)}}; }

VectorXd weights(const PoseSpace& space, const Pose& pose) {
  VectorXd w(space.targets());
  space.weights(pose, w);
  return w;
}

}  // namespace

TEST_CASE("weights are cardinal, not negative, and sum to one") {
  const PoseSpace space({elbow()});
  for (int j = 0; j < 3; ++j) CHECK((weights(space, hinge(j)) - VectorXd::Unit(3, j)).cwiseAbs().maxCoeff() < 1e-9);
  for (double angle = -3; angle < 3; angle += 0.13) {
    const VectorXd w = weights(space, hinge(angle, 0.4));
    CHECK(w.minCoeff() >= 0);
    CHECK(w.sum() == doctest::Approx(1));
  }
}

TEST_CASE("weights are the driver's hat function in one dimension, constant outside") {
  const PoseSpace space({elbow()});
  CHECK(weights(space, hinge(0.25))(0) == doctest::Approx(0.75));
  CHECK(weights(space, hinge(0.25))(1) == doctest::Approx(0.25));
  CHECK(weights(space, hinge(1.7))(2) == doctest::Approx(0.7));
  CHECK(weights(space, hinge(2.9))(2) == doctest::Approx(1));
  CHECK(weights(space, hinge(-0.8))(0) == doctest::Approx(1));
}

TEST_CASE("weights ignore the quaternion's sign and bones that the set does not name") {
  const PoseSpace space({elbow()});
  const VectorXd w = weights(space, hinge(0.6));
  CHECK((weights(space, {-hinge(0.6).rotations}) - w).norm() < 1e-12);
  CHECK((weights(space, hinge(0.6, 1.1)) - w).norm() < 1e-12);
}

TEST_CASE("independent sets are laid end to end, each summing to one") {
  TargetSet wrist{{1}, {"open", "bent"}, {hinge(0, 0), hinge(0, 1)}};
  const PoseSpace space({elbow(), wrist});
  const VectorXd w = weights(space, hinge(1.5, 0.25));
  CHECK(w.head(3).sum() == doctest::Approx(1));
  CHECK(w(3) == doctest::Approx(0.75));
  CHECK(w(4) == doctest::Approx(0.25));
}

TEST_CASE("a target fades out at its radius, smoothly, and the neutral gets what it loses") {
  TargetSet set = elbow();
  const PoseSpace endless({set});
  set.radii = {0.1, 0, 0.8};  // the neutral's own means nothing
  const PoseSpace space({set});
  for (int j = 0; j < 3; ++j) CHECK((weights(space, hinge(j)) - VectorXd::Unit(3, j)).cwiseAbs().maxCoeff() < 1e-9);
  const double step = 1e-3;
  double before = 0, slope = 0, bend = 0;
  for (double angle = 2; angle < 3.1; angle += step) {  // only the last target counts
    const VectorXd w = weights(space, hinge(angle)), w0 = weights(endless, hinge(angle));
    const double distance = angle - 2, u = std::clamp(distance / 0.4 - 1, 0.0, 1.0);
    CHECK(w.minCoeff() >= 0);
    CHECK(w.sum() == doctest::Approx(1));
    CHECK(w(1) == doctest::Approx(w0(1)));
    CHECK(w(2) == doctest::Approx(w0(2) * (1 - u * u * (3 - 2 * u))));
    if (angle > 2 + step) bend = std::max(bend, std::abs((w(2) - before) / step - slope));
    slope = (w(2) - before) / step;
    before = w(2);
  }
  CHECK(before == 0);
  CHECK(bend < 0.05);  // no corner: the slope, up to 3.75, changes as little as its steps
}

TEST_CASE("a radius is an angle, also where the set measures chords") {
  TargetSet set{{0}, {"a", "b", "c"}, {hinge(0), hinge(kPi), hinge(kPi / 2)}};
  const double b = weights(PoseSpace({set}), hinge(0.9 * kPi))(1);
  set.radii = {0, 0.1 * kPi, 0};
  CHECK(weights(PoseSpace({set}), hinge(0.95 * kPi))(1) > 0.5);
  CHECK(weights(PoseSpace({set}), hinge(0.9 * kPi))(1) < 1e-9);
  CHECK(b > 0.5);
}

TEST_CASE("distances are joint angles over the set's own bones") {
  TargetSet wrist{{0, 1}, {"open", "bent"}, {hinge(0, 0), hinge(0, 1)}};
  const PoseSpace space({elbow(), wrist});
  VectorXd d(space.targets()), expected(5);
  space.distances(hinge(0.5, -1), d);
  expected << 0.5, 0.5, 1.5, std::hypot(0.5, 1), std::hypot(0.5, 2);
  CHECK((d - expected).norm() < 1e-12);
}

TEST_CASE("radii that are not one for each target, or negative, are the caller's mistake") {
  TargetSet set = elbow();
  set.radii = {0, 1};
  CHECK_THROWS_AS(PoseSpace({set}), std::invalid_argument);
  set.radii = {0, 1, std::nan("")};
  CHECK_THROWS_AS(PoseSpace({set}), std::invalid_argument);
}

TEST_CASE("two targets at one pose are an error that names both") {
  TargetSet set = elbow();
  set.poses[2] = hinge(1.0);
  try {
    PoseSpace space({set});
    FAIL("expected an Error");
  } catch (const Error& e) {
    CHECK(std::string(e.what()).find("'half' and 'flexed'") != std::string::npos);
  }
}

TEST_CASE("targets right round a joint: cardinal, and no jump of the weights between them") {
  for (double quarter : {kPi / 2, 85 * kPi / 180}) {
    TargetSet set{{0}, {"a", "b", "c", "d"}, {hinge(0), hinge(quarter), hinge(2 * quarter), hinge(-quarter)}};
    const PoseSpace space({set});
    CHECK((weights(space, hinge(2 * quarter)) - VectorXd::Unit(4, 2)).cwiseAbs().maxCoeff() < 1e-9);
    double jump = 0;
    for (double angle = -kPi; angle < kPi; angle += 0.01)
      jump = std::max(jump, (weights(space, hinge(angle + 0.01)) - weights(space, hinge(angle))).cwiseAbs().maxCoeff());
    CHECK(jump < 0.02);
  }
}

TEST_CASE("a channel alone places targets as a driver's hat function, whatever its unit") {
  for (double unit : {1.0, 100.0, -0.01}) {
    const TargetSet set{{},
                        {"relaxed", "half", "tense"},
                        {with_channels(0, 0), with_channels(0, 0.5 * unit), with_channels(0, unit)},
                        {},
                        {0}};
    const PoseSpace space({set});
    CHECK(space.channels() == 1);
    VectorXd expected(3);
    for (double value : {-0.5, 0.0, 0.2, 0.5, 0.9, 1.0, 1.7}) {
      const double t = std::clamp(value, 0.0, 1.0);
      expected << std::max(0.0, 1 - 2 * t), 1 - std::abs(1 - 2 * t), std::max(0.0, 2 * t - 1);
      CHECK((weights(space, with_channels(1.3, value * unit, 9)) - expected).cwiseAbs().maxCoeff() < 1e-12);
    }
  }
}

TEST_CASE("a channel's whole range is a right angle among joint angles") {
  const TargetSet set{{0},
                      {"relaxed", "bent", "tense"},
                      {with_channels(0, 0), with_channels(kPi / 2, 0), with_channels(0, 8)},
                      {},
                      {0}};
  const PoseSpace space({set});
  VectorXd d(3), expected(3);
  space.distances(with_channels(kPi / 2, 4), d);
  expected << std::hypot(kPi / 2, kPi / 4), kPi / 4, std::hypot(kPi / 2, kPi / 4);
  CHECK((d - expected).norm() < 1e-12);
  for (int j = 0; j < 3; ++j)
    CHECK((weights(space, set.poses[std::size_t(j)]) - VectorXd::Unit(3, j)).cwiseAbs().maxCoeff() < 1e-9);
  // bent and tense are as far from each other, and from relaxed: what is between them is shared alike
  const VectorXd w = weights(space, with_channels(kPi / 4, 4));
  CHECK(w(1) == doctest::Approx(w(2)));
}

TEST_CASE("without channels in a set, those of a pose change no bit of a weight") {
  const PoseSpace space({elbow()});
  TargetSet other = elbow();
  for (Pose& pose : other.poses) pose.channels = Eigen::Vector2d(3, 4);
  for (double angle = -3; angle < 3; angle += 0.17)
    CHECK(weights(space, hinge(angle)) == weights(PoseSpace({other}), with_channels(angle, 1, 2)));
}

TEST_CASE("a channel that a pose does not have is the caller's mistake") {
  TargetSet set = elbow();
  set.channels = {0};
  CHECK_THROWS_WITH_AS(PoseSpace({set}), "sets: channel index 0 is not in a pose of 0 channels", std::invalid_argument);
}

TEST_CASE("a pose that is not a number is an error") {
  Eigen::Matrix<double, 1, 16, Eigen::RowMajor> transform = Eigen::Matrix<double, 1, 16>::Constant(std::nan(""));
  Rotations pose(1, 4);
  CHECK_THROWS_AS(rotation_of(LocalTransforms(transform.data(), 1, 16), 0, pose), Error);
}
