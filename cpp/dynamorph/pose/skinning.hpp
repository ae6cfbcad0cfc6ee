// SPDX-License-Identifier: GPL-3.0-or-later
// Linear blend skinning of the nodes: x_i = A_i (X_i + u_i) + a_i, [A_i | a_i] = sum_b w_ib B_b.
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Weights (n, B), rows sum to one. Row-major: a node's bones are contiguous.
using SkinWeights = Eigen::SparseMatrix<double, Eigen::RowMajor>;

/// One bind-to-world transform per row, 3 x 4 row-major.
using Transforms = Eigen::Matrix<double, Eigen::Dynamic, 12, Eigen::RowMajor>;
using TransformMap = Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>;

inline TransformMap transform(const Transforms& transforms, Eigen::Index i) {
  return TransformMap(transforms.data() + 12 * i);
}

/// The skin at one moment: the bones' transforms (B), and the nodes' transforms (n) blended from them.
struct SkinFrame {
  Transforms bones;
  Transforms nodes;
};

/// Rows of `weights` (n, B), scaled to sum to one, without entries below 1 %.
/// Throws std::invalid_argument for negative or non-finite weights, or a row without any.
SkinWeights normalized(const Eigen::Ref<const MatrixXd>& weights);

/// Blends frame.bones into frame.nodes.
void pose_nodes(const SkinWeights& weights, SkinFrame& frame);

/// world = A bind + translation_weight a for every node, all (3n).
void to_world(const SkinFrame& frame, double translation_weight, const VectorXd& bind, VectorXd& world);

/// A^T f for every node, in place (3n).
void pull_back(const SkinFrame& frame, VectorXd& f);

/// Transforms k steps before `now`, if each bone always moves as it does from `now` to `next` (constant spatial
/// velocity).
Transforms extrapolate_back(const Transforms& now, const Transforms& next, int k);

}  // namespace dynamorph
