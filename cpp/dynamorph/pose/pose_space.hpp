// SPDX-License-Identifier: GPL-3.0-or-later
// Pose space: how much each dynamic morph target counts at a pose.
//
// Each target set uses cardinal radial basis functions of the joint rotations q of the set's bones, with a linear
// kernel and a constant term:
//
//   w(q) = sum_k |q - q_k| c_k + c_0,   w_j(q_k) = delta_jk,   sum_j w_j = 1.
//
// With one joint angle that is the piecewise-linear hat function of a driver, constant outside the targets. Negative
// weights are then clamped and the rest renormalized, so that the blended stiffness stays positive definite. A target
// with a limited radius r_j fades out with its distance d_j, and the set's first target gets the weight it loses:
//
//   w_j <- w_j s(d_j / r_j),   s = 1 up to a half, then 1 - t^2 (3 - 2 t) with t = 2 d_j / r_j - 1, 0 from one on.
//
// Distances are joint angles. Poses all the way around a joint (0, 90, 180, -90 degrees) cannot be placed in a flat
// space by their angles, and weights would jump. Such sets use chords, which are distances in a flat space. A radius is
// a joint angle there too.
#pragma once

#include <string>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// One rotation per row, unit quaternion w x y z; bones in the skeleton's order.
using Rotations = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;

/// Targets whose weights sum to one, placed by the local rotations of `bones` (indices into the skeleton).
struct TargetSet {
  std::vector<int> bones;
  std::vector<std::string> names;  ///< of the targets, for messages
  std::vector<Rotations> poses;    ///< per target, (bones of the skeleton, 4)
  std::vector<double> radii = {};  ///< per target, radians, 0 unlimited; may be empty; the first one's is ignored
};

/// Local transforms, one row-major 4 x 4 per row.
using LocalTransforms = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 16, Eigen::RowMajor>>;

/// Writes the rotation of a bone's local transform, without scale and shear, into the bone's row.
void rotation_of(const LocalTransforms& transforms, int bone, Rotations& rotations);

/// Distance in radians over the set's bones: sqrt(sum of squared joint angles), or of their chords 2 sin(angle / 2). It
/// does not depend on the signs of quaternions.
double pose_distance(const std::vector<int>& bones, const Rotations& a, const Eigen::Ref<const Rotations>& b,
                     bool chordal = false);

class PoseSpace {
 public:
  /// Throws Error, which names both, when two targets of a set have (nearly) the same pose.
  explicit PoseSpace(std::vector<TargetSet> sets);

  /// Number of targets of all sets.
  int targets() const { return targets_; }

  /// The bones that any set uses, ascending. Only these rows of a pose count.
  const std::vector<int>& bones() const { return bones_; }
  int sets() const { return int(sets_.size()); }

  /// Weights (J), set after set. Each set's weights are >= 0 and sum to 1; at a target's pose they are a unit vector.
  /// Allocates nothing. `pose` (B, 4).
  void weights(const Eigen::Ref<const Rotations>& pose, Eigen::Ref<VectorXd> w) const;

  /// Distances (J) in radians to each target's pose over the joint angles of its set. Allocates nothing.
  void distances(const Eigen::Ref<const Rotations>& pose, Eigen::Ref<VectorXd> d) const;

 private:
  struct Interpolant {
    TargetSet set;
    bool chordal = false;   ///< distances are chords instead of angles
    MatrixXd coefficients;  ///< (J, J): row k times the distance to target k
    VectorXd constant;      ///< (J)

    bool fit(bool with_chords);
  };
  static Interpolant interpolate(TargetSet set);

  std::vector<Interpolant> sets_;
  std::vector<int> bones_;
  int targets_ = 0;
};

}  // namespace dynamorph
