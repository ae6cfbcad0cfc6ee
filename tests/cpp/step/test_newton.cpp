// SPDX-License-Identifier: GPL-3.0-or-later
// Newton's method without a rig or a model: on potentials whose minima are known, for one and for eight.
#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "dynamorph/step/eight.hpp"
#include "dynamorph/step/one.hpp"
#include "dynamorph/step/terms.hpp"

using namespace dynamorph;

namespace {

using Dense = One<MatrixXd>;

/// Sum of scale_k cosh(q_k), whose Hessian is positive, or of scale_k (q_k^2 - 1)^2 / 4, which is indefinite within
/// |q| < 0.57.
template <class Arithmetic>
struct Hills {
  using Number = typename Arithmetic::Number;
  using Vector = typename Arithmetic::Vector;
  bool wells = false;
  double scale = 1, least = -std::numeric_limits<double>::infinity();  ///< q_0 must stay above that
  int evaluations = 0;
  Vector gradient;
  typename Arithmetic::Matrix hessian;
  Number energy{}, forces{}, round_off{}, length{}, resolution{};

  void evaluate(const Vector& q) {
    const Eigen::Index r = Eigen::Index(q.size());
    ++evaluations;
    gradient = q;
    if constexpr (Arithmetic::kLanes == 1) {
      hessian.setZero(r, r);
    } else {
      hessian.assign(r * (r + 1) / 2, DoubleW{});
    }
    energy = Number();
    for (int lane = 0; lane < Arithmetic::kLanes; ++lane)
      for (Eigen::Index k = 0, p = 0; k < r; p += r - k, ++k) {
        const double x = Arithmetic::at(q[k], lane), y = x * x - 1;
        Arithmetic::at(energy, lane) += scale * (wells ? y * y / 4 : std::cosh(x));
        Arithmetic::at(gradient[k], lane) = scale * (wells ? y * x : std::sinh(x));
        const double curvature = scale * (wells ? 3 * x * x - 1 : std::cosh(x));
        if constexpr (Arithmetic::kLanes == 1)
          hessian(k, k) = curvature;
        else
          hessian[p][lane] = curvature;
      }
    forces = Arithmetic::norm(gradient);
    length = Arithmetic::norm(q);
  }
  /// Half of the way to the wall, at most.
  Number longest(const Vector& q, const Vector& direction) const {
    Number out = Number() + 1.0;
    for (int lane = 0; lane < Arithmetic::kLanes; ++lane) {
      const double step = Arithmetic::at(direction[0], lane), room = least - Arithmetic::at(q[0], lane);
      if (step < 0) Arithmetic::at(out, lane) = std::min(1.0, 0.5 * room / step);
    }
    return out;
  }
};

const NewtonLimits kLimits{1e-10, 1e-12, 60};
const auto kAsk = [] {};

LaneVector<DoubleW> lanes(std::initializer_list<double> first, double step) {
  LaneVector<DoubleW> out;
  for (double value : first) {
    DoubleW own;
    for (int lane = 0; lane < kLanes; ++lane) own[lane] = value + step * lane;
    out.push_back(own);
  }
  return out;
}

}  // namespace

TEST_CASE("Newton: the sum of a quadratic and a hill is least where its derivative is zero") {
  // 1/2 h (q - 1)^2 + g (q - 1) + cosh(q): the root of h (q - 1) + g + sinh(q), found by bisection.
  const double h = 3, g = -0.7;
  double low = -5, high = 5;
  while (high - low > 1e-15)
    (h * ((low + high) / 2 - 1) + g + std::sinh((low + high) / 2) > 0 ? high : low) = (low + high) / 2;

  QuadraticTerm<Dense> quadratic;
  quadratic.hessian = MatrixXd::Identity(2, 2) * h;
  quadratic.g = VectorXd::Constant(2, g);
  quadratic.origin = VectorXd::Ones(2);
  Hills<Dense> hills;
  Potential<Dense, QuadraticTerm<Dense>, Hills<Dense>> potential(quadratic, hills);
  NewtonScratch<Dense> scratch;
  VectorXd q = Eigen::Vector2d(4, -4);
  const auto report = minimize(potential, scratch, q, 1, kLimits, kAsk);
  CHECK(!report.open);
  CHECK(!report.broken);
  CHECK(report.iterations > 2);
  CHECK(q(0) == doctest::Approx(low).epsilon(1e-9));
  CHECK(q(1) == doctest::Approx(low).epsilon(1e-9));
}

TEST_CASE("Newton: the last step is not looked at when it is certain, and leaves no more than is reported") {
  for (const bool wells : {false, true})
    for (const double begin : {0.7, 1.1, 1.4, 3.0}) {
      CAPTURE(wells);
      CAPTURE(begin);
      QuadraticTerm<Dense> quadratic;  // where hills alone are odd, Newton's method is better than this test assumes
      quadratic.hessian = MatrixXd::Identity(2, 2);
      quadratic.g = Eigen::Vector2d(-0.5, 0.3);
      quadratic.origin = VectorXd::Zero(2);
      Hills<Dense> hills;
      hills.wells = wells;
      Potential<Dense, QuadraticTerm<Dense>, Hills<Dense>> potential(quadratic, hills);
      NewtonScratch<Dense> scratch;
      VectorXd q = Eigen::Vector2d(begin, 0.8 * begin);
      const auto report = minimize(potential, scratch, q, 1, kLimits, kAsk);
      CHECK(!report.open);
      if (!wells) {  // no step is halved
        CHECK(report.unseen == 1);
        CHECK(hills.evaluations == report.iterations);  // the first is before the first step
      }
      Value<Dense> value;
      potential.evaluate(q, value);
      CHECK(relative_residual(value, kLimits.tolerance) <= report.residual + 1e-15);
      CHECK(report.residual <= kLimits.tolerance);
    }
}

