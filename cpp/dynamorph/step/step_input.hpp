// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/contact/collider.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/models/skin.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph {

/// A point that a spring pulls to a place in the world.
struct Grab {
  int point;         ///< of the skin
  Vector3d goal;     ///< meters
  double stiffness;  ///< N/m
};

/// Points of a skin that springs pull.
template <class Model>
struct Grabs {
  std::shared_ptr<const SkinMap<Model>> skin;
  std::vector<Grab> springs;
};

/// What acts on a soft skin at the end of one step. It owns nothing.
template <class Model>
struct StepInput {
  const Transforms& bones;             ///< (B, 12), bind to world space
  const VectorXd& weights;             ///< of the targets (J)
  const VectorXd* external = nullptr;  ///< newtons on the free nodes (3 free), world space
  const Grabs<Model>* grabs = nullptr;
  const std::vector<ColliderStep>* colliders = nullptr;  ///< for contact's samples; a static solution ignores them
  const VectorXd* stiffness = nullptr;    ///< how many times as stiff as its material each target (J) is; null: 1
  const double* distance = nullptr;       ///< at which contact begins, meters, instead of that of the parts
  const double* self_friction = nullptr;  ///< of skin on skin of itself, likewise
};

}  // namespace dynamorph
