// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <algorithm>
#include <random>

#include "contact/shapes.hpp"
#include "dynamorph/contact/find_contacts.hpp"

using namespace dynamorph;
using shapes::rows;
using shapes::shifted;

namespace {

constexpr double kStep = 1 / 96.;

/// One rigid collider, on its way.
std::vector<ColliderStep> way(const Collider& collider, const RowMajor& before, const RowMajor& after) {
  return {{collider, rows(before), rows(after), 0.5, true}};
}

/// A square of samples facing up at a height, one each 2 cm.
shapes::Skin patch(double height, double thickness, int half = 5) {
  const int side = 2 * half + 1;
  shapes::Skin skin({0, 0, height}, {0, 0, 1}, thickness);
  skin.at.resize(side * side, 3);
  for (int i = 0; i < side * side; ++i) skin.at.row(i) << 0.02 * (i % side - half), 0.02 * (i / side - half), height;
  skin.normal = skin.normal.replicate(side * side, 1).eval();
  skin.thickness.setConstant(side * side, thickness);
  return skin;
}

/// The skin of a limb along z around x, as thick as it is deep.
shapes::Skin limb(double radius, double x = 0) {
  const int around = 40, along = 21;
  shapes::Skin skin({0, 0, 0}, {1, 0, 0}, radius);
  skin.at.resize(around * along, 3);
  skin.normal.resize(around * along, 3);
  for (int i = 0; i < around * along; ++i) {
    const double angle = 2 * kPi * (i % around) / around;
    skin.normal.row(i) << std::cos(angle), std::sin(angle), 0;
    skin.at.row(i) = radius * skin.normal.row(i) + Eigen::RowVector3d(x, 0, 0.01 * (i / around - along / 2));
  }
  skin.thickness.setConstant(around * along, radius);
  return skin;
}

Matrix3d turned(double angle, const Vector3d& axis = {1, 2, 3}) {
  return Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
}

}  // namespace

TEST_CASE("a sample near a collider has the plane of the nearest point; farther ones have none") {
  const Collider sphere = shapes::collider(shapes::sphere(0.5, 48));
  const Vector3d center(1, 2, 3);
  const RowMajor there = shapes::transform(turned(1), center);
  std::mt19937 random(3);
  for (int i = 0; i < 200; ++i) {
    Vector3d direction;
    for (double& x : direction) x = random() / 4294967295.0 - 0.5;
    direction.normalize();
    const double distance = 0.04 * random() / 4294967295.0;
    const Vector3d x = center + (0.5 + distance) * direction;
    shapes::Skin skin(x, -direction, 0.1);
    skin.step(way(sphere, there, there), 0.02);
    if (std::abs(distance - 0.02) > 0.002) CHECK(skin.contacts.size() == size_t(distance < 0.02));
    if (skin.contacts.empty()) continue;
    const Contact& contact = skin.contacts[0];
    CHECK(contact.normal.dot(direction) > 0.9);
    CHECK(contact.normal.norm() == doctest::Approx(1));
    CHECK(contact.normal.dot(x - contact.point) == doctest::Approx(distance).epsilon(0.01).scale(0.1));
    CHECK(contact.motion.norm() < 1e-15);
    CHECK(contact.weight == 1);
    CHECK(contact.too_deep < 0);
  }
}

TEST_CASE("distances are meters in the world, whatever the collider's scale") {
  const Collider box = shapes::collider(shapes::box({1, 1, 1}));
  Matrix3d shear = Matrix3d::Identity();
  shear(0, 1) = 0.5;
  const Matrix3d flat = Vector3d(2, 0.5, 0.005).asDiagonal(), mirror = Vector3d(-1, 1, 1).asDiagonal();
  // How far the face z = 1 lies from the center along its own normal.
  const std::vector<Matrix3d> cases = {
      Matrix3d::Identity(), 3 * Matrix3d::Identity(), 1e-2 * Matrix3d::Identity(), flat, mirror, shear, flat * mirror};
  for (const Matrix3d& scale : cases) {
    const Matrix3d linear = turned(0.7) * scale;
    const Vector3d center(1, -2, 0.5), across = linear.col(0).cross(linear.col(1)).normalized();
    const Vector3d outward = across * (across.dot(linear.col(2)) > 0 ? 1 : -1);
    const Vector3d on_face = center + linear * Vector3d(0.1, 0.2, 1);
    const RowMajor there = shapes::transform(linear, center);
    shapes::Skin skin(on_face + 0.01 * outward, -outward, 0.1);
    skin.step(way(box, there, there), 0.02);
    REQUIRE(skin.contacts.size() == 1);
    CHECK((skin.contacts[0].point - on_face).norm() < 1e-6);
    CHECK((skin.contacts[0].normal - outward).norm() < 1e-3);
    // The same as a deforming collider.
    Points world = box.rest().points * linear.transpose();
    world.rowwise() += center.transpose();
    shapes::Skin other(on_face + 0.01 * outward, -outward, 0.1);
    other.step({{box, rows(world), rows(world), 0.5, true}}, 0.02);
    REQUIRE(other.contacts.size() == 1);
    CHECK((other.contacts[0].point - on_face).norm() < 1e-9);
  }
}

