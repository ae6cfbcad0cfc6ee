// SPDX-License-Identifier: GPL-3.0-or-later
// The loops that the reduced polynomials' tables are summed by. Compiled for several instruction sets, as kernels.hpp.
#pragma once

#include "dynamorph/types.hpp"

namespace dynamorph {

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

}  // namespace dynamorph
