// SPDX-License-Identifier: GPL-3.0-or-later
// The unreduced soft skin: E(u, q) = sum_j w_j(q) E_j(u) over the free nodes of a tet mesh (thesis ch. 5).
//
// FullModel and ReducedModel have one interface, which step() is written against:
//   Matrix, Blend             dense or sparse; the model at one set of target weights
//   blend(w, out)             paid once per pose
//   energy, linearize         E, F = dE/dq and K = dF/dq at coordinates q
//   inertia(motion, ...)      A^T M A, and the force that the moving rig exerts
//   displacement, project     q -> u and its transpose
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/assembly.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph {

/// forces: sum w_j F_j(u), the source's; even: sum w_j F_j(u - d(q) + d_j) with d = sum w_j d_j, halfway in pose is
/// halfway in shape whatever the stiffness. Both are exact at the targets; of overlapping target sets, only even is.
enum class Blending { forces, even };

/// A dynamic morph target as the engine knows it.
struct MorphTarget {
  std::string name;
  int set = 0;                   ///< index of its target set
  VectorXd displacement;         ///< d_j (3n), metres, bind space, zero at pinned nodes
  Lame lame{};                   ///< Pa
  double density = 1000;         ///< kg/m^3
  double mass_damping = 0;       ///< alpha, 1/s
  double stiffness_damping = 0;  ///< beta, s
  bool shifted = false;          ///< elastic as the neutral shape, moved by d: a shape alone (after Capell et al. 2005)
};

/// What all models of one character share. Throws std::invalid_argument when sizes disagree.
struct SoftBody {
  /// fill, stiffness (m): filled fraction and painted multiplier of each tet; shares (m, S): each target set's part of
  /// a tet, rows sum to one; pinned (n); weights (n, B), any positive scale. With weights (n, 0) the skinning is not
  /// known: every free node is a bone of its own, and what is called bones' transforms is one for each of them.
  /// hold (m), 1/m^2: how firmly each tet is held in its target's shape, see `holds`; none without it.
  SoftBody(TetMesh mesh, VectorXd fill, const VectorXd& stiffness, MatrixXd shares, const std::vector<bool>& pinned,
           const Eigen::Ref<const MatrixXd>& weights, const VectorXd& hold = {});

  TetMesh mesh;
  VectorXd fill;
  MatrixXd shares;
  VectorXd stiffness_scale;       ///< (m) fill times painted stiffness
  std::vector<int> free_nodes;    ///< node of each free node
  std::vector<int> free_of_node;  ///< -1 where pinned
  bool own_transforms;            ///< of every free node
  SkinWeights skin;               ///< (free nodes, B)
  VectorXd rest;                  ///< X of the free nodes (3 free)
  MatrixXd volumes;               ///< (free nodes, S) lumped, m^3
  /// The hold (free nodes, S), metres: target j of set s adds mu_j / 2 sum_i holds(i, s) |u_i - d_j,i|^2 to its energy,
  /// the lumped integral of hold |u - d_j|^2 over the body. In proportion to mu_j and about its own shape, so that it
  /// is one more term of the table for mu = 1 and all targets stay exact. Empty when nothing is held so.
  MatrixXd holds;
  double size;      ///< bounding-box diagonal, m
  double volume;    ///< of the free nodes, m^3
  Vector3d centre;  ///< of that volume, m
  /// Of each bone's flesh: sum of volume times weight times p p^T, p = (X - centre, 1).
  std::vector<Eigen::Matrix4d> moments;

  int sets() const { return int(shares.cols()); }
  VectorXd restrict_to_free(const VectorXd& node_values) const;  ///< (3n) -> (3 free)
  VectorXd expand(const VectorXd& free_values) const;            ///< (3 free) -> (3n), zero at pins
};

/// Density and mass damping of each target set at weights w: sum_j w_j rho_j and sum_j w_j alpha_j rho_j.
struct SetDensities {
  VectorXd density, damped;
  void blend(const std::vector<MorphTarget>& targets, int sets, const VectorXd& w);
};

/// All stored values of a dense or sparse matrix: matrices of one model share their pattern.
inline Eigen::Map<VectorXd> values(MatrixXd& m) { return {m.data(), m.size()}; }
inline Eigen::Map<const VectorXd> values(const MatrixXd& m) { return {m.data(), m.size()}; }
inline Eigen::Map<VectorXd> values(SparseMatrix& m) { return {m.valuePtr(), m.nonZeros()}; }
inline Eigen::Map<const VectorXd> values(const SparseMatrix& m) { return {m.valuePtr(), m.nonZeros()}; }

class FullModel {
 public:
  using Matrix = SparseMatrix;

  struct Blend {
    VectorXd weights;
    SetDensities mass;
    Matrix damping;          ///< sum_j w_j beta_j K_j
    VectorXd displacement;   ///< d(q) of even blending (3 free), else empty
    VectorXd hold;           ///< sum_j w_j mu_j holds (3 free); empty when nothing is held so
    VectorXd hold_shapes;    ///< of forces blending: the same times d_j
    double hold_energy = 0;  ///< of forces blending, at u = 0
    Matrix stiffness;        ///< linear law only: f = stiffness q + force, E = energy + ...
    VectorXd force;
    double energy = 0;
  };

  /// The flesh's inertia in one pose, and scratch.
  struct Inertia {
    Matrix mass;     ///< A^T M A
    Matrix damped;   ///< the same with M times mass damping
    VectorXd force;  ///< A^T M times the motion
    SkinFrame frame, past;
    VectorXd bind, posed;
  };

  FullModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, Law law, Blending blending);

  const SoftBody& body() const { return *body_; }
  const std::shared_ptr<const SoftBody>& shared_body() const { return body_; }
  const std::vector<MorphTarget>& targets() const { return targets_; }
  Law law() const { return law_; }
  Blending blending() const { return blending_; }
  const RestShape& shape(int target) const { return shapes_[target]; }
  int dofs() const { return int(3 * body_->free_nodes.size()); }

  void blend(const VectorXd& w, Blend& out) const;
  double energy(const Blend& blend, const VectorXd& q) const;
  double linearize(const Blend& blend, const VectorXd& q, VectorXd& force, Matrix& stiffness) const;
  void inertia(const Motion& motion, const SetDensities& densities, Inertia& out) const;
  void displacement(const VectorXd& q, VectorXd& u) const { u = q; }
  void project(const VectorXd& f, VectorXd& out) const { out = f; }
  VectorXd target(int j) const { return rest_displacements_[j]; }

  /// K_j at u = d_j over the free degrees of freedom.
  Matrix rest_stiffness(int target) const;
  /// A zero matrix with this model's pattern.
  Matrix zero() const { return assembly_.pattern(); }

 private:
  /// The targets that count, and the displacements they are given.
  std::vector<Assembly::Part> parts(const Blend& blend) const;
  VectorXd given(const Blend& blend, const VectorXd& q) const;
  void blend_hold(const VectorXd& w, Blend& out) const;
  /// Energy of the hold at displacements x as `given`; pull: its force.
  double hold_energy(const Blend& blend, const VectorXd& x, VectorXd& pull) const;

  std::shared_ptr<const SoftBody> body_;
  std::vector<MorphTarget> targets_;
  Law law_;
  Blending blending_;
  Assembly assembly_;
  std::vector<RestShape> shapes_;
  std::vector<Assembly::Elements> elements_;  ///< of each target; of even blending about its shape
  std::vector<VectorXd> rest_displacements_;  ///< d_j over the free nodes
  std::vector<VectorXd> rest_stiffness_;      ///< values of each K_j
  std::vector<VectorXd> rest_pull_;           ///< K_j d_j
  std::vector<Eigen::Index> diagonal_;        ///< where the pattern stores (i, i)
};

/// Node displacements (3n, k) that follow the columns of `surfaces` (3V, k) where the mesh embeds them and are elastic
/// in between: minimise the neutral material's energy plus a stiff pull to the surface; zero at pins. Bind space,
/// metres.
MatrixXd extend_shapes(const SoftBody& body, const Embedding& embedding, const MatrixXd& surfaces);

}  // namespace dynamorph
