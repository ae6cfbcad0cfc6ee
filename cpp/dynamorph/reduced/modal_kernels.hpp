// SPDX-License-Identifier: GPL-3.0-or-later
// The loops of modal_inertia, over eight terms or over one term of eight characters.
#pragma once

#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// What one bone contributes to the terms (ModalInertia::BoneMotion), for one character and for eight. bones: its
/// twelve entries in each pose. coefficients (kMoments, kPoses), row-major. centre and gravity_offset (3).
DYNAMORPH_KERNEL(void, combine_one, const double* const* bones, const double* coefficients, const double* centre,
                 const double* gravity_offset, float (*out)[12]);
DYNAMORPH_KERNEL(void, combine_eight, const DoubleW* const* bones, const double* coefficients, const double* centre,
                 const double* gravity_offset, FloatW (*out)[12]);

/// Adds eight terms, one per lane, to force (r) and packed mass. motion: what the bones contribute, entry after entry.
/// sign: 1 for a bone, -1 for a pair. largest_force: the largest part of the force that one term can have; infinite
/// unless all are pairs. y: each mode's backward differences. slopes (9, r): scratch.
DYNAMORPH_KERNEL(void, add_eight_terms, const FloatW (*motion)[12], const FloatW& sign, double largest_force,
                 const float* y, Index r, const FloatW* table, FloatW* slopes, FloatW* force, FloatW* mass);

/// The same for one term of eight characters. second: null for a single bone.
DYNAMORPH_KERNEL(void, add_term_of_eight, const FloatW (*first)[12], const FloatW (*second)[12], double largest_force,
                 const FloatW* y, Index r, const float* table, FloatW* slopes, FloatW* force, FloatW* mass);

/// totals[8 i + j] = the sum of the lanes of sums[8 i + j], for i < count.
DYNAMORPH_KERNEL(void, add_lanes, const FloatW* sums, Index count, float* totals);

/// Adds a set's part, multiplied by its densities, to force (r) and to the packed mass and damped mass.
DYNAMORPH_KERNEL(void, add_set_of_eight, const DoubleW& density, const DoubleW& damping, const double* constant,
                 Index r, const FloatW* force_sums, const FloatW* mass_sums, DoubleW* force, DoubleW* mass,
                 DoubleW* damped);

/// Backward differences of each mode, one after another, from the coordinates q at four steps (r).
DYNAMORPH_KERNEL(void, differences_of_eight, const DoubleW* const* q, Index r, FloatW* y);

}  // namespace dynamorph