TEST_CASE("a collider that is scaled to nothing, or not finite, does not act and is reported") {
  const Collider box = shapes::collider(shapes::box({1, 1, 1}));
  const RowMajor good = shifted(0, 0, 0);
  RowMajor zero = good, flat = good, wrong = good, endless = good;
  zero.leftCols(3).setZero();
  flat(2, 2) = 0;
  wrong(1, 3) = std::nan("");
  endless(0, 0) = kInfinity;
  Points lost = box.rest().points;
  lost(3, 1) = std::nan("");
  const Points point = Points::Zero(8, 3);
  shapes::Skin skin({0, 0, 0.9}, {0, 0, -1}, 1);
  const std::vector<ColliderStep> steps = {
      {box, rows(good), rows(zero), 0, true},    {box, rows(good), rows(good), 0, true},
      {box, rows(good), rows(flat), 0, true},    {box, rows(good), rows(wrong), 0, true},
      {box, rows(good), rows(endless), 0, true}, {box, rows(lost), rows(lost), 0, true},
      {box, rows(point), rows(point), 0, true},  {box, rows(wrong), rows(wrong), 0, false}};
  skin.step(steps, 0.02);
  CHECK(skin.finder.unusable() == std::vector<int>{0, 2, 3, 4, 5, 6});
  REQUIRE(skin.contacts.size() == 1);
  CHECK(skin.contacts[0].collider == 1);
  // When it is back, nothing flies.
  skin.step(way(box, wrong, good), 0.02);
  REQUIRE(skin.contacts.size() == 1);
  CHECK(skin.contacts[0].motion.isZero(0));
  CHECK(skin.contacts[0].point.z() == doctest::Approx(0.94));
}

TEST_CASE("a thin, fast plate does not lose the samples in front of it") {
  // 0.5 % of a size of 1 m, at 3 m/s: more than six times its thickness in a step.
  const Collider plate = shapes::collider(shapes::box({0.3, 0.3, 0.0025}));
  const Collider sheet = shapes::collider(shapes::floor(0.3));
  for (const Collider* collider : {&plate, &sheet})
    for (const bool deforming : {false, true})
      for (const double tilt : {0.0, 0.4}) {
        shapes::Skin skin = patch(0, 0.5);
        const Points unmoved = skin.at;
        for (int k = 0; k < 5; ++k) {
          const auto at = [&](int step) {
            return shapes::transform(turned(tilt, {1, 0.3, 0}), {0, 0, 0.055 + 0.1 * tilt - 3 * kStep * step});
          };
          const RowMajor before = at(k), after = at(k + 1);
          const auto world = [&](const RowMajor& m) {
            Points points = collider->rest().points * m.leftCols(3).transpose();
            points.rowwise() += m.col(3).transpose();
            return points;
          };
          const Points from = world(before), to = world(after);
          if (deforming)
            skin.step({{*collider, rows(from), rows(to), 0, true}}, unmoved, 0.02, 0.02);
          else
            skin.step(way(*collider, before, after), unmoved, 0.02, 0.02);
          const Vector3d across = after.col(2), middle = after.col(3);
          for (Eigen::Index p = 0; p < skin.at.rows(); ++p)
            CHECK(across.dot(Vector3d(skin.at.row(p)) - middle) < -(collider == &plate ? 0.0025 : 0) + 0.004);
          if (k > 3) CHECK(skin.contacts.size() == size_t(skin.at.rows()));
          for (const Contact& contact : skin.contacts) {
            CHECK((contact.normal + across).norm() < 1e-6);
            CHECK((contact.motion - Vector3d(0, 0, -3 * kStep)).norm() < 1e-9);
          }
        }
      }
}

