// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// In place of a collider's number: skin, of the same body or of another one.
constexpr int kSkin = -1;
/// The same in a body's state: skin of another one.
constexpr int kOtherSkin = -2;

/// Samples of the skin on the other side of a contact.
struct OtherSide {
  std::array<int, 4> samples{};
  std::array<double, 4> weights{};  ///< zero: none; they sum to one
};

/// A sample of the skin against a collider, or against the other side, for the length of a step: a plane. Its gap is
/// n . (x - point), with x the place of the sample, less the mean of those of the other side.
struct Contact {
  int sample;          ///< of the contact samples
  int collider;        ///< of the step's colliders, or kSkin
  Vector3d point;      ///< on the plane at the end of the step, world space, meters
  Vector3d normal;     ///< unit, out of the collider
  Vector3d before;     ///< x at the beginning of the step, world space
  Vector3d motion;     ///< of the collider's surface there over the step, meters
  double weight;       ///< in [0, 1]: 0 where the bones themselves leave no room
  double too_deep;     ///< how much deeper the bones take the sample in than it can give way, meters; <= 0: not
  double gap;          ///< the least at the beginning of the step and where the sample is predicted at its end, meters
  OtherSide others{};  ///< of kSkin
  bool alone = false;  ///< of kSkin: the other side has no contacts of its own with this one

  /// Calls f(sample, weight) for all that it pushes.
  template <class F>
  void each_sample(F&& f) const {
    f(sample, 1.0);
    for (std::size_t k = 0; k < others.samples.size(); ++k)
      if (others.weights[k] > 0) f(others.samples[k], -others.weights[k]);
  }
};

/// How a sample presses on a collider.
struct Pressure {
  int sample, collider;
  Vector3d normal;  ///< unit, out of the collider, world space
  double force;     ///< newtons
  Vector3d slip;    ///< from where friction holds the sample, at most as far as it gives way there, world space, meters
};

}  // namespace dynamorph
