// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// A sample of the skin against a collider for the length of a step: a plane.
struct Contact {
  int sample;       ///< of the contact samples
  int collider;     ///< of the step's colliders
  Vector3d point;   ///< on the plane at the end of the step, world space, meters
  Vector3d normal;  ///< unit, out of the collider
  Vector3d before;  ///< where the sample was at the beginning of the step, world space
  Vector3d motion;  ///< of the collider's surface there over the step, meters
  double weight;    ///< in [0, 1]: 0 where the bones themselves leave no room
  double too_deep;  ///< how much deeper the bones take the sample in than it can give way, meters; <= 0: not
};

}  // namespace dynamorph
