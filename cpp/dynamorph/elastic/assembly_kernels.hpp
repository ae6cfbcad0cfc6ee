// SPDX-License-Identifier: GPL-3.0-or-later
// Energy, forces and stiffness blocks of four tetrahedra at a time. assembly.hpp sums them.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

constexpr int kGroupSize = 4;  // tetrahedra in the lanes of a register
constexpr int kDiagonal = 12;  // numbers stored per diagonal block: 3x3, column-major, then the node's force
constexpr int kOffDiagonal = 9;
constexpr int kPairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/// Four tetrahedra. Their nodes are in ascending order of free nodes, with pinned nodes last.
struct TetGroup {
  int tets[kGroupSize];        ///< -1 in the lanes that the last group leaves empty
  int order[4][kGroupSize];    ///< each node's number within the tetrahedron
  int nodes[4][kGroupSize];    ///< each node's first degree of freedom; that of pinned nodes reads zeros
  int blocks[10][kGroupSize];  ///< places in the chunk's store of blocks (a, a), then (a, b) for a < b
};

/// One target's elements of a group. Only nodes 1 to 3 store gradients; that of node 0 is minus their sum.
struct ElementGroup {
  double gradients[3][3][kGroupSize];  ///< node, component
  double volumes[kGroupSize];
};
struct OriginGroup {
  double values[3][3][kGroupSize];  ///< F0 - I, row, column
};

/// A target with its moduli multiplied by its weight. The stable law is StVK with (lambda + mu, 0) plus a remainder
/// kappa (tr E - det F + 1).
struct WeightedPart {
  double lambda, mu, kappa;
  const ElementGroup* groups;
  const OriginGroup* origins;  ///< null if displacements are relative to the target's shape
};

/// Evaluates all parts of groups first .. last - 1 at displacements x and returns the energy. The tangent kernels also
/// add forces and stiffness to the store.
DYNAMORPH_KERNEL(double, stvk_energy, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x);
DYNAMORPH_KERNEL(double, stable_energy, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x);
DYNAMORPH_KERNEL(double, stvk_tangent, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x, double* store);
DYNAMORPH_KERNEL(double, stable_tangent, const TetGroup* groups, int first, int last, const WeightedPart* parts,
                 size_t count, const double* x, double* store);

}  // namespace dynamorph
