// SPDX-License-Identifier: GPL-3.0-or-later
// Products of small dense matrices, whose sizes are and are not whole vectors, against Eigen's.
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "dynamorph/elastic/dense_kernels.hpp"

using namespace dynamorph;
using namespace scenes;

TEST_CASE("a product of dense matrices is Eigen's, whatever is in the result before") {
  for (Index m : {1, 4, 7, 8, 13, 100})
    for (Index k : {1, 5, 20})
      for (Index n : {1, 3, 4, 6, 20}) {
        const MatrixXd A = random_matrix(m, k, 31), B = random_matrix(k, n, 32), expected = A * B;
        MatrixXd C = MatrixXd::Constant(m, n, 7);
        multiply_dense(A.data(), m, k, B.data(), n, C.data());
        CHECK((C - expected).norm() <= 1e-14 * A.norm() * B.norm());
      }
}

TEST_CASE("weighted squares are subtracted from the lower triangle, and nothing else changes") {
  for (Index k : {1, 4, 6, 100})
    for (Index n : {1, 2, 3, 5, 8, 20}) {
      const MatrixXd B = random_matrix(k, n, 33), before = random_matrix(n, n, 34);
      const VectorXd d = random_vector(k, 1, 35).cwiseAbs();
      MatrixXd A = before;
      subtract_squares(B.data(), d.data(), k, n, A.data());
      const MatrixXd expected = before - B.transpose() * d.asDiagonal() * B;
      const MatrixXd off = (A - expected).triangularView<Eigen::Lower>();
      CHECK(off.norm() <= 1e-14 * (1 + B.squaredNorm()));
      const MatrixXd above = (A - before).triangularView<Eigen::StrictlyUpper>();
      CHECK(above.isZero(0));
    }
}
