// SPDX-License-Identifier: GPL-3.0-or-later
// The sums that the reduced polynomials' tables are made of.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

constexpr Index kTile = 12;    // three vectors
constexpr Index kDepth = 128;  // rows of a batch; a panel has 12 kB, so that two stay in the first cache

/// C += A^T B, one row of tiles: panel A against `count` panels of B. A panel is kDepth rows of kTile, of which the
/// first `depth` count; a tile of C (kTile, kTile) row-major.
DYNAMORPH_KERNEL(void, multiply_panels, const double* A, const double* B, Index count, Index depth, double* C);

/// Rows of Green's strain of a tetrahedron with the deformation gradient I + sum_k v_k G_k, over the monomials v_k and,
/// if `pairs`, v_k v_l (k <= l, packed), the coefficient of the full double sum. G (9, r) row-major, entry 3 j + i of a
/// column is G_k(i, j).
DYNAMORPH_KERNEL(void, trace_row, const double* G, Index r, bool pairs, double scale, double* row);

/// Likewise the deviator in an orthonormal basis, five rows `stride` apart: the dot product of two columns is A:B.
DYNAMORPH_KERNEL(void, deviator_rows, const double* G, Index r, bool pairs, double scale, double* rows, Index stride);

/// The bilinear part of the cofactor: columns of cross (9, pairs) are G_k x G_l, tensor cross product.
DYNAMORPH_KERNEL(void, crosses_of_pairs, const double* G, Index r, double* cross);

/// Second derivatives of StVK's force on a tetrahedron's nodes at rest: rows of out (12, pairs), node by node, are
/// d2f[G_k, G_l] for a unit volume. stresses (6, r): xx, yy, zz, xy, yz, zx of Hooke's law for each sym(G_k); gradients
/// (3, 4) column-major, of the nodes.
DYNAMORPH_KERNEL(void, curvatures_of_pairs, const double* G, const double* stresses, Index r, double lambda, double mu,
                 const double* gradients, double* out);

}  // namespace dynamorph
