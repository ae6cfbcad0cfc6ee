// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <random>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/mesh/cage.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/mesh/fill.hpp"
#include "dynamorph/mesh/pins.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"
#include "dynamorph/mesh/tetrahedralize.hpp"

using namespace dynamorph;

namespace {

/// A sphere of radius 1, outward, of rings x 2 rings quads cut in two.
CageSurface sphere(int rings = 24) {
  const int around = 2 * rings;
  CageSurface s{Points((rings - 1) * around + 2, 3), Triangles(2 * (rings - 1) * around, 3)};
  const int south = static_cast<int>(s.vertices.rows()) - 2, north = south + 1;
  s.vertices.row(south) << 0, 0, -1;
  s.vertices.row(north) << 0, 0, 1;
  int t = 0;
  for (int i = 0; i < rings - 1; ++i)
    for (int j = 0; j < around; ++j) {
      const double latitude = kPi * (i + 1) / rings, longitude = 2 * kPi * j / around;
      const int a = i * around + j, b = i * around + (j + 1) % around;
      s.vertices.row(a) << std::sin(latitude) * std::cos(longitude), std::sin(latitude) * std::sin(longitude),
          -std::cos(latitude);
      if (i == 0) s.triangles.row(t++) << south, b, a;
      if (i == rings - 2) {
        s.triangles.row(t++) << a, b, north;
        continue;
      }
      s.triangles.row(t++) << a, b, a + around;
      s.triangles.row(t++) << b, b + around, a + around;
    }
  return s;
}

std::vector<Vector3d> random_points(int count, double extent) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> coordinate(-extent, extent);
  std::vector<Vector3d> points;
  for (int i = 0; i < count; ++i) {
    const double x = coordinate(random), y = coordinate(random);
    points.emplace_back(x, y, coordinate(random));
  }
  return points;
}

TetMesh sphere_mesh(int nodes = 800) {
  const CageSurface s = sphere(8);
  return tetrahedralize(s.vertices * 1.2, s.triangles, nodes);
}

}  // namespace

TEST_CASE("points are counted inside together as one by one, wherever they are and however far from each other") {
  CageSurface s = sphere(12);
  for (const bool inside_out : {false, true}) {
    if (inside_out) s.triangles.col(1).swap(s.triangles.col(2));
    const Surface surface(s.vertices, s.triangles);
    for (const double spread : {1e-3, 0.1, 1.5})
      for (const Vector3d& middle : random_points(60, 1.5)) {
        Eigen::Matrix3Xd group(3, 20);
        int expected = 0;
        const std::vector<Vector3d> offsets = random_points(20, spread);
        for (int k = 0; k < 20; ++k) {
          group.col(k) = middle + offsets[k];
          expected += surface.contains(group.col(k));
        }
        CHECK(surface.count_inside(group) == expected);
      }
    CHECK(surface.count_inside(Eigen::Matrix3Xd(3, 0)) == 0);
  }
}

TEST_CASE("the nearest point does not depend on the guess") {
  const CageSurface s = sphere(12);
  const Surface surface(s.vertices, s.triangles);
  const std::vector<Vector3d> points = random_points(200, 1.5);
  for (size_t i = 1; i < points.size(); ++i)
    CHECK(surface.nearest(points[i], surface.nearest(points[i - 1])) == surface.nearest(points[i]));
}

TEST_CASE("distance to a surface equals a search through all triangles") {
  const CageSurface s = sphere(6);
  const Surface surface(s.vertices, s.triangles);
  for (const Vector3d& p : random_points(200, 2)) {
    double best = std::numeric_limits<double>::infinity();
    for (Eigen::Index t = 0; t < s.triangles.rows(); ++t) {
      const Vector3d a = s.vertices.row(s.triangles(t, 0)), b = s.vertices.row(s.triangles(t, 1)),
                     c = s.vertices.row(s.triangles(t, 2));
      best = std::min(best, (closest_on_triangle(p, a, b, c) - p).norm());
    }
    CHECK(surface.distance(p) == best);
  }
}

TEST_CASE("winding numbers tell inside from outside, open or inside out") {
  const CageSurface s = sphere();
  const Surface closed(s.vertices, s.triangles);
  const Surface open(s.vertices, s.triangles.topRows(s.triangles.rows() * 9 / 10));
  const Surface inside_out(s.vertices, s.triangles.rowwise().reverse());
  for (const Vector3d& p : random_points(500, 1.5)) {
    const double r = p.norm();
    if (std::abs(r - 1) > 0.02) {
      CHECK(closed.winding_number(p) == doctest::Approx(r < 1).epsilon(0.02));
      CHECK(inside_out.contains(p) == (r < 1));
    }
    if (r < 0.5 || r > 1.2) CHECK(open.contains(p) == (r < 1));
  }
}

