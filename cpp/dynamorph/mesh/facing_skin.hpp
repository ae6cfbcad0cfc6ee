// SPDX-License-Identifier: GPL-3.0-or-later
// Where the skin of one pose meets itself: for each point, the nearest triangle that faces it. What is near at rest as
// well is left out: the skin beside a point, and the other side of a thin part, which is behind it.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/bvh.hpp"

namespace dynamorph {

class FacingSkin {
 public:
  /// A point of the skin, and the place on a triangle that faces it.
  struct Touch {
    int point = -1, triangle = -1;
    Vector3d weights = Vector3d::Zero();  ///< of the triangle's corners
    Vector3d normal = Vector3d::Zero();   ///< outward, there
    Vector3d outward = Vector3d::Zero();  ///< normal of the skin at the point
    double gap = 0;                       ///< from there along the normal, meters; negative inside
  };

  /// rest (P, 3), triangles: outward. thickness (P): of the body from the skin to its middle, meters.
  FacingSkin(const Points& rest, const Triangles& triangles, const VectorXd& thickness);

  /// Those of these points with a gap below `near` at the places x (P, 3), by point.
  void find(const Points& x, const std::vector<int>& points, double near, std::vector<Touch>& out);

  const VectorXd& area() const { return area_; }  ///< of the skin around each point, m^2

 private:
  struct Normals {
    Points triangles, points;  ///< unit
  };
  Normals normals(const Points& x) const;
  bool may_touch(int point, int triangle, double near) const;

  Points rest_;
  Triangles triangles_;
  VectorXd thickness_, area_;
  Normals at_rest_;
  Bvh bvh_;
};

}  // namespace dynamorph
