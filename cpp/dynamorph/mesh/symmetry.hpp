// SPDX-License-Identifier: GPL-3.0-or-later
// Makes the tets around a mirror-symmetric skin mirror-symmetric too, so that its left and right move alike.
//
// Neither the wrap nor TetGen keeps a symmetry. So the tets on one side of the mirror plane are kept, and the other
// side becomes their mirror image. As in isosurface stuffing (Labelle & Shewchuk 2007, doi 10.1145/1276377.1276448),
// nodes near the plane are moved onto it first, where that inverts no tet, so that cutting the others leaves no
// slivers.
#pragma once

#include <optional>
#include <vector>

#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// Where a coordinate has a value.
struct MirrorPlane {
  int axis;
  double at;  ///< meters

  Vector3d image(Vector3d p) const {
    p[axis] = 2 * at - p[axis];
    return p;
  }
};

/// The plane in the middle of a skin, across X or else Y or Z, about which its mirror image is nowhere farther from it
/// than 1/500 of its diagonal; none if there is no such plane.
std::optional<MirrorPlane> mirror_plane(const Points& vertices, const Triangles& triangles);

/// Of each point of a skin with a mirror plane, the point nearest to its mirror image, within the same tolerance; -1
/// where there is none, and of points without a triangle.
std::vector<int> mirror_images(const Points& vertices, const Triangles& triangles);

/// For a skin with a mirror plane, the half of the mesh with the larger coordinates and its mirror image, whose nodes
/// and tets come last. The same mesh for any other skin.
TetMesh symmetric_like(const TetMesh& mesh, const Points& vertices, const Triangles& triangles);

}  // namespace dynamorph
