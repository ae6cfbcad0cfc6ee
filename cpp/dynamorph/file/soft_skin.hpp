// SPDX-License-Identifier: GPL-3.0-or-later
// Loads a soft skin from a model file, ready to step.
//
//   const SoftSkin skin = load_soft_skin(file::read("body.dynamorph"), {neutral, flexed});
//   MovingBody<ReducedModel> moving(skin.model, {});
//   Simulation<ReducedModel> simulation(moving);
#pragma once

#include <memory>

#include "dynamorph/file/model_file.hpp"
#include "dynamorph/reduced/reduced_model.hpp"

namespace dynamorph::file {

/// V surface vertices, n coordinates of the model (of its modes, then of its responses), J targets, B bones.
struct SoftSkin {
  std::shared_ptr<const ReducedModel> model;
  std::vector<std::string> bone_names;  ///< (B); the model has one more bone, the object itself, which comes last
  Embedding embedding;                  ///< of the surface vertices (V) in the model's tetrahedra
  MatrixXd modes;                       ///< (3V, n) displacement of the surface by each coordinate, local space
  MatrixXd residual_shapes;             ///< (3V, J) the part of the targets' shapes that the nodes cannot represent

  /// Displacement of the surface (3V) before skinning, in the mesh object's local space, at the coordinates (n) and
  /// target weights (J) of a step.
  VectorXd surface(const VectorXd& coordinates, const VectorXd& weights) const {
    return modes * coordinates + residual_shapes * weights;
  }
};

/// How many targets a model has. Throws Error when the content is not that of a model.
int target_count(const Content& content);

/// targets: one for each of the model's, with its material, which the artist authors and the model does not store. The
/// shapes and sets come from the model: `displacement`, `shifted` and `set` are not read. Throws Error when the content
/// is not that of a reduced model, and std::invalid_argument when the targets do not fit.
SoftSkin load_soft_skin(const Content& content, std::vector<MorphTarget> targets, Blending blending = Blending::even);

}  // namespace dynamorph::file
