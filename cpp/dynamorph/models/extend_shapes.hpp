// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/models/soft_body.hpp"

namespace dynamorph {

/// Node displacements (3n, k) that follow the columns of `surfaces` (3V, k) where the mesh embeds them, and are elastic
/// in between. They minimize the neutral material's energy plus a stiff pull to the surface, and are zero at pinned
/// nodes. Bind space, meters.
MatrixXd extend_shapes(const SoftBody& body, const Embedding& embedding, const MatrixXd& surfaces);

}  // namespace dynamorph
