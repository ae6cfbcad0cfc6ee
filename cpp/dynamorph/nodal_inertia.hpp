// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of a soft skin in modes, node by node: for skinning that is not linear in the bones' matrices, where
// ModalInertia's sums do not exist, and to compare those with. In double; the cost grows with the nodes.
#pragma once

#include "dynamorph/full_model.hpp"

namespace dynamorph {

class NodalInertia {
 public:
  /// In the basis U (3 free, r).
  NodalInertia(std::shared_ptr<const SoftBody> body, MatrixXd U) : body_(std::move(body)), U_(std::move(U)) {}

  struct Scratch {
    std::array<VectorXd, Motion::kMoments> displacements;
    NodeMotion nodes;
    VectorXd root;    ///< of each node's mass
    MatrixXd modes;   ///< M^(1/2) A U (3 free, r)
    MatrixXd damped;  ///< the same with M times mass damping
  };

  /// U^T A^T M A U (r, r), the same with M times mass damping, and the force of `motion` (r).
  void evaluate(const Motion& motion, const SetDensities& densities, Scratch& scratch, MatrixXd& mass, MatrixXd& damped,
                VectorXd& force) const;

 private:
  std::shared_ptr<const SoftBody> body_;
  MatrixXd U_;
};

}  // namespace dynamorph
