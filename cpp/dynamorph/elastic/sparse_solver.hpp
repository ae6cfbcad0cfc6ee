// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/Cholesky>
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
/// Stiffness at points beside H acts exactly in the conjugate gradients. Few rows J do in the preconditioner, too: with
/// the factor L of H alone and W = L^-1 J^T (Woodbury),
///
///   (L L^T + J^T D J)^-1 = L^-T (1 - W (D^-1 + W^T W)^-1 W^T) L^-1.
///
/// Of many, whose W would be costly, the factor has the majorant on H's pattern.
class SparseSolver {
 public:
  /// Solves (H + the points' J^T diag(d) J) x = b. Returns false when that is not positive definite.
  bool solve(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b, VectorXd& x);
  /// Factors again at the next solve, so that results do not depend on what was solved before.
  void forget() { fit_ = false; }

 private:
  /// Makes the preconditioner know the points beside its factor. size: 3n; rows: their number; 0: it does not.
  void set_apart(const std::vector<const SparsePoints*>& points, Eigen::Index size, Eigen::Index rows);
  void precondition();  ///< what is left, as far as the factor and those points know
  /// Whether x meets the accuracy after at most `most` iterations. Also returns false at negative curvature.
  bool iterate(const SparseMatrix& H, const std::vector<const SparsePoints*>& points, const VectorXd& b, VectorXd& x,
               int most);

  BlockCholesky<float> factor_;
  SparseMatrix majorized_;            ///< H with the majorant of points
  bool fit_ = false;                  ///< the factor exists and is worth keeping
  bool has_points_ = false;           ///< it has the majorant of points
  std::vector<int> reached_;          ///< rows of W (3n, k) that are not zero, in the factor's order
  RowMajor W_;                        ///< those; no columns where the points are in the factor
  Eigen::LLT<MatrixXd> capacitance_;  ///< D^-1 + W^T W
  VectorXd pushed_;                   ///< W^T L^-1 r (k)
  int solves_ = 0;                    ///< with this factor
  int iterations_ = 0;                ///< in these solves
  int factoring_ = 0;                 ///< iterations that cost as much as a factorization
  VectorXd residual_, preconditioned_, d_, Hd_;
  std::vector<float> half_;
};

}  // namespace dynamorph
