// SPDX-License-Identifier: GPL-3.0-or-later
// The unreduced soft skin: E(u, q) = sum_j w_j(q) E_j(u) over the free nodes of a tet mesh (thesis ch. 5).
//
// FullModel and ReducedModel share one interface, which step() uses:
//   Matrix, Blend                dense or sparse; the model at one set of target weights
//   blend(w, e, out)             needed once per pose: shapes and masses by the weights w, elasticity by the weights e,
//                                which are w times how stiff each target is at the moment
//   Workspace                    scratch of evaluations, which a simulation keeps
//   energy, linearize            E, F = dE/dq and K = dF/dq at coordinates q
//   inertia(inertial, ...)       A^T M A, and the force that the moving rig exerts
//   rigid_force(now, moved, ...) A^T M D (X, 1): such a force on the rest positions X alone, with D blended from
//   `moved` displacement, project_force  q -> u and its transpose SkinPoints, skin_points      the same at points of
//   the skin (skin.hpp)
#pragma once

#include <cmath>
#include <memory>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/assembly.hpp"
#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/skin.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"

namespace dynamorph {

class FullModel {
 public:
  using Matrix = SparseMatrix;
  using SkinPoints = NodalPoints;

  struct Blend {
    const FullModel* of = nullptr;  ///< the model that made it
    VectorXd weights, elastic;      ///< w, e
    SetDensities mass;
    Matrix damping;          ///< sum_j e_j beta_j K_j
    VectorXd displacement;   ///< even blending: d(q) (3 free); otherwise empty
    VectorXd hold;           ///< sum_j e_j mu_j hold_stiffness (3 free); empty without a hold
    VectorXd hold_shapes;    ///< forces blending: the same times d_j
    double hold_energy = 0;  ///< forces blending: its energy at u = 0
    Matrix stiffness;        ///< linear law only: f = stiffness q + force, E = energy + ...
    VectorXd force;
    double energy = 0;
  };

  /// Inertia of the soft tissue in one pose, and scratch.
  struct Inertia {
    Matrix mass;     ///< A^T M A
    Matrix damped;   ///< the same with M times mass damping
    VectorXd force;  ///< A^T M times the inertial target
    SkinFrame frame, past;
    VectorXd bind, posed;
  };

  /// What evaluations in one pose need beside their results.
  struct Workspace {
    void begin(double) {}       ///< as of ReducedModel, whose sums depend on the tolerance
    VectorXd from_shape, pull;  ///< displacements that the elements take, and the force of the hold
  };

  FullModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, MaterialModel material_model,
            Blending blending);

  const SoftBody& body() const { return *body_; }
  const std::shared_ptr<const SoftBody>& shared_body() const { return body_; }
  const std::vector<MorphTarget>& targets() const { return targets_; }
  MaterialModel material_model() const { return material_model_; }
  Blending blending() const { return blending_; }
  const RestShape& shape(int target) const { return shapes_[target]; }
  int dofs() const { return int(3 * body_->free_nodes.size()); }
  /// Norm of the coordinates when the whole body moves by one meter.
  double meter() const { return std::sqrt(double(body_->free_nodes.size())); }

  void blend(const VectorXd& w, const VectorXd& e, Blend& out) const;
  /// With each target as stiff as its material.
  void blend(const VectorXd& w, Blend& out) const { blend(w, w, out); }
  double energy(const Blend& blend, const VectorXd& q, Workspace& workspace) const;
  double linearize(const Blend& blend, const VectorXd& q, Workspace& workspace, VectorXd& force,
                   Matrix& stiffness) const;
  /// With a workspace of its own.
  double energy(const Blend& blend, const VectorXd& q) const {
    Workspace workspace;
    return energy(blend, q, workspace);
  }
  double linearize(const Blend& blend, const VectorXd& q, VectorXd& force, Matrix& stiffness) const {
    Workspace workspace;
    return linearize(blend, q, workspace, force, stiffness);
  }
  void inertia(const InertialTarget& inertial, const SetDensities& densities, Inertia& out) const;
  void rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities, Inertia& scratch,
                   VectorXd& force) const;
  void displacement(const VectorXd& q, VectorXd& u) const { u = q; }
  void project_force(const VectorXd& f, VectorXd& out) const { out = f; }
  SkinPoints skin_points(const Embedding& embedding) const { return {*body_, embedding}; }
  VectorXd target(int j) const { return rest_displacements_[j]; }

  /// K_j at u = d_j over the free degrees of freedom.
  Matrix rest_stiffness(int target) const;
  /// A zero matrix with this model's pattern.
  Matrix zero() const { return assembly_.pattern(); }

 private:
  /// The targets with a weight, and the displacements to evaluate them at.
  std::vector<Assembly::Part> parts(const Blend& blend) const;
  void displacement_from_shape(const Blend& blend, const VectorXd& q, VectorXd& out) const;
  void blend_hold(const VectorXd& e, Blend& out) const;
  /// Energy of the hold at displacements x from `displacement_from_shape`. pull: its force.
  double hold_energy(const Blend& blend, const VectorXd& x, VectorXd& pull) const;

  std::shared_ptr<const SoftBody> body_;
  std::vector<MorphTarget> targets_;
  MaterialModel material_model_;
  Blending blending_;
  Assembly assembly_;
  std::vector<RestShape> shapes_;
  std::vector<Assembly::Elements> elements_;  ///< of each target; with even blending, about its shape
  std::vector<VectorXd> rest_displacements_;  ///< d_j over the free nodes
  std::vector<VectorXd> rest_stiffness_;      ///< values of each K_j
  std::vector<VectorXd> rest_pull_;           ///< K_j d_j
  std::vector<Eigen::Index> diagonal_;        ///< where the pattern stores (i, i)
};

}  // namespace dynamorph
