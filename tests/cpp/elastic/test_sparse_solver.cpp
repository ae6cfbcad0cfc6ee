// SPDX-License-Identifier: GPL-3.0-or-later
// Sparse factors and solves of stiffness matrices, against Eigen's.
#include <doctest/doctest.h>

#include <Eigen/SparseCholesky>
#include <random>

#include "dynamorph/elastic/sparse_solver.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

/// Stiffness and mass of a bar with jittered nodes, those in the plane x = 0 pinned if asked.
SparseMatrix jittered_stiffness(int length, int width, bool with_pins, unsigned seed) {
  TetMesh mesh = scenes::bar(length, width, width, 0.05);
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> uniform(-0.008, 0.008);
  for (double& x : mesh.nodes.reshaped()) x += uniform(generator);
  const Eigen::Index n = mesh.nodes.rows(), m = mesh.tets.rows();
  std::vector<bool> pinned(n);
  for (Eigen::Index i = 0; i < (width + 1) * (width + 1); ++i) pinned[i] = with_pins;
  const auto body = std::make_shared<SoftBody>(mesh, VectorXd::Ones(m), VectorXd::LinSpaced(m, 0.2, 3),
                                               MatrixXd::Ones(m, 1), pinned, MatrixXd::Ones(n, 1));
  const MorphTarget neutral{"neutral", 0, VectorXd::Zero(3 * n), {2e4, 1e4}};
  SparseMatrix K = FullModel(body, {neutral}, MaterialModel::linear, Blending::forces).rest_stiffness(0);
  for (Eigen::Index i = 0; i < K.rows(); ++i) K.coeffRef(i, i) += 1e3 * body->volumes(i / 3, 0);
  return K;
}

}  // namespace

TEST_CASE("block Cholesky: solves like Eigen's, in both precisions, for one and for several right-hand sides") {
  for (bool with_pins : {false, true})
    for (int length : {1, 4, 17}) {
      const int width = length == 17 ? 4 : length == 4 ? 2 : 1;
      const SparseMatrix A = jittered_stiffness(length, width, with_pins, 7 + length);
      const MatrixXd B = MatrixXd::Random(A.rows(), 11);
      const MatrixXd expected = Eigen::SimplicialLLT<SparseMatrix>(A).solve(B);
      BlockCholesky<double> factor;
      REQUIRE(factor.factorize(A));
      MatrixXd X = B;
      factor.solve_in_place(X);
      CHECK((X - expected).norm() < 1e-9 * expected.norm());
      CHECK((factor.solve(B.col(3)) - expected.col(3)).norm() < 1e-9 * expected.norm());

      BlockCholesky<float> single(factor.symbolic());
      REQUIRE(single.factorize(A));
      CHECK(single.symbolic() == factor.symbolic());
      X = B;
      single.solve_in_place(X);
      // The error of rounding the factor is the condition number's, so compare what is solved for.
      CHECK((A * X - B).norm() < 1e-2 * B.norm());
      CHECK((A * single.solve(B.col(3)) - B.col(3)).norm() < 1e-2 * B.col(3).norm());

      // The halves, also of columns that are nearly empty: A^-1 = W^T W.
      std::vector<double> half;
      const MatrixXd W = factor.forward(MatrixXd::Identity(A.rows(), A.rows()));
      CHECK((W.transpose() * W * B - expected).norm() < 1e-9 * expected.norm());
      VectorXd x;
      factor.forward(B.col(3), half);
      CHECK((Eigen::Map<VectorXd>(half.data(), A.rows()) - W * B.col(3)).norm() < 1e-9 * (W * B.col(3)).norm());
      factor.backward(half, x);
      CHECK((x - expected.col(3)).norm() < 1e-9 * expected.norm());
    }
}

TEST_CASE("block Cholesky: says when a matrix is not positive definite, and takes the next one") {
  const SparseMatrix A = jittered_stiffness(6, 2, true, 3);
  BlockCholesky<double> factor;
  for (Eigen::Index i : {Eigen::Index(0), A.rows() / 2, A.rows() - 1}) {
    SparseMatrix bad = A;
    bad.coeffRef(i, i) = -1;
    CHECK(!factor.factorize(bad));
    bad.coeffRef(i, i) = std::numeric_limits<double>::quiet_NaN();
    CHECK(!factor.factorize(bad));
  }
  SparseMatrix shifted = A;
  const double lowest = Eigen::SelfAdjointEigenSolver<MatrixXd>(MatrixXd(A), Eigen::EigenvaluesOnly).eigenvalues()(0);
  shifted.diagonal().array() -= 1.01 * lowest;
  CHECK(!factor.factorize(shifted));
  shifted.diagonal().array() += 0.02 * lowest;
  CHECK(factor.factorize(shifted));

  // Another pattern is analyzed again: here the nodes of A without its last ones, and one coupled to all others.
  const Eigen::Index rows = A.rows() - 30;
  MatrixXd dense = MatrixXd(A).topLeftCorner(rows, rows);
  dense.row(4).setConstant(-0.01);
  dense.col(4).setConstant(-0.01);
  dense(4, 4) = dense.diagonal().maxCoeff();
  const SparseMatrix other = dense.sparseView();
  REQUIRE(factor.factorize(other));
  const VectorXd b = VectorXd::LinSpaced(rows, -1, 2);
  CHECK((other * factor.solve(b) - b).norm() < 1e-9 * b.norm());
}

