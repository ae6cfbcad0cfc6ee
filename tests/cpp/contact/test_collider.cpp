// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <random>

#include "contact/shapes.hpp"
#include "dynamorph/contact/collider.hpp"

using namespace dynamorph;

namespace {

std::vector<Vector3d> random_points(int count, double extent, int seed = 1) {
  std::mt19937 random(seed);
  std::vector<Vector3d> points(count);
  for (Vector3d& p : points)
    for (double& x : p) x = extent * (2 * (random() / 4294967295.0) - 1);
  return points;
}

bool contains(const Collider& collider, const ColliderPose& pose, const Vector3d& x) {
  return collider.contains(pose, x, collider.nearest(pose, x));
}
bool contains(const Collider& collider, const Vector3d& x) { return contains(collider, collider.rest(), x); }

/// Positive outside.
double box_distance(const Vector3d& x, const Vector3d& half) {
  const Vector3d q = x.cwiseAbs() - half;
  return q.cwiseMax(0).norm() + std::min(q.maxCoeff(), 0.0);
}

}  // namespace

TEST_CASE("what a collider cannot be made of is refused with a sentence") {
  const shapes::Mesh box = shapes::box({1, 1, 1});
  const auto refused = [&](const char* what, auto change) {
    shapes::Mesh mesh = box;
    change(mesh);
    CHECK_THROWS_WITH_AS(shapes::collider(mesh), doctest::Contains(what), std::invalid_argument);
  };
  refused("triangles: a collider needs at least one", [](shapes::Mesh& m) { m.triangles.resize(0, 3); });
  refused("triangles: expected vertex indices from 0 to 7", [](shapes::Mesh& m) { m.triangles(3, 1) = 8; });
  refused("triangles: expected vertex indices from 0 to 7", [](shapes::Mesh& m) { m.triangles(3, 1) = -1; });
  refused("triangles: expected vertex indices", [](shapes::Mesh& m) { m.points.resize(0, 3); });
  refused("points: must be finite", [](shapes::Mesh& m) { m.points(2, 1) = std::nan(""); });
  refused("points: must be finite", [](shapes::Mesh& m) { m.points(2, 1) = kInfinity; });
  refused("none of them has three different corners", [](shapes::Mesh& m) { m.points.setZero(); });
}

TEST_CASE("the nearest point equals a search through all triangles, within its cutoff") {
  const shapes::Mesh mesh = shapes::sphere(1, 7);
  const Collider collider = shapes::collider(mesh);
  for (const Vector3d& x : random_points(300, 2)) {
    double best = kInfinity;
    for (Eigen::Index t = 0; t < mesh.triangles.rows(); ++t) {
      const auto corner = [&](int k) { return Vector3d(mesh.points.row(mesh.triangles(t, k))); };
      best = std::min(best, (closest_on_triangle(x, corner(0), corner(1), corner(2)) - x).norm());
    }
    const ColliderPoint nearest = collider.nearest(collider.rest(), x);
    CHECK((nearest.point - x).norm() == doctest::Approx(best));
    CHECK((collider.at(collider.rest(), nearest) - nearest.point).norm() < 1e-9);
    CHECK(bool(collider.nearest(collider.rest(), x, 0.3)) == (best < 0.3));
  }
}

TEST_CASE("inside and outside of a box, also at its edges and corners") {
  const Vector3d half(1, 0.5, 0.01);
  const Collider box = shapes::collider(shapes::box(half));
  const Collider turned = shapes::collider(shapes::inside_out(shapes::box(half)));
  std::vector<Vector3d> points = random_points(500, 1.2);
  for (const Vector3d& p : random_points(2000, 1.2, 2)) {  // near faces, edges and corners
    const Vector3d near = p.cwiseMax(-half).cwiseMin(half);
    points.push_back(near + 1e-6 * p);
    points.push_back(near - 1e-6 * p);
  }
  for (const Vector3d& x : points) {
    const double distance = box_distance(x, half);
    if (std::abs(distance) < 1e-9) continue;
    CHECK(contains(box, x) == (distance < 0));
    CHECK(contains(turned, x) == (distance < 0));
    CHECK(turned.signed_distance(turned.rest(), x) == doctest::Approx(distance).epsilon(1e-6));
    const ColliderPoint nearest = box.nearest(box.rest(), x);
    CHECK((x - nearest.point).norm() == doctest::Approx(std::abs(distance)).epsilon(1e-6));
    CHECK(box.pseudonormal(box.rest(), nearest).norm() == doctest::Approx(1));
  }
}

