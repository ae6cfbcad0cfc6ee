// SPDX-License-Identifier: GPL-3.0-or-later
// Where the points of a surface lie in a tet mesh, and how values extend from them to its nodes.
#pragma once

#include <functional>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// For each of V surface points: point = sum_k weights(k) x[nodes(k)], where the weights sum to one.
///
/// A point outside the mesh uses the nearest tet with extrapolated weights, so that linear motion of the tet carries it
/// exactly. Extrapolation stops where a weight would fall below -1/2. Farther out, a tet's rotation would swing the
/// point about, so the point is carried with a constant offset instead.
struct Embedding {
  Tets nodes;  ///< (V, 4), those of one tet per point
  Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> weights;
  VectorXd distances;  ///< to the tet mesh, meters; 0 inside

  /// E, (V, node_count): values at the points = E * values at the nodes.
  SparseMatrix matrix(Eigen::Index node_count) const;
  /// E values, (V, k), of values (n, k) at the nodes.
  RowMajor interpolate(const RowMajor& values) const;
};

/// Whether a tet may carry a point.
using MayCarry = std::function<bool(Eigen::Index point, int tet)>;

/// may_carry: by default, all tets may. If none may, the nearest tet carries the point.
Embedding embed(const TetMesh& mesh, const Points& points, const MayCarry& may_carry = {});

/// Extends values (V, k) at surface points to values (n, k) at nodes: least squares at the points plus a little
/// smoothness along edges, which alone decides deep inside. Constants stay constant. Values overshoot slightly, so
/// clamp and normalize skin weights afterward.
MatrixXd extend_to_nodes(const TetMesh& mesh, const Embedding& embedding, const MatrixXd& values);

}  // namespace dynamorph
