// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/elasticity.hpp"
#include "dynamorph/models/soft_body.hpp"

namespace dynamorph {

/// forces: sum w_j F_j(u), as in the thesis. even: sum w_j F_j(u - d(q) + d_j) with d = sum w_j d_j, so that halfway in
/// pose is halfway in shape, whatever the stiffness. Both are exact at the targets; with overlapping target sets, only
/// even is.
enum class Blending { forces, even };

/// A dynamic morph target as the engine knows it.
struct MorphTarget {
  std::string name;
  int set = 0;                   ///< index of its target set
  VectorXd displacement;         ///< d_j (3n), meters, bind space, zero at pinned nodes
  Lame lame{};                   ///< Pa
  double density = 1000;         ///< kg/m^3
  double mass_damping = 0;       ///< alpha, 1/s
  double stiffness_damping = 0;  ///< beta, s
  bool shifted = false;  ///< elasticity of the neutral shape, moved by d: a shape alone (after Capell et al. 2005)
};

/// Lame's parameters of a Young's modulus (Pa) and a Poisson's ratio. Throws std::invalid_argument unless the first is
/// above zero and the second from 0 to 0.495.
Lame lame_of(double young, double poisson);

/// Throws std::invalid_argument, or Error for what an artist can fix, unless a model of `body` can have these targets.
/// There must be at least one. Each must belong to one of the body's sets and have finite properties, with lambda at
/// most 100 mu. Its displacement must be finite at every node and zero at pinned nodes.
void check_targets(const SoftBody& body, const std::vector<MorphTarget>& targets);

/// Weights (J): one for the first target of each set.
VectorXd neutral_weights(const SoftBody& body, const std::vector<MorphTarget>& targets);

/// Coordinates of the targets' shapes blended by the weights (J).
template <class Model>
void blended_shape(const Model& model, const VectorXd& weights, VectorXd& q) {
  q.setZero(model.dofs());
  for (Eigen::Index j = 0; j < weights.size(); ++j)
    if (weights(j) != 0) q += weights(j) * model.target(int(j));
}

/// Throws std::invalid_argument unless `blending` is one of the enumeration's values.
void check(Blending blending);

/// Density and mass damping of each target set at weights w: sum_j w_j rho_j and sum_j w_j alpha_j rho_j.
struct SetDensities {
  VectorXd density, damped;
  void blend(const std::vector<MorphTarget>& targets, int sets, const VectorXd& w);
};

}  // namespace dynamorph
