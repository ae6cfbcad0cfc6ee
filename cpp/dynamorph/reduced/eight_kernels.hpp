// SPDX-License-Identifier: GPL-3.0-or-later
// The loops that a step of eight characters spends its time in, beside those of modal_inertia: one character a lane.
// Symmetric matrices are packed upper triangles.
#pragma once

#include "dynamorph/core/types.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// y += a x.
void add_scaled(const Doubles& a, const double* x, Eigen::Index size, Doubles* y);

/// damping += damped; H = inertial mass + rate damping.
void add_up(const Doubles* mass, const Doubles* damped, double inertial, double rate, Eigen::Index size,
            Doubles* damping, Doubles* H);

/// y = S x, S packed.
void packed_product(const Doubles* S, const Doubles* x, Eigen::Index r, Doubles* y);

void dot(const Doubles* a, const Doubles* b, Eigen::Index size, Doubles& out);

/// v in single precision and its pairs, both orders of a pair together.
void expand(const Doubles* q, const Doubles* centre, Eigen::Index r, Floats* v, Floats* pairs);

/// linear += w K1 v and quadratic += w K2 (v v) of one target's table, as table_layout.hpp orders it.
void add_orders(const float* table, Eigen::Index rows, Eigen::Index r, const Floats& w, const Floats* v,
                const Floats* pairs, Floats* product, Floats* linear, Floats* quadratic);

/// As contract_orders of kernels.hpp; the tangent packed.
void contract(const Doubles* constant, const Floats* linear, const Floats* quadratic, const Doubles* q,
              const Doubles* centre, const Doubles* rest_force, Eigen::Index r, Doubles* force, Doubles* tangent,
              Doubles& energy);

/// Columns L D of L D L^T in place of the packed matrix, and D^-1; a lane whose matrix is not positive definite gets a
/// zero or negative entry there.
void factorize(Doubles* V, Eigen::Index r, Doubles* inverse);

void substitute(const Doubles* V, const Doubles* inverse, Eigen::Index r, Doubles* x);

/// Of the given bones' transforms (B, 12).
bool all_finite(const double* transforms, const int* bones, Eigen::Index count);

/// jump += of one bone's flesh by its moments, of an affine motion off its course (12 entries).
void add_jump(const Doubles* now, const Doubles* last, const Doubles* before, const double* moments,
              const Vector3d& centre, Doubles& jump);

}  // namespace dynamorph
