// SPDX-License-Identifier: GPL-3.0-or-later
// The loop of nodal_inertia, over eight nodes at a time.
#pragma once

#include "dynamorph/reduced/inertia/modal_arithmetic.hpp"
#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// Eight nodes' transforms in the poses of an inertial target, [A | a] row-major, and their masses.
struct EightNodes {
  DoubleW poses[bone_pairs::kPoses][12];
  DoubleW mass, damped;
};

/// Adds the contributions of eight nodes to the force (r), to the packed mass and, if it is not null, to `damped`.
/// table: U (r, 3), then X. d (r, kPoses) row-major, sums (kPoses): displacements and coefficients in each pose.
/// gravity_offset (3). modes (r, 3): scratch.
DYNAMORPH_KERNEL(void, add_eight_nodes, const EightNodes& nodes, const DoubleW* table, Index r, const double* d,
                 const double* sums, const double* gravity_offset, DoubleW* modes, DoubleW* force, DoubleW* mass,
                 DoubleW* damped);

}  // namespace dynamorph
