// SPDX-License-Identifier: GPL-3.0-or-later
// Which samples of a skin touch which colliders during a step, and from which side. It is decided once per step, from
// geometry alone; within the step each contact is a plane.
#pragma once

#include <cstdint>
#include <vector>

#include "dynamorph/contact/collider.hpp"
#include "dynamorph/contact/contact.hpp"

namespace dynamorph {

/// The samples of a skin (P) during a step, in world space, meters. It owns nothing.
struct SampleStep {
  const Points& before;       ///< where they were at the end of the last step
  const Points& predicted;    ///< the first guess of where they are at the end of this one
  const Points& unmoved;      ///< where bones and targets alone put them at the end of this one
  const Points& normal;       ///< of the skin there, outward, unit
  const VectorXd& thickness;  ///< T (P) of the tissue below
};

/// What a step must know of the step before it. A copy of it belongs to each copy of a simulation's state. Clear it
/// when the body jumps: all that is inside a collider then gets out by the shortest way that its tissue allows.
struct ContactMemory {
  /// Where a sample was held.
  struct Plane {
    int sample, collider;
    Vector3d point, normal;  ///< at the end of the step, world space
  };
  std::vector<Plane> planes;         ///< by sample, and those of a sample by collider
  std::vector<std::uint8_t> active;  ///< whether each collider acted; empty at the beginning

  void clear() { *this = {}; }
};

/// Its buffers are kept from step to step; what it finds depends on the arguments alone.
class ContactFinder {
 public:
  /// Sets `contacts` to those of all samples that are nearer than `margin` (meters) to an active collider at the end of
  /// the step, or inside it; by sample, and those of a sample by collider. A sample may have several contacts with one
  /// collider, as in the corner of a room. Updates the memory.
  /// Throws std::invalid_argument for arrays that do not fit each other.
  void find(const std::vector<ColliderStep>& colliders, const SampleStep& samples, double margin, ContactMemory& memory,
            std::vector<Contact>& contacts);

  /// Active colliders that could not act in the last step: they are not finite, or scaled to nothing.
  const std::vector<int>& unusable() const { return unusable_; }

 private:
  std::vector<int> unusable_;
};

}  // namespace dynamorph