TEST_CASE("an empty surface contains nothing and is infinitely far") {
  const Surface none(Points(0, 3), Triangles(0, 3));
  CHECK(std::isinf(none.distance(Vector3d::Zero())));
  CHECK_FALSE(none.contains(Vector3d::Zero()));
}

TEST_CASE("tets fill the cage: volume, boundary, orientation, node count") {
  const CageSurface s = sphere(8);
  const TetMesh mesh = tetrahedralize(s.vertices, s.triangles, 800);
  double volume = 0;
  for (Eigen::Index t = 0; t < s.triangles.rows(); ++t) {
    const Vector3d a = s.vertices.row(s.triangles(t, 0)), b = s.vertices.row(s.triangles(t, 1)),
                   c = s.vertices.row(s.triangles(t, 2));
    volume += a.cross(b).dot(c) / 6;
  }
  CHECK(volumes(mesh).sum() == doctest::Approx(volume).epsilon(1e-10));
  CHECK(volumes(mesh).minCoeff() > 0);
  CHECK((mesh.nodes.topRows(s.vertices.rows()) - s.vertices).cwiseAbs().maxCoeff() < 1e-12);
  CHECK(std::abs(mesh.nodes.rows() - 800) < 160);
}

TEST_CASE("an embedding reproduces points and linear fields, and stays bounded far outside") {
  const TetMesh mesh = sphere_mesh();
  const std::vector<Vector3d> samples = random_points(300, 3);
  Points points(samples.size(), 3);
  for (size_t i = 0; i < samples.size(); ++i) points.row(i) = samples[i];
  const Embedding e = embed(mesh, points);
  const Points carried = e.matrix(mesh.nodes.rows()) * mesh.nodes;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    CHECK(e.weights.row(i).sum() == doctest::Approx(1));
    CHECK(e.weights.row(i).minCoeff() > -0.5 - 1e-9);
    const bool bounded = e.weights.row(i).minCoeff() < -0.5 + 1e-9;
    if (!bounded) CHECK((carried.row(i) - points.row(i)).norm() < 1e-9);
    if (points.row(i).norm() < 1) {
      CHECK(e.distances[i] == 0);
      CHECK(e.weights.row(i).minCoeff() >= 0);
    }
    if (points.row(i).norm() > 1.2) CHECK(e.distances[i] >= points.row(i).norm() - 1.2 - 1e-9);
  }
}

TEST_CASE("fill fractions add up to the body's volume") {
  const CageSurface s = sphere();
  const TetMesh mesh = sphere_mesh();
  const VectorXd fill = fill_fractions(mesh, s.vertices, s.triangles);
  CHECK(fill.minCoeff() >= 0.05);
  CHECK(fill.maxCoeff() <= 1);
  CHECK(fill.dot(volumes(mesh)) == doctest::Approx(4 * kPi / 3).epsilon(0.03));
}

TEST_CASE("extended values keep constants and fit what varies smoothly") {
  const CageSurface s = sphere();
  const TetMesh mesh = sphere_mesh();
  const Embedding e = embed(mesh, s.vertices);
  MatrixXd values(s.vertices.rows(), 2);
  values << VectorXd::Ones(s.vertices.rows()), s.vertices.col(0);
  const MatrixXd nodes = extend_to_nodes(mesh, e, values);
  CHECK((nodes.col(0).array() - 1).abs().maxCoeff() < 1e-6);
  CHECK((e.matrix(mesh.nodes.rows()) * nodes - values).cwiseAbs().maxCoeff() < 0.05);
}

TEST_CASE("bones hold more nodes as the ratio grows, none outside the body") {
  const CageSurface s = sphere();
  const TetMesh mesh = sphere_mesh();
  Points head(1, 3), tail(1, 3);
  head << 0, 0, -0.5;
  tail << 0, 0, 0.5;
  const auto pins = [&](double ratio, const Points& heads, const Points& tails) {
    return pinned(mesh, s.vertices, s.triangles, heads, tails, ratio);
  };
  const auto count = [](const std::vector<bool>& flags) { return std::count(flags.begin(), flags.end(), true); };
  CHECK(count(pins(0, head, tail)) == 0);
  CHECK(count(pins(0.3, head, tail)) > 0);
  CHECK(count(pins(0.3, head, tail)) < count(pins(0.6, head, tail)));
  CHECK(count(pins(0.3, head, head)) > 0);  // a bone without length is a point
  CHECK(count(pins(0.9, Points(0, 3), Points(0, 3))) == 0);
  const std::vector<bool> all = pins(1, head, tail);
  for (size_t i = 0; i < all.size(); ++i) {
    const double r = mesh.nodes.row(i).norm();
    if (std::abs(r - 1) > 0.02) CHECK(all[i] == (r < 1));
  }
}

TEST_CASE("a canceled cage stops") {
  const CageSurface s = sphere();
  CHECK_THROWS_AS(make_cage_surface(s.vertices, s.triangles, 100, [](double) { return false; }), Cancelled);
}
