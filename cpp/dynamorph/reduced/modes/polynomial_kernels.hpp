// SPDX-License-Identifier: GPL-3.0-or-later
// The hot loops of a reduced step, besides those of modal_inertia.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

constexpr Index kChunk = 8;  ///< entries of K2 that a step reads together (table_layout.hpp)

/// y += A x, with A (rows, columns) column-major. Single precision is summed in double.
DYNAMORPH_KERNEL(void, add_product, const double* A, Index rows, const double* x, Index columns, double* y);
DYNAMORPH_KERNEL(void, add_single_product, const float* A, Index rows, const double* x, Index columns, double* y);

/// y += A x for a symmetric A stored by symmetric_index, summed in double. size is a whole number of chunks.
DYNAMORPH_KERNEL(void, add_symmetric_product, const float* A, Index size, const double* x, double* y);

/// Both with blocks of four columns summed in single precision. rows is a whole number of chunks.
DYNAMORPH_KERNEL(void, add_short_product, const float* A, Index rows, const float* x, Index columns, double* y);
DYNAMORPH_KERNEL(void, add_short_symmetric_product, const float* A, Index size, const float* x, double* y);

/// y = A x in single precision. A: blocks of kRowBlock rows, each (kRowBlock, columns) column-major.
constexpr Index kRowBlock = 32;
DYNAMORPH_KERNEL(void, multiply_row_blocks, const float* A, Index blocks, const float* x, Index columns, double* y);
/// The same for two right-hand sides x (2, columns), to y (rows, 2).
DYNAMORPH_KERNEL(void, multiply_row_blocks_twice, const float* A, Index blocks, const float* x, Index columns,
                 double* y);

/// y += A^T x, with A (rows, columns) column-major.
DYNAMORPH_KERNEL(void, add_dots, const double* A, Index rows, Index columns, const double* x, double* y);

/// Contracts the packed orders K0, K1 v and K2 (v v) of a tangent (polynomials.hpp). Returns the energy, and writes the
/// force (r) and the tangent itself (r, r).
DYNAMORPH_KERNEL(double, contract_orders, const double* constant, const double* linear, const double* quadratic,
                 const double* v, Index r, double* force, double* stiffness);

/// out = sum_k weights[k] tables[k], each (size).
DYNAMORPH_KERNEL(void, blend_tables, const float* const* tables, const double* weights, int count, Index size,
                 float* out);

/// For S (h, pairs of r), where a pair stands for both its orders and h is a whole number of chunks: adds S v to slopes
/// (h, r), and writes products (pairs) = S^T y.
DYNAMORPH_KERNEL(void, couple, const float* S, Index h, Index r, const double* v, const double* y, double* slopes,
                 double* products);

}  // namespace dynamorph
