// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia of the responses (responses.hpp). W = U C^T + W' with W'^T M U = 0 for unit density. What moves in the modes,
// U C^T, has their exact inertia. The displacement in W' is small, so that of its inertia only the mass is kept that
// each response k has alone. At rest there is no other. Where bones scale, it is
//
//   sum_b |R_b|^2 / 3 sum_i m_i w_ib |W_ik|^2,
//
// or, for nodes with transforms of their own, the same sum over those. What is left out can make the mass of unevenly
// scaled bones indefinite, most of all where W is nearly in the span of U. There the mass between modes and responses
// is made as much smaller as is needed. The moving rig acts on W' through twelve loads of each bone, and of each pair
// of bones that share much tissue (modal_inertia.hpp),
//
//   force = sum_b (R_b^T [R^ | t^]_b) : sum_i m_i w_ib W'_i (X_i, 1) - ...,
//
// where [R^ | t^] is the bone's inertial target. On unseen clips of whole bodies this is nearly as accurate as the
// exact inertia (docs/accuracy.md).
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <memory>
#include <vector>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class ResponseInertia {
 public:
  /// U (3 free, r): the modes; W (3 free, h): the responses, W^T M W = 1 for unit density.
  ResponseInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U, const MatrixXd& W);

  struct Scratch {
    VectorXd loads, force, past, border_force;
    VectorXd growth;  ///< of each bone or node: its mean square scale, less one
    VectorXd scales;  ///< (rows) the mean square scale of each response
    MatrixXd between, gram;
    Eigen::LLT<MatrixXd> corner{MatrixXd()};  // or a move would read what Eigen leaves unset
    Eigen::SelfAdjointEigenSolver<MatrixXd> eigen;
    std::vector<int> active;  ///< pairs
    Transforms target;        ///< what pulls the rest positions of each bone or node
    std::vector<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> centered;  ///< the same of bones_, about the center
  };

  /// Adds the responses' part of mass, damped mass and force (r + h), whose corner and head are the modes'.
  void evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch, ArrowMatrix& mass,
                ArrowMatrix& damped, VectorXd& force) const;

  /// Adds the responses' part of the force of a target D (X, 1) with the rest positions X, D blended from `moved`, in
  /// the pose `now`.
  void rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities, Scratch& scratch,
                   VectorXd& force) const;

 private:
  /// One bone, or two bones that share tissue, by their places in bones_.
  struct LoadedPair {
    int first, second;  ///< the same for one bone
    double size;        ///< of its loads, the largest of the sets
  };
  /// Of one target set, for unit density.
  struct Set {
    LaneVector<float> loads;  ///< (rows, 12 pairs); or with transforms of their own, (rows, 3 nodes)
    VectorXd mass;            ///< (h), at rest
    LaneVector<float> parts;  ///< of that mass, carried by each bone or node (rows, bones or nodes)
    MatrixXd border;          ///< W'^T M U (h, r), whose sum over the sets is zero
  };
  void tabulate_loads(const MatrixXd& remainder, int s, Set& set);
  void tabulate_mass(const MatrixXd& W, int s, Set& set);
  /// Writes what pulls the rest positions of each pair (12), or of each node (3), in its own frame, and which pairs
  /// matter. target: of each bone or node.
  void take_loads(const Transforms& now, const Transforms& target, Scratch& scratch) const;
  void take_nodal_loads(const Transforms& now, const Transforms& target, Scratch& scratch) const;
  /// How bones or nodes scale.
  void take_growth(const Transforms& now, Scratch& scratch) const;
  /// Adds those loads of one set, for unit density, to scratch.force (rows).
  void add_loads(const Set& set, Scratch& scratch) const;
  /// The factor, at most 1, on the border of `matrix` with which it is positive definite.
  double definite_border(const ArrowMatrix& matrix, Scratch& scratch) const;

  std::shared_ptr<const SoftBody> body_;
  Eigen::Index count_, rows_;
  std::vector<int> bones_;         ///< those that carry soft tissue
  std::vector<LoadedPair> pairs_;  ///< one bone, then two
  MatrixXd modal_;                 ///< C (h, r)
  double bound_;                   ///< definite_border's bound, a little above what it is at rest
  std::vector<Set> sets_;
};

}  // namespace dynamorph
