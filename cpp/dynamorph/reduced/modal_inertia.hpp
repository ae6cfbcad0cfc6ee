// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of a soft skin in modes, without its mesh: its cost does not depend on the number of nodes.
//
// Nodes are posed by x = sum_b w_b (R_b (X + U z) + t_b), linear in the bones' matrices, so every sum over nodes is a
// fixed tensor contracted with those. Weights sum to one, hence for any matrices D_b
//
//   A^T sum_b w_b D_b = sum_b w_b R_b^T D_b - sum_{b<c} w_b w_c (R_b - R_c)^T (D_b - D_c):
//
// a sum over `terms`, which are the bones, and the pairs of bones that share flesh. Rigid bones need only the pairs for
// the mass (R_b^T R_b = 1), and pairs that turn together need nothing.
#pragma once

#include <array>
#include <vector>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class ModalInertia {
 public:
  /// Tensors of all target sets in the basis U (3 free, r).
  ModalInertia(const SoftBody& body, const MatrixXd& U);

  /// What one bone contributes to the terms, 3 x 4 row-major: its transform, then sum_n coefficients'(m, n) [R_n | t_n]
  /// for each backward difference m of the coordinates; t of the first of those, at the flesh's centre and less
  /// gravity_offset,
  /// counts.
  struct BoneMotion {
    float values[1 + InertialTarget::kMoments][12];
  };

  /// What `evaluate` makes, and its scratch: nothing is allocated after the first time.
  struct Result {
    MatrixXd mass;    ///< U^T A^T M A U (r, r)
    MatrixXd damped;  ///< the same with M times mass damping
    VectorXd force;   ///< of the inertial target (r)
    std::vector<BoneMotion> bones;
    std::vector<float> differences, totals;
    LaneVector<FloatW> sums, slopes;
  };

  /// Mass and force of `inertial` in the pose of its first bones. Tensors are in single precision, differences in time
  /// in double. Pairs of bones that matter little are simplified: with 20 bones and 33 pairs bent by half a radian the
  /// mass is within 4e-4 and the force within 7e-6 of the nodes' own, with few bones both within 1e-7.
  void evaluate(const InertialTarget& inertial, const SetDensities& densities, Result& out) const;

  /// The same of eight characters, one a lane: coordinates (r); the entries of used_bones(), twelve each.
  struct EightInertialTarget {
    std::array<const DoubleW*, InertialTarget::kMoments> q;
    std::array<const DoubleW*, InertialTarget::kPoses> bones;
    Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses> coefficients;
    Vector3d gravity_offset;
  };
  struct EightInertia {
    LaneVector<DoubleW> mass, damped;  ///< packed upper triangles
    LaneVector<DoubleW> force;
    LaneVector<FloatW> bones, differences, sums, slopes;
  };
  /// density, damping: of each target set.
  void evaluate(const EightInertialTarget& inertial, const DoubleW* density, const DoubleW* damping,
                EightInertia& out) const;

  /// The bones that carry flesh.
  const std::vector<int>& used_bones() const { return used_; }

  /// Number of terms of all sets.
  int terms() const;

 private:
  using Bones = std::pair<int, int>;  ///< (b, b) one bone, (b, c) a pair; of used_
  /// Up to eight terms, side by side.
  struct Group {
    std::vector<Bones> bones;
    std::array<float, kLanes> signs;  ///< 1 of a bone, -1 of a pair
    double influence;                 ///< the largest part of the force that one of them can have, if all are pairs
  };
  /// Of one target set.
  struct Tensors {
    VectorXd mass;              ///< U^T M1 U, packed upper triangle
    std::vector<Group> groups;  ///< bones, then pairs, the most influential first
    LaneVector<FloatW> table;   ///< terms::entries of each group
    std::vector<float> terms;   ///< the same, entries() of one term after another
  };
  int used(int bone);  ///< its place in used_, where it is added
  void tabulate(const SoftBody& body, const MatrixXd& U, int set, Tensors& out) const;

  Eigen::Index r_;
  Vector3d centre_;        ///< of the flesh: rest positions are relative to it
  std::vector<int> used_;  ///< first those of the terms
  size_t in_terms_;        ///< how many those are
  std::vector<Tensors> sets_;
};

}  // namespace dynamorph
