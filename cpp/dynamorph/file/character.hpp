// SPDX-License-Identifier: GPL-3.0-or-later
// Loads what the export format Soft Skin adds to a model: all that a program needs beside the model to pose the soft
// skin, to step it and to draw it.
//
//   const Content content = read("body.dynamorph");
//   const Character character = load_character(content);
//   const SoftSkin skin = load_soft_skin(content, character.targets, character.blending);
#pragma once

#include "dynamorph/file/model_file.hpp"
#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/pose/pose_space.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph::file {

using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

/// V surface vertices, T triangles, J targets, B bones. A *local* transform is a bone's relative to its parent, without
/// the rest transform: the identity at rest.
struct Character {
  std::string name;
  Points vertices;  ///< (V, 3) at rest, local space
  Triangles triangles;
  Matrix3d to_bind;  ///< local space to bind space, which is in meters
  /// (V, K) the bones that move each vertex, and how much; bone B is the object itself.
  Eigen::Matrix<std::int32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> influence_bones;
  RowMajor influence_weights;
  std::vector<MorphTarget> targets;  ///< (J) names and materials
  Blending blending;
  std::vector<TargetSet> sets;           ///< for PoseSpace
  std::vector<MatrixXd> target_poses;    ///< per target, local transforms (B, 16), row-major
  std::vector<std::string> channels;     ///< (C) names of the numbers that place targets beside bones
  MatrixXd target_channels;              ///< (J, C)
  std::vector<Transforms> target_bones;  ///< per target, (B + 1, 12), for Simulation::balance_targets
  std::vector<int> parents;              ///< (B), -1 for none; parents come first
  std::vector<Matrix4> rest;             ///< (B) armature space
  Matrix4 rig_world, object_world;       ///< where armature and mesh were exported
  Vector3d gravity;                      ///< m/s^2, world

  /// The transforms (B + 1, 12) that a step takes, of local transforms (B, 16); moved: both objects since the export.
  Transforms bones(const MatrixXd& local, const Matrix4& moved) const;
};

/// Whether the content has a character beside its model.
bool has_character(const Content& content);

/// Throws Error where something is missing or does not fit together.
Character load_character(const Content& content);

}  // namespace dynamorph::file
