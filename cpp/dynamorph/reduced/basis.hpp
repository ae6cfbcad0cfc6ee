// SPDX-License-Identifier: GPL-3.0-or-later
// The subspace of a reduced soft skin (docs/theory.md, Reduction): per target linear modes, their modal derivatives and
// the static responses to accelerated bones, compressed by mass-PCA; the targets' own shapes stay exactly in the span.
#pragma once

#include "dynamorph/core/progress.hpp"
#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

/// Vibration modes at a target's shape: K phi = omega^2 M phi, phi^T M phi = 1 with the target's density.
struct LinearModes {
  MatrixXd shapes;  ///< (3 free, k)
  VectorXd omega;   ///< (k), rad/s, ascending
};

/// The k lowest modes of `target` by Spectra, shift-invert with a sparse Cholesky factorisation.
/// Throws Error when the eigensolver does not converge.
LinearModes linear_modes(const FullModel& model, int target, int k);

/// Second derivatives of the force about a target's shape, the other sets in their neutral shapes (3 free, pairs of
/// modes (pair_index)): d2F[phi_k, phi_l] in the model's law, with the sets that linear_modes' K is made of.
MatrixXd force_curvatures(const FullModel& model, int target, const MatrixXd& modes);

struct Basis {
  MatrixXd U;                     ///< (3 free, r), U^T M U = I for unit density
  double explained_variance = 1;  ///< fraction of the candidates' mass-weighted variance in the span
};

/// r modes for all targets of the model. Throws Error when r cannot hold every target's shape and one mode of motion.
Basis make_basis(const FullModel& model, int r, const ProgressFn& progress = {});

}  // namespace dynamorph