TEST_CASE("sparse solver: the same accuracy with a fresh factor and with a stale one, and no indefinite matrix") {
  const SparseMatrix A = jittered_stiffness(9, 3, true, 11);
  SparseSolver solver;
  for (int k = 0; k < 40; ++k) {
    SparseMatrix H = (1 + 0.05 * k) * A;
    for (Eigen::Index i = 0; i < H.rows() / 2; ++i) H.coeffRef(i, i) *= 1 + 0.02 * k;
    const VectorXd b = VectorXd::LinSpaced(A.rows(), -1, 2 + k);
    VectorXd x;
    REQUIRE(solver.solve(H, {}, b, x));
    CHECK((H * x - b).norm() < 1e-3 * b.norm());
  }
  VectorXd x;
  CHECK(!solver.solve(-A, {}, VectorXd::Ones(A.rows()), x));
  CHECK(solver.solve(A, {}, VectorXd::Ones(A.rows()), x));
}

namespace {

/// Rows over random nodes of random tets of the bar of jittered_stiffness, `parts` each, and their stiffness.
SparsePoints random_points(const TetMesh& mesh, const std::vector<int>& free_of_node, Eigen::Index dofs, int rows,
                           int parts, double stiffness) {
  std::mt19937 generator(5);
  std::uniform_real_distribution<double> uniform(-1, 1);
  std::vector<Eigen::Triplet<double>> entries;
  SparsePoints out;
  for (int row = 0, part = 0; row < rows; ++row) {
    for (int m = 0; m < parts; ++m, ++part) {
      const Eigen::Index tet = Eigen::Index(generator() % unsigned(mesh.tets.rows()));
      for (int a = 0; a < 4; ++a)
        for (int c = 0; c < 3; ++c)
          if (const int free = free_of_node[std::size_t(mesh.tets(tet, a))]; free >= 0)
            entries.emplace_back(part, 3 * free + c, uniform(generator));
    }
    out.rows.ends.push_back(part);
  }
  out.rows.parts.resize(rows * parts, dofs);
  out.rows.parts.setFromTriplets(entries.begin(), entries.end());
  out.stiffness = VectorXd::LinSpaced(rows, stiffness, 3 * stiffness);
  return out;
}

MatrixXd dense(const SparsePoints& points) {
  MatrixXd J(points.rows.rows(), points.rows.parts.cols());
  for (Eigen::Index row = 0; row < J.rows(); ++row)
    for (Eigen::Index i = 0; i < J.cols(); ++i) J(row, i) = points.rows.dot(row, VectorXd::Unit(J.cols(), i));
  return J.transpose() * points.stiffness.asDiagonal() * J;
}

}  // namespace

TEST_CASE("sparse solver: stiffness at points is exact, on the mesh's pattern and beyond it") {
  const SparseMatrix A = jittered_stiffness(7, 2, true, 13);
  const TetMesh mesh = scenes::bar(7, 2, 2, 0.05);
  std::vector<int> free_of_node(std::size_t(mesh.nodes.rows()));
  for (int i = 0; i < int(free_of_node.size()); ++i) free_of_node[std::size_t(i)] = i - 9;  // the first nine are pinned
  for (int& free : free_of_node) free = std::max(free, -1);
  const VectorXd b = VectorXd::LinSpaced(A.rows(), -1, 2);
  SparseSolver solver;
  VectorXd x;
  for (int parts : {1, 5})
    for (double stiffness : {1.0, 1e4}) {  // beside a mesh of some 1e3
      SparsePoints points = random_points(mesh, free_of_node, A.rows(), 12, parts, stiffness);
      points.stiffness(5) = 0;  // it does nothing
      const SparsePoints many = random_points(mesh, free_of_node, A.rows(), 300, parts, stiffness);
      const MatrixXd exact = MatrixXd(A) + dense(points);
      for (const auto& each :
           std::vector<std::vector<const SparsePoints*>>{{&points}, {&points, &many}, {}, {&points}}) {
        MatrixXd H = A;
        for (const SparsePoints* some : each) H += dense(*some);
        REQUIRE(solver.solve(A, each, b, x));
        CHECK((H * x - b).norm() < 2e-4 * b.norm());
      }

      SparseMatrix majorized = A;
      add_majorant(points, majorized);
      CHECK(majorized.nonZeros() == A.nonZeros());
      const MatrixXd more = MatrixXd(majorized) - exact;
      const auto eigen = more.selfadjointView<Eigen::Lower>().eigenvalues();
      CHECK(eigen.minCoeff() > -1e-10 * eigen.cwiseAbs().maxCoeff() - 1e-9 * stiffness);
      if (parts == 1) CHECK(more.norm() < 1e-12 * exact.norm());
    }
}
