// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of a soft skin in modes, node by node. It is for skinning that is not linear in the bones' matrices, where
// the sums of ModalInertia do not exist. It works in double, and its cost grows with the number of nodes.
//
//   mass = sum_i m_i (A_i U_i)^T (A_i U_i),  force = sum_i m_i (A_i U_i)^T y_i,
//
// where y_i is the inertial target at node i.
#pragma once

#include <array>
#include <memory>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class NodalInertia {
 public:
  /// Inertia in the basis U (3 free, r).
  NodalInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U);

  /// Nothing is allocated after the first time.
  struct Scratch {
    std::array<SkinFrame, InertialTarget::kPoses> poses;
    MatrixXd displacements;  ///< of the modes in each pose (kPoses, r)
    LaneVector<DoubleW> modes, force, mass, damped;
  };

  /// U^T A^T M A U (r, r), the same with M times mass damping, and the force of `inertial` (r).
  void evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch, MatrixXd& mass,
                MatrixXd& damped, VectorXd& force) const;

  /// The force (r) of a target D (X, 1), D = `moved` of each node, in the pose `now`; for nodes with their own.
  void rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities, Scratch& scratch,
                   Eigen::Ref<VectorXd> force) const;

 private:
  std::shared_ptr<const SoftBody> body_;
  Eigen::Index r_;
  LaneVector<DoubleW> table_;  ///< for each eight nodes, U mode after mode, then X; three numbers each
};

}  // namespace dynamorph
