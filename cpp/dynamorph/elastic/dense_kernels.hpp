// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

/// Length of a dense factor's columns, padded to whole vectors.
DYNAMORPH_INLINE Index whole_vectors(Index size) { return (size + 3) / 4 * 4; }

/// Replaces the lower triangle of a symmetric matrix by the columns V = L D of L D L^T. Columns are whole_vectors(n)
/// apart, and are zero on and above the diagonal when done. inverse (n): the inverse of D. Returns false when the
/// matrix is not positive definite.
DYNAMORPH_KERNEL(bool, decompose_dense, double* V, Index n, double* inverse);

/// Adds J^T diag(d) J to the lower triangle of A (n, n), column-major, with J (k, n) row-major and d (k).
DYNAMORPH_KERNEL(void, add_squares, const double* J, const double* d, Index k, Index n, double* A);

/// Subtracts B^T diag(d) B from the lower triangle of A (n, n), with B (k, n) and d (k); matrices are column-major.
DYNAMORPH_KERNEL(void, subtract_squares, const double* B, const double* d, Index k, Index n, double* A);

/// C = A B, with A (m, k) and B (k, n); all are column-major.
DYNAMORPH_KERNEL(void, multiply_dense, const double* A, Index m, Index k, const double* B, Index n, double* C);

/// Solves L y = x, then L^T x = D^-1 y. x is padded to whole vectors.
DYNAMORPH_KERNEL(void, substitute_dense, const double* V, const double* inverse, Index n, double* x);

}  // namespace dynamorph
