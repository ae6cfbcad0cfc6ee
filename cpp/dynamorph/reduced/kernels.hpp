// SPDX-License-Identifier: GPL-3.0-or-later
// The loops that a reduced step spends its time in, beside those of modal_inertia.
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

constexpr Eigen::Index kChunk = 8;
inline Eigen::Index whole_chunks(Eigen::Index size) { return (size + kChunk - 1) / kChunk * kChunk; }

/// Rows of the columns that DenseFactor works in.
inline Eigen::Index whole_vectors(Eigen::Index size) { return (size + 3) / 4 * 4; }

/// Of a symmetric matrix (size, size), size a whole number of chunks: what add_symmetric_product reads.
inline Eigen::Index symmetric_size(Eigen::Index size) { return size * (size + kChunk) / 2; }

/// Where entry (row, column), row not in an earlier chunk than column, lies there: panels of four columns, each from
/// the chunk of rows that holds the diagonal down; chunk after chunk, column after column. Diagonal chunks are whole.
inline Eigen::Index symmetric_index(Eigen::Index size, Eigen::Index row, Eigen::Index column) {
  const Eigen::Index c = column / kChunk, below = size - kChunk * c;
  const Eigen::Index panels = kChunk * c * size - kChunk * kChunk * c * (c - 1) / 2 + 4 * below * (column % kChunk / 4);
  return panels + 4 * kChunk * (row / kChunk - c) + kChunk * (column % 4) + row % kChunk;
}

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

/// Factor L D L^T of a small symmetric matrix. Allocates only when the size changes.
class DenseFactor {
 public:
  bool compute(const MatrixXd& H);  ///< false when H (n, n) is not positive definite
  void solve(const VectorXd& b, VectorXd& x);

 private:
  MatrixXd columns_;  ///< L D below the diagonal, rows padded to whole vectors
  VectorXd inverse_, padded_;
};

}  // namespace dynamorph
