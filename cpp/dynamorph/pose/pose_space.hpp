// SPDX-License-Identifier: GPL-3.0-or-later
// Pose space: how much each dynamic morph target counts at a pose.
//
// Each target set uses cardinal radial basis functions of the joint rotations q of the set's bones:
//
//   w(q) = C^T phi(q) + P^T p(q),   w_j(q_k) = delta_jk,   sum_j w_j = 1.
//
// Negative weights are then clamped and the rest renormalized, so that the blended stiffness stays positive definite. A
// target with a limited radius r_j fades out with its distance d_j, and the set's first target gets the weight it
// loses:
//
//   w_j <- w_j s(d_j / r_j),   s = 1 up to a half, then 1 - t^2 (3 - 2 t) with t = 2 d_j / r_j - 1, 0 from one on.
//
// Distances are joint angles, which make the linear kernel a driver's hat function. Poses all the way around a joint
// (0, 90, 180, -90 degrees) cannot be placed in a flat space by their angles, and weights would jump. Such sets use
// chords, which are distances in a flat space. A radius is a joint angle there too.
//
// The thin plate's linear terms p(q) are the rotation vectors from the set's first pose, which flip at 180 degrees.
// From 150 degrees on, the weights pass over to a second interpolant without that jump. It uses chords for distances
// and the entries of the rotation matrices for p(q). This is the thin plate in the space where chords are distances.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// One rotation per row, unit quaternion w x y z; bones in the skeleton's order.
using Rotations = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;

/// linear: |q - q_k|, in one dimension the piecewise-linear hat of a driver. gaussian and thin_plate are smooth.
enum class Kernel { linear, gaussian, thin_plate };

/// Targets whose weights sum to one, placed by the local rotations of `bones` (indices into the skeleton).
struct TargetSet {
  std::vector<int> bones;
  std::vector<std::string> names;  ///< of the targets, for messages
  std::vector<Rotations> poses;    ///< per target, (bones of the skeleton, 4)
  Kernel kernel = Kernel::linear;
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
    bool chordal = false;   ///< distances are chords instead of angles
    bool matrices = false;  ///< linear terms are entries of rotation matrices instead of rotation vectors
    double width = 1;       ///< of the kernel, radians
    MatrixXd coefficients;  ///< (J, J): row k times phi(|q - q_k|)
    MatrixXd polynomial;    ///< (1 + dims, J): the constant, then the linear terms on the poses' span
    MatrixXd span;          ///< (3 or 9 times bones, dims) orthonormal, empty except for thin_plate

    bool fit(const TargetSet& set);
    /// Adds `factor` times the weights (J), which sum to one but may be negative.
    void add_weights(const TargetSet& set, const Eigen::Ref<const Rotations>& pose, double factor,
                     Eigen::Ref<VectorXd> w) const;
  };
  struct Interpolated {
    TargetSet set;
    Interpolant usual;
    std::optional<Interpolant> turned;  ///< used towards 180 degrees; thin_plate only
  };
  static Interpolated interpolate(TargetSet set);

  std::vector<Interpolated> sets_;
  std::vector<int> bones_;
  int targets_ = 0;
};

}  // namespace dynamorph
