// SPDX-License-Identifier: GPL-3.0-or-later
// The loops that a step of eight characters spends its time in, beside those of modal_inertia: one character a lane.
// Symmetric matrices are packed upper triangles.
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

/// v in single precision and its pairs, both orders of a pair together.
DYNAMORPH_KERNEL(void, expand, const DoubleW* q, const DoubleW* centre, Index r, FloatW* v, FloatW* pairs);

/// linear += w K1 v and quadratic += w K2 (v v) of one target's table, as table_layout.hpp orders it.
DYNAMORPH_KERNEL(void, add_orders, const float* table, Index rows, Index r, const FloatW& w, const FloatW* v,
                 const FloatW* pairs, FloatW* product, FloatW* linear, FloatW* quadratic);

/// As contract_orders of polynomial_kernels.hpp; the tangent packed.
DYNAMORPH_KERNEL(void, contract, const DoubleW* constant, const FloatW* linear, const FloatW* quadratic,
                 const DoubleW* q, const DoubleW* centre, const DoubleW* rest_force, Index r, DoubleW* force,
                 DoubleW* tangent, DoubleW& energy);

/// Columns L D of L D L^T in place of the packed matrix, and D^-1; a lane whose matrix is not positive definite gets a
/// zero or negative entry there.
DYNAMORPH_KERNEL(void, factorize, DoubleW* V, Index r, DoubleW* inverse);

DYNAMORPH_KERNEL(void, substitute, const DoubleW* V, const DoubleW* inverse, Index r, DoubleW* x);

/// Of the given bones' transforms (B, 12).
DYNAMORPH_KERNEL(bool, all_finite, const double* transforms, const int* bones, Index count);

/// jump += of one bone's flesh by its moments, of an affine motion off its course (12 entries).
DYNAMORPH_KERNEL(void, add_jump, const DoubleW* now, const DoubleW* last, const DoubleW* before, const double* moments,
                 const double* centre, DoubleW& jump);

}  // namespace dynamorph
