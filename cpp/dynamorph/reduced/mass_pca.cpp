// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/mass_pca.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>

#include "dynamorph/reduced/gram_accumulator.hpp"

namespace dynamorph {

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

}  // namespace dynamorph