TEST_CASE("a sample rests on a floor, open or not, for as long as it is pressed, and leaves it as it came") {
  const Collider sheet = shapes::collider(shapes::floor(1)), one_sided = shapes::collider(shapes::floor(1), true),
                 block = shapes::collider(shapes::moved(shapes::box({1, 1, 0.2}), {0, 0, -0.2}));
  const RowMajor there = shifted(0, 0, 0);
  for (const Collider* floor : {&sheet, &one_sided, &block}) {
    shapes::Skin skin({0.2, 0.2, 0.05}, {0, 0, -1}, 0.1);
    Points unmoved = skin.at;
    for (int k = 0; k < 40; ++k) {
      unmoved.row(0) << 0.2 + 0.01 * k, 0.2, k < 30 ? 0.05 - 0.01 * std::min(k, 10) : 0.01 * (k - 34);
      skin.step(way(*floor, there, there), unmoved, 0.02, 0.05);
      CHECK(skin.at(0, 2) > -0.003);
      if (unmoved(0, 2) > 0) CHECK(skin.at(0, 2) == unmoved(0, 2));
      if (unmoved(0, 2) < 0.019) REQUIRE(skin.contacts.size() == 1);
      if (unmoved(0, 2) < 0.019) CHECK(skin.contacts[0].normal.z() == doctest::Approx(1));
    }
  }
}

TEST_CASE("who slides off an edge is free, also below") {
  const Collider sheet = shapes::collider(shapes::floor(1)),
                 block = shapes::collider(shapes::moved(shapes::box({1, 1, 0.2}), {0, 0, -0.2}));
  const RowMajor there = shifted(0, 0, 0);
  for (const Collider* floor : {&sheet, &block}) {
    shapes::Skin skin({0.955, 0.1, 0.001}, {0, 0, -1}, 0.1);
    Points unmoved = skin.at;
    for (int k = 0; k < 20; ++k) {
      unmoved.row(0) << 0.955 + 0.01 * k, 0.1, k < 12 ? -0.01 : -0.05;
      skin.step(way(*floor, there, there), unmoved, 0.02, 0.05);
      CHECK((skin.at(0, 2) > -0.001) == (unmoved(0, 0) < 1));
    }
    CHECK(skin.at(0, 2) == -0.05);
  }
}

TEST_CASE("what is deep inside at the beginning gets out through the collider, not through the body") {
  // A ball appears in a belly that faces +x.
  const Collider ball = shapes::collider(shapes::sphere(0.05, 24));
  const RowMajor there = shifted(0.24, 0, 0);  // its far side is 6 cm deep
  for (double side : {0., 0.02, 0.04}) {
    shapes::Skin skin({0.25, side, 0}, {1, 0, 0}, 0.2);
    skin.step(way(ball, there, there), 0.02);
    REQUIRE(skin.contacts.size() == 1);
    CHECK(skin.contacts[0].normal.x() < -0.3);
    const double far = 0.24 - std::sqrt(0.0025 - side * side);
    CHECK(skin.contacts[0].weight == 1);
    CHECK(skin.contacts[0].too_deep == doctest::Approx(0.25 - far - 0.7 * 0.2).epsilon(0.01));
    CHECK(skin.at(0, 0) == doctest::Approx(0.23));  // not in one leap
    for (int k = 0; k < 5; ++k) skin.step(way(ball, there, there), 0.02);
    skin.step(way(ball, there, there), 0.02);  // and it stays there
    REQUIRE(skin.contacts.size() == 1);
    CHECK(skin.contacts[0].normal.x() < -0.3);
    CHECK(skin.at(0, 0) < 0.23);
    CHECK((Vector3d(skin.at.row(0)) - Vector3d(0.24, 0, 0)).norm() == doctest::Approx(0.05).epsilon(0.01));
  }
  // Barely inside it, on the side toward the body, the nearest point is the way.
  shapes::Skin skin({0.195, 0.01, 0}, {1, 0, 0}, 0.2);
  skin.step(way(ball, there, there), 0.02);
  REQUIRE(skin.contacts.size() == 1);
  CHECK(skin.contacts[0].point.y() == doctest::Approx(0.011).epsilon(0.1));
}

