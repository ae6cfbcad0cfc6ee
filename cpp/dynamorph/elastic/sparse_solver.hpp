// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/elastic/sparse_rows.hpp"

namespace dynamorph {

/// y = H x for a symmetric H of whole 3x3 blocks, both triangles stored, as FullModel makes them. y must not be x.
void multiply_symmetric(const SparseMatrix& H, const VectorXd& x, VectorXd& y);

/// Solves H x = b for tangents (of whole 3x3 blocks) that change little from one to the next. Factoring is by far the
/// most work, so the solver uses conjugate gradients, preconditioned with the single-precision factor of an earlier
/// tangent. If they meet no negative curvature, their result is a descent direction even if H is indefinite.
///
/// The solver factors again once a solve costs more than the solves since the last factorization did on average, with
/// that factorization counted in. This is the least work in the long run. The solver counts work instead of measuring
/// time, so that results can be reproduced.
///
/// Stiffness at points beside H acts exactly in the conjugate gradients. The factor has its majorant on H's pattern,
/// which is the same for points that touch one tet each.
class SparseSolver {
 public:
  /// Solves (H + the points' J^T diag(d) J) x = b. Returns false when that is not positive definite.
  bool solve(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b, VectorXd& x);
  /// Factors again at the next solve, so that results do not depend on what was solved before.
  void forget() { fit_ = false; }

 private:
  /// Whether x meets the accuracy after at most `most` iterations. Also returns false at negative curvature.
  bool iterate(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b, VectorXd& x,
               int most);

  BlockCholesky<float> factor_;
  SparseMatrix majorized_;  ///< H with the majorant of points
  bool fit_ = false;        ///< the factor exists and is worth keeping
  int solves_ = 0;          ///< with this factor
  int iterations_ = 0;      ///< in these solves
  int factoring_ = 0;       ///< iterations that cost as much as a factorization
  VectorXd residual_, preconditioned_, d_, Hd_;
  std::vector<float> scratch_;
};

}  // namespace dynamorph
