// SPDX-License-Identifier: GPL-3.0-or-later
// CGAL's own number types give exact predicates. GMP and MPFR would be two more libraries to ship.
#define CGAL_DISABLE_GMP 1
#define CGAL_NO_GMP 1
#define CGAL_DISABLE_MPFR 1
#define CGAL_NO_MPFR 1
#include "dynamorph/mesh/cage.hpp"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/alpha_wrap_3.h>

#include <array>
#include <cmath>
#include <vector>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/weld.hpp"

namespace dynamorph {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Wrap = CGAL::Surface_mesh<Kernel::Point_3>;

/// The closed input, scaled to a unit box and in the types that CGAL takes.
struct Soup {
  std::vector<Kernel::Point_3> points;
  std::vector<std::array<std::size_t, 3>> triangles;
};

Soup to_unit(const ClosedSurface& surface, const UnitBox& box) {
  Soup soup;
  for (Eigen::Index i = 0; i < surface.vertices.rows(); ++i) {
    const Vector3d p = (surface.vertices.row(i).transpose() - box.origin) / box.size;
    soup.points.emplace_back(p.x(), p.y(), p.z());
  }
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    const std::array<std::size_t, 3> f{std::size_t(surface.triangles(t, 0)), std::size_t(surface.triangles(t, 1)),
                                       std::size_t(surface.triangles(t, 2))};
    if (!CGAL::collinear(soup.points[f[0]], soup.points[f[1]], soup.points[f[2]])) soup.triangles.push_back(f);
  }
  return soup;
}

Wrap wrap(const Soup& soup, double alpha) {
  Wrap result;
  CGAL::alpha_wrap_3(soup.points, soup.triangles, alpha, 0.2 * alpha, result);
  return result;
}

/// The area of a soup, or of a ball that is a tenth of it across where it has hardly any, as wires.
double area(const Soup& soup) {
  double sum = 0;
  for (const auto& [a, b, c] : soup.triangles)
    sum += std::sqrt(CGAL::squared_area(soup.points[a], soup.points[b], soup.points[c]));
  return std::max(sum, 0.01 * kPi);
}

/// A wrap with about the target's number of vertices.
Wrap wrap_with_vertices(const Soup& soup, int target, const ProgressFn& progress) {
  constexpr int kTries = 8;
  constexpr double kCloseEnough = 0.07;
  constexpr double kAreaOfVertex = 1.15;  // in alpha^2; bodies have 1 to 1.5
  double slope = -2;                      // d log(count) / d log(alpha) for a smooth surface
  double x = 0.5 * std::log(area(soup) / (kAreaOfVertex * target)), last_x = 0, last_y = 0;
  Wrap best;
  double best_error = HUGE_VAL;
  for (int i = 0; i < kTries && best_error > kCloseEnough; ++i) {
    Wrap candidate = wrap(soup, std::exp(x));
    report(progress, 1 - std::pow(0.6, i + 1));
    const double y = std::log(std::max<double>(candidate.number_of_vertices(), 1) / target);
    if (std::abs(y) < best_error) {
      best_error = std::abs(y);
      best = std::move(candidate);
    }
    // Thin parts appear and vanish with alpha, so a measured slope outside this range says nothing about the next step.
    if (i > 0 && x != last_x) slope = std::clamp((y - last_y) / (x - last_x), -4.0, -1.0);
    last_x = x;
    last_y = y;
    x -= y / slope;
  }
  return best;
}

CageSurface to_cage(const Wrap& wrap, const UnitBox& box) {
  CageSurface cage{Points(wrap.number_of_vertices(), 3), Triangles(wrap.number_of_faces(), 3)};
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

CageSurface make_cage_surface(const Points& vertices, const Triangles& triangles, int target_vertices,
                              const ProgressFn& progress) {
  constexpr int kMost = 1000000;  // takes minutes
  if (target_vertices < 4 || target_vertices > kMost)
    throw std::invalid_argument("target_vertices: expected 4 to " + std::to_string(kMost) + ", got " +
                                std::to_string(target_vertices));
  const ClosedSurface closed = close_surface(vertices, triangles);
  const UnitBox box = unit_box(closed.vertices, closed.triangles);
  const Wrap wrap = wrap_with_vertices(to_unit(closed, box), target_vertices, progress);
  if (wrap.number_of_faces() == 0)
    throw Error("No closed cage could be wrapped around the mesh. Raise the cage resolution, or thicken the mesh.");
  return to_cage(wrap, box);
}

}  // namespace dynamorph
