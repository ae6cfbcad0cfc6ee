// SPDX-License-Identifier: GPL-3.0-or-later
// The Hessian of a step's potential, with the matrix of a model, and what Newton's method does with it.
#pragma once

#include <type_traits>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/sparse_solver.hpp"
#include "dynamorph/reduced/arrow_matrix.hpp"

namespace dynamorph {

/// Matrix: SparseMatrix or ArrowMatrix, of the size and pattern of the model's.
template <class Matrix>
struct Hessian {
  Matrix base;
};

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

/// Solves H x = b.
template <class Matrix>
class HessianSolver {
 public:
  /// Returns false when H is not positive definite.
  bool solve(const Hessian<Matrix>& H, const VectorXd& b, VectorXd& x) {
    if constexpr (kSparse) {
      return factor_.solve(H.base, b, x);
    } else {
      if (!factor_.compute(H.base)) return false;
      factor_.solve(b, x);
      return true;
    }
  }

  /// Makes the next result independent of earlier ones.
  void forget() {
    if constexpr (kSparse) factor_.forget();
  }

 private:
  static constexpr bool kSparse = std::is_same_v<Matrix, SparseMatrix>;
  std::conditional_t<kSparse, SparseSolver, ArrowFactor> factor_;
};

}  // namespace dynamorph
