// SPDX-License-Identifier: GPL-3.0-or-later
// How far apart two points of the skin are for the flesh between them.
//
// A path through the flesh runs along the edges of the skin, and straight through the body: from a vertex inward along
// its normal to where that leaves the body again. So what lies opposite in a thin slab (ear, hand, cape) is near, and
// what lies opposite across a gap, or touches, is as far as the path around.
#pragma once

#include <array>
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

  /// The skin: vertices and triangles, which may look either way. It may be open, and have seams: equal vertices at
  /// open edges count as one. Edges longer than `spacing` (metres) get points in between. Throws std::invalid_argument
  /// when a triangle names a vertex that does not exist.
  InteriorGraph(const Points& vertices, const Triangles& triangles, double spacing);

  int size() const { return int(points_.size()); }
  const Vector3d& point(int i) const { return points_[i]; }
  /// The point of an input vertex; -1 when it has no triangle.
  int of_vertex(Eigen::Index vertex) const { return of_vertex_[vertex]; }
  /// The loose part of the skin that a point belongs to: there are no paths between parts.
  int part(int i) const { return part_[i]; }
  const std::vector<Step>& steps(int i) const { return steps_[i]; }

  /// The point of the skin that is around p, or nearest to it outside of the body; -1 when there is no skin. Skin that
  /// lies inside another part, or touches it, is none: where parts overlap it would be the other's.
  int nearest(const Vector3d& p) const;

 private:
  using Triangle = std::array<int, 3>;

  /// On the skin.
  struct Place {
    int triangle = -1;
    Vector3d at = Vector3d::Zero();
    bool outside = false;  // of it lies what it is nearest to
  };

  void weld(const Points& vertices, const Triangles& triangles);
  void close(const Points& vertices, const Triangles& triangles);
  void refine(double spacing);
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
  std::vector<bool> buried_;  // inside another place of the same part, or touching it
  Bvh bvh_ = Bvh({});
  Surface body_ = Surface(Points(0, 3), Triangles(0, 3));  // closed
};

}  // namespace dynamorph
