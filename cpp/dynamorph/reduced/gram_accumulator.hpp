// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// C = sum a^T b over rows a (m) and b (n), collected in batches so that it is summed at the speed of a matrix product.
class GramAccumulator {
 public:
  /// Of one kind of row, a = b (n): of C, which is symmetric, the upper triangle.
  explicit GramAccumulator(Eigen::Index n);
  /// Of row i of C, the columns from `first(i)` on, which must not decrease with i.
  GramAccumulator(Eigen::Index m, Eigen::Index n, const std::function<Eigen::Index(Eigen::Index)>& first);

  void add(const double* row);
  void add(const double* a, const double* b);
  /// To be called before C is read.
  void finish();
  double operator()(Eigen::Index i, Eigen::Index j) const;

 private:
  std::vector<Eigen::Index> first_;  ///< column of tiles that each row of tiles starts with
  std::vector<Eigen::Index> start_;  ///< of each row of tiles in tiles_, in tiles
  Eigen::Index m_, n_, filled_ = 0;
  std::vector<double> a_, b_;  ///< the batch in panels: tiles' columns of each row, row after row; a_ is empty if a = b
  std::vector<double> tiles_;  ///< row after row of those kept, each row-major
};

}  // namespace dynamorph