TEST_CASE("split vertices and triangles without area leave a mesh closed") {
  shapes::Mesh mesh = shapes::box({1, 1, 1}), split{Points(36, 3), Triangles(14, 3)};
  for (int corner = 0; corner < 36; ++corner) {  // each triangle has its own vertices
    split.points.row(corner) = mesh.points.row(mesh.triangles(corner / 3, corner % 3));
    split.triangles(corner / 3, corner % 3) = corner;
  }
  split.triangles.row(12) << 0, 0, 1;
  split.triangles.row(13) << 3, 4, 4;
  const Collider collider = shapes::collider(split);
  for (const Vector3d& x : random_points(500, 1.5)) CHECK(contains(collider, x) == (box_distance(x, {1, 1, 1}) < 0));
  // A needle between two triangles: one side has a vertex more than the other.
  shapes::Mesh needle = mesh;
  needle.points.conservativeResize(9, 3);
  needle.points.row(8) = (mesh.points.row(1) + mesh.points.row(2)) / 2;
  needle.triangles.conservativeResize(14, 3);
  needle.triangles.row(0) << 0, 2, 8;
  needle.triangles.row(12) << 0, 8, 1;
  needle.triangles.row(13) << 8, 2, 1;
  const Collider pierced = shapes::collider(needle);
  for (const Vector3d& x : random_points(500, 1.5)) CHECK(contains(pierced, x) == (box_distance(x, {1, 1, 1}) < 0));
}

TEST_CASE("faces that are there twice count once") {
  const auto turned = [](const Triangles& triangles) { return Triangles(triangles.rowwise().reverse()); };
  const auto both = [](const Triangles& a, const Triangles& b) {
    Triangles out(a.rows() + b.rows(), 3);
    out << a, b;
    return out;
  };
  const shapes::Mesh box = shapes::box({1, 1, 1}), floor = shapes::floor(1);
  const Triangles& own = box.triangles;
  // Reversed, in either order; some of them; from the same side; and as a shell of its own vertices.
  for (const Triangles& triangles :
       {both(own, turned(own)), both(turned(own), own), both(own, turned(own.topRows(5))), both(own, own)}) {
    const Collider collider(box.points, triangles);
    CHECK(collider.triangles().rows() == own.rows());
    for (const Vector3d& x : random_points(300, 1.5)) CHECK(contains(collider, x) == (box_distance(x, {1, 1, 1}) < 0));
  }
  const Collider shell = shapes::collider(shapes::joined(box, shapes::inside_out(box)), true);
  CHECK_FALSE(shell.one_sided());
  for (const Vector3d& x : random_points(300, 1.5)) CHECK(contains(shell, x) == (box_distance(x, {1, 1, 1}) < 0));
  // An open sheet stays one, and has both of its sides.
  const Collider sheet(floor.points, both(floor.triangles, turned(floor.triangles)), true);
  CHECK_FALSE(sheet.solid());
  CHECK(sheet.sheet(0));
  CHECK(Collider(floor.points, both(floor.triangles, floor.triangles), true).one_sided());
}

