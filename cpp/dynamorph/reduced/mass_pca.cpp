// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/mass_pca.hpp"

#include <Spectra/SymEigsSolver.h>

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <random>
#include <stdexcept>

#include "dynamorph/reduced/gram_accumulator.hpp"

namespace dynamorph {

namespace {

/// x -> A^T A x, which Spectra iterates with.
class GramOperator {
 public:
  using Scalar = double;
  explicit GramOperator(const SparseMatrix& A) : A_(A) {}
  Eigen::Index rows() const { return A_.cols(); }
  Eigen::Index cols() const { return A_.cols(); }
  void perform_op(const double* x, double* y) const {
    const VectorXd image = A_ * Eigen::Map<const VectorXd>(x, cols());
    Eigen::Map<VectorXd>(y, rows()) = A_.transpose() * image;
  }

 private:
  const SparseMatrix& A_;
};

/// Orthonormal combinations of columns with the eigenvectors of their Gram matrix, strongest first, as long as they are
/// strong.
MatrixXd strong_only(const SparseMatrix& A, const MatrixXd& combinations) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(RowMajor(A * combinations)));
  const Eigen::Index strong = (eigen.eigenvalues().array() > 1e-14 * A.squaredNorm()).count();
  return combinations * eigen.eigenvectors().rightCols(strong).rowwise().reverse();
}

/// Orthonormal combinations (columns, `count`) that include the strongest, the better the more steps; all of them, if
/// there are no more than `count`. Halko, Martinsson and Tropp, SIAM Review 53 (2011), algorithm 4.4.
MatrixXd random_combinations(const SparseMatrix& A, Eigen::Index count, int steps) {
  std::mt19937 random(1);
  MatrixXd Q(A.cols(), count);
  for (double& number : Q.reshaped()) number = double(random()) / (1u << 31) - 1;
  for (int step = 0; step < steps; ++step) {
    const MatrixXd image = A * Q;
    Q = A.transpose() * image;
    Q = Eigen::HouseholderQR<MatrixXd>(Q).householderQ() * MatrixXd::Identity(A.cols(), count);
  }
  return Q;
}

}  // namespace

MatrixXd gram(const RowMajor& A) {
  GramAccumulator products(A.cols());
  for (Eigen::Index i = 0; i < A.rows(); ++i) products.add(A.row(i).data());
  products.finish();
  MatrixXd out(A.cols(), A.cols());
  for (Eigen::Index j = 0; j < A.cols(); ++j)
    for (Eigen::Index i = j; i < A.cols(); ++i) out(i, j) = products(j, i);
  return out;
}

MatrixXd orthonormal(const MatrixXd& columns) {
  MatrixXd unit = columns;
  for (Eigen::Index c = 0; c < unit.cols(); ++c)
    if (unit.col(c).norm() > 0) unit.col(c).normalize();
  const Eigen::JacobiSVD<MatrixXd, Eigen::HouseholderQRPreconditioner> svd(unit, Eigen::ComputeThinU);
  const Eigen::Index rank = (svd.singularValues().array() > 1e-9).count();
  return svd.matrixU().leftCols(rank);
}

MatrixXd strongest(const RowMajor& columns, Eigen::Index most) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(columns));
  const VectorXd& squares = eigen.eigenvalues();
  const Eigen::Index strong = (squares.array() > 1e-14 * squares.maxCoeff()).count();
  return columns * eigen.eigenvectors().rightCols(std::min(most, strong)).rowwise().reverse();
}

MatrixXd strongest_combinations(const SparseMatrix& A, Eigen::Index most) {
  const Eigen::Index k = std::min({most, A.rows(), A.cols() - 1}), search = std::min(A.cols(), 2 * k + 20);
  // An iteration from one vector, as Spectra's, breaks down where there are few combinations, and finds one of several
  // that are equally strong.
  const MatrixXd all = strong_only(A, random_combinations(A, search, 1));
  if (all.cols() < search) return all.leftCols(std::min(k, all.cols()));
  MatrixXd found(A.cols(), 0);
  try {
    GramOperator op(A);
    Spectra::SymEigsSolver<GramOperator> solver(op, k, search);
    solver.init();
    solver.compute(Spectra::SortRule::LargestAlge, 1000, 1e-10);
    if (solver.info() == Spectra::CompInfo::Successful) found = strong_only(A, solver.eigenvectors());
  } catch (const std::runtime_error&) {  // of its decomposition of a small matrix
  }
  if (found.cols() < k) found = strong_only(A, random_combinations(A, search, 20));
  return found.leftCols(std::min(k, found.cols()));
}

}  // namespace dynamorph
