// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/LU>
#include <algorithm>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// One tet, ready for queries.
struct Tet {
  static constexpr double kLowestWeight = -0.5;

  Vector3d corners[4];
  Matrix3d to_weights;  ///< x - corners[0] to the weights of corners 1..3

  Tet(const TetMesh& mesh, Eigen::Index t) {
    for (int k = 0; k < 4; ++k) corners[k] = mesh.nodes.row(mesh.tets(t, k));
    Matrix3d edges;
    edges << corners[1] - corners[0], corners[2] - corners[0], corners[3] - corners[0];
    to_weights = edges.inverse();
  }

  Eigen::Vector4d weights(const Vector3d& p) const {
    const Vector3d w = to_weights * (p - corners[0]);
    return {1 - w.sum(), w[0], w[1], w[2]};
  }

  Vector3d point(const Eigen::Vector4d& w) const {
    return w[0] * corners[0] + w[1] * corners[1] + w[2] * corners[2] + w[3] * corners[3];
  }

  Vector3d closest(const Vector3d& p) const {
    if (weights(p).minCoeff() >= 0) return p;
    Vector3d best = corners[0];
    for (int k = 0; k < 4; ++k) {
      const Vector3d q = closest_on_triangle(p, corners[(k + 1) % 4], corners[(k + 2) % 4], corners[(k + 3) % 4]);
      if ((q - p).squaredNorm() < (best - p).squaredNorm()) best = q;
    }
    return best;
  }

  /// The weights of p, or those of the last point on the way from `closest` to p where all weights are >=
  /// kLowestWeight.
  Eigen::Vector4d bounded_weights(const Vector3d& p, const Vector3d& closest) const {
    const Eigen::Vector4d near = weights(closest), far = weights(p);
    double t = 1;
    for (int k = 0; k < 4; ++k)
      if (far[k] < kLowestWeight) t = std::min(t, (kLowestWeight - near[k]) / (far[k] - near[k]));
    return near + t * (far - near);
  }
};

}  // namespace dynamorph
