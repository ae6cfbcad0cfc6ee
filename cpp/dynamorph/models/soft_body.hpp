// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph {

/// The data that all models of one character share. Throws std::invalid_argument when sizes disagree.
struct SoftBody {
  /// fill, stiffness (m): filled fraction and painted factor of each tet. region_weights (m, S): each target set's part
  /// of a tet; rows sum to one. pinned (n). weights (n, B): skin weights at any positive scale. With weights (n, 0) the
  /// skinning is not known; then every free node is its own bone, and there is one bone transform for each of them.
  /// hold (m), 1/m^2: how firmly each tet is held in its target's shape, see `hold_stiffness`; empty for no hold.
  SoftBody(TetMesh mesh, VectorXd fill, const VectorXd& stiffness, MatrixXd region_weights,
           const std::vector<bool>& pinned, const Eigen::Ref<const MatrixXd>& weights, const VectorXd& hold = {});

  TetMesh mesh;
  VectorXd fill;
  MatrixXd region_weights;
  VectorXd stiffness_scale;       ///< (m) fill times painted stiffness
  std::vector<int> free_nodes;    ///< node of each free node
  std::vector<int> free_of_node;  ///< -1 where pinned
  bool own_transforms;            ///< whether every free node has its own
  SkinWeights skin;               ///< (free nodes, B)
  VectorXd rest;                  ///< X of the free nodes (3 free)
  MatrixXd volumes;               ///< (free nodes, S) lumped, m^3
  /// The hold (free nodes, S), meters: target j of set s adds mu_j / 2 sum_i hold_stiffness(i, s) |u_i - d_j,i|^2 to
  /// its energy, the lumped integral of hold |u - d_j|^2 over the body. It is proportional to mu_j and acts about the
  /// target's own shape, so that it belongs to the table for mu = 1 and all targets stay exact. Empty when
  /// there is no hold.
  MatrixXd hold_stiffness;
  double size;      ///< bounding-box diagonal, m
  double volume;    ///< of the free nodes, m^3
  Vector3d center;  ///< of that volume, m
  /// Moments of each bone's soft tissue: the sum of volume times weight times p p^T, where p = (X - center, 1).
  std::vector<Eigen::Matrix4d> moments;

  int sets() const { return int(region_weights.cols()); }
  VectorXd unit_mass() const;  ///< lumped, of every degree of freedom (3 free) for unit density, all sets together
  VectorXd restrict_to_free(const VectorXd& node_values) const;  ///< (3n) -> (3 free)
  VectorXd expand(const VectorXd& free_values) const;            ///< (3 free) -> (3n), zero at pins
};

}  // namespace dynamorph
