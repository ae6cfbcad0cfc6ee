// SPDX-License-Identifier: GPL-3.0-or-later
// Scalar laws of contact, for a stiffness or a force of one.
//
// Normal: with the depth d under a surface and the width w of the transition,
//
//   E(d) = 0 for d < 0,   d^3 / (6 w) for d < w,   w^2 / 6 + w (d - w) / 2 + (d - w)^2 / 2 beyond.
//
// Its stiffness E'' is continuous and at most one, so that Newton's method stays quadratic where skin touches down. A
// barrier is no better here: bones and colliders are prescribed, and leave the feasible region at every step.
//
// Friction: with the slip y over a step and the slip e below which skin sticks,
//
//   F(y) = y^2 / e - y^3 / (3 e^2) for y < e,   y - e / 3 beyond,
//
// Coulomb's law made smooth (Li et al. 2020, Incremental Potential Contact, section 5.2, doi 10.1145/3386569.3392425):
// F'(y) grows from 0 to 1 while y grows from 0 to e.
#pragma once

#include <algorithm>

namespace dynamorph {

struct ContactRamp {
  double energy, force, stiffness;
};
inline ContactRamp contact_ramp(double depth, double width) {
  const double x = std::clamp(depth, 0.0, width), beyond = std::max(depth - width, 0.0);
  return {x * x * x / (6 * width) + (width / 2 + beyond / 2) * beyond, x * x / (2 * width) + beyond, x / width};
}

/// Beside the energy the stiffness along the slip and across it; the force is `across` times the slip.
struct SmoothedSlip {
  double energy, along, across;
};
inline SmoothedSlip smoothed_slip(double slip, double sticks) {
  const double x = slip / sticks;
  if (x < 1) return {slip * x * (1 - x / 3), 2 * (1 - x) / sticks, (2 - x) / sticks};
  return {slip - sticks / 3, 0, 1 / slip};
}

}  // namespace dynamorph
