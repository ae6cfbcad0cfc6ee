// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/mass_pca.hpp"

#include <Spectra/SymEigsSolver.h>

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/reduced/gram_accumulator.hpp"

namespace dynamorph {

namespace {

/// x -> P A^T A P x, which Spectra iterates with; P projects onto what is orthogonal to the columns of `found`.
class GramOperator {
 public:
  using Scalar = double;
  GramOperator(const SparseMatrix& A, const MatrixXd& found) : A_(A), found_(found) {}
  Eigen::Index rows() const { return A_.cols(); }
  Eigen::Index cols() const { return A_.cols(); }
  void perform_op(const double* x, double* y) const {
    const VectorXd image = A_ * projected(Eigen::Map<const VectorXd>(x, cols()));
    Eigen::Map<VectorXd>(y, rows()) = projected(A_.transpose() * image);
  }

 private:
  VectorXd projected(const VectorXd& x) const { return x - found_ * (found_.transpose() * x); }

  const SparseMatrix& A_;
  const MatrixXd& found_;
};

/// Orthonormal combinations of columns with the eigenvectors of their Gram matrix, strongest first, as long as they are
/// strong.
MatrixXd strong_only(const SparseMatrix& A, const MatrixXd& combinations) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(RowMajor(A * combinations)));
  const Eigen::Index strong = (eigen.eigenvalues().array() > 1e-14 * A.squaredNorm()).count();
  return combinations * eigen.eigenvectors().rightCols(strong).rowwise().reverse();
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
  const Eigen::Index most_there = std::min({most, A.rows(), A.cols() - 1});
  MatrixXd found(A.cols(), 0);
  // From one vector, as Spectra begins with, an iteration finds one of several equally strong combinations, and the
  // others by chance. So where there are few it is repeated in what is left.
  while (found.cols() < most_there && A.squaredNorm() - (A * found).squaredNorm() > 1e-12 * A.squaredNorm()) {
    const Eigen::Index k = most_there - found.cols(), search = std::min(A.cols(), 2 * k + 20);
    GramOperator op(A, found);
    Spectra::SymEigsSolver<GramOperator> solver(op, k, search);
    solver.init();
    solver.compute(Spectra::SortRule::LargestAlge, 1000, 1e-10);
    if (solver.info() != Spectra::CompInfo::Successful)
      throw Error("The loads of " + std::to_string(A.cols()) +
                  " columns were not decomposed. Ask for fewer modes, or let fewer bones deform the mesh.");
    MatrixXd all(A.cols(), found.cols() + k);
    all << found, solver.eigenvectors();
    const MatrixXd more = strong_only(A, orthonormal(all));
    if (more.cols() <= found.cols()) break;
    found = more.leftCols(std::min(most_there, more.cols()));
  }
  return found;
}

}  // namespace dynamorph
