// SPDX-License-Identifier: GPL-3.0-or-later
// Fills a closed cage with tetrahedra, using TetGen (Si 2015, doi 10.1145/2629697).
#pragma once

#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// Fills a closed surface without self-intersections. The surface's vertices become the first nodes, in the same order;
/// no nodes are added on the surface. Tets have a radius-edge ratio <= 1.5 and dihedral angles >= 8 degrees, where the
/// surface allows. There are about `target_nodes` nodes, if the surface leaves room for nodes inside. `inner` (k, 3):
/// points that become nodes. Throws Error when the surface cannot be filled, or only with more than four times the
/// nodes.
/// TetGen crashes or hangs on some input, so call this only where that is contained.
TetMesh tetrahedralize(const Points& vertices, const Triangles& triangles, int target_nodes,
                       const Points& inner = Points());

}  // namespace dynamorph
