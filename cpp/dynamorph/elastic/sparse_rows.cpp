// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/sparse_rows.hpp"

namespace dynamorph {

using Eigen::Index;
using Part = Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator;

double SparseRows::dot(Index row, const VectorXd& x) const {
  double sum = 0;
  for (int m = first(row); m < ends[row]; ++m)
    for (Part it(parts, m); it; ++it) sum += it.value() * x(it.col());
  return sum;
}

void SparseRows::add(Index row, double factor, Eigen::Ref<VectorXd> y) const {
  for (int m = first(row); m < ends[row]; ++m)
    for (Part it(parts, m); it; ++it) y(it.col()) += factor * it.value();
}

void multiply(const SparseRows& J, const VectorXd& x, VectorXd& out) {
  out.resize(J.rows());
  for (Index row = 0; row < J.rows(); ++row) out(row) = J.dot(row, x);
}

void add_transposed_product(const SparseRows& J, const VectorXd& f, VectorXd& y) {
  for (Index row = 0; row < J.rows(); ++row) J.add(row, f(row), y);
}

void add_stiffness_product(const SparsePoints& points, const VectorXd& x, VectorXd& y) {
  for (Index row = 0; row < points.rows.rows(); ++row)
    points.rows.add(row, points.stiffness(row) * points.rows.dot(row, x), y);
}

void add_majorant(const SparsePoints& points, SparseMatrix& A) {
  const SparseRows& J = points.rows;
  for (Index row = 0; row < J.rows(); ++row) {
    double norms = 0;
    for (int m = J.first(row); m < J.ends[row]; ++m) norms += J.parts.row(m).norm();
    for (int m = J.first(row); m < J.ends[row]; ++m) {
      const double norm = J.parts.row(m).norm();
      if (norm == 0) continue;
      const double factor = points.stiffness(row) * norms / norm;
      for (Part i(J.parts, m); i; ++i)
        for (Part j(J.parts, m); j; ++j) A.coeffRef(i.col(), j.col()) += factor * i.value() * j.value();
    }
  }
}

}  // namespace dynamorph
