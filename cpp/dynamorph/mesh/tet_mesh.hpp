// SPDX-License-Identifier: GPL-3.0-or-later
// A mesh of tetrahedra.
#pragma once

#include <utility>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// The largest coordinate, meters. Beyond it the cube of a length would not be finite, and volumes and distances in
/// tets are computed from such cubes.
constexpr double kFarthest = 1e100;

struct TetMesh {
  Points nodes;  ///< n rest positions, meters
  Tets tets;     ///< m rows of node indices, positively oriented: det(b - a, c - a, d - a) > 0
};

/// Makes a mesh from stored arrays. Throws std::invalid_argument when an index is out of range, a coordinate is not a
/// number or beyond kFarthest, a tet is not positively oriented, or a node belongs to no tet.
TetMesh make_tet_mesh(Points nodes, Tets tets);

/// Volume of every tet, cubic meters.
VectorXd volumes(const TetMesh& mesh);

/// Of a tet's linear shape functions, 1/m: one column per node.
using Gradients = Eigen::Matrix<double, 3, 4>;
/// Those of the tet with these edges from its first node to the others (columns).
Gradients gradients_of(const Matrix3d& edges);
Gradients gradients_of(const TetMesh& mesh, Eigen::Index tet);

/// Any two tets that share a face.
std::vector<std::pair<int, int>> face_neighbors(const Tets& tets);

}  // namespace dynamorph
