// SPDX-License-Identifier: GPL-3.0-or-later
// Cholesky factors of stiffness matrices: symmetric, sparse, three rows and columns to each node of a tet mesh.
//
// Nodes are ordered by approximate minimum degree and gathered into supernodes, runs of columns with (nearly) the same
// rows below, so that nearly all arithmetic is on small dense matrices. Multifrontal (Duff & Reid 1983): each supernode
// adds up what its children in the elimination tree leave for it, eliminates its own columns and leaves an update
// matrix for its parent.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Ordering and structure of the factor, the same for all matrices of one pattern.
struct SymbolicCholesky;

/// A = L L^T up to a permutation, L in double or single precision (the factorisation itself is always in double, so a
/// single factor solves to about 1e-6 and is a preconditioner that is read in half the time). Solving is const and may
/// be done from several threads.
template <class Real>
class BlockCholesky {
 public:
  /// Takes over the structure found for another matrix, where there is one with the same pattern.
  explicit BlockCholesky(std::shared_ptr<const SymbolicCholesky> symbolic = nullptr) : symbolic_(std::move(symbolic)) {}

  /// A (3n, 3n), both triangles stored; what is analysed is the pattern of its 3x3 blocks, and again only when the
  /// pattern changes. False when A is not positive definite, after which there is nothing to solve with.
  bool factorize(const SparseMatrix& A);
  const std::shared_ptr<const SymbolicCholesky>& symbolic() const { return symbolic_; }
  size_t size() const { return factor_.size(); }  ///< of the factor, which a solve reads twice
  double factorization_work() const;              ///< multiplications of a factorisation

  VectorXd solve(const VectorXd& b) const;
  /// x = A^-1 b with the caller's scratch, so that nothing is allocated from the second call on. b may be x.
  void solve(const VectorXd& b, VectorXd& x, std::vector<Real>& scratch) const;
  /// All columns of X (3n, k), eight at a time: much faster than one by one.
  void solve_in_place(Eigen::Ref<MatrixXd> X) const;

 private:
  std::shared_ptr<const SymbolicCholesky> symbolic_;
  std::vector<Real> factor_;                      ///< the supernodes' columns, with 1 / L_ii on the diagonal
  std::vector<double> panel_, strips_, updates_;  ///< scratch of the factorisation
};

extern template class BlockCholesky<float>;
extern template class BlockCholesky<double>;

}  // namespace dynamorph
