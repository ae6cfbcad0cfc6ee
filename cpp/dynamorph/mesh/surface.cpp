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

struct Corners {
  Vector3d a, b, c;
};

Corners corners(const Points& vertices, const Triangles& triangles, int t) {
  return {vertices.row(triangles(t, 0)), vertices.row(triangles(t, 1)), vertices.row(triangles(t, 2))};
}

// Van Oosterom and Strackee 1983: tan(Omega / 2) = a . (b x c) / (|a||b||c| + (a.b)|c| + (b.c)|a| + (c.a)|b|).
double solid_angle(const Corners& triangle, const Vector3d& p) {
  const Vector3d a = triangle.a - p, b = triangle.b - p, c = triangle.c - p;
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  const double y = a.dot(b.cross(c)), x = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
  return 2 * std::atan2(y, x);
}

double winding_number(const Dipole& dipole, const Vector3d& to, double distance2) {
  return dipole.area_vector.dot(to) / (4 * kPi * distance2 * std::sqrt(distance2));
}

bool is_far(const Dipole& dipole, double distance2) { return distance2 > 4 * dipole.radius * dipole.radius; }

/// The sum of what is seen of the triangles below a node.
double winding_number(const Points& vertices, const Triangles& triangles, const Bvh& bvh,
                      const std::vector<Dipole>& dipoles, int index, const Vector3d& p) {
  const Bvh::Node& node = bvh.nodes[index];
  const Dipole& d = dipoles[index];
  const Vector3d to = d.centroid - p;
  const double distance2 = to.squaredNorm();
  if (is_far(d, distance2)) return winding_number(d, to, distance2);
  if (!node.leaf())
    return winding_number(vertices, triangles, bvh, dipoles, index + 1, p) +
           winding_number(vertices, triangles, bvh, dipoles, node.right, p);
  double omega = 0;
  for (int i = node.begin; i < node.end; ++i) omega += solid_angle(corners(vertices, triangles, bvh.order[i]), p);
  return omega / (4 * kPi);
}

/// Points within `radius` of `center`, and the sums of what each sees.
struct Group {
  const Eigen::Ref<const Eigen::Matrix3Xd>& points;
  Vector3d center;
  double radius;
  VectorXd sums;
};

/// Adds what a group sees of the triangles below a node. What is far from all is looked at once.
void add_winding_numbers(const Points& vertices, const Triangles& triangles, const Bvh& bvh,
                         const std::vector<Dipole>& dipoles, int index, Group& group) {
  const Bvh::Node& node = bvh.nodes[index];
  const Dipole& d = dipoles[index];
  const double least = (d.centroid - group.center).norm() - group.radius;
  const bool far = least > 0 && is_far(d, least * least);
  if (!far && !node.leaf()) {
    add_winding_numbers(vertices, triangles, bvh, dipoles, index + 1, group);
    add_winding_numbers(vertices, triangles, bvh, dipoles, node.right, group);
    return;
  }
  for (Eigen::Index k = 0; k < group.sums.size(); ++k) {
    const Vector3d p = group.points.col(k), to = d.centroid - p;
    const double distance2 = to.squaredNorm();
    if (far || is_far(d, distance2)) {
      group.sums(k) += winding_number(d, to, distance2);
      continue;
    }
    for (int i = node.begin; i < node.end; ++i)
      group.sums(k) += solid_angle(corners(vertices, triangles, bvh.order[i]), p) / (4 * kPi);
  }
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

void find_dipoles(const Points& vertices, const Triangles& triangles, const Bvh& bvh, std::vector<Dipole>& out) {
  out.resize(bvh.nodes.size());
  for (int index = int(bvh.nodes.size()) - 1; index >= 0; --index) {  // children come after their parents
    const Bvh::Node& node = bvh.nodes[index];
    Dipole d;
    const auto add = [&](const Vector3d& area_vector, double area, const Vector3d& centroid) {
      d.area_vector += area_vector;
      d.area += area;
      d.centroid += area * centroid;
    };
    if (!node.leaf())
      for (int child : {index + 1, node.right}) add(out[child].area_vector, out[child].area, out[child].centroid);
    for (int i = node.begin; node.leaf() && i < node.end; ++i) {
      const auto [a, b, c] = corners(vertices, triangles, bvh.order[i]);
      const Vector3d vector = (b - a).cross(c - a) / 2;
      add(vector, vector.norm(), (a + b + c) / 3);
    }
    d.centroid = d.area > 0 ? Vector3d(d.centroid / d.area) : node.box.center();
    d.radius = (node.box.center() - d.centroid).norm() + node.box.diagonal().norm() / 2;
    out[index] = d;
  }
}

double winding_number(const Points& vertices, const Triangles& triangles, const Bvh& bvh,
                      const std::vector<Dipole>& dipoles, const Vector3d& p) {
  return bvh.nodes.empty() ? 0 : winding_number(vertices, triangles, bvh, dipoles, 0, p);
}

Surface::Surface(Points vertices, Triangles triangles)
    : vertices_(std::move(vertices)), triangles_(std::move(triangles)), bvh_(boxes(vertices_, triangles_)) {
  find_dipoles(vertices_, triangles_, bvh_, dipoles_);
}

int Surface::count_inside(const Eigen::Ref<const Eigen::Matrix3Xd>& points) const {
  if (bvh_.nodes.empty() || points.cols() == 0) return 0;
  const Vector3d center = points.rowwise().mean();
  Group group{points, center, (points.colwise() - center).colwise().norm().maxCoeff(), VectorXd::Zero(points.cols())};
  add_winding_numbers(vertices_, triangles_, bvh_, dipoles_, 0, group);
  return int((group.sums.array().abs() > 0.5).count());
}

Vector3d Surface::nearest(const Vector3d& p, Vector3d nearest) const {
  double best = (nearest - p).squaredNorm();
  bvh_.nearest(p, best, [&](int t) {
    const Vector3d closest = closest_on_triangle(p, corner(t, 0), corner(t, 1), corner(t, 2));
    const double distance = (closest - p).squaredNorm();
    if (!(distance < best)) return;  // NaN at a triangle with equal corners, whose edges its neighbors have too
    best = distance;
    nearest = closest;
  });
  return nearest;
}

}  // namespace dynamorph
