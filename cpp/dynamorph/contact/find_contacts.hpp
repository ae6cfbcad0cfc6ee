// SPDX-License-Identifier: GPL-3.0-or-later
// Which samples of a skin touch which colliders during a step, and from which side. It is decided once per step, from
// geometry alone; within the step each contact is a plane (P, n). A sample that was outside a collider at the end of
// the last step stays on that side, however thin and fast the collider is:
//
// 1. It begins where it was, x, in the collider's own moving frame. If it is behind a plane that held it in the last
//    step, n . (x - P) < 0, and the way from x along n leaves the collider, it begins there instead.
// 2. It is on its way to where it is predicted. What it runs into stops it, and it slides on along the surface, up to
//    eight times along three planes. P is the point nearest to where it gets, and n leads from P to there.
// 3. What is inside without having come in (at the beginning, or after a jump of the collider or the body) gets out at
//    the nearest point if n . N < -0.3, N the normal of the skin. Otherwise the nearest way out leads through the body,
//    and a ball that appears in a belly would push the skin outward: it gets out along -N, with n = -N. A sheet that is
//    less deep than the tissue is thick is put outside the skin. All that takes steps of the margin at most.
//
// A collider that comes from within the body, n . N > 0.5, does not carry the skin along.
//
// What the bones leave no room for is not forced. With D the depth at which bones and targets alone put the sample,
// under the plane or along -N, whichever is more, and T the thickness of the tissue below, a contact has the weight
//
//   s = 1 - smooth_step((D - 0.7 T) / (0.5 T)).
//
// Along -N, what begins only below T is on the other side of the body, and does not count.
#pragma once

#include <cstdint>
#include <vector>

#include "dynamorph/contact/collider.hpp"
#include "dynamorph/contact/contact.hpp"

namespace dynamorph {

/// Samples of a skin (N) during a step, in world space, meters. The others touch nothing.
struct SampleStep {
  std::vector<int> samples;  ///< which ones, ascending
  Points before;             ///< where they were at the end of the last step
  Points predicted;          ///< the first guess of where they are at the end of this one
  Points unmoved;            ///< where bones and targets alone put them at the end of this one
  Points normal;             ///< of the skin there, outward, unit
  VectorXd thickness;        ///< T of the tissue below

  /// So many samples, at zero.
  void begin(Eigen::Index count) {
    samples.resize(std::size_t(count));
    for (Points* points : {&before, &predicted, &unmoved, &normal}) points->setZero(count, 3);
    thickness.resize(count);
  }
};

/// What a step must know of the step before it. A copy of it belongs to each copy of a simulation's state. Clear it
/// when the body jumps, or the colliders become others.
struct ContactMemory {
  /// What held a sample.
  struct Plane {
    int sample, collider;
    Vector3d point, normal;  ///< at the end of the step, world space
  };
  std::vector<Plane> planes;         ///< by collider, and those of a collider by sample
  std::vector<std::uint8_t> active;  ///< whether each collider acted; empty at the beginning

  void clear() { *this = {}; }
  bool acted(int collider) const { return collider < int(active.size()) && active[std::size_t(collider)]; }
};

/// Its buffers are kept from step to step; what it finds depends on the arguments alone.
class ContactFinder {
 public:
  /// Sets `contacts` to those of all samples that are inside an active collider at the end of the step or may get
  /// there: by collider, and those of a collider by sample. Those are looked at that come nearer than `near`, meters,
  /// and twice their way beside the collider, but not from farther than `margin`. A sample may have several contacts
  /// with a collider, as in the corner of a room. Updates the memory. Throws std::invalid_argument for arrays that do
  /// not fit each other.
  void find(const std::vector<ColliderStep>& colliders, const SampleStep& samples, double near, double margin,
            ContactMemory& memory, std::vector<Contact>& contacts);

  /// Active colliders that could not act in the last step: they are not finite, or scaled to nothing.
  const std::vector<int>& unusable() const { return unusable_; }

 private:
  /// Carries a surface to the world without changing its lengths; it may mirror.
  struct Frame {
    Matrix3d turn, back;
    Vector3d shift;
    Vector3d to_world(const Vector3d& x) const { return turn * x + shift; }
    Vector3d to_own(const Vector3d& x) const { return back * (x - shift); }
  };

  /// A collider's surface at one moment. A rigid collider's stretch is part of it, so that distances are meters.
  struct Surface {
    std::uint64_t collider = 0;  ///< what `pose` is of; 0: nothing yet
    Matrix3d stretch = Matrix3d::Zero();
    ColliderPose pose;

    bool is(const Collider& collider, const Matrix3d& stretch) const;
    bool is(const Collider& collider, const Eigen::Map<const Points>& points) const;
    void set(const Collider& collider, const Matrix3d& stretch);
    void set(const Collider& collider, const Eigen::Map<const Points>& points);
  };

  /// A collider during the step. Where its surface at rest, or that of the end, serves as well, no other is made.
  struct Posed {
    Surface first, last;
    const ColliderPose *begin, *end;
    Frame from_begin, from_end;
    bool away;       ///< from all samples; the following is then not set
    bool came;       ///< whether it was somewhere at the beginning
    double deforms;  ///< how far any of its points moves in its own frame, meters
  };

  struct Sample;
  struct Plane;
  struct Below;
  class Search;

  void touch(const Collider& collider, int number, const Posed& posed, bool known, const SampleStep& samples,
             const Bvh::Box& around, double near, double margin, const std::vector<ContactMemory::Plane>& held,
             std::vector<Contact>& contacts);

  static bool split(const Eigen::Map<const RowMajor>& transform, Frame& frame, Matrix3d& stretch);
  static bool pose(const ColliderStep& step, const Bvh::Box& samples, Posed& posed);

  std::vector<Posed> posed_;
  std::vector<int> unusable_;
  std::vector<ContactMemory::Plane> planes_;  ///< the memory of the next step
};

}  // namespace dynamorph