TEST_CASE("what is deep inside overlapping pieces gets out of all of them") {
  // Two blocks one upon the other, the upper one sunk into the lower; a sample in both.
  const shapes::Mesh block = shapes::box({0.5, 0.5, 0.05});
  const Collider blocks = shapes::collider(shapes::joined(block, shapes::moved(block, {0, 0, 0.06})));
  const RowMajor there = shifted(0, 0, 0);
  for (const double z : {-1., 1.}) {  // z: where the skin faces
    shapes::Skin skin({0.1, 0.1, 0.03}, {0, 0, z}, 0.5);
    for (int k = 0; k < 6; ++k) {
      skin.step(way(blocks, there, there), 0.02);
      REQUIRE(skin.contacts.size() == 1);
      CHECK(skin.contacts[0].normal.z() == doctest::Approx(-z));
    }
    CHECK(skin.at(0, 2) == doctest::Approx(z > 0 ? -0.05 : 0.11));
  }
}

TEST_CASE("a floor that stands in a foot at the beginning lifts it, a sheet as well as a block") {
  const Collider sheet = shapes::collider(shapes::floor(1)),
                 block = shapes::collider(shapes::moved(shapes::box({1, 1, 0.5}), {0, 0, -0.5}));
  const RowMajor there = shifted(0, 0, 0);
  for (const Collider* floor : {&sheet, &block}) {
    shapes::Skin sole({0.3, 0.2, -0.01}, {0, 0, -1}, 0.03);
    sole.step(way(*floor, there, there), 0.02);
    REQUIRE(sole.contacts.size() == 1);
    CHECK(sole.at(0, 2) == doctest::Approx(0));
    sole.step(way(*floor, there, there), 0.02);
    REQUIRE(sole.contacts.size() == 1);
    CHECK(sole.contacts[0].normal.z() == doctest::Approx(1));
    // Legs are far below: nothing can be done, which is reported where the floor has an inside.
    shapes::Skin legs({0.3, 0.2, -0.4}, {1, 0, 0}, 0.05);
    legs.step(way(*floor, there, there), 0.02);
    CHECK(legs.at(0, 2) == -0.4);
    if (floor == &block) CHECK(legs.contacts[0].too_deep == doctest::Approx(0.4 - 0.7 * 0.05));
  }
}

TEST_CASE("a contact fades where the bones take a sample in deeper than it can give way") {
  const Collider block = shapes::collider(shapes::moved(shapes::box({1, 1, 0.5}), {0, 0, -0.5}));
  const RowMajor there = shifted(0, 0, 0);
  shapes::Skin skin({0.3, 0.2, 0.01}, {0, 0, -1}, 0.1);
  double last = 1;
  for (int k = 0; k < 30; ++k) {
    const double depth = 0.005 * k;
    Points unmoved = skin.at;
    unmoved(0, 2) = -depth;
    skin.step(way(block, there, there), unmoved, 0.02);
    REQUIRE(skin.contacts.size() == 1);
    const Contact& contact = skin.contacts[0];
    CHECK(contact.weight == doctest::Approx(1 - smooth_step((depth - 0.07) / 0.05)));
    CHECK(contact.too_deep == doctest::Approx(depth - 0.7 * 0.1));
    CHECK(contact.weight <= last);
    last = contact.weight;
  }
  CHECK(last == 0);
  CHECK(skin.at(0, 2) == doctest::Approx(-0.145));
}

