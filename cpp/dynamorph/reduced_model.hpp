// SPDX-License-Identifier: GPL-3.0-or-later
// The soft skin in a modal subspace, u = U z, with the interface of FullModel.
#pragma once

#include "dynamorph/full_model.hpp"
#include "dynamorph/polynomials.hpp"

namespace dynamorph {

class ReducedModel {
 public:
  using Matrix = MatrixXd;

  struct Blend {
    VectorXd weights;
    SetDensities mass;
    Matrix damping;     ///< sum_j w_j beta_j K_j (r, r)
    VectorXd table;     ///< sum_j w_j table_j
    VectorXd force;     ///< f at v = 0
    double energy = 0;  ///< E at v = 0
    VectorXd centre;    ///< v = z - centre
    /// Scratch of linearize: v, its pairs, and the packed tangent by order.
    mutable VectorXd v, pairs, constant, linear, quadratic;
  };

  ReducedModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, const ReducedTables& tables,
               Blending blending);

  const SoftBody& body() const { return *body_; }
  const std::shared_ptr<const SoftBody>& shared_body() const { return body_; }
  const std::vector<MorphTarget>& targets() const { return targets_; }
  const MatrixXd& basis() const { return U_; }
  int dofs() const { return int(U_.cols()); }

  void blend(const VectorXd& w, Blend& out) const;
  double energy(const Blend& blend, const VectorXd& z) const;
  double linearize(const Blend& blend, const VectorXd& z, VectorXd& force, Matrix& stiffness) const;
  void inertia(const SkinFrame& frame, const VectorXd& density, Matrix& out) const;
  void displacement(const VectorXd& z, VectorXd& u) const;
  void project(const VectorXd& f, VectorXd& out) const;
  VectorXd target(int j) const { return coordinates_[j]; }
  Matrix zero() const { return Matrix::Zero(dofs(), dofs()); }

 private:
  /// The orders of the tangent at v (in the scratch), packed.
  void expand(const Blend& blend, const VectorXd& z) const;
  void recentre(int target);
  void build_inertia();

  std::shared_ptr<const SoftBody> body_;
  std::vector<MorphTarget> targets_;
  Blending blending_;
  MatrixXd U_;
  std::vector<VectorXd> coordinates_;  ///< z_j
  MatrixXd tables_;                    ///< column j: target j's table with its material, about z_j (even) or 0 (forces)
  TableLayout layout_;
  std::vector<VectorXd> rest_stiffness_;  ///< packed K_j at z_j
  std::vector<VectorXd> forces_;          ///< of forces blending, at z = 0
  std::vector<double> energies_;

  /// U^T A^T M A U without the mesh, for weights that sum to one:
  ///   A^T A = sum_b w_b R_b^T R_b - sum_{b<c} w_b w_c (R_b - R_c)^T (R_b - R_c),
  /// six columns for the entries of each of those symmetric 3 x 3 matrices. Rigid bones need only the pairs: the first
  /// sum is the identity. Single precision: a step reads all pairs, and is as fast as they are small (step() takes the
  /// inertial force itself from the nodes, in double, and this only for the change within the step).
  struct InertiaTables {
    VectorXd mass;          ///< packed U^T M1 U
    Eigen::MatrixXf bones;  ///< (pairs of modes, 6 B)
    Eigen::MatrixXf pairs;  ///< (pairs of modes, 6 P)
  };
  std::vector<InertiaTables> inertia_;  ///< per target set
  struct BonePair {
    int first, second;
    double share;  ///< of the body's volume, weighted with both bones' weights
  };
  std::vector<BonePair> bone_pairs_;  ///< bones that share nodes
};

}  // namespace dynamorph
