// SPDX-License-Identifier: GPL-3.0-or-later
// Which nodes of a tet mesh the bones pin.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// Points (k, 3) along the bones (segments from head to tail), about as far apart as the cage's vertices, where the
/// cage leaves room for them. As nodes, they tie the soft tissue to a bone that would otherwise pass between nodes.
/// Where there is room, three points surround the bone within the range that it pins (`ratio` and `skin` as for
/// `pinned`), because a body pinned along a mere line could spin about it.
Points points_on_bones(const Points& cage, const Triangles& triangles, const Points& skin, const Triangles& faces,
                       const Points& heads, const Points& tails, double ratio);

/// True for the nodes that the bones pin: those at a distance to the nearest bone (segment from head to tail) of less
/// than `ratio` of the way from bone to skin. 0 pins none, 1 pins all nodes inside the body; nodes outside are never
/// pinned. The surface is closed first (`close_surface`).
std::vector<bool> pinned(const TetMesh& mesh, const Points& vertices, const Triangles& triangles, const Points& heads,
                         const Points& tails, double ratio);

}  // namespace dynamorph
