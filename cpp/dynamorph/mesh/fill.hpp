// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// Fraction of each tet that the body fills, 0.05 .. 1. A cage is larger than the body and has webs between limbs, so
/// both mass and stiffness are multiplied by this fraction. The floor keeps every node massive and every tet stiff. The
/// surface is closed first (`close_surface`).
VectorXd fill_fractions(const TetMesh& mesh, const Points& vertices, const Triangles& triangles,
                        const ProgressFn& progress = {});

}  // namespace dynamorph
