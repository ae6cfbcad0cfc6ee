// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/facing_skin.hpp"

#include <algorithm>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr double kBeside = 1. / 3;  // of the thickness, at rest: nearer is the same piece of skin
constexpr double kNearAtRest = 2;   // times how near contact begins: what touches nearly at rest does so for a reason
constexpr double kThrough = 3;      // of the thickness, at rest: what is behind and no farther is the other side
constexpr double kReach = 0.35;     // of the thickness: how far inside a point is still seen
constexpr double kAside = 0.3;      // cosine between normals at rest: beyond it two places are on the same side
constexpr double kFaces = -0.2;     // cosine between normals

Bvh::Box box_of(const Points& x, const Triangles& triangles, int t) {
  Bvh::Box box;
  for (const int corner : triangles.row(t)) box.extend(x.row(corner).transpose());
  return box;
}

std::vector<Bvh::Box> boxes_of(const Points& x, const Triangles& triangles) {
  check_triangles(x, triangles);
  std::vector<Bvh::Box> boxes;
  for (int t = 0; t < triangles.rows(); ++t) boxes.push_back(box_of(x, triangles, t));
  return boxes;
}

/// Weights of the triangle's point q, which is in its plane.
Vector3d weights_at(const Vector3d& q, const Matrix3d& corners) {
  const Vector3d u = corners.col(1) - corners.col(0), v = corners.col(2) - corners.col(0), w = q - corners.col(0);
  const double uu = u.dot(u), uv = u.dot(v), vv = v.dot(v), wu = w.dot(u), wv = w.dot(v);
  const double determinant = std::max(uu * vv - uv * uv, 1e-300);
  const double b = (vv * wu - uv * wv) / determinant, c = (uu * wv - uv * wu) / determinant;
  return {1 - b - c, b, c};
}

}  // namespace

FacingSkin::FacingSkin(const Points& rest, const Triangles& triangles, const VectorXd& thickness)
    : rest_(rest), triangles_(triangles), thickness_(thickness), bvh_(boxes_of(rest, triangles)) {
  at_rest_ = normals(rest);
  area_ = VectorXd::Zero(rest.rows());
  for (Index t = 0; t < triangles.rows(); ++t)
    for (const int corner : triangles.row(t)) area_(corner) += area_vector(rest, triangles, t).norm() / 3;
}

FacingSkin::Normals FacingSkin::normals(const Points& x) const {
  Normals out{Points::Zero(triangles_.rows(), 3), Points::Zero(x.rows(), 3)};
  for (Index t = 0; t < triangles_.rows(); ++t) {
    const Vector3d area = area_vector(x, triangles_, t);
    for (const int corner : triangles_.row(t)) out.points.row(corner) += area.transpose();
    out.triangles.row(t) = area.normalized();
  }
  out.points.rowwise().normalize();
  return out;
}

bool FacingSkin::may_touch(int point, int triangle, double near) const {
  Vector3d center = Vector3d::Zero();
  double thickness = thickness_(point);
  for (const int corner : triangles_.row(triangle)) {
    center += rest_.row(corner).transpose() / 3;
    thickness = std::max(thickness, thickness_(corner));
  }
  const Vector3d from = rest_.row(point).transpose() - center;
  const double far = from.norm();
  if (far < std::max(kBeside * thickness, kNearAtRest * near)) return false;
  const Vector3d normal = at_rest_.triangles.row(triangle);
  const Vector3d outward = at_rest_.points.row(point);
  const bool behind = from.dot(normal) < 0 && from.dot(outward) > 0 && outward.dot(normal) < kAside;
  return !behind || far > kThrough * thickness;
}

void FacingSkin::find(const Points& x, const std::vector<int>& points, double near, std::vector<Touch>& out) {
  const Normals now = normals(x);
  bvh_.refit([&](int t) { return box_of(x, triangles_, t); });
  std::vector<Touch> found(points.size());
  parallel_parts(Index(points.size()), [&](Index first, Index end) {
    for (Index i = first; i < end; ++i) {
      const int point = points[std::size_t(i)];
      const Vector3d p = x.row(point), outward = now.points.row(point);
      const double reach = std::max(near, kReach * thickness_(point));
      double best = reach * reach;
      Touch& touch = found[std::size_t(i)];
      bvh_.nearest(p, best, [&](int t) {
        if (!(outward.dot(now.triangles.row(t)) < kFaces)) return;
        const Vector3d a = x.row(triangles_(t, 0)), b = x.row(triangles_(t, 1)), c = x.row(triangles_(t, 2));
        const Vector3d q = closest_on_triangle(p, a, b, c);
        const double square = (p - q).squaredNorm();
        if (!(square < best) || !may_touch(point, t, near)) return;
        best = square;
        Matrix3d corners;
        corners << a, b, c;
        touch = {point, t, weights_at(q, corners), Vector3d::Zero(), outward, 0};
        for (int k = 0; k < 3; ++k) touch.normal += touch.weights(k) * now.points.row(triangles_(t, k)).transpose();
        touch.normal.normalize();
        touch.gap = (p - q).dot(touch.normal);
      });
    }
  });
  out.clear();
  for (const Touch& touch : found)
    if (touch.point >= 0 && touch.gap < near && touch.normal.allFinite()) out.push_back(touch);
}

}  // namespace dynamorph
