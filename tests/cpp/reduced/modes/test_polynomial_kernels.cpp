// SPDX-License-Identifier: GPL-3.0-or-later
// The products of a reduced step, whose sizes are and are not whole vectors, against Eigen's.
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "dynamorph/reduced/modes/polynomial_kernels.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

using namespace dynamorph;
using namespace scenes;

TEST_CASE("products with columns in both precisions, and with rows, are added to what is there") {
  for (Index rows : {1, 3, 4, 22, 104})
    for (Index columns : {1, 4, 7, 20}) {
      const Eigen::MatrixXf single = random_matrix(rows, columns, 41).cast<float>();
      const MatrixXd A = single.cast<double>();
      const VectorXd x = random_vector(columns, 1, 42), f = random_vector(rows, 1, 43);
      VectorXd y = f, z = f, dots = x;
      add_product(A.data(), rows, x.data(), columns, y.data());
      add_single_product(single.data(), rows, x.data(), columns, z.data());
      add_dots(A.data(), rows, columns, f.data(), dots.data());
      CHECK((y - f - A * x).norm() <= 1e-14 * (1 + A.norm()));
      CHECK(y == z);
      CHECK((dots - x - A.transpose() * f).norm() <= 1e-14 * (1 + f.norm() * A.norm()));
    }
}

TEST_CASE("a coupling adds its slopes, and its products with an answer are those of each pair of modes") {
  for (Index h : {8, 24, 104})
    for (Index r : {1, 2, 4, 5, 12, 20}) {
      const Eigen::MatrixXf S = random_matrix(h, r * (r + 1) / 2, 44).cast<float>();
      const VectorXd v = random_vector(r, 1, 45), answer = random_vector(h, 1, 46);
      const MatrixXd before = random_matrix(h, r, 47);
      MatrixXd slopes = before, expected = before;
      VectorXd products(S.cols()), dots(S.cols());
      couple(S.data(), h, r, v.data(), answer.data(), slopes.data(), products.data());
      Index pair = 0;
      for_pairs(r, [&](Index k, Index l) {
        const VectorXd column = S.col(pair).cast<double>();
        expected.col(k) += v(l) * column;
        if (l != k) expected.col(l) += v(k) * column;
        dots(pair++) = answer.dot(column);
      });
      CHECK((slopes - expected).norm() <= 1e-14 * expected.norm());
      CHECK((products - dots).norm() <= 1e-14 * answer.norm() * S.norm());
    }
}
