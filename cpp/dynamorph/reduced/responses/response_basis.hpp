// SPDX-License-Identifier: GPL-3.0-or-later
// The subspace of a whole body (docs/theory.md, Whole bodies): few modes, in which the energy is tabulated, and many
// responses, which stay linear (responses.hpp). Both are static answers to what a rig can do: each bone accelerates
// along and about each axis, and stretches.
#pragma once

#include "dynamorph/core/progress.hpp"
#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

struct ResponseBasis {
  MatrixXd U;           ///< the modes (3 free, r), U^T M U = I for unit density; the targets' shapes are in their span
  VectorXd amplitudes;  ///< (r) how much each mode moves, relative to the others
  MatrixXd W;  ///< the responses (3 free, h), W^T M W = I; about the neutral target W^T K W is diagonal and W^T K U = 0
};

/// Makes r modes and h responses for all targets of the model; fewer responses where the bones cause fewer. Throws
/// Error when r cannot hold every target's shape and one mode of motion, the cage cannot move in so many, or nothing
/// resists some motion of it (check_no_free_motion), and std::invalid_argument unless h is at least 1.
ResponseBasis make_response_basis(const FullModel& model, int r, int h, const ProgressFn& progress = {});

/// The modes U and responses W of another stiffness, for the same body and targets: the same modes, and responses of
/// the same span, which this stiffness decouples. For a picture while the stiffness is painted; amplitudes stay empty.
/// Throws std::invalid_argument unless both have the model's degrees of freedom, and Error where they do not fit it.
ResponseBasis adapt_response_basis(const FullModel& model, const MatrixXd& U, const MatrixXd& W);

}  // namespace dynamorph
