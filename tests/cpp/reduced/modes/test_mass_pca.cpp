// SPDX-License-Identifier: GPL-3.0-or-later
// The strongest combinations of columns, of few and of very many.
#include <doctest/doctest.h>

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "dynamorph/reduced/modes/mass_pca.hpp"

using namespace dynamorph;
using Eigen::Index;

static MatrixXd directions(Index rows, Index count, unsigned seed) {
  std::mt19937 random(seed);
  MatrixXd numbers(rows, count);
  for (double& number : numbers.reshaped()) number = double(random()) / (1u << 31) - 1;
  return Eigen::HouseholderQR<MatrixXd>(numbers).householderQ() * MatrixXd::Identity(rows, count);
}

/// As the bones' loads are decomposed: the way depends on the number of columns.
static MatrixXd strongest_of(const RowMajor& columns, Index most) {
  if (columns.cols() <= kManyColumns) return strongest(columns, most);
  const SparseMatrix sparse = columns.sparseView();
  return sparse * strongest_combinations(sparse, most);
}

TEST_CASE("the strongest combinations of few and of many columns") {
  constexpr Index kRows = 300, kRank = 120, kMost = 24;
  for (const Index count : {400, 2000}) {
    VectorXd sizes(kRank);  // each a tenth weaker than the one before
    for (Index k = 0; k < kRank; ++k) sizes(k) = std::pow(0.9, double(k));
    const MatrixXd expected = directions(kRows, kRank, 1) * sizes.asDiagonal();
    const RowMajor columns = expected * directions(count, kRank, 2).transpose();
    const MatrixXd found = strongest_of(columns, kMost);
    REQUIRE(found.cols() == kMost);
    for (Index k = 0; k < kMost; ++k) {
      CAPTURE(count);
      CAPTURE(k);
      CHECK(found.col(k).norm() == doctest::Approx(sizes(k)).epsilon(1e-6));
      CHECK(std::abs(found.col(k).dot(expected.col(k))) == doctest::Approx(sizes(k) * sizes(k)).epsilon(1e-6));
    }
    CHECK(strongest_of(columns, kMost) == found);
  }
}

TEST_CASE("columns of zeros and copies add nothing") {
  const MatrixXd two = directions(60, 2, 3);
  RowMajor columns = RowMajor::Zero(60, 3000);
  for (Index k = 0; k < 100; ++k) columns.col(7 * k) = two.col(k % 2);
  const MatrixXd found = strongest_of(columns, 24);
  REQUIRE(found.cols() == 2);
  CHECK((found - two * (two.transpose() * found)).norm() < 1e-9 * found.norm());
}

TEST_CASE("of combinations that are equally strong each is found") {
  for (const Index count : {12, 72}) {  // few, and more than are asked for
    const MatrixXd all = directions(80, count, 4);
    RowMajor columns(80, 2880);
    for (Index k = 0; k < 2880; ++k) columns.col(k) = (1 + k % count / 4 % 3) * all.col(k % count);
    const MatrixXd found = strongest_of(columns, 24);
    REQUIRE(found.cols() == std::min(count, Index(24)));
    CHECK((found - all * (all.transpose() * found)).norm() < 1e-9 * found.norm());
    for (Index k = 0; k < found.cols(); ++k)
      CHECK(found.col(k).norm() == doctest::Approx((count == 12 ? 3 - double(k / 4) : 3.) * std::sqrt(2880. / count)));
  }
}

TEST_CASE("a part and its copies") {
  constexpr Index kCopies = 120, kRows = 30, kLoads = 12;
  for (const Index kinds : {1, 12}) {  // of parts, each a tenth weaker than the one before
    SparseMatrix columns(kCopies * kRows, kCopies * kLoads);
    std::vector<double> sizes;
    std::vector<Eigen::Triplet<double>> entries;
    for (Index b = 0; b < kCopies; ++b) {
      const double weaker = std::pow(0.9, double(b % kinds));
      const MatrixXd part = directions(kRows, kLoads, 5 + unsigned(b % kinds));
      for (Index c = 0; c < kLoads; ++c) {
        sizes.push_back(weaker * std::pow(0.8, double(c)));
        for (Index i = 0; i < kRows; ++i)
          entries.emplace_back(b * kRows + i, b * kLoads + c, sizes.back() * part(i, c));
      }
    }
    columns.setFromTriplets(entries.begin(), entries.end());
    std::sort(sizes.rbegin(), sizes.rend());
    const MatrixXd combinations = strongest_combinations(columns, 60), found = columns * combinations;
    REQUIRE(found.cols() == 60);
    CHECK((combinations.transpose() * combinations - MatrixXd::Identity(60, 60)).norm() < 1e-9);
    for (Index k = 0; k < 60; ++k) {
      CAPTURE(kinds);
      CAPTURE(k);
      CHECK(found.col(k).norm() == doctest::Approx(sizes[k]).epsilon(1e-3));
    }
  }
}