TEST_CASE("what is on both sides of a limb presses as its parts do") {
  const double radius = 0.07;
  const shapes::Mesh ball = shapes::sphere(0.05, 16), finger = shapes::box({0.01, 0.06, 0.008});
  const auto beside = [](const shapes::Mesh& mesh, double x, double z = 0) {
    return shapes::moved(mesh, {x, 0.0012, z + 0.0017});
  };
  const auto pinch = [&](double deep) {
    return std::vector{beside(ball, radius + 0.05 - deep), beside(ball, deep - radius - 0.05)};
  };
  const std::vector<std::vector<shapes::Mesh>> cases = {
      pinch(0.01),
      pinch(0.03),
      pinch(0.055),  // their weight fades
      {beside(finger, 0.06, 0.05), beside(finger, 0.06, 0.02), beside(finger, 0.06, -0.01),
       beside(finger, -0.06, 0.02)},
      {beside(shapes::tube(0.06, 0.09, 0.05), 0),
       beside(shapes::tube(0.06, 0.09, 0.05), 0.18)},                                    // the legs of trousers
      {beside(shapes::sphere(0.012, 8), radius - 0.055), beside(ball, -radius - 0.02)},  // one of them has gone past
  };
  const RowMajor there = shifted(0, 0, 0);
  for (const auto& parts : cases) {
    shapes::Mesh all = parts[0];
    std::vector<Collider> colliders;
    std::vector<ColliderStep> steps;
    for (std::size_t k = 1; k < parts.size(); ++k) all = shapes::joined(all, parts[k]);
    for (const shapes::Mesh& part : parts) colliders.push_back(shapes::collider(part));
    for (const Collider& each : colliders) steps.push_back({each, rows(there), rows(there), 0, true});
    const Collider whole = shapes::collider(all);
    shapes::Skin one = limb(radius), several = limb(radius);
    const Points unmoved = one.at;
    for (int k = 0; k < 4; ++k) {
      one.step(way(whole, there, there), unmoved, 0.02, 0.02);
      several.step(steps, unmoved, 0.02, 0.02);
      // Of two facets that are as near, either may be chosen.
      CHECK((one.at - several.at).cwiseAbs().maxCoeff() < 0.002);
      for (const Contact& contact : one.contacts)
        CHECK(std::any_of(several.contacts.begin(), several.contacts.end(), [&](const Contact& other) {
          return other.sample == contact.sample && std::abs(other.weight - contact.weight) < 1e-5 &&
                 std::abs(other.too_deep - contact.too_deep) < 1e-4;
        }));
    }
    CHECK((one.at - unmoved).rowwise().norm().maxCoeff() > 0.009);
  }
}

TEST_CASE("a belt or a cuff presses all around, as deep as it is") {
  const RowMajor there = shifted(0, 0, 0);
  for (const double half : {0.015, 0.075})
    for (const double inner : {0.065, 0.06, 0.05}) {
      const Collider belt = shapes::collider(shapes::tube(inner, 0.09, half, 240));
      shapes::Skin skin = limb(0.07);
      const Points unmoved = skin.at;
      for (int k = 0; k < 4; ++k) skin.step(way(belt, there, there), unmoved, 0.02);
      int pressed = 0;
      for (const Contact& contact : skin.contacts) {
        CHECK(contact.weight == 1);
        CHECK(contact.too_deep < 0);
        pressed += contact.normal.dot(Vector3d(skin.normal.row(contact.sample))) < -0.99;
      }
      CHECK(pressed >= 40 * (2 * int(half / 0.01) - 1));
      for (Eigen::Index p = 0; p < skin.at.rows(); ++p)
        if (std::abs(unmoved(p, 2)) < half - 0.011)
          CHECK(skin.at.row(p).head<2>().norm() == doctest::Approx(inner).epsilon(1e-3));
    }
}

TEST_CASE("a rod that has gone past the skin into the body lets it go") {
  const Collider rod = shapes::collider(shapes::box({0.004, 0.3, 0.004}));
  const RowMajor there = shifted(0.07 - 0.06, 0, 0);
  for (const bool partner : {false, true}) {
    shapes::Skin skin = limb(0.07);
    const Points unmoved = skin.at;
    // Pushed along so far by the rod.
    for (Eigen::Index p = 0; p < skin.at.rows(); ++p)
      if (unmoved(p, 0) > 0.01 && std::abs(unmoved(p, 2)) < 0.004) skin.at(p, 0) = 0.005;
    const Collider both = shapes::collider(
        shapes::joined(shapes::box({0.004, 0.3, 0.004}), shapes::moved(shapes::box({0.02, 0.3, 0.3}), {-0.09, 0, 0})));
    for (int k = 0; k < 3; ++k) skin.step(way(partner ? both : rod, there, there), unmoved, 0.02);
    for (const Contact& contact : skin.contacts)
      if (unmoved(contact.sample, 2) == 0 && unmoved(contact.sample, 0) > 0.069) CHECK(contact.weight == 0);
  }
}

