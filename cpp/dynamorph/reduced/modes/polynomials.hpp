// SPDX-License-Identifier: GPL-3.0-or-later
// Every law's energy is a polynomial of degree <= 4 in the modal coordinates (thesis eq. 5.7). About a target's own
// coordinates z_j, with v = z - z_j and packed pairs (k <= l), the tangent, force and energy are
//
//   H(v) = K0 + K1 v + K2 (v v),
//   f = (K0 + 1/2 K1 v + 1/3 K2 (v v)) v,
//   E = v . (1/2 K0 + 1/6 K1 v + 1/12 K2 (v v)) v
//
// so one table [K0 | K1 | K2] gives energy, force and tangent from one product.
#pragma once

#include "dynamorph/core/progress.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph {

/// What a built reduced model stores: geometry only. Each target has a table for lambda = 1 Pa and one for mu = 1 Pa,
/// so that a change of its stiffness is a linear recombination and never needs a new precompute.
struct ReducedTables {
  MaterialModel material_model = MaterialModel::linear;
  MatrixXd basis;                ///< U (3 free, r)
  std::vector<VectorXd> lambda;  ///< per target, the distinct coefficients as `unfolded` takes them
  std::vector<VectorXd> mu;
  /// The responses (responses.hpp), or none: W (3 free, h); per target D (h), then S (h, pairs) column by column,
  /// unless the law is linear; and per target A (h, r). The tables of target j are those of the modes U - W A_j.
  MatrixXd responses;
  std::vector<VectorXd> response_lambda, response_mu;
  std::vector<MatrixXd> relaxation;

  TableLayout layout() const { return {basis.cols(), material_model != MaterialModel::linear}; }
};

/// G (9, r): column k is dF/dz_k of tet e for the modes (3 free, r), column-major 3 x 3. Returns false if all its nodes
/// are pinned.
bool mode_gradients(const SoftBody& body, const Element& element, Eigen::Index e, const RowMajor& modes, RowMajor& G);

/// The targets' shapes in the basis, z_j = U^T M d_j with the mass M for unit density. Throws std::invalid_argument
/// unless U (3 free, r) is finite, U^T M U = I and every shape is in its span, U z_j = d_j. A model in another basis
/// would play shapes other than those sculpted.
std::vector<VectorXd> target_coordinates(const SoftBody& body, const std::vector<MorphTarget>& targets,
                                         const MatrixXd& U);

/// Tables of every target of `model` in the basis U (3 free, r), without responses, or each in the relaxed modes of its
/// own (3 free, r). Throws like `target_coordinates`.
ReducedTables reduce(const FullModel& model, const MatrixXd& U, const ProgressFn& progress = {},
                     const std::vector<MatrixXd>& relaxed = {});

}  // namespace dynamorph
