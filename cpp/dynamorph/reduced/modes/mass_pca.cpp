// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/mass_pca.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <random>

#include "dynamorph/reduced/modes/gram_accumulator.hpp"

namespace dynamorph {

namespace {

constexpr int kSteps = 10;

/// The orthonormal combinations, rotated to the eigenvectors of A^T A in their span, strongest first, without those
/// that are zero but for round-off.
MatrixXd strong_only(const SparseMatrix& A, const MatrixXd& combinations) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(RowMajor(A * combinations)));
  const Eigen::Index strong = (eigen.eigenvalues().array() > 1e-14 * A.squaredNorm()).count();
  return combinations * eigen.eigenvectors().rightCols(strong).rowwise().reverse();
}

/// Orthonormal combinations (columns, `count`) whose span contains the strongest ones. Halko, Martinsson and Tropp,
/// SIAM Review 53 (2011), algorithm 4.4. Lanczos's iteration, which starts from a single vector, is no faster, and
/// finds only one of several equally strong combinations, such as those of a part and its copies.
MatrixXd random_combinations(const SparseMatrix& A, Eigen::Index count) {
  std::mt19937 random(1);
  MatrixXd Q(A.cols(), count);
  for (double& number : Q.reshaped()) number = double(random()) / (1u << 31) - 1;
  for (int step = 0; step < kSteps; ++step) {
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

MatrixXd strongest(const RowMajor& columns, Eigen::Index count) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(columns));
  const VectorXd& squares = eigen.eigenvalues();
  const Eigen::Index strong = (squares.array() > 1e-14 * squares.maxCoeff()).count();
  return columns * eigen.eigenvectors().rightCols(std::min(count, strong)).rowwise().reverse();
}

MatrixXd strongest_combinations(const SparseMatrix& A, Eigen::Index count) {
  const MatrixXd combinations = strong_only(A, random_combinations(A, std::min(A.cols(), 2 * count + 20)));
  return combinations.leftCols(std::min(count, combinations.cols()));
}

}  // namespace dynamorph
