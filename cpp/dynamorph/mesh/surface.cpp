// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/surface.hpp"

#include <cmath>

namespace dynamorph {

namespace {

std::vector<Bvh::Box> boxes(const Points& vertices, const Triangles& triangles) {
  check_triangles(vertices, triangles);
  std::vector<Bvh::Box> boxes(triangles.rows());
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    for (int k = 0; k < 3; ++k) boxes[t].extend(Vector3d(vertices.row(triangles(t, k))));
  return boxes;
}

}  // namespace

void check_triangles(const Points& vertices, const Triangles& triangles) {
  if (triangles.size() && (triangles.minCoeff() < 0 || triangles.maxCoeff() >= vertices.rows()))
    throw std::invalid_argument("triangles: expected vertex indices from 0 to " + std::to_string(vertices.rows() - 1) +
                                ", got " + std::to_string(triangles.minCoeff()) + " to " +
                                std::to_string(triangles.maxCoeff()));
}

// Ericson, Real-Time Collision Detection, 5.1.5: finds the vertex, edge or face region of the triangle that p projects
// to.
Vector3d closest_on_triangle(const Vector3d& p, const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp), d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d1 <= 0 && d2 <= 0) return a;
  if (d3 >= 0 && d4 <= d3) return b;
  if (d6 >= 0 && d5 <= d6) return c;
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  if (va <= 0 && d4 >= d3 && d5 >= d6) return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  return a + (vb * ab + vc * ac) / (va + vb + vc);
}

Surface::Surface(Points vertices, Triangles triangles)
    : vertices_(std::move(vertices)), triangles_(std::move(triangles)), bvh_(boxes(vertices_, triangles_)) {
  dipoles_.reserve(bvh_.nodes.size());
  for (const Bvh::Node& node : bvh_.nodes) dipoles_.push_back(dipole(node));
}

Surface::Dipole Surface::dipole(const Bvh::Node& node) const {
  Dipole d;
  double area = 0;
  for (int i = node.begin; i < node.end; ++i) {
    const int t = bvh_.order[i];
    const Vector3d a = corner(t, 0), b = corner(t, 1), c = corner(t, 2);
    const Vector3d vector = (b - a).cross(c - a) / 2;
    d.area_vector += vector;
    d.centroid += vector.norm() * (a + b + c) / 3;
    area += vector.norm();
  }
  d.centroid = area > 0 ? Vector3d(d.centroid / area) : node.box.center();
  d.radius = (node.box.center() - d.centroid).norm() + node.box.diagonal().norm() / 2;
  return d;
}

Vector3d Surface::nearest(const Vector3d& p) const {
  double best = kInfinity;
  Vector3d nearest = Vector3d::Constant(best);
  bvh_.nearest(p, best, [&](int t) {
    const Vector3d closest = closest_on_triangle(p, corner(t, 0), corner(t, 1), corner(t, 2));
    const double distance = (closest - p).squaredNorm();
    if (distance >= best) return;
    best = distance;
    nearest = closest;
  });
  return nearest;
}

double Surface::winding_number(int index, const Vector3d& p) const {
  const Bvh::Node& node = bvh_.nodes[index];
  const Dipole& d = dipoles_[index];
  const Vector3d to = d.centroid - p;
  const double distance2 = to.squaredNorm();
  if (distance2 > 4 * d.radius * d.radius) return d.area_vector.dot(to) / (4 * kPi * distance2 * std::sqrt(distance2));
  if (!node.leaf()) return winding_number(index + 1, p) + winding_number(node.right, p);
  double omega = 0;
  for (int i = node.begin; i < node.end; ++i) omega += solid_angle(bvh_.order[i], p);
  return omega / (4 * kPi);
}

// Van Oosterom and Strackee 1983: tan(Omega / 2) = a . (b x c) / (|a||b||c| + (a.b)|c| + (b.c)|a| + (c.a)|b|).
double Surface::solid_angle(int triangle, const Vector3d& p) const {
  const Vector3d a = corner(triangle, 0) - p, b = corner(triangle, 1) - p, c = corner(triangle, 2) - p;
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  const double y = a.dot(b.cross(c)), x = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
  return 2 * std::atan2(y, x);
}

}  // namespace dynamorph
