// SPDX-License-Identifier: GPL-3.0-or-later
// The matrices of a reduced model: few tabulated modes (r), which all act on each other, and many responses (h), each
// of which acts on itself and on the modes alone.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/dense_factor.hpp"

namespace dynamorph {

/// The symmetric matrix [A B^T; B diag(d)] with the corner A (r, r), the border B (h, r) and d (h). Without responses,
/// h = 0, it is the dense matrix A.
class ArrowMatrix {
 public:
  using Index = Eigen::Index;

  ArrowMatrix() = default;
  /// Zero.
  ArrowMatrix(Index r, Index h) : r_(r), h_(h), entries_(VectorXd::Zero(r * r + h * r + h)) {}

  Index rows() const { return r_ + h_; }
  Index corner_size() const { return r_; }
  bool fits(Index r, Index rows) const { return r_ == r && this->rows() == rows; }
  Eigen::Map<MatrixXd> corner() { return {entries_.data(), r_, r_}; }
  Eigen::Map<const MatrixXd> corner() const { return {entries_.data(), r_, r_}; }
  Eigen::Map<MatrixXd> border() { return {entries_.data() + r_ * r_, h_, r_}; }
  Eigen::Map<const MatrixXd> border() const { return {entries_.data() + r_ * r_, h_, r_}; }
  Eigen::Map<VectorXd> rest() { return {entries_.data() + r_ * r_ + h_ * r_, h_}; }  ///< d
  Eigen::Map<const VectorXd> rest() const { return {entries_.data() + r_ * r_ + h_ * r_, h_}; }

  VectorXd diagonal() const;
  void add_to_diagonal(double factor, const VectorXd& values);
  void multiply(const VectorXd& x, VectorXd& y) const;
  MatrixXd dense() const;
  void dense(MatrixXd& out) const;

  friend Eigen::Map<VectorXd> values(ArrowMatrix& m) { return {m.entries_.data(), m.entries_.size()}; }
  friend Eigen::Map<const VectorXd> values(const ArrowMatrix& m) { return {m.entries_.data(), m.entries_.size()}; }

 private:
  Index r_ = 0, h_ = 0;
  VectorXd entries_;  ///< the corner and the border column by column, then d
};

/// Solves H x = b by the Schur complement A - B^T diag(d)^-1 B. Allocates only when the size changes.
class ArrowFactor {
 public:
  bool compute(const ArrowMatrix& H);  ///< returns false when H is not positive definite
  void solve(const VectorXd& b, VectorXd& x);

 private:
  const ArrowMatrix* H_ = nullptr;
  VectorXd inverse_, corner_, rest_, solved_;  ///< 1 / d, and scratch
  MatrixXd schur_;                             ///< its lower triangle
  DenseFactor factor_;
};

/// Stiffness at points beside an arrow matrix: J^T diag(d) J with d >= 0. The first points may also give way by
/// unknowns a of their own, which have a stiffness C = L L^T as well: [J R]^T diag(d) [J R], and C over a.
struct DensePoints {
  RowMajor rows;        ///< J (k, rows of the matrix)
  VectorXd stiffness;   ///< d (k)
  RowMajor own_rows;    ///< R (p, m) of the first p <= k points, whose d > 0
  MatrixXd own_factor;  ///< L (m, m)
};

/// Solves (H + that of the points) x = b, where x are the unknowns of H, and then those that points have of their own:
/// these are eliminated. With few rows it uses H's own factor (Woodbury), with many that of the whole dense matrix,
/// whichever takes less arithmetic. Allocates only when the sizes grow.
class ArrowSolver {
 public:
  /// Returns false when the sum is not positive definite.
  bool solve(const ArrowMatrix& H, const std::vector<const DensePoints*>& points, const VectorXd& b, VectorXd& x);

 private:
  /// Points without their own unknowns: S^-1 J with a stiffness of one each, where S S^T = diag(d)^-1 + R C^-1 R^T.
  struct Softened {
    MatrixXd lower;          ///< S
    VectorXd forces;         ///< S^-1 R C^-1 b_a
    Eigen::Index first_row;  ///< of them in rows_
  };

  bool gather(const std::vector<const DensePoints*>& points, Eigen::Index size, const VectorXd& b);
  bool soften(const DensePoints& points, const Eigen::Ref<const VectorXd>& own_b, Eigen::Index first_row);
  bool solve_reduced(const ArrowMatrix& H, VectorXd& x);
  void solve_own(const std::vector<const DensePoints*>& points, const VectorXd& b, VectorXd& x) const;
  bool solve_by_rows(const ArrowMatrix& H, const VectorXd& b, VectorXd& x);
  bool solve_dense(const ArrowMatrix& H, const VectorXd& b, VectorXd& x);

  ArrowFactor arrow_;
  RowMajor rows_;  ///< those with a stiffness
  VectorXd stiffness_, reduced_b_, reduced_x_;
  std::vector<Softened> softened_;    ///< of those that have unknowns of their own
  MatrixXd answers_, small_, dense_;  ///< H^-1 J^T, d^-1 + J H^-1 J^T, H + J^T d J
  VectorXd one_, right_, forces_;
  DenseFactor factor_;
};

}  // namespace dynamorph
