// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// C = sum a^T b over rows a (m) and b (n), collected in batches so that it is summed at the speed of a matrix product.
class GramAccumulator {
 public:
  /// For rows a = b (n). C is symmetric, and only its upper triangle is summed.
  explicit GramAccumulator(Eigen::Index n);
  /// For each row i of C, sums only the columns from `first(i)` on. `first` must not decrease with i.
  GramAccumulator(Eigen::Index m, Eigen::Index n, const std::function<Eigen::Index(Eigen::Index)>& first);

  void add(const double* row);
  void add(const double* a, const double* b);
  /// Call this before reading C.
  void finish();
  double operator()(Eigen::Index i, Eigen::Index j) const;

 private:
  std::vector<Eigen::Index> first_;  ///< first column of tiles in each row of tiles
  std::vector<Eigen::Index> start_;  ///< place of each row of tiles in tiles_, in tiles
  Eigen::Index m_, n_, filled_ = 0;
  std::vector<double> a_, b_;  ///< the batch in panels of kTile columns, row after row; a_ is empty if a = b
  std::vector<double> tiles_;  ///< those kept, row after row, each row-major
};

// Products on all cores, several times as fast as Eigen's, which does not know this machine's widest vectors.

/// The lower triangle of A^T A.
MatrixXd gram(const RowMajor& A);
/// A^T B.
MatrixXd inner_products(const RowMajor& A, const RowMajor& B);
/// A B, of many rows and few columns.
RowMajor product(const RowMajor& A, const RowMajor& B);

}  // namespace dynamorph
