// SPDX-License-Identifier: GPL-3.0-or-later
// The loops of modal_inertia, over eight pairs of bones at a time.
#pragma once

#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// What one bone contributes to its pairs (ModalInertia::BoneMotion). bones: its twelve entries in each pose.
/// coefficients (kMoments, kPoses), row-major. center and gravity_offset (3).
DYNAMORPH_KERNEL(void, combine_poses, const double* const* bones, const double* coefficients, const double* center,
                 const double* gravity_offset, float (*out)[12]);
/// Adds eight pairs of bones, one per lane, to force (r) and packed mass. motion: what the bones contribute, entry
/// after entry. sign: 1 for one bone, -1 for two. largest_force: the largest part of the force that one pair can have;
/// infinite unless all are of two bones. y: each mode's backward differences. slopes (9, r): scratch.
DYNAMORPH_KERNEL(void, add_eight_pairs, const FloatW (*motion)[12], const FloatW& sign, double largest_force,
                 const float* y, Index r, const FloatW* table, FloatW* slopes, FloatW* force, FloatW* mass);
/// Adds the force of eight pairs of bones on rest positions alone. motion: of each bone its transform, and what moves
/// its rest positions.
DYNAMORPH_KERNEL(void, add_eight_rigid_pairs, const FloatW (*motion)[12], const FloatW& sign, Index r,
                 const FloatW* table, FloatW* force);

/// totals[8 i + j] = the sum of the lanes of sums[8 i + j], for i < count.
DYNAMORPH_KERNEL(void, add_lanes, const FloatW* sums, Index count, float* totals);

}  // namespace dynamorph
