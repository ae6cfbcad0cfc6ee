// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

/// Rows of a dense factor's columns, in whole vectors.
DYNAMORPH_INLINE Index whole_vectors(Index size) { return (size + 3) / 4 * 4; }

/// Columns V = L D of L D L^T in place of the lower triangle of a symmetric matrix, whole_vectors(n) from one to the
/// next; zero on and above the diagonal when done. inverse (n): of D. False when it is not positive definite.
DYNAMORPH_KERNEL(bool, decompose_dense, double* V, Index n, double* inverse);

/// L y = x, then L^T x = D^-1 y; x in whole vectors.
DYNAMORPH_KERNEL(void, substitute_dense, const double* V, const double* inverse, Index n, double* x);

}  // namespace dynamorph
