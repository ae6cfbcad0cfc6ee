// SPDX-License-Identifier: GPL-3.0-or-later
// The loops of sparse_cholesky and sparse_solver, with three scalar rows and columns per block.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

/// Column-major scalars, with `stride` from one column to the next.
struct Dense {
  double* data;
  Index stride;
  DYNAMORPH_INLINE double* at(Index row, Index column) const { return data + column * stride + row; }
};

constexpr int kStrip = 12;  // scalar rows of a packed strip and of a register tile: three vectors of four doubles
constexpr int kSides = 8;   // right-hand sides at a time; a row of them is contiguous

/// y = H x for a symmetric H (columns, columns) in Eigen's compressed storage, both triangles stored. gathered: scratch
/// with as many entries as the longest column has rows.
DYNAMORPH_KERNEL(void, multiply_blocks, const int* outer, const int* inner, const double* values, Index columns,
                 const double* x, double* gathered, double* y);

/// C -= A B^T from strips of rows. The numbers of rows of A and B are multiples of 3. For a symmetric product (A is B),
/// only the lower triangle and a little more is computed.
DYNAMORPH_KERNEL(void, subtract_product, const double* A, Index a_rows, const double* B, Index b_rows, Index depth,
                 bool symmetric, Dense C);

/// Factors columns first .. last - 1 of a panel and leaves 1 / L_ii on the diagonal. The products of earlier columns
/// must already be subtracted from them. Returns false when the panel is not positive definite.
DYNAMORPH_KERNEL(bool, eliminate_columns, Dense panel, Index rows, Index first, Index last);

/// x = L^-1 x for a supernode's columns; subtracts their contribution from the rows below.
DYNAMORPH_KERNEL(void, forward_double, const double* L, Index rows, Index columns, double* x);
DYNAMORPH_KERNEL(void, forward_single, const float* L, Index rows, Index columns, float* x);

/// x = L^-T x for a supernode's columns, given the solution at the rows below.
DYNAMORPH_KERNEL(void, backward_double, const double* L, Index rows, Index columns, double* x);
DYNAMORPH_KERNEL(void, backward_single, const float* L, Index rows, Index columns, float* x);

/// The same in place for kSides right-hand sides. X has the rows of the whole matrix; `below` lists the supernode's
/// rows below.
DYNAMORPH_KERNEL(void, forward_sides_double, const double* L, const int* below, Index first, Index rows, Index columns,
                 double* X);
DYNAMORPH_KERNEL(void, forward_sides_single, const float* L, const int* below, Index first, Index rows, Index columns,
                 float* X);
DYNAMORPH_KERNEL(void, backward_sides_double, const double* L, const int* below, Index first, Index rows, Index columns,
                 double* X);
DYNAMORPH_KERNEL(void, backward_sides_single, const float* L, const int* below, Index first, Index rows, Index columns,
                 float* X);

}  // namespace dynamorph
