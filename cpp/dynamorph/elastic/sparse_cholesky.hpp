// SPDX-License-Identifier: GPL-3.0-or-later
// Cholesky factors of stiffness matrices, which are symmetric and sparse, with three rows and columns per node of a tet
// mesh.
//
// Nodes are ordered by approximate minimum degree and gathered into supernodes, runs of columns with (nearly) the same
// rows below, so that nearly all arithmetic is on small dense matrices. The method is multifrontal (Duff & Reid 1983):
// each supernode adds up the update matrices of its children in the elimination tree, eliminates its own columns and
// leaves an update matrix for its parent.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Ordering and structure of the factor, the same for all matrices of one pattern.
struct SymbolicCholesky;

/// A = L L^T up to a permutation, with L in double or single precision. The factorization itself is always in double. A
/// single-precision factor solves to about 1e-6; as a preconditioner it is read in half the time. Solving is const and
/// may be done from several threads.
template <class Real>
class BlockCholesky {
 public:
  /// Reuses the structure found for another matrix, if that has the same pattern.
  explicit BlockCholesky(std::shared_ptr<const SymbolicCholesky> symbolic = nullptr) : symbolic_(std::move(symbolic)) {}

  /// A (3n, 3n), both triangles stored. Analyzes the pattern of its 3x3 blocks, and analyzes it again only when it
  /// changes. Returns false when A is not positive definite; then there is no factor to solve with.
  bool factorize(const SparseMatrix& A);
  const std::shared_ptr<const SymbolicCholesky>& symbolic() const { return symbolic_; }
  size_t size() const { return factor_.size(); }  ///< of the factor, which a solve reads twice
  double factorization_work() const;              ///< multiplications per factorization

  VectorXd solve(const VectorXd& b) const;
  /// Computes x = A^-1 b with the caller's scratch, so that nothing is allocated from the second call on. b may be x.
  void solve(const VectorXd& b, VectorXd& x, std::vector<Real>& scratch) const;
  /// Solves for all columns of X (3n, k), eight at a time, which is much faster than one by one, and more so where only
  /// a few rows of them are not zero.
  void solve_in_place(Eigen::Ref<MatrixXd> X) const;

  // The two halves of a solution, A^-1 = P^T L^-T L^-1 P.

  using Columns = Eigen::Matrix<Real, Eigen::Dynamic, Eigen::Dynamic>;
  /// y = L^-1 P b: its first 3n numbers, with room for `backward`.
  void forward(const VectorXd& b, std::vector<Real>& y) const;
  /// x = P^T L^-T y. Overwrites y.
  void backward(std::vector<Real>& y, VectorXd& x) const;
  /// L^-1 P X of all columns of X (3n, k), eight at a time.
  Columns forward(const MatrixXd& X) const;

 private:
  /// X: kSides numbers for each row of the matrix, in the factor's order.
  void forward_sides(Real* X) const;
  void backward_sides(Real* X) const;

  std::shared_ptr<const SymbolicCholesky> symbolic_;
  std::vector<Real> factor_;                      ///< the supernodes' columns, with 1 / L_ii on the diagonal
  std::vector<double> panel_, strips_, updates_;  ///< scratch of the factorization
};

extern template class BlockCholesky<float>;
extern template class BlockCholesky<double>;

}  // namespace dynamorph