TEST_CASE("a body with a hole has an inside, a hemisphere has none") {
  shapes::Mesh mesh = shapes::sphere(1, 24);
  const Eigen::Index all = mesh.triangles.rows();
  const Collider holed = Collider(mesh.points, mesh.triangles.topRows(all - 48));  // a cap of 7.5 degrees is missing
  const Collider inside_out = Collider(mesh.points, mesh.triangles.topRows(all - 48).rowwise().reverse());
  const Collider half = Collider(mesh.points, mesh.triangles.topRows(all / 2));
  CHECK(holed.solid());
  CHECK_FALSE(half.solid());
  for (const Vector3d& x : random_points(500, 1.5)) {
    if (std::abs(x.norm() - 1) > 0.02 && (x - Vector3d(0, 0, 1)).norm() > 0.3) {
      CHECK(contains(holed, x) == (x.norm() < 1));
      CHECK(contains(inside_out, x) == (x.norm() < 1));
    }
    CHECK_FALSE(contains(half, x));
  }
}

TEST_CASE("triangles that face either way are turned outward") {
  shapes::Mesh mesh = shapes::sphere(1, 12);
  for (Eigen::Index t = 0; t < mesh.triangles.rows(); t += 3) std::swap(mesh.triangles(t, 0), mesh.triangles(t, 1));
  const Collider collider = shapes::collider(mesh);
  for (const Vector3d& x : random_points(500, 1.5))
    if (std::abs(x.norm() - 1) > 0.04) CHECK(contains(collider, x) == (x.norm() < 1));
}

TEST_CASE("pieces may overlap, enclose a cavity, or stand on a floor") {
  const Vector3d half(1, 1, 1), apart(0.8, 0.3, 0.1);
  const shapes::Mesh box = shapes::box(half);
  const Collider both = shapes::collider(shapes::joined(box, shapes::inside_out(shapes::moved(box, apart))));
  const Collider hollow = shapes::collider(shapes::joined(box, shapes::inside_out(shapes::box({0.5, 0.5, 0.5}))));
  const Collider standing = shapes::collider(shapes::joined(shapes::moved(shapes::floor(5), {0, 0, -1.5}), box));
  for (const Vector3d& x : random_points(1000, 2)) {
    const bool inside = box_distance(x, half) < 0;
    CHECK(contains(both, x) == (inside || box_distance(x - apart, half) < 0));
    CHECK(contains(hollow, x) == (inside && box_distance(x, {0.5, 0.5, 0.5}) > 0));
    CHECK(contains(standing, x) == inside);
  }
}

TEST_CASE("what is behind a one-sided collider is inside, but not beside it") {
  const Collider floor = shapes::collider(shapes::floor(1), true);
  CHECK(contains(floor, {0.3, 0.2, -0.1}));
  CHECK(contains(floor, {0.3, 0.3, -0.1}));  // on the edge that its two triangles share
  CHECK_FALSE(contains(floor, {0.3, 0.2, 0.1}));
  CHECK_FALSE(contains(floor, {1.5, 0.2, -0.1}));
  const Collider room = shapes::collider(shapes::inside_out(shapes::box({2, 2, 2})), true);
  CHECK_FALSE(contains(room, {0, 1, 0}));
  CHECK(contains(room, {0, 2.5, 0}));
}

TEST_CASE("a pose that followed its points equals a collider built there") {
  const shapes::Mesh rest = shapes::sphere(1, 10);
  const Collider collider(rest.points, rest.triangles.topRows(rest.triangles.rows() - 4));  // winding numbers
  shapes::Mesh bent = rest;
  for (Eigen::Index i = 0; i < bent.points.rows(); ++i)
    bent.points.row(i) << bent.points(i, 0) + 0.4 * std::sin(2 * bent.points(i, 2)), 0.6 * bent.points(i, 1),
        bent.points(i, 2) + 3;
  ColliderPose pose;
  collider.refit(Points(2 * bent.points), pose);
  collider.refit(bent.points, pose);
  const Collider built(bent.points, rest.triangles.topRows(rest.triangles.rows() - 4));
  for (const Vector3d& p : random_points(300, 1.5)) {
    const Vector3d x = p + Vector3d(0, 0, 3);
    const ColliderPoint a = collider.nearest(pose, x), b = built.nearest(built.rest(), x);
    CHECK((a.point - b.point).norm() < 1e-12);
    CHECK((collider.pseudonormal(pose, a) - built.pseudonormal(built.rest(), b)).norm() < 1e-12);
    CHECK(contains(collider, pose, x) == contains(built, x));
  }
}

