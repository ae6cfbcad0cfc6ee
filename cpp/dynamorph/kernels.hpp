// SPDX-License-Identifier: GPL-3.0-or-later
// The few loops a reduced step spends its time in. Compiled for several instruction sets and chosen when loaded, so
// that a wheel built for any x86-64 uses AVX2 where the machine has it. Matrices are column-major unless said.
#pragma once

#include "dynamorph/types.hpp"

namespace dynamorph {

/// y += A x, A (rows, columns).
void add_product(const double* A, Eigen::Index rows, const double* x, Eigen::Index columns, double* y);

/// y += A x with A in single precision, summed in double.
void add_product(const float* A, Eigen::Index rows, const double* x, Eigen::Index columns, double* y);

/// y += A x, A symmetric (size, size), its lower triangle packed column after column.
void add_symmetric_product(const double* A, Eigen::Index size, const double* x, double* y);

/// Rows and columns of the sums below are padded to whole tiles.
constexpr Eigen::Index kTile = 12;
inline Eigen::Index padded(Eigen::Index size) { return (size + kTile - 1) / kTile * kTile; }

/// C += A^T B, all row-major: A (depth, m), B (depth, n), C (padded m, padded n). Of a symmetric product (A = B) only
/// the upper triangle is promised.
void add_transposed_product(const double* A, Eigen::Index m, const double* B, Eigen::Index n, Eigen::Index depth,
                            bool symmetric, double* C);

/// The part of Green's strain that is quadratic in the modes: for the pairs of mode k with l = k..r-1,
///   strain[c][l - k] = six(sym(G_k^T G_l))_c, trace[l - k] = G_k : G_l;
/// gradients (9, r) row-major, entry 3 j + i of a column is G(i, j); rows of strain are `stride` apart, or strain is
/// null.
void strain_of_pairs(const double* gradients, Eigen::Index r, Eigen::Index k, double* trace, double* strain,
                     Eigen::Index stride);

/// The bilinear part of the cofactor: column l - k of cross (9 rows, `stride` apart) is G_k x G_l, tensor cross
/// product.
void crosses_of_pairs(const double* gradients, Eigen::Index r, Eigen::Index k, double* cross, Eigen::Index stride);

/// y = A^T x.
void transposed_product(const MatrixXd& A, const double* x, double* y);

}  // namespace dynamorph
