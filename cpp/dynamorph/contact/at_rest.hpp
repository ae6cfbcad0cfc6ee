// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <utility>

#include "dynamorph/core/types.hpp"
#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/pose/inertial_target.hpp"

namespace dynamorph {

/// K and M of a model in its targets' shapes blended by the weights, and in the pose of their sculpts.
template <class Model>
std::pair<typename Model::Matrix, typename Model::Matrix> stiffness_and_mass(const Model& model,
                                                                             const VectorXd& weights) {
  typename Model::Blend blend;
  model.blend(weights, blend);
  VectorXd rest, force;
  blended_shape(model, weights, rest);
  typename Model::Matrix K = model.zero();
  model.linearize(blend, rest, force, K);
  Transforms still(model.body().skin.cols(), 12);
  still.rowwise() = Eigen::Matrix<double, 1, 12>{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
  InertialTarget inertial;
  inertial.q.fill(&rest);
  inertial.bones.fill(&still);
  typename Model::Inertia inertia;
  model.inertia(inertial, blend.mass, inertia);
  return {K, inertia.mass};
}

/// K + M / (10 s)^2. The answer to a push of ten seconds is static, and exists where nothing holds the body.
template <class Model>
typename Model::Matrix lasting_stiffness(const Model& model, const VectorXd& weights) {
  constexpr double kAtRest = 10;  // s
  auto [K, M] = stiffness_and_mass(model, weights);
  values(K) += values(M) / (kAtRest * kAtRest);
  return K;
}

}  // namespace dynamorph
