// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of the responses (responses.hpp). Their displacement is small, so that of A^T M A only the mass at rest is
// kept, which is diagonal among the responses; the moving rig acts on them through twelve loads of each bone,
//
//   force = sum_b (R_b^T [R^ | t^]_b) : sum_i m_i w_ib W_i (X_i, 1),
//
// where [R^ | t^] is the bone's inertial target. On unseen clips of whole bodies this is as accurate as the exact
// inertia (docs/accuracy.md).
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/arrow_matrix.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class ResponseInertia {
 public:
  /// U (3 free, r): the modes; W (3 free, h): the responses, W^T M W = 1 for unit density.
  ResponseInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U, const MatrixXd& W);

  struct Scratch {
    VectorXd loads, force, past;
  };

  /// Adds the responses' part of mass, damped mass and force (r + h), whose corner and head are the modes'.
  void evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch, ArrowMatrix& mass,
                ArrowMatrix& damped, VectorXd& force) const;

 private:
  /// Of one target set, for unit density.
  struct Set {
    LaneVector<float> loads;  ///< (rows, 12 bones); or with transforms of their own, (rows, 3 nodes)
    VectorXd mass;            ///< (h)
    MatrixXd border;          ///< W^T M U (h, r)
  };
  /// Writes the inertial target of each bone (12), or of each node (3), in its own frame. Returns the mean square
  /// scale of the bones.
  double take_loads(const InertialTarget& inertial, VectorXd& loads) const;
  double take_nodal_loads(const InertialTarget& inertial, VectorXd& loads) const;

  std::shared_ptr<const SoftBody> body_;
  Eigen::Index count_, rows_;
  std::vector<int> bones_;       ///< those that carry soft tissue
  std::vector<double> volumes_;  ///< of their tissue, relative to all
  std::vector<Set> sets_;
};

}  // namespace dynamorph
