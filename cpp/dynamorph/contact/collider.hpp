// SPDX-License-Identifier: GPL-3.0-or-later
// What soft tissue runs into: a triangle mesh, rigid or deforming.
//
// Its pieces (triangles that share edges) are of three kinds:
//
//   closed   every edge has two triangles. A point is inside where (x - P) . N < 0 for the nearest point P and its
//            pseudonormal N: of a face its normal, of an edge the sum of both faces' normals, of a vertex the sum of
//            its faces' normals, weighted by their angles (Baerentzen, Aanaes 2005, Signed distance computation using
//            the angle weighted pseudonormal, doi 10.1109/TVCG.2005.49).
//   holed    its border L is short beside its area A, L^2 < A, as of a character with open eyes. A point is inside
//   where
//            the generalized winding number is above 1/2 (mesh/surface.hpp). That also holds for pieces that overlap.
//   sheet    a floor, a plate, cloth. Nothing is inside; it stops what comes from either side.
//
// A one-sided collider is different: what is behind its normals is inside, whatever its kind.
#pragma once

#include <cstdint>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/bvh.hpp"

namespace dynamorph {

/// Immutable: simulations may share it.
class Collider {
 public:
  /// points (V, 3) in its own frame, meters; triangles (T, 3). A closed or holed piece that is inside out is turned,
  /// unless the collider is one-sided. Triangles without area do no harm.
  /// Throws std::invalid_argument without triangles, for indices out of range and for points that are not finite.
  Collider(Points points, Triangles triangles, bool one_sided = false);

  const Points& points() const { return points_; }
  const Triangles& triangles() const { return triangles_; }  ///< turned outward
  bool one_sided() const { return one_sided_; }

 private:
  Points points_;
  Triangles triangles_;
  bool one_sided_;
};

/// Where a collider is at the beginning and at the end of a step. It owns nothing.
struct ColliderStep {
  const Collider& collider;
  /// Rigid: from its own frame to world space (3, 4). It may scale, shear and mirror. Deforming: its points in world
  /// space, meters (V, 3).
  Eigen::Map<const RowMajor> before, after;
  double friction;
  bool active;  ///< else nothing touches it

  bool rigid() const { return after.cols() == 4; }
};

}  // namespace dynamorph
