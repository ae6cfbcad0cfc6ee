// SPDX-License-Identifier: GPL-3.0-or-later
// Pose space: how much each dynamic morph target counts at a pose.
//
// Each target set uses cardinal radial basis functions of its poses q, the joint rotations of the set's bones and the
// values of its channels, with a linear kernel and a constant term:
//
//   w(q) = sum_k |q - q_k| c_k + c_0,   w_j(q_k) = delta_jk,   sum_j w_j = 1.
//
// With one joint angle that is the piecewise-linear hat function of a driver, constant outside the targets. Negative
// weights are then clamped and the rest renormalized, so that the blended stiffness stays positive definite. A target
// with a limited radius r_j fades out with its distance d_j, and the set's first target gets the weight it loses:
//
//   w_j <- w_j s(d_j / r_j),   s = 1 up to a half, then 1 - t^2 (3 - 2 t) with t = 2 d_j / r_j - 1, 0 from one on.
//
// Distances are joint angles. A channel is a number that is no rotation, as a slider has it: all the way between the
// targets' farthest values on it counts as a right angle. So
//
//   |q - p|^2 = sum over bones of angle(q, p)^2 + sum over channels of (pi/2 (q - p) / range)^2.
//
// Poses all the way around a joint (0, 90, 180, -90 degrees) cannot be placed in a flat space by their angles, and
// weights would jump. Such sets use chords, which are distances in a flat space. A radius is a joint angle there too.
#pragma once

#include <string>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// One rotation per row, unit quaternion w x y z; bones in the skeleton's order.
using Rotations = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;

/// The local rotations (B, 4) of all bones of a skeleton, and the values (C) of all channels.
struct Pose {
  Rotations rotations;
  VectorXd channels = {};
};

/// Targets whose weights sum to one, placed by the local rotations of `bones` (indices into the skeleton) and by the
/// values of `channels` (indices into those of a pose).
struct TargetSet {
  std::vector<int> bones;
  std::vector<std::string> names;  ///< of the targets, for messages
  std::vector<Pose> poses;         ///< per target
  std::vector<double> radii = {};  ///< per target, radians, 0 unlimited; may be empty; the first one's is ignored
  std::vector<int> channels = {};
};

/// Local transforms, one row-major 4 x 4 per row.
using LocalTransforms = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 16, Eigen::RowMajor>>;

/// Writes the rotation of a bone's local transform, without scale and shear, into the bone's row.
void rotation_of(const LocalTransforms& transforms, int bone, Rotations& rotations);

class PoseSpace {
 public:
  /// Throws Error, which names both, when two targets of a set have (nearly) the same pose.
  explicit PoseSpace(std::vector<TargetSet> sets);

  /// Number of targets of all sets.
  int targets() const { return targets_; }

  /// The bones that any set uses, ascending. Only these rows of a pose's rotations count.
  const std::vector<int>& bones() const { return bones_; }

  /// How many channels a pose must have at least.
  int channels() const { return channels_; }
  int sets() const { return int(sets_.size()); }

  /// Weights (J), set after set. Each set's weights are >= 0 and sum to 1; at a target's pose they are a unit vector.
  /// Allocates nothing.
  void weights(const Pose& pose, Eigen::Ref<VectorXd> w) const;

  /// Distances (J) in radians to each target's pose, over the bones and channels of its set. Allocates nothing.
  void distances(const Pose& pose, Eigen::Ref<VectorXd> d) const;

 private:
  struct Interpolant {
    TargetSet set;
    VectorXd angles;        ///< for each of the set's channels, radians that one unit of it counts
    bool chordal = false;   ///< the kernel's distances have chords instead of angles
    MatrixXd coefficients;  ///< (J, J): row k times the distance to target k
    VectorXd constant;      ///< (J)

    bool fit(bool with_chords);

    /// Distance in radians: the root of the sum of squared joint angles, or of their chords 2 sin(angle / 2), and of
    /// squared ways along the channels. It does not depend on the signs of quaternions.
    double distance(const Pose& a, const Pose& b, bool with_chords = false) const;
  };
  static Interpolant interpolate(TargetSet set);

  std::vector<Interpolant> sets_;
  std::vector<int> bones_;
  int channels_ = 0, targets_ = 0;
};

}  // namespace dynamorph
