// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <vector>

#include "dynamorph/contact/collider.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph {

/// A point of the skin that a spring pulls to a place in the world.
struct Grab {
  int point;         ///< of the simulation's skin
  Vector3d goal;     ///< meters
  double stiffness;  ///< N/m
};

/// What acts on a soft skin at the end of one step. It owns nothing.
struct StepInput {
  const Transforms& bones;                   ///< (B, 12), bind to world space
  const VectorXd& weights;                   ///< of the targets (J)
  const VectorXd* external = nullptr;        ///< newtons on the free nodes (3 free), world space
  const std::vector<Grab>* grabs = nullptr;  ///< need Simulation::set_skin()
  /// Need Simulation::set_contact(). Simulation::solve_static ignores them.
  const std::vector<ColliderStep>* colliders = nullptr;
};

}  // namespace dynamorph
