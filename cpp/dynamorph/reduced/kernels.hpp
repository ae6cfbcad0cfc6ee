// SPDX-License-Identifier: GPL-3.0-or-later
// The loops that a reduced step spends its time in, beside those of modal_inertia.
#pragma once

#include "dynamorph/core/types.hpp"
#include "dynamorph/reduced/table_layout.hpp"

namespace dynamorph {

/// y += A x, A (rows, columns) column-major. Single precision is summed in double.
void add_product(const double* A, Eigen::Index rows, const double* x, Eigen::Index columns, double* y);
void add_product(const float* A, Eigen::Index rows, const double* x, Eigen::Index columns, double* y);

/// y += A x, A symmetric, stored by symmetric_index in an array aligned to 32 bytes, summed in double.
void add_symmetric_product(const float* A, Eigen::Index size, const double* x, double* y);

/// y = A^T x.
void transposed_product(const MatrixXd& A, const double* x, double* y);

/// From the packed orders K0, K1 v and K2 (v v) of a tangent (polynomials.hpp): returns the energy, writes the force
/// (r) and the tangent itself (r, r).
double contract_orders(const double* constant, const double* linear, const double* quadratic, const double* v,
                       Eigen::Index r, double* force, double* stiffness);

/// out = sum_k weights[k] tables[k], each (size).
void blend_tables(const float* const* tables, const double* weights, int count, Eigen::Index size, float* out);

}  // namespace dynamorph
