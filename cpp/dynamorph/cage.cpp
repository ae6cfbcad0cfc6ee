// SPDX-License-Identifier: GPL-3.0-or-later
// Exact predicates from CGAL's own number types: GMP and MPFR would be two more libraries to ship.
#define CGAL_DISABLE_GMP 1
#define CGAL_NO_GMP 1
#define CGAL_DISABLE_MPFR 1
#define CGAL_NO_MPFR 1
#include "dynamorph/cage.hpp"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/alpha_wrap_3.h>

#include <array>
#include <cmath>
#include <map>
#include <sstream>
#include <vector>

#include "dynamorph/surface.hpp"

namespace dynamorph {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Wrap = CGAL::Surface_mesh<Kernel::Point_3>;

/// The input in a unit box, welded: what CGAL takes.
struct Soup {
  std::vector<Kernel::Point_3> points;
  std::vector<std::array<std::size_t, 3>> triangles;
};

/// x = origin + size * unit
struct UnitBox {
  Vector3d origin;
  double size;
};

void check_finite(const Points& vertices) {
  std::ostringstream list;
  int bad = 0;
  for (Eigen::Index i = 0; i < vertices.rows(); ++i)
    if (!vertices.row(i).allFinite() && ++bad <= 5) list << (bad > 1 ? ", " : "") << i;
  if (bad == 0) return;
  std::ostringstream message;
  message << bad << " of " << vertices.rows() << " vertices have a NaN or infinite coordinate (first: " << list.str()
          << "). Delete them, or reset the shape key or modifier that moves them.";
  throw Error(message.str());
}

UnitBox unit_box(const Points& vertices, const Triangles& triangles) {
  if (triangles.rows() == 0) throw Error("The mesh has no faces. Model some, or un-hide them, then build again.");
  Eigen::AlignedBox3d box;
  Vector3d mean = Vector3d::Zero();
  for (int i : triangles.reshaped()) {
    box.extend(Vector3d(vertices.row(i)));
    mean += vertices.row(i) / double(triangles.size());
  }
  const double size = box.diagonal().norm();
  if (!(size > 1e-6 && size < 1e6)) {
    std::ostringstream message;
    message << "The mesh is " << size
            << " m across; sizes from 1e-6 to 1e6 m can be built. Scale it and apply the scale.";
    throw Error(message.str());
  }
  Matrix3d covariance = Matrix3d::Zero();
  for (int i : triangles.reshaped()) {
    const Vector3d d = (vertices.row(i).transpose() - mean) / size;
    covariance += d * d.transpose() / double(triangles.size());
  }
  const double thickness = Eigen::SelfAdjointEigenSolver<Matrix3d>(covariance).eigenvalues()[0];
  if (thickness < 1e-12)  // squared, relative
    throw Error("The mesh is flat: it has no volume to simulate. Give it thickness (Solidify modifier, applied).");
  return {box.min(), size};
}

Soup weld(const Points& vertices, const Triangles& triangles, const UnitBox& box) {
  constexpr double tolerance = 1e-6;
  std::map<std::array<std::int64_t, 3>, std::size_t> cells;
  Soup soup;
  const auto index = [&](int vertex) {
    const Vector3d p = (vertices.row(vertex).transpose() - box.origin) / box.size;
    const std::array<std::int64_t, 3> cell{std::llround(p.x() / tolerance), std::llround(p.y() / tolerance),
                                           std::llround(p.z() / tolerance)};
    const auto [it, is_new] = cells.emplace(cell, soup.points.size());
    if (is_new) soup.points.emplace_back(p.x(), p.y(), p.z());
    return it->second;
  };
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    const std::array<std::size_t, 3> f{index(triangles(t, 0)), index(triangles(t, 1)), index(triangles(t, 2))};
    if (!CGAL::collinear(soup.points[f[0]], soup.points[f[1]], soup.points[f[2]])) soup.triangles.push_back(f);
  }
  return soup;
}

Wrap wrap(const Soup& soup, double alpha) {
  Wrap result;
  CGAL::alpha_wrap_3(soup.points, soup.triangles, alpha, 0.2 * alpha, result);
  return result;
}

/// The wrap whose number of vertices is nearest to the target.
Wrap wrap_with_vertices(const Soup& soup, int target, const ProgressFn& progress) {
  constexpr int tries = 8;
  constexpr double close_enough = 0.07;
  double slope = -2;  // d log(count) / d log(alpha) of a smooth surface
  double x = std::log(1 / std::sqrt(double(target))), last_x = 0, last_y = 0;
  Wrap best;
  double best_error = HUGE_VAL;
  for (int i = 0; i < tries && best_error > close_enough; ++i) {
    Wrap candidate = wrap(soup, std::exp(x));
    report(progress, 1 - std::pow(0.6, i + 1));
    const double y = std::log(std::max<double>(candidate.number_of_vertices(), 1) / target);
    if (std::abs(y) < best_error) {
      best_error = std::abs(y);
      best = std::move(candidate);
    }
    // Thin parts appear and vanish with alpha: a measured slope off this range says nothing about the next step.
    if (i > 0 && x != last_x) slope = std::clamp((y - last_y) / (x - last_x), -4.0, -1.0);
    last_x = x;
    last_y = y;
    x -= y / slope;
  }
  return best;
}

Cage to_cage(const Wrap& wrap, const UnitBox& box) {
  Cage cage{Points(wrap.number_of_vertices(), 3), Triangles(wrap.number_of_faces(), 3)};
  std::vector<int> number(wrap.num_vertices());
  int row = 0;
  for (const auto v : wrap.vertices()) {
    const auto& p = wrap.point(v);
    number[v.idx()] = row;
    cage.vertices.row(row++) = box.origin + box.size * Vector3d(p.x(), p.y(), p.z());
  }
  row = 0;
  for (const auto f : wrap.faces()) {
    int k = 0;
    for (const auto v : wrap.vertices_around_face(wrap.halfedge(f))) cage.triangles(row, k++) = number[v.idx()];
    ++row;
  }
  return cage;
}

}  // namespace

Cage make_cage(const Points& vertices, const Triangles& triangles, int target_vertices, const ProgressFn& progress) {
  if (target_vertices < 4)
    throw std::invalid_argument("target_vertices: expected at least 4, got " + std::to_string(target_vertices));
  check_triangles(vertices, triangles);
  check_finite(vertices);
  const UnitBox box = unit_box(vertices, triangles);
  const Wrap wrap = wrap_with_vertices(weld(vertices, triangles, box), target_vertices, progress);
  if (wrap.number_of_faces() == 0)
    throw Error("No closed cage could be wrapped around the mesh. Raise the cage resolution, or thicken the mesh.");
  return to_cage(wrap, box);
}

}  // namespace dynamorph
