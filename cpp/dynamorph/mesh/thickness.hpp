// SPDX-License-Identifier: GPL-3.0-or-later
// How thick a body is around a point, and how deep the point lies in it.
//
// Thickness T is the radius of the largest ball inside the body that covers the point: wide in a belly, narrow in a
// finger, whatever the bones say. The balls are those of the medial axis that touch the skin (found by shrinking, Ma,
// Bae, Choi 2012, 3D medial axis point approximation using nearest neighbors, doi 10.1007/s00371-011-0594-7). A ball
// that the point lies a little outside of counts less and less, so that T is continuous.
#pragma once

#include <vector>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

class Thickness {
 public:
  /// The skin: any triangle soup, which is closed first (`close_surface`, whose errors it throws). Skin that lies
  /// inside other skin, as under clothes, does not count.
  Thickness(const Points& vertices, const Triangles& triangles, const ProgressFn& progress = {});

  struct Measures {
    VectorXd thickness;  ///< T (k), metres; above zero
    VectorXd depth;      ///< to the skin (k), metres; 0 outside of the body
  };
  /// At points (k, 3). A point outside of the body has the thickness of the skin nearest to it.
  Measures at(const Points& points) const;

 private:
  struct Ball {
    Vector3d center;
    double radius;
  };

  void find_balls(const Points& vertices, const Triangles& triangles, const ProgressFn& progress);
  double thickness(const Vector3d& p) const;

  Surface body_;  ///< closed
  Surface skin_;  ///< its triangles with nothing of the body outside
  double size_ = 0;
  std::vector<Ball> balls_;  ///< largest first
};

}  // namespace dynamorph
