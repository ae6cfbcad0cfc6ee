// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/mass_pca.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <random>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/modes/gram_accumulator.hpp"

namespace dynamorph {

namespace {

constexpr int kSteps = 6;

using SparseRows = Eigen::SparseMatrix<double, Eigen::RowMajor>;

/// A B, on all cores.
RowMajor multiplied(const SparseRows& A, const RowMajor& B) {
  constexpr Eigen::Index kRows = 256;
  RowMajor out(A.rows(), B.cols());
  run_tasks(int((A.rows() + kRows - 1) / kRows), {}, [&](int part, const ProgressFn&) {
    const Eigen::Index first = part * kRows, some = std::min(kRows, A.rows() - first);
    out.middleRows(first, some).noalias() = A.middleRows(first, some) * B;
  });
  return out;
}

/// The orthonormal combinations, rotated to the eigenvectors of A^T A in their span, strongest first, without those
/// that are zero but for round-off.
MatrixXd strong_only(const SparseMatrix& A, const MatrixXd& combinations) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(multiplied(SparseRows(A), combinations)));
  const Eigen::Index strong = (eigen.eigenvalues().array() > 1e-14 * A.squaredNorm()).count();
  return combinations * eigen.eigenvectors().rightCols(strong).rowwise().reverse();
}

/// Columns with the same span that are nearly orthonormal, and so stay distinct when they are multiplied once more:
/// Cholesky QR, shifted for those that depend on others (Fukaya et al., SIAM J. Sci. Comput. 42, 2020).
RowMajor nearly_orthonormal(const RowMajor& columns) {
  MatrixXd products = gram(columns);
  products.diagonal().array() += 1e-14 * products.diagonal().sum();
  const Eigen::LLT<MatrixXd> factor(products);
  if (factor.info() != Eigen::Success)
    return Eigen::HouseholderQR<MatrixXd>(columns).householderQ() * MatrixXd::Identity(columns.rows(), columns.cols());
  const MatrixXd inverse = factor.matrixL().solve(MatrixXd::Identity(columns.cols(), columns.cols()));
  return product(columns, RowMajor(inverse.transpose()));
}

/// Orthonormal combinations (columns, `count`) whose span contains the strongest ones. Halko, Martinsson and Tropp,
/// SIAM Review 53 (2011), algorithm 4.4. Lanczos's iteration, which starts from a single vector, is no faster, and
/// finds only one of several equally strong combinations, such as those of a part and its copies.
MatrixXd random_combinations(const SparseMatrix& A, Eigen::Index count) {
  const SparseRows rows = A, columns = A.transpose();
  std::mt19937 random(1);
  RowMajor Q(A.cols(), count);
  for (double& number : Q.reshaped()) number = double(random()) / (1u << 31) - 1;
  for (int step = 0; step < kSteps; ++step) Q = nearly_orthonormal(multiplied(columns, multiplied(rows, Q)));
  return Eigen::HouseholderQR<MatrixXd>(Q).householderQ() * MatrixXd::Identity(A.cols(), count);
}

}  // namespace

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
  return product(columns, eigen.eigenvectors().rightCols(std::min(count, strong)).rowwise().reverse());
}

MatrixXd strongest_combinations(const SparseMatrix& A, Eigen::Index count) {
  const MatrixXd combinations = strong_only(A, random_combinations(A, std::min(A.cols(), 2 * count + 20)));
  return combinations.leftCols(std::min(count, combinations.cols()));
}

}  // namespace dynamorph
