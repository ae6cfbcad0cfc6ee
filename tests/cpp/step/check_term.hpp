// SPDX-License-Identifier: GPL-3.0-or-later
// The one check that every term of a step's potential must pass.
#pragma once

#include <type_traits>

#include "derivatives.hpp"
#include "dynamorph/step/newton.hpp"

namespace scenes {

/// What the stiffness at points, with unknowns of their own, makes of x, beside a product with a model's own matrix.
inline void add_points(const SparsePoints& points, const VectorXd& x, VectorXd& y) {
  add_stiffness_product(points, x, y);
}
inline void add_points(const DensePoints& points, const VectorXd& x, VectorXd& y) {
  const Eigen::Index p = points.own_rows.rows(), m = points.own_rows.cols();
  y.tail(m) += points.own_factor * (points.own_factor.transpose() * x.tail(m));
  if (points.stiffness.size() == 0) return;
  VectorXd moved = points.rows * x.head(points.rows.cols());
  moved.head(p) += points.own_rows * x.tail(m);
  const VectorXd forces = points.stiffness.cwiseProduct(moved);
  y.head(points.rows.cols()) += points.rows.transpose() * forces;
  y.tail(m) += points.own_rows.transpose() * forces.head(p);
}

/// The term at a distance from other coordinates, where its derivatives are checked: its second ones have kinks.
template <class Term>
struct Around {
  Term& term;
  VectorXd center;
  double value(const VectorXd& q) { return term.value(center + q); }
  auto linearize(const VectorXd& q) { return term.linearize(center + q); }
};

/// Checks a term (newton.hpp) at scales * x for some x of size `step`, with differences of that size: its gradient and
/// its Hessian against its value, that the value is the same whether it is asked for alone or not, and that its
/// round-off is sane. scales: of the coordinates, so that no part is hidden behind a stiffer one.
template <class Matrix, class Term>
void check_term(Term& term, const VectorXd& scales, double step) {
  const VectorXd x = random_vector(scales.size(), 3 * step, 21);
  const double alone = term.value(scales.cwiseProduct(x));
  const auto whole = term.linearize(scales.cwiseProduct(x));
  CHECK(whole.gradient.size() == x.size());
  CHECK(whole.value == alone);
  const RoundOff round_off = whole.round_off;
  CHECK(round_off.gradient >= 0);
  CHECK(round_off.gradient <= 1e-6 * round_off.forces);
  check_derivatives(
      [&](const VectorXd& x, VectorXd& f, VectorXd& Kd, const VectorXd& d) {
        const auto at = term.linearize(scales.cwiseProduct(x));
        f = scales.cwiseProduct(at.gradient);
        const VectorXd moved = scales.cwiseProduct(d);
        if constexpr (std::is_same_v<decltype(at.hessian), const PointStiffness<Matrix>&>) {
          Kd.setZero(x.size());
          add_points(at.hessian, moved, Kd);
        } else {
          multiply(at.hessian, moved, Kd);
        }
        Kd = scales.cwiseProduct(Kd);
        return at.value;
      },
      x, step);
}

}  // namespace scenes
