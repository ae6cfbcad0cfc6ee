// SPDX-License-Identifier: GPL-3.0-or-later
// The shape that a soft body has in a pose, found by statics: what an artist would sculpt there, instead of what linear
// blend skinning makes of it. Over the bind-space displacements u of a tet mesh's nodes, whose places in the pose are
// x = A (X + u) + a, it minimizes
//
//   sum_t V_t (psi(F_t(x)) + b(det F_t(X + u))) + sum_i h_i / 2 |A_i u_i|^2 + sum_c k_c / 2 max(d - gap_c, 0)^2:
//
// soft tissue that keeps its volume about the rest shape *in the pose*, where the elasticity of a target is about its
// own shape in bind space; a barrier that keeps that shape usable as a target's; the hold of the bones; and the skin's
// contact with itself. The bones take it from rest to the pose in steps, each from the last. The skin goes with the
// nodes by the smooth embedding, and back through its own skinning to bind space.
//
// The hold gives way around its sources, nodes that skinning crushes or puts into other skin: it is firm at the bones
// and weak at the skin within a thickness of the body from them, whole from two, and nothing moves farther away. Where
// skinning cannot be inverted well, it stays.
#pragma once

#include <vector>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/models/skin.hpp"

namespace dynamorph {

/// Bind space, meters. n nodes, m tets, P points, B bones.
struct PosedBody {
  TetMesh mesh;
  VectorXd stiffness;   ///< (m) >= 0: how firm each tet is, relative to the others
  SkinWeights weights;  ///< of the nodes (n, B)
  Skin skin;            ///< (P)
  Triangles triangles;  ///< of the skin, outward
  VectorXd thickness;   ///< (P) > 0: from the skin to the middle of the body
};

struct PosedShape {
  Points skin;              ///< displacement of the points (P, 3), bind space
  double least_volume = 1;  ///< of a tet with that displacement, bind space, relative to rest
  double overlap = 0;       ///< by which the skin is still in itself, meters: the bones leave no room
  int overlaps = -1;        ///< the point that is deepest
  VectorXd plain;           ///< (P) from 0 to 1: how much of plain skinning stays where it cannot be inverted
  int iterations = 0;       ///< of Newton's method, in all steps
  bool converged = false;   ///< in the last step
};

/// path: skin transforms of the bones (B, 12) from near rest to the pose. Throws std::invalid_argument unless sizes
/// fit, Error for transforms that are not finite, and Cancelled.
PosedShape shape_by_physics(const PosedBody& body, const std::vector<Transforms>& path, const ProgressFn& progress);

}  // namespace dynamorph
