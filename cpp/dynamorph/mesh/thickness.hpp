// SPDX-License-Identifier: GPL-3.0-or-later
// How thick a body is around a point, and how deep the point lies in it.
//
// Thickness T is the radius of the largest ball inside the body that covers the point. It is large in a belly and small
// in a finger, wherever the bones are. The balls are those of the medial axis that touch the skin (found by shrinking,
// Ma, Bae, Choi 2012, 3D medial axis point approximation using nearest neighbors, doi 10.1007/s00371-011-0594-7). A
// ball counts less the farther the point lies outside it, so that T is continuous.
#pragma once

#include <vector>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

class Thickness {
 public:
  /// The skin may be any triangle soup. It is closed first by `close_surface`, and errors from there pass through. Skin
  /// inside other skin, as under clothes, does not count.
  Thickness(const Points& vertices, const Triangles& triangles, const ProgressFn& progress = {});

  struct Measures {
    VectorXd thickness;  ///< T (k), meters; above zero
    VectorXd depth;      ///< distance to the skin (k), meters; 0 outside the body
  };
  /// Measures at points (k, 3). A point outside the body has the thickness of the skin nearest to it.
  Measures at(const Points& points) const;

  struct Ball {
    Vector3d center;
    double radius;
  };
  /// Few balls inside the body, largest first, that come as near to each of the points (k, 3) of its skin as
  /// `tolerance` times the thickness there, or as near as any does.
  std::vector<Ball> covering(const Points& points, double tolerance) const;

 private:
  void find_balls(const Points& vertices, const Triangles& triangles, const ProgressFn& progress);
  double thickness(const Vector3d& p) const;
  /// Raises `best` to the thickness at p by the balls below a node of the tree.
  void raise(int index, const Vector3d& p, double& best) const;

  Surface body_;  ///< closed
  Surface skin_;  ///< the triangles that have no part of the body on their outer side
  double size_ = 0;
  std::vector<Ball> balls_;      ///< largest first
  Bvh tree_;                     ///< over the space in which each counts
  std::vector<double> largest_;  ///< radius below each node
};

}  // namespace dynamorph
