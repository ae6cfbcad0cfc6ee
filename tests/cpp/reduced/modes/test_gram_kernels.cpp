// SPDX-License-Identifier: GPL-3.0-or-later
// The sums over rows and over pairs of modes, against their definitions.
#include <doctest/doctest.h>

#include <tuple>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/modes/gram_accumulator.hpp"
#include "dynamorph/reduced/modes/gram_kernels.hpp"
#include "elastic/laws.hpp"

using namespace dynamorph;

namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Matrix3d mode(const RowMajor& G, int k) { return Eigen::Map<const Matrix3d>(VectorXd(G.col(k)).data()); }

}  // namespace

TEST_CASE("sums of row products: the triangle of A^T A, and the wanted part of A^T B, over one batch and several") {
  for (int rows : {0, 5, 128, 300})
    for (int n : {1, 12, 29}) {
      const RowMajor A = RowMajor::Random(rows, n), B = RowMajor::Random(rows, 3 * n);
      GramAccumulator gram(n), part(n, 3 * n, [](Eigen::Index i) { return 2 * i; });
      for (int i = 0; i < rows; ++i) {
        gram.add(A.row(i).data());
        part.add(A.row(i).data(), B.row(i).data());
      }
      gram.finish();
      part.finish();
      const MatrixXd square = A.transpose() * A, product = A.transpose() * B;
      double error = 0;
      for (int i = 0; i < n; ++i) {
        for (int j = i; j < n; ++j) error = std::max(error, std::abs(gram(i, j) - square(i, j)));
        for (int j = 2 * i; j < 3 * n; ++j) error = std::max(error, std::abs(part(i, j) - product(i, j)));
      }
      CHECK(error <= 1e-13 * (1 + rows));
      CHECK((inner_products(A, B) - product).cwiseAbs().maxCoeff() <= 1e-13 * (1 + rows));
    }
}

TEST_CASE("products in parts are those of whole matrices, whatever the number of threads") {
  for (int rows : {0, 1, 1024, 2500, 20000}) {
    const RowMajor A = RowMajor::Random(rows, 17), B = RowMajor::Random(rows, 5), C = RowMajor::Random(17, 7);
    const auto all = [&] { return std::make_tuple(gram(A), inner_products(A, B), product(A, C)); };
    const auto [square, inner, multiplied] = all();
    const MatrixXd lower = (A.transpose() * A).eval().triangularView<Eigen::Lower>();
    CHECK((square - lower).norm() <= 1e-12 * (1 + rows));
    CHECK((inner - A.transpose() * B).norm() <= 1e-12 * (1 + rows));
    CHECK((multiplied - A * C).norm() <= 1e-12 * (1 + rows));
    set_threads(1);
    CHECK(all() == std::make_tuple(square, inner, multiplied));
    set_threads(0);
  }
}

TEST_CASE("curvatures of pairs are the second derivatives of StVK's nodal forces at rest") {
  const Lame lame{2.0, 0.7};
  const int r = 6;
  const double h = 1e-2;  // the force is cubic in F: the mixed difference below is exact
  const RowMajor G = RowMajor::Random(9, r);
  Eigen::Matrix<double, 3, 4> gradients = Eigen::Matrix<double, 3, 4>::Random();
  gradients.col(0) = -gradients.rightCols<3>().rowwise().sum();
  RowMajor stresses(6, r), curvatures(12, r * (r + 1) / 2);
  for (int k = 0; k < r; ++k) {
    const Matrix3d strain = 0.5 * (mode(G, k) + mode(G, k).transpose());
    const Matrix3d S = lame.lambda * strain.trace() * Matrix3d::Identity() + 2 * lame.mu * strain;
    stresses.col(k) << S(0, 0), S(1, 1), S(2, 2), S(0, 1), S(1, 2), S(2, 0);
  }
  curvatures_of_pairs(G.data(), stresses.data(), r, lame.lambda, lame.mu, gradients.data(), curvatures.data());
  for (int k = 0, p = 0; k < r; ++k)
    for (int l = k; l < r; ++l, ++p) {
      const auto force = [&](double a, double b) -> Eigen::Matrix<double, 3, 4> {
        return stress(MaterialModel::stvk, lame, Matrix3d::Identity() + a * mode(G, k) + b * mode(G, l)) * gradients;
      };
      const Eigen::Matrix<double, 3, 4> expected =
          (force(h, h) - force(h, -h) - force(-h, h) + force(-h, -h)) / (4 * h * h);
      const VectorXd actual = curvatures.col(p);
      CHECK((actual - expected.reshaped()).norm() <= 1e-9 * expected.norm());
    }
}
