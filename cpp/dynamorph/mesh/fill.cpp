// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/fill.hpp"

#include <algorithm>
#include <vector>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "dynamorph/mesh/tet.hpp"

namespace dynamorph {

namespace {

using Eigen::Vector4d;

constexpr double kFloor = 0.05;

/// The barycentric weights of 20 points spread evenly over a tet.
std::vector<Vector4d> sample_weights() {
  constexpr int n = 3;
  std::vector<Vector4d> samples;
  for (int i = 0; i <= n; ++i)
    for (int j = 0; i + j <= n; ++j)
      for (int k = 0; i + j + k <= n; ++k)
        samples.push_back((Vector4d(i, j, k, n - i - j - k).array() + 0.5) / (n + 2));
  return samples;
}

/// The fraction of the samples of a tet that the surface contains.
double filled(const Tet& tet, const Surface& surface, const std::vector<Vector4d>& samples) {
  const Vector3d center = tet.point(Vector4d::Constant(0.25));
  double radius = 0;
  for (const Vector3d& corner : tet.corners) radius = std::max(radius, (corner - center).norm());
  const double clearance = surface.distance(center);
  const bool center_inside = surface.contains(center);
  if (clearance > radius) return center_inside;  // the skin does not pass through the tet
  Eigen::Matrix3Xd near_skin(3, samples.size());
  Eigen::Index asked = 0;
  int inside = 0;
  for (const Vector4d& weights : samples) {
    const Vector3d p = tet.point(weights);
    if ((p - center).norm() < clearance)
      inside += center_inside;
    else
      near_skin.col(asked++) = p;
  }
  return double(inside + surface.count_inside(near_skin.leftCols(asked))) / double(samples.size());
}

}  // namespace

VectorXd fill_fractions(const TetMesh& mesh, const Points& vertices, const Triangles& triangles,
                        const ProgressFn& progress) {
  constexpr Eigen::Index kBlock = 256;  // tets per task
  const ClosedSurface closed = close_surface(vertices, triangles);
  const Surface surface(closed.vertices, closed.triangles);
  const std::vector<Vector4d> samples = sample_weights();
  const Eigen::Index tets = mesh.tets.rows();
  VectorXd fractions(tets);
  run_tasks(int((tets + kBlock - 1) / kBlock), progress, [&](int block, const ProgressFn& done) {
    for (Eigen::Index t = block * kBlock; t < std::min(tets, (block + 1) * kBlock); ++t)
      fractions[t] = std::max(kFloor, filled(Tet(mesh, t), surface, samples));
    report(done, 1);
  });
  return fractions;
}

}  // namespace dynamorph
