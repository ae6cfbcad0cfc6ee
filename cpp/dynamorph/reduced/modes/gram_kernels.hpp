// SPDX-License-Identifier: GPL-3.0-or-later
// The sums that make up the reduced polynomials' tables.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

constexpr Index kTile = 12;    // three vectors
constexpr Index kDepth = 128;  // rows of a batch; a panel has 12 kB, so that two stay in the L1 cache

/// C += A^T B for one row of tiles: panel A against `count` panels of B. A panel is kDepth rows of kTile; only the
/// first `depth` rows count. A tile of C (kTile, kTile) is row-major.
DYNAMORPH_KERNEL(void, multiply_panels, const double* A, const double* B, Index count, Index depth, double* C);

/// The trace of Green's strain of a tetrahedron with the deformation gradient I + sum_k v_k G_k. The columns of the row
/// are the monomials v_k and, if `pairs`, v_k v_l (k <= l, packed) with the coefficients of the full double sum. The
/// matrix G (9, r) is row-major; entry 3 j + i of column k is G_k(i, j).
DYNAMORPH_KERNEL(void, trace_row, const double* G, Index r, bool pairs, double scale, double* row);

/// The same for the deviator in an orthonormal basis, as five rows `stride` apart. The dot product of two columns is
/// A:B.
DYNAMORPH_KERNEL(void, deviator_rows, const double* G, Index r, bool pairs, double scale, double* rows, Index stride);

/// The bilinear part of the cofactor: the columns of cross (9, pairs) are the tensor cross products G_k x G_l.
DYNAMORPH_KERNEL(void, crosses_of_pairs, const double* G, Index r, double* cross);

/// Second derivatives of StVK's force on a tetrahedron's nodes at rest. The rows of out (12, pairs), node by node, are
/// d2f[G_k, G_l] for a unit volume. stresses (6, r): xx, yy, zz, xy, yz, zx of Hooke's law for each sym(G_k). gradients
/// (3, 4): of the nodes, column-major.
DYNAMORPH_KERNEL(void, curvatures_of_pairs, const double* G, const double* stresses, Index r, double lambda, double mu,
                 const double* gradients, double* out);

}  // namespace dynamorph
