// SPDX-License-Identifier: GPL-3.0-or-later
// The loops of modal_inertia: of eight terms, or of one term for eight characters.
#pragma once

#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// What one bone contributes to the terms (ModalInertia::BoneMotion), of one character and of eight. bones: its twelve
/// entries in each pose; shares (kMoments, kPoses), row-major; centre and gravity_offset (3).
DYNAMORPH_KERNEL(void, combine_one, const double* const* bones, const double* shares, const double* centre,
                 const double* gravity_offset, float (*out)[12]);
DYNAMORPH_KERNEL(void, combine_eight, const Doubles* const* bones, const double* shares, const double* centre,
                 const double* gravity_offset, Floats (*out)[12]);

/// Eight terms, one a lane: adds to force (r) and packed mass. motion: entry after entry of what the bones contribute;
/// sign: 1 of a bone, -1 of a pair; influence: the largest part of the force that one of them can have, where all are
/// pairs, else infinite; y: each mode's backward differences; slopes (9, r): scratch.
DYNAMORPH_KERNEL(void, add_eight_terms, const Floats (*motion)[12], const Floats& sign, double influence,
                 const float* y, Index r, const Floats* table, Floats* slopes, Floats* force, Floats* mass);

/// The same for one term of eight characters; second: null of a single bone.
DYNAMORPH_KERNEL(void, add_term_of_eight, const Floats (*first)[12], const Floats (*second)[12], double influence,
                 const Floats* y, Index r, const float* table, Floats* slopes, Floats* force, Floats* mass);

/// totals[8 i + j] = the sum of the lanes of sums[8 i + j], for i < count.
DYNAMORPH_KERNEL(void, add_lanes, const Floats* sums, Index count, float* totals);

/// A set's part, by its densities: force (r), and mass and damped mass, packed.
DYNAMORPH_KERNEL(void, add_set_of_eight, const Doubles& density, const Doubles& damping, const double* constant,
                 Index r, const Floats* force_sums, const Floats* mass_sums, Doubles* force, Doubles* mass,
                 Doubles* damped);

/// Backward differences of each mode, one after another, from the coordinates q at four steps (r).
DYNAMORPH_KERNEL(void, differences_of_eight, const Doubles* const* q, Index r, Floats* y);

}  // namespace dynamorph
