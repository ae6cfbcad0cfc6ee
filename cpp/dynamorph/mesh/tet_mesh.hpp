// SPDX-License-Identifier: GPL-3.0-or-later
// A mesh of tetrahedra.
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Metres. Beyond it the cube of a length would not be finite, which volumes and distances in tets are computed from.
constexpr double kFarthest = 1e100;

struct TetMesh {
  Points nodes;  // n rest positions, metres
  Tets tets;     // m rows of node indices, positively oriented: det(b - a, c - a, d - a) > 0
};

/// A mesh from stored arrays. Throws std::invalid_argument on an index out of range, a coordinate that is not a number
/// or beyond kFarthest, a tet that is not positively oriented or a node of no tet.
TetMesh make_tet_mesh(Points nodes, Tets tets);

/// Volume of every tet, cubic metres.
VectorXd volumes(const TetMesh& mesh);

}  // namespace dynamorph
