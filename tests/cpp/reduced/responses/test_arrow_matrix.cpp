// SPDX-License-Identifier: GPL-3.0-or-later
// Arrow matrices and their factors against the dense matrices that they stand for.
#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <limits>

#include "derivatives.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

constexpr int kSizes[][2] = {{1, 1}, {4, 0}, {7, 20}, {12, 3}, {9, 64}};

/// Positive definite: its diagonal outweighs the rest.
ArrowMatrix arrow(int r, int h) {
  ArrowMatrix out(r, h);
  const VectorXd entries = random_vector(r * r + h * r, 1, 17);
  const Eigen::Map<const MatrixXd> corner(entries.data(), r, r);
  out.corner() = corner + corner.transpose();
  out.border() = Eigen::Map<const MatrixXd>(entries.data() + r * r, h, r);
  out.rest().setConstant(r + 1);
  out.add_to_diagonal(1, VectorXd::LinSpaced(r + h, 3 * (r + h), 4 * (r + h)));
  return out;
}

}  // namespace

TEST_CASE("an arrow matrix has the entries, the diagonal and the products of the dense one") {
  for (const auto& [r, h] : kSizes) {
    ArrowMatrix A = arrow(r, h);
    const MatrixXd dense = A.dense();
    CHECK(A.rows() == r + h);
    CHECK(A.corner_size() == r);
    CHECK(dense == dense.transpose());
    CHECK(dense.topLeftCorner(r, r) == A.corner());
    CHECK(dense.bottomLeftCorner(h, r) == A.border());
    CHECK(dense.bottomRightCorner(h, h) == MatrixXd(A.rest().asDiagonal()));
    CHECK(A.diagonal() == VectorXd(dense.diagonal()));
    const VectorXd x = random_vector(r + h, 1, 18), shift = random_vector(r + h, 1, 19);
    VectorXd y;
    A.multiply(x, y);
    CHECK((y - dense * x).norm() <= 1e-14 * y.norm());
    A.add_to_diagonal(0.5, shift);
    CHECK((A.dense() - dense - MatrixXd(0.5 * shift.asDiagonal())).norm() <= 1e-14 * dense.norm());
  }
}

TEST_CASE("the values of an arrow matrix are all that it has: sums and multiples go through them") {
  ArrowMatrix A = arrow(5, 8), B(5, 8);
  values(B) = 3 * values(A) + values(A);
  CHECK((B.dense() - 4 * A.dense()).norm() <= 1e-14 * B.dense().norm());
  CHECK(ArrowMatrix(5, 8).dense() == MatrixXd::Zero(13, 13));
}

TEST_CASE("an arrow factor solves like a dense one, of any size after another") {
  ArrowFactor factor;
  for (const auto& [r, h] : kSizes) {
    const ArrowMatrix A = arrow(r, h);
    const VectorXd b = random_vector(r + h, 1, 20);
    VectorXd x;
    REQUIRE(factor.compute(A));
    factor.solve(b, x);
    CHECK((x - A.dense().llt().solve(b)).norm() <= 1e-13 * x.norm());
  }
}

TEST_CASE("an arrow factor without responses is the dense factor, bit for bit") {
  for (int r : {1, 4, 7, 30}) {
    const ArrowMatrix A = arrow(r, 0);
    const VectorXd b = random_vector(r, 1, 21);
    ArrowFactor factor;
    DenseFactor expected;
    VectorXd x, y;
    REQUIRE(factor.compute(A));
    REQUIRE(expected.compute(A.corner()));
    factor.solve(b, x);
    expected.solve(b, y);
    CHECK(x == y);
    VectorXd product, dense = A.corner() * b;
    A.multiply(b, product);
    CHECK(product == dense);
  }
}

TEST_CASE("an arrow factor says whether the matrix is positive definite, whichever part makes it so") {
  ArrowFactor factor;
  ArrowMatrix A = arrow(7, 20);
  CHECK(factor.compute(A));
  for (double wrong : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    ArrowMatrix B = A;
    B.rest()(13) = wrong;
    CHECK_FALSE(factor.compute(B));
  }
  ArrowMatrix corner = A;
  corner.corner()(3, 3) = -1;
  CHECK_FALSE(factor.compute(corner));
  // Corner and rest are each positive definite, but together with the border they are not.
  ArrowMatrix border = A;
  border.border()(13, 3) = 2 * std::sqrt(A.corner()(3, 3) * A.rest()(13));
  CHECK(border.dense().selfadjointView<Eigen::Lower>().eigenvalues().minCoeff() < 0);
  CHECK_FALSE(factor.compute(border));
  ArrowMatrix nan = A;
  nan.border()(2, 1) = std::numeric_limits<double>::quiet_NaN();
  CHECK_FALSE(factor.compute(nan));
}

