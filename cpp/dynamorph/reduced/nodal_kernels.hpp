// SPDX-License-Identifier: GPL-3.0-or-later
// The loop of nodal_inertia: eight nodes at a time.
#pragma once

#include "dynamorph/reduced/modal_arithmetic.hpp"
#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// Eight nodes' transforms in the poses of an inertial target, [A | a] row-major, and by how much they count.
struct EightNodes {
  DoubleW poses[terms::kPoses][12];
  DoubleW mass, damped;
};

/// What eight nodes add to the force (r) and to the packed mass, and if `damped` is not null to that. table: U (r, 3),
/// then X; d (r, kPoses) row-major and sums (kPoses): displacements and coefficients in each pose; gravity_offset (3);
/// modes (r, 3): scratch.
DYNAMORPH_KERNEL(void, add_eight_nodes, const EightNodes& nodes, const DoubleW* table, Index r, const double* d,
                 const double* sums, const double* gravity_offset, DoubleW* modes, DoubleW* force, DoubleW* mass,
                 DoubleW* damped);

}  // namespace dynamorph
