// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of a soft skin in modes, node by node: for skinning that is not linear in the bones' matrices, where
// ModalInertia's sums do not exist. In double; the cost grows with the nodes.
//
//   mass = sum_i m_i (A_i U_i)^T (A_i U_i),  force = sum_i m_i (A_i U_i)^T y_i,  y_i what the inertial target
//   adds up to at node i.
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
  /// In the basis U (3 free, r).
  NodalInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U);

  /// Nothing is allocated after the first time.
  struct Scratch {
    std::array<SkinFrame, InertialTarget::kPoses> poses;
    MatrixXd displacements;  ///< of the modes in each pose (r, kPoses)
    LaneVector<DoubleW> modes, force, mass, damped;
  };

  /// U^T A^T M A U (r, r), the same with M times mass damping, and the force of `inertial` (r).
  void evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch, MatrixXd& mass,
                MatrixXd& damped, VectorXd& force) const;

 private:
  std::shared_ptr<const SoftBody> body_;
  Eigen::Index r_;
  LaneVector<DoubleW> table_;  ///< of eight nodes after the other: U mode after mode, then X; three numbers each
};

}  // namespace dynamorph
