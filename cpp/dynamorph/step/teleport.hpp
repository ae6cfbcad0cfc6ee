// SPDX-License-Identifier: GPL-3.0-or-later
// A rig that jumps to another place. The past is carried along, so that the soft skin does not fly after it.
#pragma once

#include <array>

#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"

namespace dynamorph {

/// x -> turn x + shift.
struct RigidMotion {
  Matrix3d turn;
  Vector3d shift;
};

/// The rigid motion that best carries the body, in the mean square over its volume, from where `now` and `before` would
/// take it in one more step to where the bones `to` put it. All are (B, 12). Kabsch 1976, doi
/// 10.1107/S0567739476001873.
RigidMotion fit_jump(const SoftBody& body, const Transforms& now, const Transforms& before, const Transforms& to);

/// Whether the bones (B, 12) are farther than `distance` (meters, root mean square over the body; 0: never) from where
/// the last two of `past` (newest first) would take them.
bool jumps(const SoftBody& body, double distance, const Transforms& bones,
           const std::array<Transforms, InertialTarget::kMoments>& past);

/// Carries all of `past` by the rigid motion that best fits the jump to the bones.
void carry_past(const SoftBody& body, const Transforms& bones, std::array<Transforms, InertialTarget::kMoments>& past);

}  // namespace dynamorph
