// SPDX-License-Identifier: GPL-3.0-or-later
// Where the points of a surface sit in a tet mesh, and what its nodes inherit from them.
#pragma once

#include <functional>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

/// For each of V surface points: point = sum_k weights(k) x[nodes(k)], the weights summing to one.
///
/// A point outside takes the nearest tet and its weights there, extrapolated, so that linear motion of the tet carries
/// it exactly. Extrapolation stops where a weight would fall below -1/2: further out a tet's rotation would swing the
/// point about, and it is carried with a constant offset instead.
struct Embedding {
  Tets nodes;  // (V, 4): of one tet each
  Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> weights;
  VectorXd distances;  // to the tet mesh, metres; 0 inside

  /// E, (V, node_count): values at the points = E * values at the nodes.
  SparseMatrix matrix(Eigen::Index node_count) const;
};

/// Whether a tet may carry a point.
using MayCarry = std::function<bool(Eigen::Index point, int tet)>;

/// may_carry: all tets by default; where none may, the nearest does.
Embedding embed(const TetMesh& mesh, const Points& points, const MayCarry& may_carry = {});

/// Values (V, k) at surface points, extended to values (n, k) at nodes: least squares at the points plus a little
/// smoothness along edges, which decides alone deep inside. Constants stay constant. Overshoots slightly: skin weights
/// want clamping and normalising afterwards.
MatrixXd extend_to_nodes(const TetMesh& mesh, const Embedding& embedding, const MatrixXd& values);

}  // namespace dynamorph
