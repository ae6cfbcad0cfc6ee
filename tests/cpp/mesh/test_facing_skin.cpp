// SPDX-License-Identifier: GPL-3.0-or-later
// Where skin meets itself: two fingers of one body that are moved into each other, and a thin sheet that meets nothing.
#include <doctest/doctest.h>

#include <numeric>

#include "contact/shapes.hpp"
#include "dynamorph/mesh/facing_skin.hpp"

using namespace dynamorph;
using namespace shapes;

namespace {

std::vector<int> all_of(const Points& x) {
  std::vector<int> out(std::size_t(x.rows()));
  std::iota(out.begin(), out.end(), 0);
  return out;
}

}  // namespace

TEST_CASE("skin that meets other skin is found, with its depth") {
  const Mesh one = sphere(0.1), two = moved(one, {0.5, 0, 0}), both = joined(one, two);
  FacingSkin skin(both.points, both.triangles, VectorXd::Constant(both.points.rows(), 0.1));
  CHECK(skin.area().sum() == doctest::Approx(8 * kPi * 0.01).epsilon(0.02));
  std::vector<FacingSkin::Touch> touches;
  skin.find(both.points, all_of(both.points), 0.002, touches);
  CHECK(touches.empty());
  for (const double depth : {0.01, -0.001}) {
    Points x = both.points;
    x.bottomRows(two.points.rows()).col(0).array() -= 0.3 + depth;
    skin.find(x, all_of(x), 0.002, touches);
    REQUIRE(!touches.empty());
    double deepest = -1;
    for (const FacingSkin::Touch& touch : touches) {
      const bool first = touch.point < one.points.rows();
      CHECK(touch.normal.dot(Vector3d(first ? -1 : 1, 0, 0)) > 0.8);
      CHECK(touch.weights.sum() == doctest::Approx(1));
      deepest = std::max(deepest, -touch.gap);
    }
    CHECK(deepest == doctest::Approx(depth).epsilon(0.1));
  }
}

TEST_CASE("the other side of a thin part, and skin beside a point, are no contact") {
  const Mesh plate = box({0.2, 0.2, 0.01});
  FacingSkin skin(plate.points, plate.triangles, VectorXd::Constant(8, 0.1));
  std::vector<FacingSkin::Touch> touches;
  skin.find(plate.points, all_of(plate.points), 0.005, touches);
  CHECK(touches.empty());
  Points thinner = plate.points;
  thinner.col(2) *= -0.1;  // turned inside out
  skin.find(thinner, all_of(thinner), 0.005, touches);
  CHECK(touches.empty());
}
