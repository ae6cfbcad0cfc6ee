// SPDX-License-Identifier: GPL-3.0-or-later
// A mesh of tetrahedra and the body inside it: where each surface point sits, how much of each tet is body, what the
// nodes inherit from the surface, and which of them the bones hold.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

struct TetMesh {
  Points nodes;  // n rest positions, metres
  Tets tets;     // m rows of node indices, positively oriented: det(b - a, c - a, d - a) > 0
};

/// A mesh from stored arrays. Throws std::invalid_argument on an index out of range, a NaN, a tet that is not
/// positively oriented or a node of no tet.
TetMesh make_tet_mesh(Points nodes, Tets tets);

/// Volume of every tet, cubic metres.
VectorXd volumes(const TetMesh& mesh);

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

/// Fraction of each tet that the body fills, 0.05 .. 1: a cage is larger than the body and has webs between limbs, and
/// both mass and stiffness go with the fraction. The floor keeps every node massive and every tet stiff. The surface is
/// closed first (`close_surface`, here and in `pinned`).
VectorXd fill_fractions(const TetMesh& mesh, const Points& vertices, const Triangles& triangles,
                        const ProgressFn& progress = {});

/// Values (V, k) at surface points, extended to values (n, k) at nodes: least squares at the points plus a little
/// smoothness along edges, which decides alone deep inside. Constants stay constant. Overshoots slightly: skin weights
/// want clamping and normalising afterwards.
MatrixXd extend_to_nodes(const TetMesh& mesh, const Embedding& embedding, const MatrixXd& values);

/// Points (k, 3) along the bones (segments from head to tail), about as far apart as the cage's vertices, where the
/// cage leaves room for them: as nodes they tie the flesh to a bone that would else pass between nodes. Where there is
/// room, three around the bone within what it holds (`ratio` and `skin` as for `pinned`): a body held along a mere line
/// could spin about it.
Points points_on_bones(const Points& cage, const Triangles& triangles, const Points& skin, const Triangles& faces,
                       const Points& heads, const Points& tails, double ratio);

/// True for the nodes that the bones hold: those whose distance to the nearest bone (segment from head to tail) is less
/// than `ratio` of the way from bone to skin. 0 holds none, 1 all nodes inside the body; nodes outside are never held.
std::vector<bool> pinned(const TetMesh& mesh, const Points& vertices, const Triangles& triangles, const Points& heads,
                         const Points& tails, double ratio);

}  // namespace dynamorph
