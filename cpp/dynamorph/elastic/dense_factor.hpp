// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Factor L D L^T of a small symmetric matrix. Allocates only when the size changes.
class DenseFactor {
 public:
  bool compute(const MatrixXd& H);  ///< returns false when H (n, n) is not positive definite
  void solve(const VectorXd& b, VectorXd& x);

 private:
  MatrixXd columns_;  ///< L D below the diagonal, rows padded to whole vectors
  VectorXd inverse_, padded_;
};

}  // namespace dynamorph
