// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of a soft skin in modes, without its mesh. The cost does not depend on the number of nodes.
//
// Nodes are posed by x = sum_b w_b (R_b (X + U z) + t_b). This is linear in the bones' matrices, so every sum over
// nodes is a fixed tensor contracted with those matrices. Weights sum to one, hence for any matrices D_b
//
//   A^T sum_b w_b D_b = sum_b w_b R_b^T D_b - sum_{b<c} w_b w_c (R_b - R_c)^T (D_b - D_c).
//
// This is a sum over single bones and over any two bones that share soft tissue (bone_pairs.hpp). If bones are rigid,
// R_b^T R_b = 1, the mass needs only the sum over two bones. Two bones that rotate together need nothing.
#pragma once

#include <array>
#include <vector>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/inertia/bone_pairs.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class ModalInertia {
 public:
  /// Tensors of all target sets in the basis U (3 free, r).
  ModalInertia(const SoftBody& body, const MatrixXd& U);

  /// What one bone contributes to its pairs, as 3 x 4 row-major matrices: its transform, then sum_n coefficients'(m, n)
  /// [R_n | t_n] for each backward difference m of the coordinates. Only the first difference uses its t, which is
  /// taken at the body's center and minus gravity_offset.
  struct BoneMotion {
    float values[1 + InertialTarget::kMoments][12];
  };

  /// The results of `evaluate`, and its scratch. Nothing is allocated after the first time.
  struct Result {
    MatrixXd mass;    ///< U^T A^T M A U (r, r)
    MatrixXd damped;  ///< the same with M times mass damping
    VectorXd force;   ///< of the inertial target (r)
    std::vector<BoneMotion> bones;
    std::vector<float> differences, totals;
    LaneVector<FloatW> sums, slopes;
  };

  /// Mass and force of `inertial` in the pose of its first bones. Tensors are in single precision, differences in time
  /// in double. Pairs of two bones that matter little are simplified. With 20 bones and 33 pairs bent by half a radian,
  /// the mass is within 4e-4 and the force within 7e-6 of a sum over the nodes; with few bones, both are within 1e-7.
  void evaluate(const InertialTarget& inertial, const SetDensities& densities, Result& out) const;

  /// The force (r) of a target D (X, 1) with the rest positions X, D blended from `moved` (B), in the pose `now` (B).
  void rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities, Result& scratch,
                   Eigen::Ref<VectorXd> force) const;

 private:
  using BonePair = bone_pairs::BonePair;
  /// Up to eight pairs, side by side.
  struct Group {
    std::vector<BonePair> pairs;      ///< places in used_
    std::array<float, kLanes> signs;  ///< 1 for one bone, -1 for two
    double largest_force;  ///< the largest part of the force that one can have; infinite unless all are of two bones
  };
  /// The tensors of one target set.
  struct Tensors {
    VectorXd mass;              ///< U^T M1 U, packed upper triangle
    std::vector<Group> groups;  ///< one bone, then two, those with the largest force first
    LaneVector<FloatW> table;   ///< bone_pairs::entries of each group
  };
  int used(int bone);  ///< its place in used_; adds it if it is missing
  void tabulate(const SoftBody& body, const MatrixXd& U, int set, Tensors& out) const;

  Eigen::Index r_;
  Vector3d center_;        ///< of the body; rest positions are relative to it
  std::vector<int> used_;  ///< the bones of the pairs
  std::vector<Tensors> sets_;
};

}  // namespace dynamorph