TEST_CASE("Newton: from where the Hessian is indefinite it goes downhill, to a minimum") {
  Hills<Dense> wells;
  wells.wells = true;
  Potential<Dense, Hills<Dense>> potential(wells);
  NewtonScratch<Dense> scratch;
  VectorXd q = Eigen::Vector3d(0.1, -0.05, 2);
  CHECK(!minimize(potential, scratch, q, 1, kLimits, kAsk).open);
  CHECK((q.cwiseAbs() - VectorXd::Ones(3)).norm() < 1e-8);
  CHECK(q(0) > 0);
  CHECK(q(1) < 0);
}

TEST_CASE("Newton: when it is stopped it has converged only if what is left is nothing") {
  Hills<Dense> hills;
  Potential<Dense, Hills<Dense>> potential(hills);
  NewtonScratch<Dense> scratch;
  VectorXd q = VectorXd::Constant(1, 0.1);
  CHECK(minimize(potential, scratch, q, 1, {1e-15, 1e-6, 2}, kAsk).open);  // the second step is some 1e-4
  q(0) = 0.1;
  CHECK(!minimize(potential, scratch, q, 1, {1e-15, 1e-2, 2}, kAsk).open);
}

TEST_CASE("Newton: what is stiff in one place does not hold back what is indefinite in another") {
  QuadraticTerm<Dense> stiff;
  stiff.hessian = MatrixXd::Zero(2, 2);
  stiff.hessian(0, 0) = 1e8;
  stiff.g = VectorXd::Zero(2);
  stiff.origin = VectorXd::Zero(2);
  Hills<Dense> wells;
  wells.wells = true;
  Potential<Dense, QuadraticTerm<Dense>, Hills<Dense>> potential(stiff, wells);
  NewtonScratch<Dense> scratch;
  VectorXd q = Eigen::Vector2d(0, 0.1);
  const auto report = minimize(potential, scratch, q, 1, kLimits, kAsk);
  CHECK(!report.open);
  CHECK(report.iterations < 20);
  CHECK(q(1) == doctest::Approx(1).epsilon(1e-9));
}

TEST_CASE("Newton: eight are stepped as each of them alone, and who does not take part stays") {
  Hills<EightLanes> hills;
  QuadraticTerm<EightLanes> quadratic;
  quadratic.hessian = lanes({2, 0.3, 4}, 0.5);
  quadratic.g = lanes({1, -2}, 0.3);
  quadratic.origin = lanes({0.2, 0.1}, -0.4);
  Potential<EightLanes, QuadraticTerm<EightLanes>, Hills<EightLanes>> potential(quadratic, hills);
  NewtonScratch<EightLanes> scratch;
  const LaneVector<DoubleW> begin = lanes({3, -3}, 0.5);
  LaneVector<DoubleW> q = begin;
  const Lanes moving = 0b10110111;
  CHECK(!minimize(potential, scratch, q, moving, kLimits, kAsk).open);
  for (int lane = 0; lane < kLanes; ++lane) {
    CAPTURE(lane);
    if (!(moving >> lane & 1)) {
      CHECK(q[0][lane] == begin[0][lane]);
      CHECK(q[1][lane] == begin[1][lane]);
      continue;
    }
    Hills<Dense> own;
    QuadraticTerm<Dense> alone;
    alone.hessian = MatrixXd(2, 2);
    alone.hessian << quadratic.hessian[0][lane], quadratic.hessian[1][lane], quadratic.hessian[1][lane],
        quadratic.hessian[2][lane];
    alone.g = Eigen::Vector2d(quadratic.g[0][lane], quadratic.g[1][lane]);
    alone.origin = Eigen::Vector2d(quadratic.origin[0][lane], quadratic.origin[1][lane]);
    Potential<Dense, QuadraticTerm<Dense>, Hills<Dense>> sum(alone, own);
    NewtonScratch<Dense> work;
    VectorXd x = Eigen::Vector2d(begin[0][lane], begin[1][lane]);
    minimize(sum, work, x, 1, kLimits, kAsk);
    CHECK(q[0][lane] == doctest::Approx(x(0)).epsilon(1e-9));
    CHECK(q[1][lane] == doctest::Approx(x(1)).epsilon(1e-9));
  }
}

TEST_CASE("Newton: a lane without a direction or a number does not disturb the others") {
  Hills<EightLanes> hills;
  Potential<EightLanes, Hills<EightLanes>> potential(hills);
  NewtonScratch<EightLanes> scratch;
  LaneVector<DoubleW> q = lanes({2, 1}, 0);
  q[0][3] = std::numeric_limits<double>::quiet_NaN();
  q[1][5] = 1e200;  // cosh overflows
  const auto report = minimize(potential, scratch, q, (1U << kLanes) - 1, kLimits, kAsk);
  CHECK(report.broken == ((1U << 3) | (1U << 5)));
  CHECK(!report.open);
  for (int lane = 0; lane < kLanes; ++lane)
    if (lane != 3 && lane != 5) CHECK(std::abs(q[0][lane]) + std::abs(q[1][lane]) < 1e-9);
}

TEST_CASE("Newton: no step is longer than a term admits") {
  Hills<Dense> hills;
  hills.least = 0.5;  // the minimum at 0 is beyond
  Potential<Dense, Hills<Dense>> potential(hills);
  NewtonScratch<Dense> scratch;
  VectorXd q = VectorXd::Constant(1, 3.0);
  minimize(potential, scratch, q, 1, {1e-10, 1e-12, 200}, kAsk);
  CHECK(q(0) >= 0.5);
  CHECK(q(0) < 0.5 + 1e-6);
}
