// SPDX-License-Identifier: GPL-3.0-or-later
// The subspace of a reduced soft skin (docs/theory.md, Reduction). For each target it has linear modes, their modal
// derivatives and the static responses to accelerated bones, compressed by mass-PCA. The targets' own shapes stay
// exactly in the span.
#pragma once

#include "dynamorph/core/progress.hpp"
#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

/// Vibration modes at a target's shape: K phi = omega^2 M phi, phi^T M phi = 1 with the target's density.
struct LinearModes {
  MatrixXd shapes;  ///< (3 free, k)
  VectorXd omega;   ///< (k), rad/s, ascending
};

/// The k lowest modes of `target`, found by Spectra with shift-invert and a sparse Cholesky factorization.
/// Throws Error when nothing resists some motion of the body (check_no_free_motion), or the eigensolver does not
/// converge.
LinearModes linear_modes(const FullModel& model, int target, int k);

/// Second derivatives d2F[phi_k, phi_l] of the force about a target's shape, with the other sets in their neutral
/// shapes: (3 free, pairs of modes (pair_index)). They use the model's law, and the same targets as K of linear_modes.
MatrixXd force_curvatures(const FullModel& model, int target, const MatrixXd& modes);

/// The same of this target's energy alone, without the other sets, for any Lame parameters: it is linear in them.
RowMajor force_curvatures_alone(const FullModel& model, int target, Lame lame, const MatrixXd& modes);

struct Basis {
  MatrixXd U;                     ///< (3 free, r), U^T M U = I for unit density
  double explained_variance = 1;  ///< fraction of the candidates' mass-weighted variance in the span
};

/// Makes r modes for all targets of the model. Throws Error when r cannot hold every target's shape and one mode of
/// motion, and when nothing resists some motion of the body (check_no_free_motion).
Basis make_basis(const FullModel& model, int r, const ProgressFn& progress = {});

}  // namespace dynamorph
