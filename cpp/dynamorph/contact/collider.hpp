// SPDX-License-Identifier: GPL-3.0-or-later
// What soft tissue runs into: a triangle mesh, rigid or deforming.
//
// Its pieces (triangles that share edges) are of three kinds:
//
//   closed   every edge has two triangles. A point x is inside where (x - P) . N < 0 for the nearest point P and its
//            pseudonormal N: of a face its normal, of an edge the sum of both faces' normals, of a vertex the sum of
//            its faces' normals, weighted by their angles (Baerentzen, Aanaes 2005, Signed distance computation using
//            the angle weighted pseudonormal, doi 10.1109/TVCG.2005.49).
//   holed    the border L is short beside the area A, L^2 < A, as of a character with open eyes. A point is inside
//   where
//            the generalized winding number is above 1/2 (mesh/surface.hpp). So it is if there are several pieces,
//            which may overlap.
//   sheet    a floor, a plate, cloth. Nothing is inside; it stops what comes from either side.
//
// A one-sided collider is different: what is behind its normals is inside, whatever its kind. A face counts once. If
// one is there from both sides, the collider is not one-sided.
#pragma once

#include <cstdint>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/bvh.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

/// A collider's triangles at one moment. `Collider::refit` keeps its parts together.
struct ColliderPose {
  Points points;
  Bvh bvh = Bvh({});
  std::vector<Dipole> dipoles;  ///< only if winding numbers tell what is inside
  double turned = 1;            ///< -1 if the pose is a mirror image: its triangles face inward
};

/// A point of a collider.
struct ColliderPoint {
  int triangle = -1;  ///< none
  Vector3d weights;   ///< of its corners; exactly zero off the corner or edge that it lies on
  Vector3d point;
  bool front = true;  ///< of a crossing: whether it comes from outside
  explicit operator bool() const { return triangle >= 0; }
};

/// Immutable: simulations may share it.
class Collider {
 public:
  /// points (V, 3) in its own frame, meters; triangles (T, 3). A closed or holed piece that is inside out is turned,
  /// unless the collider is one-sided. Triangles without area, and those that are there twice, do no harm.
  /// Throws std::invalid_argument without triangles, for indices out of range and for points that are not finite.
  Collider(Points points, Triangles triangles, bool one_sided = false);

  const Triangles& triangles() const { return triangles_; }  ///< turned outward
  bool one_sided() const { return one_sided_; }
  const ColliderPose& rest() const { return rest_; }  ///< as it was built
  std::uint64_t id() const { return id_; }            ///< no other collider of the process has it

  /// Sets a pose to where the points (V, 3) are; cheaper than building one.
  void refit(const Eigen::Ref<const Points>& points, ColliderPose& pose) const;

  // The queries below are in the pose's own space.

  /// The point nearest to x, if it is nearer than `cutoff` (meters).
  ColliderPoint nearest(const ColliderPose& pose, const Vector3d& x, double cutoff = kInfinity) const;
  /// Out of the collider there, unit; zero where triangles without area, or folded onto each other, leave none.
  Vector3d pseudonormal(const ColliderPose& pose, const ColliderPoint& at) const;
  /// Whether x is inside, if `nearest` is the point nearest to it.
  bool contains(const ColliderPose& pose, const Vector3d& x, const ColliderPoint& nearest) const;
  /// Meters; negative inside.
  double signed_distance(const ColliderPose& pose, const Vector3d& x) const;
  /// Of a triangle, unit, out of the collider; zero without area.
  Vector3d normal(const ColliderPose& pose, int triangle) const;

  /// Where a point of the collider is in another pose.
  Vector3d at(const ColliderPose& pose, const ColliderPoint& point) const {
    const Vector3d& w = point.weights;
    const int t = point.triangle;
    return w[0] * corner(pose, t, 0) + w[1] * corner(pose, t, 1) + w[2] * corner(pose, t, 2);
  }

  /// Whether it is in a piece that has no inside.
  bool sheet(int triangle) const { return !one_sided_ && kinds_[pieces_[triangle]] == Kind::sheet; }
  /// Whether a point is on a border.
  bool on_border(const ColliderPoint& at) const;
  /// Whether any piece has an inside.
  bool solid() const { return one_sided_ || solids_ > 0; }

  enum class Crossing { entering, leaving, either };  ///< a sheet is entered and left from both sides
  /// The first point where the straight way from `from` to `to` crosses the collider while it moves from one pose to
  /// another, as it is in the last pose. Both poses may be the same.
  ColliderPoint first_crossing(const ColliderPose& before, const ColliderPose& after, const Vector3d& from,
                               const Vector3d& to, Crossing kind) const;

 private:
  enum class Kind : std::uint8_t { closed, holed, sheet };
  enum : int { kNone = -1, kSeveral = -2 };

  Vector3d corner(const ColliderPose& pose, int triangle, int k) const {
    return pose.points.row(triangles_(triangle, k));
  }
  Bvh::Box box(const Points& points, int triangle) const;
  Vector3d area_vector(const Points& points, int triangle) const;
  double signed_volume(const Points& points, int triangle, const Vector3d& from) const;
  static int vertex_of(const ColliderPoint& at);  ///< which of its triangle's corners it is; -1: none
  static int edge_of(const ColliderPoint& at);    ///< the corner where its edge begins; -1: inside the triangle
  /// Of what has an inside, seen from the middle of the points.
  double volume(const ColliderPose& pose) const;
  bool needs_winding() const { return solids_ > 0 && !by_normals_; }
  const Triangles& winding_triangles() const { return winding_.size() ? winding_ : triangles_; }

  void drop_needless();
  void find_neighbors();
  void find_corners();
  std::vector<bool> orient();
  void find_kinds(const Points& points);
  void turn(int triangle);

  std::uint64_t id_;
  Triangles triangles_;
  bool one_sided_;
  std::vector<int> place_;    ///< of the vertices (V): the same number where they are at the same place
  Triangles neighbors_;       ///< across the edges that begin at a triangle's corners; kNone, or kSeveral
  std::vector<int> pieces_;   ///< of the triangles
  std::vector<Kind> kinds_;   ///< of the pieces
  int solids_ = 0;            ///< pieces that have an inside
  bool by_normals_ = false;   ///< all is one closed piece
  std::vector<int> first_;    ///< of each place: its corners are corners_[first_[i]] to before corners_[first_[i + 1]]
  std::vector<int> corners_;  ///< 3 triangle + k
  Triangles winding_;         ///< if there are sheets and others: the triangles, those of sheets without area
  double volume_ = 0;         ///< at rest
  ColliderPose rest_;
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
