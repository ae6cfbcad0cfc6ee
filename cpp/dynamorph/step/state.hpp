// SPDX-License-Identifier: GPL-3.0-or-later
// What a body keeps from one step to the next, and what a step says of itself.
#pragma once

#include <array>
#include <vector>

#include "dynamorph/contact/contact.hpp"
#include "dynamorph/contact/find_contacts.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/step/motion_limit.hpp"

namespace dynamorph {

/// Where a soft skin is. Copy it to undo, resume or fork a simulation.
struct State {
  std::array<VectorXd, InertialTarget::kMoments> q;        ///< coordinates (dofs), now and at the last three steps
  std::array<Transforms, InertialTarget::kMoments> bones;  ///< (B, 12), bind to world space, likewise
  DrivenLoad driven;                                       ///< of the motion limit; empty without one
  ContactMemory contact;                                   ///< from which sides it touches colliders
  std::vector<Pressure> pressures;                         ///< of what it touches, by collider, then by sample
  VectorXd dents;  ///< amplitudes of the local responses (P): where a step's Newton's method begins; empty without
};

struct StepReport {
  int iterations = 0;  ///< of Newton's method
  /// Whether the gradient was within the tolerance of the forces, or Newton's last step within the tolerance of the
  /// body's size (root mean square). If false, the state is the best one found, and it is finite.
  bool converged = true;
  double residual = 0;      ///< gradient relative to the largest force term
  double energy = 0;        ///< elastic energy, J
  bool teleported = false;  ///< the rig jumped so far that the past was carried along

  double excess = 0;     ///< the largest x of motion_limit.hpp; above 1/2 the load of that bone was held back
  int excess_bone = -1;  ///< whose it is; -1 without a motion limit
  double farthest = 0;   ///< of a point from its targets' shape, relative to its limit, before Newton's method
  int pulled = 0;        ///< 1 where anything was so far that a motion limit pulled it back

  int contacts = 0;            ///< samples that are pushed
  double penetration = 0;      ///< the largest depth of a sample under a surface, meters, where the bones leave it room
  double too_deep = 0;         ///< how deep a sample stays in something that the bones take it too far into, meters
  int too_deep_sample = -1;    ///< which one; -1: nothing is too deep
  int too_deep_collider = -1;  ///< in which collider; -1: its own skin, -2 - b: that of the body b of a list
  std::vector<Vector3d> contact_forces;    ///< newtons on each collider
  Vector3d body_force = Vector3d::Zero();  ///< newtons that other soft bodies push it with
  std::vector<int> unusable_colliders;     ///< active, but not finite or without extent
};

}  // namespace dynamorph
