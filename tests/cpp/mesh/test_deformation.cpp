// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <set>
#include <utility>
#include <vector>

#include "dynamorph/mesh/deformation.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

/// A cube with edges of 2 m from the origin, of two cells along each.
struct Cube {
  Points points;
  Triangles triangles;
  std::vector<EdgeEnds> edges;  ///< of one mesh

  Cube() {
    const TetMesh mesh = scenes::bar(2, 2, 2, 1);
    points = mesh.nodes;
    triangles = scenes::surface_of(mesh);
    std::set<Edge> found;
    for (Eigen::Index t = 0; t < triangles.rows(); ++t)
      for (int k = 0; k < 3; ++k) found.insert(undirected(triangles(t, k), triangles(t, (k + 1) % 3)));
    EdgeEnds& ends = edges.emplace_back(Eigen::Index(found.size()), 2);
    Eigen::Index row = 0;
    for (const auto& [a, b] : found) ends.row(row++) << a, b;
  }

  /// That of frames in which it is displaced by coordinates (F) times u (V, 3).
  Deformation measure(const VectorXd& coordinates, const Points& u) const {
    return measure_deformation(points, triangles, edges, RowMajor(coordinates), RowMajor(flat(u).transpose()));
  }
};

}  // namespace

TEST_CASE("a scaled cube is stretched by its scale") {
  const Cube cube;
  const VectorXd scales = Eigen::Vector4d(0, 0.5, 1.25, 3);
  const Deformation found = cube.measure((scales.array() - 1).matrix(), cube.points);
  for (Eigen::Index f = 0; f < scales.size(); ++f) {
    const double corner = std::abs(scales[f] - 1) * std::sqrt(12.0);
    CHECK(found.largest[f] == doctest::Approx(corner));
    CHECK(found.percentile[f] == doctest::Approx(corner));  // one of 26 vertices
    CHECK(found.shortest[f] == doctest::Approx(scales[f]));
    CHECK(found.longest[f] == doctest::Approx(scales[f]));
    CHECK(found.flipped[f] == 0);
  }
  CHECK((found.farthest - 2 * cube.points.rowwise().norm()).norm() < 1e-14);  // in the last frame
}

TEST_CASE("what is turned over counts by its area") {
  Points points(6, 3);
  points << 0, 0, 0, 1, 0, 0, 0, 1, 0, 5, 0, 0, 7, 0, 0, 5, 1, 0;
  Triangles triangles(2, 3);
  triangles << 0, 1, 2, 3, 4, 5;  // of 0.5 and 1 square meter
  RowMajor modes = RowMajor::Zero(2, 18), coordinates(4, 2);
  modes(0, 3) = -2;   // mirrors the first in x = 0,
  modes(1, 12) = -4;  // and the second in x = 5
  coordinates << 0, 0, 1, 0, 0, 1, 1, 1;
  const Deformation found = measure_deformation(points, triangles, {}, coordinates, modes);
  CHECK((found.flipped - Eigen::Vector4d(0, 1, 2, 3) / 3).norm() < 1e-15);
  CHECK((found.shortest.array() == 1).all());  // without edges
}

TEST_CASE("the worst mesh counts, however small it is") {
  Cube cube;
  EdgeEnds torn(1, 2), many(2001, 2);
  torn << 25, 26;  // 1 m at rest
  many.rowwise() = Eigen::RowVector2i(0, 1);
  many.bottomRows(1) = torn;  // 0.05 % of all, which does not show among them
  Points u = Points::Zero(27, 3);
  u.row(26) << 0, 0, 2;
  cube.edges = {many};
  CHECK(cube.measure(VectorXd::Ones(1), u).longest[0] == 1);
  cube.edges = {many, torn};
  CHECK(cube.measure(VectorXd::Ones(1), u).longest[0] == doctest::Approx(3));
}

TEST_CASE("vertices without area do not count") {
  Cube cube;  // the node in the middle is on no triangle
  Points u = Points::Zero(27, 3);
  u(13, 2) = 7;
  Deformation found = cube.measure(VectorXd::Ones(1), u);
  CHECK(found.largest[0] == 0);
  CHECK(found.farthest[13] == 7);
  cube.triangles.resize(0, 3);
  found = cube.measure(VectorXd::Ones(1), u);
  CHECK(found.percentile[0] == 0);
  CHECK(found.flipped[0] == 0);
}

TEST_CASE("a quantile is the smallest value up to which the weights have that share") {
  const auto of = [](std::vector<Weighted> values, double share) { return quantile(values, share); };
  CHECK(of({{7, 0}}, 0.5) == 7);
  const std::vector<Weighted> three{{3, 2}, {1, 1}, {2, 5}};
  CHECK(of(three, 0) == 1);
  CHECK(of(three, 0.125) == 1);
  CHECK(of(three, 0.126) == 2);
  CHECK(of(three, 0.75) == 2);
  CHECK(of(three, 0.751) == 3);
  CHECK(of(three, 1) == 3);
  std::vector<Weighted> many;
  for (int k = 0; k < 1000; ++k) many.push_back({double(k * 387 % 1000), 1});  // each whole number once
  for (const double share : {0.001, 0.002, 0.25, 0.5, 0.75, 0.998, 0.999, 1.0})
    CHECK(of(many, share) == doctest::Approx(1000 * share - 1));
  for (Weighted& each : many) each.weight = each.value < 998 ? 0 : 1;  // the first cut misses
  CHECK(of(many, 0.001) == 998);
  CHECK(of(many, 0.999) == 999);
}

TEST_CASE("what cannot be measured is refused") {
  const Cube cube;
  const RowMajor one = RowMajor::Ones(1, 1), still = RowMajor::Zero(1, 81);
  const auto refused = [&](const char* message, const std::vector<EdgeEnds>& edges, const RowMajor& coordinates,
                           const RowMajor& modes) {
    CHECK_THROWS_WITH_AS(measure_deformation(cube.points, cube.triangles, edges, coordinates, modes),
                         doctest::Contains(message), std::invalid_argument);
  };
  const auto edge = [](int a, int b) {
    EdgeEnds ends(1, 2);
    ends << a, b;
    return std::vector<EdgeEnds>{ends};
  };
  refused("edges: expected vertex indices from 0 to 26, got 3 to 27", edge(3, 27), one, still);
  refused("edges: expected finite lengths above zero", edge(3, 3), one, still);
  refused("edges: expected at least one for each mesh", {EdgeEnds(0, 2)}, one, still);
  refused("modes: expected 2 rows, got 1", cube.edges, RowMajor::Ones(1, 2), still);
  refused("modes: expected one displacement per vertex", cube.edges, one, RowMajor::Zero(1, 78));
  refused("must be finite", cube.edges, one * kInfinity, still);
}
