// SPDX-License-Identifier: GPL-3.0-or-later
// What the bones hold of a tet mesh.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// Points (k, 3) along the bones (segments from head to tail), about as far apart as the cage's vertices, where the
/// cage leaves room for them: as nodes they tie the flesh to a bone that would else pass between nodes. Where there is
/// room, three around the bone within what it holds (`ratio` and `skin` as for `pinned`): a body held along a mere line
/// could spin about it.
Points points_on_bones(const Points& cage, const Triangles& triangles, const Points& skin, const Triangles& faces,
                       const Points& heads, const Points& tails, double ratio);

/// True for the nodes that the bones hold: those whose distance to the nearest bone (segment from head to tail) is less
/// than `ratio` of the way from bone to skin. 0 holds none, 1 all nodes inside the body; nodes outside are never held.
/// The surface is closed first
/// (`close_surface`).
std::vector<bool> pinned(const TetMesh& mesh, const Points& vertices, const Triangles& triangles, const Points& heads,
                         const Points& tails, double ratio);

}  // namespace dynamorph
