// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/mass_pca.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>
#include <random>

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

namespace {

/// An orthonormal basis (rows, `count`) of nearly what the columns do most, by iteration of a block that always begins
/// alike.
MatrixXd subspace(const RowMajor& columns, Eigen::Index count) {
  constexpr int kRounds = 4;  // what is a third as strong as the weakest that counts is left to 1e-4
  std::mt19937 random;        // the same numbers on every system, unlike a distribution of the library
  MatrixXd block(columns.cols(), count);
  for (double& number : block.reshaped()) number = double(random()) / (1u << 31) - 1;
  block = columns * block;
  const auto normalize = [&] {
    block = Eigen::HouseholderQR<MatrixXd>(block).householderQ() * MatrixXd::Identity(block.rows(), count);
  };
  for (int round = 0; round < kRounds; ++round) {
    normalize();
    block = columns * (columns.transpose() * block);
  }
  normalize();
  return block;
}

}  // namespace

MatrixXd strongest(const RowMajor& columns, Eigen::Index most) {
  constexpr Eigen::Index kMany = 1000;  // the time of the eigensolver grows with the third power
  if (columns.cols() > std::max(kMany, 4 * most)) {
    const MatrixXd basis = subspace(columns, std::min(most + most / 4 + 10, columns.rows()));
    const RowMajor across = columns.transpose() * basis;  // its rows' combinations are those of the columns
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(across));
    const VectorXd sizes = eigen.eigenvalues().cwiseMax(0).cwiseSqrt();
    const Eigen::Index strong = std::min(most, (sizes.array() > 1e-7 * sizes.maxCoeff()).count());
    return basis * (eigen.eigenvectors() * sizes.asDiagonal()).rightCols(strong).rowwise().reverse();
  }
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(columns));
  const VectorXd& squares = eigen.eigenvalues();
  const Eigen::Index strong = (squares.array() > 1e-14 * squares.maxCoeff()).count();
  return columns * eigen.eigenvectors().rightCols(std::min(most, strong)).rowwise().reverse();
}

}  // namespace dynamorph
