// SPDX-License-Identifier: GPL-3.0-or-later
// The Hessian of a step's potential, and what Newton's method does with it. It is the model's own matrix, to which most
// terms add, and stiffness at points of the skin, from terms that act there:
//
//   H = base + sum of J^T diag(d) J,  d >= 0
//
// Few rows J in a full or an arrow matrix would fill all of it, so they are kept apart (sparse_solver.hpp,
// arrow_matrix.hpp).
#pragma once

#include <type_traits>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/sparse_solver.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"

namespace dynamorph {

/// Rows J and their stiffness d, beside such a matrix.
template <class Matrix>
using PointStiffness = std::conditional_t<std::is_same_v<Matrix, SparseMatrix>, SparsePoints, DensePoints>;

/// Matrix: SparseMatrix or ArrowMatrix, of the size and pattern of the model's.
template <class Matrix>
struct Hessian {
  Matrix base;
  std::vector<const PointStiffness<Matrix>*> points;
};

/// Whether there is anything that points add.
inline bool acts(const SparsePoints& points) { return points.stiffness.size() > 0; }
inline bool acts(const DensePoints& points) { return points.stiffness.size() > 0 || points.own_rows.cols() > 0; }

/// Of rows over the coordinates, which others may follow in x and y.
inline void multiply(const RowMajor& J, const VectorXd& x, VectorXd& out) { out.noalias() = J * x.head(J.cols()); }
inline void add_transposed_product(const RowMajor& J, const VectorXd& f, VectorXd& y) {
  y.head(J.cols()).noalias() += J.transpose() * f;
}

inline void multiply(const SparseMatrix& A, const VectorXd& x, VectorXd& y) { y.noalias() = A * x; }
inline void multiply(const ArrowMatrix& A, const VectorXd& x, VectorXd& y) { A.multiply(x, y); }

inline void add_to_diagonal(SparseMatrix& A, double factor, const VectorXd& values) { A.diagonal() += factor * values; }
inline void add_to_diagonal(ArrowMatrix& A, double factor, const VectorXd& values) {
  A.add_to_diagonal(factor, values);
}

/// Magnitudes of the entries of A's diagonal, none below 1e-6 of the largest. For a mesh, the three entries of a node
/// are averaged, so that they do not depend on the axes.
template <class Matrix>
void diagonal_scales(const Matrix& A, VectorXd& out) {
  constexpr double kSmallest = 1e-6;
  out = A.diagonal().cwiseAbs();
  if constexpr (std::is_same_v<Matrix, SparseMatrix>)
    for (Eigen::Index i = 0; i < out.size(); i += 3) out.segment<3>(i).setConstant(out.segment<3>(i).mean());
  out = out.cwiseMax(kSmallest * out.maxCoeff());
}

/// Solves H x = b, with the unknowns that points have of their own after those of the base.
template <class Matrix>
class HessianSolver {
 public:
  /// Returns false when H is not positive definite.
  bool solve(const Hessian<Matrix>& H, const VectorXd& b, VectorXd& x) { return solver_.solve(H.base, H.points, b, x); }

  /// Makes the next result independent of earlier ones.
  void forget() {
    if constexpr (std::is_same_v<Matrix, SparseMatrix>) solver_.forget();
  }

 private:
  std::conditional_t<std::is_same_v<Matrix, SparseMatrix>, SparseSolver, ArrowSolver> solver_;
};

}  // namespace dynamorph
