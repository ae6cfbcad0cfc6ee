// SPDX-License-Identifier: GPL-3.0-or-later
// The loops that a step of eight characters spends its time in, beside those of modal_inertia: one character a lane.
// Symmetric matrices are packed upper triangles.
#pragma once

#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// y += a x.
DYNAMORPH_KERNEL(void, add_scaled, const Doubles& a, const double* x, Index size, Doubles* y);

/// damping += damped; H = inertial mass + rate damping.
DYNAMORPH_KERNEL(void, add_up, const Doubles* mass, const Doubles* damped, double inertial, double rate, Index size,
                 Doubles* damping, Doubles* H);

/// y = S x, S packed.
DYNAMORPH_KERNEL(void, packed_product, const Doubles* S, const Doubles* x, Index r, Doubles* y);

DYNAMORPH_KERNEL(void, dot, const Doubles* a, const Doubles* b, Index size, Doubles& out);

/// v in single precision and its pairs, both orders of a pair together.
DYNAMORPH_KERNEL(void, expand, const Doubles* q, const Doubles* centre, Index r, Floats* v, Floats* pairs);

/// linear += w K1 v and quadratic += w K2 (v v) of one target's table, as table_layout.hpp orders it.
DYNAMORPH_KERNEL(void, add_orders, const float* table, Index rows, Index r, const Floats& w, const Floats* v,
                 const Floats* pairs, Floats* product, Floats* linear, Floats* quadratic);

/// As contract_orders of polynomial_kernels.hpp; the tangent packed.
DYNAMORPH_KERNEL(void, contract, const Doubles* constant, const Floats* linear, const Floats* quadratic,
                 const Doubles* q, const Doubles* centre, const Doubles* rest_force, Index r, Doubles* force,
                 Doubles* tangent, Doubles& energy);

/// Columns L D of L D L^T in place of the packed matrix, and D^-1; a lane whose matrix is not positive definite gets a
/// zero or negative entry there.
DYNAMORPH_KERNEL(void, factorize, Doubles* V, Index r, Doubles* inverse);

DYNAMORPH_KERNEL(void, substitute, const Doubles* V, const Doubles* inverse, Index r, Doubles* x);

/// Of the given bones' transforms (B, 12).
DYNAMORPH_KERNEL(bool, all_finite, const double* transforms, const int* bones, Index count);

/// jump += of one bone's flesh by its moments, of an affine motion off its course (12 entries).
DYNAMORPH_KERNEL(void, add_jump, const Doubles* now, const Doubles* last, const Doubles* before, const double* moments,
                 const double* centre, Doubles& jump);

}  // namespace dynamorph