TEST_CASE("an arrow factor agrees with the eigenvalues about the sign, near singular ones too") {
  ArrowFactor factor;
  ArrowMatrix A = arrow(6, 10);
  const double least = A.dense().selfadjointView<Eigen::Lower>().eigenvalues().minCoeff();
  for (double margin : {1e-9, -1e-9}) {
    ArrowMatrix B = A;
    B.add_to_diagonal(-(1 - margin) * least, VectorXd::Ones(16));
    CHECK(factor.compute(B) == (margin > 0));
  }
}

TEST_CASE("an arrow solver with stiffness at points solves what the dense matrix does, with few rows and with many") {
  for (const auto& [r, h] : kSizes)
    for (int rows : {0, 1, 3, 200}) {
      const ArrowMatrix H = arrow(r, h);
      DensePoints first, second;
      first.rows = random_vector(rows * H.rows(), 1, 31).reshaped<Eigen::RowMajor>(rows, H.rows());
      first.stiffness = VectorXd::LinSpaced(rows, 0, 50);  // the first does not act
      second.rows = RowMajor::Ones(1, H.rows());
      second.stiffness = VectorXd::Constant(1, 7);
      const MatrixXd sum = H.dense() + first.rows.transpose() * first.stiffness.asDiagonal() * first.rows +
                           second.rows.transpose() * second.stiffness.asDiagonal() * second.rows;
      const VectorXd b = random_vector(H.rows(), 1, 32);
      VectorXd x;
      ArrowSolver solver;
      REQUIRE(solver.solve(H, {&first, &second}, b, x));
      CHECK((sum * x - b).norm() <= 1e-12 * (sum.norm() * x.norm() + b.norm()));
    }
}

TEST_CASE("an arrow that only its points hold is solved, and one that they do not hold is refused") {
  ArrowMatrix H = arrow(6, 10);
  H.add_to_diagonal(-1, VectorXd::Unit(16, 2) * 2 * H.dense().norm());
  DensePoints points;
  points.rows = VectorXd::Unit(16, 2).transpose();
  points.stiffness = VectorXd::Constant(1, 3 * H.dense().norm());
  const VectorXd b = random_vector(16, 1, 33);
  VectorXd x;
  ArrowSolver solver;
  CHECK(!solver.solve(H, {}, b, x));
  REQUIRE(solver.solve(H, {&points}, b, x));
  const MatrixXd sum = H.dense() + points.rows.transpose() * points.stiffness(0) * points.rows;
  CHECK((sum * x - b).norm() <= 1e-12 * sum.norm() * x.norm());
  points.stiffness(0) = 1;
  CHECK(!solver.solve(H, {&points}, b, x));
}

TEST_CASE("points give way by unknowns of their own, as the dense matrix of all unknowns has it") {
  for (const auto& [r, h] : kSizes)
    for (const int pressed : {0, 3, 40}) {
      const ArrowMatrix H = arrow(r, h);
      const Eigen::Index n = H.rows();
      MatrixXd sum = MatrixXd::Zero(n + 7, n + 7);
      sum.topLeftCorner(n, n) = H.dense();
      std::vector<DensePoints> all(3);  // those of two bodies, and others without
      Eigen::Index own = n;
      for (std::size_t k = 0; k < all.size(); ++k) {
        DensePoints& points = all[k];
        const int rows = pressed + 2, m = k == 2 ? 0 : 3 + int(k);
        points.rows = random_vector(rows * n, 1, 31).reshaped<Eigen::RowMajor>(rows, n);
        points.stiffness = VectorXd::LinSpaced(rows, 40, 2);
        points.stiffness(rows - 1) = 0;  // the last does not act
        points.own_rows = random_vector(pressed * m, 1, 33 + unsigned(k)).reshaped<Eigen::RowMajor>(pressed, m);
        points.own_factor = random_vector(m * m, 0.3, 35).reshaped(m, m).triangularView<Eigen::Lower>();
        points.own_factor.diagonal().array() += 2;
        MatrixXd over = MatrixXd::Zero(rows, n + 7);
        over.leftCols(n) = points.rows;
        over.block(0, own, pressed, m) = points.own_rows;
        sum += over.transpose() * points.stiffness.asDiagonal() * over;
        sum.block(own, own, m, m) += points.own_factor * points.own_factor.transpose();
        own += m;
      }
      const VectorXd b = random_vector(n + 7, 1, 32);
      VectorXd x;
      ArrowSolver solver;
      REQUIRE(solver.solve(H, {&all[0], &all[1], &all[2]}, b, x));
      CHECK((sum * x - b).norm() <= 1e-11 * (sum.norm() * x.norm() + b.norm()));
    }
}
