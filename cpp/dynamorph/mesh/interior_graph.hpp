// SPDX-License-Identifier: GPL-3.0-or-later
// Distances between points of the skin, measured through the body.
//
// A path through the body runs along the edges of the skin, and straight across: from a vertex inward along its normal
// to where that line leaves the body again. So points on opposite sides of a thin slab (ear, hand, cape) are near each
// other. Points across a gap, or of parts that touch, are as far apart as the path around.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/bvh.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

class InteriorGraph {
 public:
  struct Step {
    int to;
    double length;
  };

  /// The skin: vertices and triangles, which may face either way. It may be open, and it may have seams: vertices at
  /// the same place at open edges count as one. Edges longer than `spacing` (meters) get points in between. Throws
  /// std::invalid_argument when a triangle names a vertex that does not exist, and when millions of points would be
  /// added, as when the skin is in another unit than the spacing.
  InteriorGraph(const Points& vertices, const Triangles& triangles, double spacing);

  int size() const { return int(points_.size()); }
  const Vector3d& point(int i) const { return points_[i]; }
  /// The point of an input vertex; -1 when it has no triangle.
  int of_vertex(Eigen::Index vertex) const { return of_vertex_[vertex]; }
  /// The loose part of the skin that a point belongs to. There are no paths between parts.
  int part(int i) const { return part_[i]; }
  const std::vector<Step>& steps(int i) const { return steps_[i]; }

  /// The point of the skin nearest to p; if p is inside the body, on skin that has p on its inner side. -1 when there
  /// is no skin. Skin that lies inside another part, or touches it, does not count, because where parts overlap it
  /// would belong to the other part.
  int nearest(const Vector3d& p) const;

 private:
  /// A place on the skin.
  struct Place {
    int triangle = -1;
    Vector3d at = Vector3d::Zero();
    bool outside = false;  ///< whether the query point is on its outer side
  };

  void join_seams(const Points& vertices, const Triangles& triangles);
  void face_outward(const Points& vertices, const Triangles& triangles);
  void connect();
  void find_parts();
  void find_normals();
  void find_buried(double off);
  void look_through();
  int opposite(int from) const;
  Place nearest_place(const Vector3d& p, bool only_around) const;
  int nearest_corner(int triangle, const Vector3d& p) const;

  std::vector<int> of_vertex_;
  std::vector<Vector3d> points_, normals_;
  std::vector<Triangle> triangles_;
  std::vector<std::vector<Step>> steps_;
  std::vector<int> part_;
  std::vector<char> buried_;  ///< whether a point is inside its own part, or touches it elsewhere
  Bvh bvh_ = Bvh({});
  Surface body_ = Surface(Points(0, 3), Triangles(0, 3));  ///< closed
};

}  // namespace dynamorph