TEST_CASE("a ball driven right through a body and back neither drags the skin along nor out") {
  const Collider ball = shapes::collider(shapes::sphere(0.05, 24));
  shapes::Skin skin = patch(0, 0.04);
  const Points unmoved = skin.at;
  const auto at = [](int k) { return shifted(0.003, 0.001, 0.08 - 0.02 * std::min(k, 60 - k)); };
  for (int k = 0; k < 60; ++k) {
    const RowMajor before = at(k), after = at(k + 1);
    skin.step(way(ball, before, after), unmoved, 0.02, 0.02);
    for (Eigen::Index p = 0; p < skin.at.rows(); ++p) {
      const Vector3d moves = skin.at.row(p) - unmoved.row(p);
      CHECK(moves.norm() < 0.06);
      CHECK(moves.z() < 0.012);
    }
  }
  CHECK((skin.at - unmoved).cwiseAbs().maxCoeff() == 0);
}

TEST_CASE("in a corner both walls hold") {
  // The corner of a room, as one mesh: a floor and two walls, seen from inside.
  shapes::Mesh room = shapes::inside_out(shapes::box({1, 1, 1}));
  const Collider corner(room.points, room.triangles, true);
  const RowMajor there = shifted(0, 0, 0);
  shapes::Skin skin({-0.99, -0.99, -0.98}, Vector3d(-1, -1, -1).normalized(), 0.2);
  Points unmoved = skin.at;
  for (int k = 0; k < 20; ++k) {
    unmoved.row(0) << -1.02, -1.03, -1.04;
    skin.step(way(corner, there, there), unmoved, 0.02, 0.02);
    CHECK(skin.at.minCoeff() > -1.002);
  }
}

TEST_CASE("a collider or a body that jumps is not swept along its way") {
  const Collider ball = shapes::collider(shapes::sphere(0.05, 16));
  const RowMajor left = shifted(-2, 0, 0), right = shifted(2, 0, 0), inside = shifted(0.04, 0, 0);
  shapes::Skin skin({0, 0, 0}, {1, 0, 0}, 0.1);
  skin.step(way(ball, left, left), 0.02);
  skin.step(way(ball, left, right), 0.02);  // right through the sample
  CHECK(skin.contacts.empty());
  skin.step(way(ball, right, inside), 0.02);
  REQUIRE(skin.contacts.size() == 1);
  CHECK(skin.contacts[0].motion.isZero(0));
  CHECK(skin.contacts[0].normal.x() < -0.9);
  for (int k = 0; k < 4; ++k) skin.step(way(ball, inside, inside), 0.02);
  CHECK(skin.at(0, 0) == doctest::Approx(-0.01).epsilon(0.02));
  const Points far = Points::Constant(1, 3, 1.0);
  skin.step(way(ball, inside, inside), far, 0.02);  // now the body
  CHECK(skin.contacts.empty());
}

TEST_CASE("what is inactive touches nothing; when it is active again, what is inside gets out") {
  const Collider block = shapes::collider(shapes::moved(shapes::box({1, 1, 0.5}), {0, 0, -0.5}));
  const RowMajor there = shifted(0, 0, 0);
  shapes::Skin skin({0.3, 0.2, 0.01}, {0, 0, -1}, 0.1);
  const Points sunk = Points(Eigen::RowVector3d(0.3, 0.2, -0.03));
  skin.step(way(block, there, there), 0.02);
  skin.step({{block, rows(there), rows(there), 0, false}}, sunk, 0.02);
  CHECK(skin.contacts.empty());
  CHECK(skin.at == sunk);
  skin.step(way(block, there, there), 0.02);
  CHECK(skin.at(0, 2) == doctest::Approx(-0.01));
  skin.step(way(block, there, there), 0.02);
  CHECK(skin.at(0, 2) == doctest::Approx(0));
}

TEST_CASE("a copy of the memory continues as the first did, to the last bit") {
  const Collider ball = shapes::collider(shapes::sphere(0.1, 24)),
                 plate = shapes::collider(shapes::box({0.3, 0.3, 0.002}));
  const auto step = [&](shapes::Skin& skin, const Points& unmoved, int k) {
    const auto ball_at = [](int k) { return shapes::transform(turned(0.1 * k) * 0.7, {0.01 * k, 0, 0.1 - 0.01 * k}); };
    const auto plate_at = [](int k) {
      return shapes::transform(turned(0.01 * k) * Vector3d(1, 1, 2).asDiagonal(), {0, 0.05, 0.05 - 0.02 * k});
    };
    const RowMajor a = ball_at(k), b = ball_at(k + 1), c = plate_at(k), d = plate_at(k + 1);
    skin.step({{ball, rows(a), rows(b), 0, true}, {plate, rows(c), rows(d), 0, true}}, unmoved, 0.02, 0.02);
  };
  shapes::Skin first = patch(0, 0.1);
  const Points unmoved = first.at;
  for (int k = 0; k < 4; ++k) step(first, unmoved, k);
  shapes::Skin second = patch(0, 0.1);
  second.at = first.at;
  second.memory = first.memory;
  for (int k = 4; k < 10; ++k) {
    step(first, unmoved, k);
    step(second, unmoved, k);
    CHECK(first.at == second.at);
    CHECK(first.contacts.size() == second.contacts.size());
  }
}

