// SPDX-License-Identifier: GPL-3.0-or-later
// The hot loops of a step of eight characters, besides those of modal_inertia. Each lane is one character. Symmetric
// matrices are packed upper triangles.
#pragma once

#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// y += a x.
DYNAMORPH_KERNEL(void, add_scaled, const DoubleW& a, const double* x, Index size, DoubleW* y);

/// damping += damped; H = inertial mass + rate damping.
DYNAMORPH_KERNEL(void, add_up, const DoubleW* mass, const DoubleW* damped, double inertial, double rate, Index size,
                 DoubleW* damping, DoubleW* H);

/// y = S x, S packed.
DYNAMORPH_KERNEL(void, packed_product, const DoubleW* S, const DoubleW* x, Index r, DoubleW* y);

DYNAMORPH_KERNEL(void, dot, const DoubleW* a, const DoubleW* b, Index size, DoubleW& out);

/// v = q - centre in single precision, and the products of its pairs, with both orders of a pair together.
DYNAMORPH_KERNEL(void, expand, const DoubleW* q, const DoubleW* centre, Index r, FloatW* v, FloatW* pairs);

/// linear += w K1 v and quadratic += w K2 (v v) for one target's table, in the order of table_layout.hpp.
DYNAMORPH_KERNEL(void, add_orders, const float* table, Index rows, Index r, const FloatW& w, const FloatW* v,
                 const FloatW* pairs, FloatW* product, FloatW* linear, FloatW* quadratic);

/// Like contract_orders of polynomial_kernels.hpp, with a packed tangent.
DYNAMORPH_KERNEL(void, contract, const DoubleW* constant, const FloatW* linear, const FloatW* quadratic,
                 const DoubleW* q, const DoubleW* centre, const DoubleW* rest_force, Index r, DoubleW* force,
                 DoubleW* tangent, DoubleW& energy);

/// Replaces the packed matrix by the columns L D of L D L^T, and computes D^-1. In a lane where the matrix is not
/// positive definite, D^-1 gets an entry that is not positive and finite.
DYNAMORPH_KERNEL(void, factorize, DoubleW* V, Index r, DoubleW* inverse);

DYNAMORPH_KERNEL(void, substitute, const DoubleW* V, const DoubleW* inverse, Index r, DoubleW* x);

/// Whether the given bones' transforms (B, 12) are all finite.
DYNAMORPH_KERNEL(bool, all_finite, const double* transforms, const int* bones, Index count);

/// Adds to `jump` how far one bone's soft tissue is off its course: the squared distance, integrated by the bone's
/// moments. The motions are affine (12 entries).
DYNAMORPH_KERNEL(void, add_jump, const DoubleW* now, const DoubleW* last, const DoubleW* before, const double* moments,
                 const double* centre, DoubleW& jump);

}  // namespace dynamorph
