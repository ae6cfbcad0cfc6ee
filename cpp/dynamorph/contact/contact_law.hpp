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
//
// Newton's method overshoots where skin is to stick: beyond e, F'' = 0 does not see the turn ahead. So the force w of a
// slip vector y has an unknown of its own, with r(|y|) w = y, r = y / F'. Each iteration linearizes that:
//
//   w_new = (y_new - r' (y / |y|) . (y_new - y) w) / r,      no longer than 1,
//
// and the stiffness is 1 / r (I - r' (w y^T + y w^T) / (2 |y|)), which is F'' where w is the force of y, and more where
// they disagree (Chan, Golub, Mulet 1999, A nonlinear primal-dual method for total variation-based image restoration,
// doi 10.1137/S1064827596299767).
#pragma once

#include <Eigen/Core>
#include <algorithm>

namespace dynamorph {

struct ContactRamp {
  double energy, force, stiffness;
};
inline ContactRamp contact_ramp(double depth, double width) {
  const double x = std::clamp(depth, 0.0, width), beyond = std::max(depth - width, 0.0);
  return {x * x * x / (6 * width) + (width / 2 + beyond / 2) * beyond, x * x / (2 * width) + beyond, x / width};
}

/// Its energy, and r and r' above.
struct SmoothedSlip {
  double energy, compliance, slope;
  double force(double slip) const { return slip / compliance; }
};
inline SmoothedSlip smoothed_slip(double slip, double sticks) {
  const double x = slip / sticks, under = 2 - x;
  if (x < 1) return {slip * x * (1 - x / 3), sticks / under, 1 / (under * under)};
  return {slip - sticks / 3, slip, 1};
}

/// The force of a slip in the course of Newton's method.
class SlipForce {
 public:
  struct Stiffness {
    Eigen::Vector2d direction;
    double along, across;
  };

  /// The next slip is the first one, with the force that it has.
  void begin() { last_ = {}; }

  /// Goes on to a slip y, and returns the stiffness there, not negative.
  Stiffness follow(const Eigen::Vector2d& y, double sticks) {
    before_ = last_;
    const SmoothedSlip now = smoothed_slip(y.norm(), sticks);
    Eigen::Vector2d w = y / now.compliance;
    if (before_.known) {
      const SmoothedSlip last = smoothed_slip(before_.y.norm(), sticks);
      w = (y - last.slope * unit(before_.y).dot(y - before_.y) * before_.w) / last.compliance;
      if (w.squaredNorm() > 1) w.normalize();
    }
    last_ = {true, y, w};
    // The eigenvectors of w y^T + y w^T bisect the angles of w and y.
    const Eigen::Vector2d along = unit(y), sum = unit(w) + along;
    const double agrees = w.dot(along), force = w.norm();
    return {sum.squaredNorm() > 1e-20 ? Eigen::Vector2d(sum.normalized()) : Eigen::Vector2d(-along.y(), along.x()),
            (1 - now.slope * (agrees + force) / 2) / now.compliance,
            (1 - now.slope * (agrees - force) / 2) / now.compliance};
  }

  /// The slip that it followed last does not count: Newton's method did not go there.
  void go_back() { last_ = before_; }

 private:
  struct Slip {
    bool known = false;
    Eigen::Vector2d y = Eigen::Vector2d::Zero(), w = Eigen::Vector2d::Zero();
  };

  static Eigen::Vector2d unit(const Eigen::Vector2d& v) {
    const double length = v.norm();
    return length > 0 ? Eigen::Vector2d(v / length) : Eigen::Vector2d(1, 0);
  }

  Slip last_, before_;
};

}  // namespace dynamorph