TEST_CASE("a deforming collider that is away costs nothing, and is met when it comes") {
  const Collider block = shapes::collider(shapes::box({0.5, 0.5, 0.05}));
  shapes::Skin skin({0.1, 0.1, 0}, {0, 0, 1}, 0.2);
  const Points unmoved = skin.at;
  for (int k = 0; k < 30; ++k) {
    const auto at = [&](int step) {
      return Points(block.rest().points.rowwise() + Eigen::RowVector3d(0, 0, 0.5 - 0.02 * step));
    };
    const Points before = at(k), after = at(k + 1);
    skin.step({{block, rows(before), rows(after), 0, true}}, unmoved, 0.02);
    const double face = 0.45 - 0.02 * (k + 1);
    CHECK(skin.contacts.size() == size_t(face < 0.02));
    if (face > -0.13) CHECK(skin.at(0, 2) == doctest::Approx(std::min(face, 0.0)));
  }
}

TEST_CASE("nonsense of every kind neither fails nor makes a contact that is not finite") {
  std::mt19937 random(7);
  const auto number = [&] { return 2 * (random() / 4294967295.0) - 1; };
  for (int round = 0; round < 200; ++round) {
    const int vertices = 3 + int(random() % 20), triangles = 1 + int(random() % 40);
    shapes::Mesh mesh{Points(vertices, 3), Triangles(triangles, 3)};
    for (double& x : mesh.points.reshaped()) x = random() % 3 ? 0.2 * number() : 0.1 * double(random() % 3);
    for (int& i : mesh.triangles.reshaped()) i = int(random() % vertices);
    mesh.triangles.row(0) << 0, 1, 2;
    mesh.points.row(0) << 0.3, 0, 0;
    mesh.points.row(1) << 0, 0.31, 0;
    mesh.points.row(2) << 0, 0, 0.32;
    const Collider collider = shapes::collider(mesh, round % 5 == 0);
    shapes::Skin skin = patch(0, 0.1);
    for (int k = 0; k < 6; ++k) {
      Points before = mesh.points, after = mesh.points;
      for (double& x : after.reshaped()) x += 0.05 * number();
      RowMajor from = shifted(0, 0, 0.05 * number()), to = from;
      for (double& x : to.reshaped()) x += 0.3 * number();
      if (random() % 2)
        skin.step({{collider, rows(before), rows(after), 0, true}}, 0.02, 0.1);
      else
        skin.step(way(collider, from, to), 0.02, 0.1);
      for (const Contact& contact : skin.contacts) {
        CHECK(contact.point.allFinite());
        CHECK(contact.motion.allFinite());
        CHECK(contact.normal.norm() == doctest::Approx(1));
        CHECK((contact.weight >= 0 && contact.weight <= 1));
        CHECK_FALSE(std::isnan(contact.too_deep));
      }
    }
  }
}

TEST_CASE("arrays that do not fit are refused") {
  const Collider box = shapes::collider(shapes::box({1, 1, 1}));
  const RowMajor there = shifted(0, 0, 0);
  const Points few = Points::Zero(7, 3);
  shapes::Skin skin({0, 0, 2}, {0, 0, 1}, 1);
  CHECK_THROWS_WITH_AS(skin.step({{box, rows(few), rows(few), 0, true}}, 0.1),
                       doctest::Contains("collider, after: expected 8 rows, got 7"), std::invalid_argument);
  CHECK_THROWS_AS(skin.step({{box, rows(few), rows(there), 0, true}}, 0.1), std::invalid_argument);
  skin.thickness.resize(2);
  CHECK_THROWS_WITH_AS(skin.step(way(box, there, there), 0.1), doctest::Contains("thickness"), std::invalid_argument);
}
