// SPDX-License-Identifier: GPL-3.0-or-later
// Energy, forces and blocks of the stiffness of tetrahedra, four at a time: what assembly.hpp sums.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

constexpr int kGroupSize = 4;  // tetrahedra in the lanes of a register
constexpr int kDiagonal = 12;  // numbers stored of a diagonal block: 3x3, column-major, and the node's force
constexpr int kOffDiagonal = 9;
constexpr int kPairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/// Four tetrahedra, their nodes in ascending order of free nodes and held ones last.
struct TetGroup {
  int tets[kGroupSize];        ///< -1 in the lanes that the last group leaves empty
  int order[4][kGroupSize];    ///< the tetrahedron's own number of each node
  int nodes[4][kGroupSize];    ///< its first degree of freedom; that of held nodes reads zeros
  int blocks[10][kGroupSize];  ///< where in the chunk's store blocks (a, a), then (a, b) for a < b, are summed
};

/// One target's elements of a group. Nodes 1 to 3 have gradients, that of node 0 is minus their sum.
struct ElementGroup {
  double gradients[3][3][kGroupSize];  ///< node, component
  double volumes[kGroupSize];
};
struct OriginGroup {
  double values[3][3][kGroupSize];  ///< F0 - I, row, column
};

/// A target with its moduli times its weight: the stable law is StVK with (lambda + mu, 0) and a remainder kappa (tr E
/// - det F + 1).
struct WeightedPart {
  double lambda, mu, kappa;
  const ElementGroup* groups;
  const OriginGroup* origins;  ///< null where displacements are given from the target's shape
};

/// All parts of groups first .. last - 1 at displacements x; returns the energy. The tangents add forces and stiffness
/// to the store, too.
DYNAMORPH_KERNEL(double, stvk_energy, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x);
DYNAMORPH_KERNEL(double, stable_energy, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x);
DYNAMORPH_KERNEL(double, stvk_tangent, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x, double* store);
DYNAMORPH_KERNEL(double, stable_tangent, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x, double* store);

}  // namespace dynamorph
