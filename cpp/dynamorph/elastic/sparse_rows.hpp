// SPDX-License-Identifier: GPL-3.0-or-later
// Stiffness at points of a mesh, beside that of the mesh itself: J^T diag(d) J with few rows.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Rows of J (k, 3n) over the nodes of a mesh. Each is a sum of parts, and each part touches the nodes of one tet
/// alone, so that its square has a place in the mesh's own stiffness.
struct SparseRows {
  Eigen::SparseMatrix<double, Eigen::RowMajor> parts;  ///< (parts, 3n)
  std::vector<int> ends;                               ///< (k) one past the last part of each row

  Eigen::Index rows() const { return Eigen::Index(ends.size()); }
  int first(Eigen::Index row) const { return row == 0 ? 0 : ends[row - 1]; }
  /// The dot product of a row with x (3n).
  double dot(Eigen::Index row, const VectorXd& x) const;
  /// y += factor times a row.
  void add(Eigen::Index row, double factor, Eigen::Ref<VectorXd> y) const;
};

/// Rows and their stiffness d >= 0 (k), N/m for rows without a unit.
struct SparsePoints {
  SparseRows rows;
  VectorXd stiffness;
};

/// out = J x (k).
void multiply(const SparseRows& J, const VectorXd& x, VectorXd& out);
/// y += J^T f (3n).
void add_transposed_product(const SparseRows& J, const VectorXd& f, VectorXd& y);

/// y += J^T diag(d) J x.
void add_stiffness_product(const SparsePoints& points, const VectorXd& x, VectorXd& y);

/// Adds a matrix of A's own pattern that is at least J^T diag(d) J, and is just that for rows of one part: with parts
/// a_m and weights t_m that sum to one,
///
///   (sum_m a_m) (sum_m a_m)^T <= sum_m a_m a_m^T / t_m      (Cauchy-Schwarz),
///
/// here with t_m in proportion to the norms of the parts, which makes the trace of the right side least.
void add_majorant(const SparsePoints& points, SparseMatrix& A);

}  // namespace dynamorph