TEST_CASE("a mirrored pose still has its inside inside") {
  const Vector3d half(1, 0.5, 0.25);
  const Collider box = shapes::collider(shapes::box(half));
  ColliderPose pose;
  Points mirrored = box.rest().points;
  mirrored.col(0) *= -1;
  box.refit(mirrored, pose);
  for (const Vector3d& x : random_points(300, 1.2)) {
    CHECK(contains(box, pose, x) == (box_distance(x, half) < 0));
    const ColliderPoint nearest = box.nearest(pose, x);
    CHECK((x - nearest.point).dot(box.pseudonormal(pose, nearest)) * box_distance(x, half) >= 0);
  }
}

TEST_CASE("the first crossing of a sphere, at rest and in motion") {
  const shapes::Mesh mesh = shapes::sphere(1, 32);
  const Collider sphere = shapes::collider(mesh);
  const ColliderPose& rest = sphere.rest();
  const auto cross = [&](const Vector3d& from, const Vector3d& to, Collider::Crossing kind) {
    return sphere.first_crossing(rest, rest, from, to, kind);
  };
  const Vector3d from(0.2, 0.1, 3), to(0.2, 0.1, -3);
  const ColliderPoint in = cross(from, to, Collider::Crossing::entering);
  const ColliderPoint out = cross(from, to, Collider::Crossing::leaving);
  REQUIRE(in);
  REQUIRE(out);
  CHECK(in.point.z() == doctest::Approx(std::sqrt(0.95)).epsilon(0.01));
  CHECK(out.point.z() == doctest::Approx(-std::sqrt(0.95)).epsilon(0.01));
  CHECK(in.front);
  CHECK_FALSE(out.front);
  CHECK(cross(from, to, Collider::Crossing::either).point == in.point);
  CHECK_FALSE(cross(from, {0.2, 0.1, 1.1}, Collider::Crossing::entering));
  CHECK_FALSE(cross({0, 0, 0}, {0.1, 0.9, 0}, Collider::Crossing::leaving));

  // It flies past a point that stays: as if the point had gone the other way.
  ColliderPose moved;
  sphere.refit(mesh.points.rowwise() + Eigen::RowVector3d(0, 0, 6), moved);
  const ColliderPoint met = sphere.first_crossing(rest, moved, from, from, Collider::Crossing::entering);
  REQUIRE(met);
  CHECK((met.point - Vector3d(0, 0, 6) - in.point).norm() < 1e-9);
  CHECK_FALSE(sphere.first_crossing(rest, moved, {3, 0, 3}, {3, 0, 3}, Collider::Crossing::entering));
}

TEST_CASE("no way into a turning, swelling sphere slips between its triangles") {
  const shapes::Mesh mesh = shapes::sphere(1, 12);
  const Collider sphere = shapes::collider(mesh);
  ColliderPose moved;
  const Matrix3d turn = Eigen::AngleAxisd(0.3, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  sphere.refit(1.3 * mesh.points * turn.transpose(), moved);
  for (const Vector3d& p : random_points(3000, 1)) {
    const Vector3d way = p.normalized();
    CHECK(sphere.first_crossing(sphere.rest(), moved, 1.1 * way, way, Collider::Crossing::entering));
    CHECK(sphere.first_crossing(sphere.rest(), moved, 1.2 * way, 1.2 * way, Collider::Crossing::entering));
    CHECK_FALSE(sphere.first_crossing(sphere.rest(), moved, 1.2 * way, 1.4 * way, Collider::Crossing::entering));
  }
}
