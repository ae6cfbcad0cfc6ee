// SPDX-License-Identifier: GPL-3.0-or-later
// A few points on the bar of scenes.hpp.
#pragma once

#include "derivatives.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/models/skin.hpp"

namespace scenes {

using namespace dynamorph;

/// `count` points along the bar's edge y = z = 0.1 m, the first near its end, with weights and residual shapes of their
/// own.
inline Skin skin_of(const SoftBody& body, int count) {
  Skin out;
  out.rest.resize(count, 3);
  for (int p = 0; p < count; ++p) out.rest.row(p) << 0.29 - 0.06 * p, 0.1, 0.1;
  out.embedding = embed(body.mesh, out.rest);
  MatrixXd weights(count, 2);
  for (int p = 0; p < count; ++p) weights.row(p) << 0.2 + 0.1 * p, 0.8 - 0.1 * p;
  out.weights = normalized(weights);
  out.residual_shapes = random_vector(9 * count, 0.01, 77).reshaped(3 * count, 3);
  return out;
}

}  // namespace scenes
