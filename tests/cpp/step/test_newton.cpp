// SPDX-License-Identifier: GPL-3.0-or-later
// Newton's method without a rig or a model: on potentials whose minima are known.
#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "dynamorph/step/newton.hpp"
#include "dynamorph/step/terms.hpp"

using namespace dynamorph;

namespace {

ArrowMatrix dense(const MatrixXd& A) {
  ArrowMatrix out(A.rows(), 0);
  out.corner() = A;
  return out;
}

/// Sum of cosh(q_k), whose Hessian is positive, or of (q_k^2 - 1)^2 / 4, which is indefinite within |q| < 0.57.
struct Hills {
  bool wells = false;
  int values = 0, linearizations = 0;

  double value(const VectorXd& q) {
    ++values;
    return energy(q);
  }
  Term<ArrowMatrix> linearize(const VectorXd& q) {
    ++linearizations;
    gradient_ = wells ? VectorXd((q.array().square() - 1) * q.array()) : VectorXd(q.array().sinh());
    const VectorXd curvature = wells ? VectorXd(3 * q.array().square() - 1) : VectorXd(q.array().cosh());
    hessian_ = dense(curvature.asDiagonal());
    return {energy(q), gradient_, hessian_, {gradient_.norm(), 0, q.norm()}};
  }

 private:
  double energy(const VectorXd& q) const {
    return wells ? ((q.array().square() - 1).square() / 4).sum() : q.array().cosh().sum();
  }

  VectorXd gradient_;
  ArrowMatrix hessian_;
};

QuadraticTerm<ArrowMatrix> quadratic_of(const MatrixXd& H, const VectorXd& g, const VectorXd& origin) {
  QuadraticTerm<ArrowMatrix> out;
  out.H = dense(H);
  out.g = g;
  out.origin = origin;
  return out;
}

const NewtonLimits kLimits{1e-10, 1e-12, 60};

/// The report, with `q` moved to the minimum.
template <class... Terms>
NewtonReport minimized(VectorXd& q, const NewtonLimits& limits, Terms&... terms) {
  Potential<ArrowMatrix, Terms...> potential(terms...);
  NewtonScratch<ArrowMatrix> scratch;
  scratch.hessian.base = ArrowMatrix(q.size(), 0);
  return minimize(potential, scratch, q, limits, [] {});
}

}  // namespace

TEST_CASE("Newton: the sum of a quadratic and a hill is least where its derivative is zero") {
  // 1/2 h (q - 1)^2 + g (q - 1) + cosh(q): the root of h (q - 1) + g + sinh(q), found by bisection.
  const double h = 3, g = -0.7;
  double low = -5, high = 5;
  while (high - low > 1e-15)
    (h * ((low + high) / 2 - 1) + g + std::sinh((low + high) / 2) > 0 ? high : low) = (low + high) / 2;

  auto quadratic = quadratic_of(h * MatrixXd::Identity(2, 2), VectorXd::Constant(2, g), VectorXd::Ones(2));
  Hills hills;
  VectorXd q = Eigen::Vector2d(4, -4);
  const NewtonReport report = minimized(q, kLimits, quadratic, hills);
  CHECK(report.converged);
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
      // Where hills alone are odd, Newton's method is better than this test assumes.
      auto quadratic = quadratic_of(MatrixXd::Identity(2, 2), Eigen::Vector2d(-0.5, 0.3), VectorXd::Zero(2));
      Hills hills;
      hills.wells = wells;
      VectorXd q = Eigen::Vector2d(begin, 0.8 * begin);
      const NewtonReport report = minimized(q, kLimits, quadratic, hills);
      CHECK(report.converged);
      if (!wells) {  // no step is halved
        CHECK(report.unseen);
        CHECK(hills.linearizations == report.iterations);  // the first is before the first step
      }
      Potential<ArrowMatrix, QuadraticTerm<ArrowMatrix>, Hills> potential(quadratic, hills);
      Linearization sum;
      potential.linearize(q, sum);
      CHECK(relative_residual(sum, kLimits.tolerance) <= report.residual + 1e-15);
      CHECK(report.residual <= kLimits.tolerance);
    }
}

TEST_CASE("Newton: from where the Hessian is indefinite it goes downhill, to a minimum") {
  Hills wells;
  wells.wells = true;
  VectorXd q = Eigen::Vector3d(0.1, -0.05, 2);
  CHECK(minimized(q, kLimits, wells).converged);
  CHECK((q.cwiseAbs() - VectorXd::Ones(3)).norm() < 1e-8);
  CHECK(q(0) > 0);
  CHECK(q(1) < 0);
}

TEST_CASE("Newton: when it is stopped it has converged only if what is left is nothing") {
  Hills hills;
  VectorXd q = VectorXd::Constant(1, 0.1);
  CHECK(!minimized(q, {1e-15, 1e-6, 2}, hills).converged);  // the second step is some 1e-4
  q(0) = 0.1;
  CHECK(minimized(q, {1e-15, 1e-2, 2}, hills).converged);
}

TEST_CASE("Newton: what is stiff in one place does not hold back what is indefinite in another") {
  auto stiff = quadratic_of(Eigen::Vector2d(1e8, 0).asDiagonal(), VectorXd::Zero(2), VectorXd::Zero(2));
  Hills wells;
  wells.wells = true;
  VectorXd q = Eigen::Vector2d(0, 0.1);
  const NewtonReport report = minimized(q, kLimits, stiff, wells);
  CHECK(report.converged);
  CHECK(report.iterations < 20);
  CHECK(q(1) == doctest::Approx(1).epsilon(1e-9));
}

TEST_CASE("Newton: a step that is too long is halved by values alone") {
  // sqrt(1 + q^2), at which Newton's method goes from q to -q^3.
  struct Bowl {
    int values = 0, linearizations = 0;
    double value(const VectorXd& q) {
      ++values;
      return std::sqrt(1 + q(0) * q(0));
    }
    Term<ArrowMatrix> linearize(const VectorXd& q) {
      ++linearizations;
      const double length = std::sqrt(1 + q(0) * q(0));
      gradient_ = q / length;
      hessian_ = dense(MatrixXd::Constant(1, 1, std::pow(length, -3)));
      return {length, gradient_, hessian_, {1, 0, std::abs(q(0))}};
    }
    VectorXd gradient_;
    ArrowMatrix hessian_;
  } bowl;
  VectorXd q = VectorXd::Constant(1, 2.0);  // the whole step goes to -8
  const NewtonReport report = minimized(q, kLimits, bowl);
  CHECK(report.converged);
  CHECK(std::abs(q(0)) < 1e-9);
  CHECK(bowl.values > 1);
  CHECK(bowl.linearizations <= 2 * report.iterations + 1);  // of the whole step, and of the one that is taken
}

TEST_CASE("Newton: a force that is not finite is reported") {
  for (double begin : {std::numeric_limits<double>::quiet_NaN(), 1e200}) {  // cosh overflows
    Hills hills;
    VectorXd q = VectorXd::Constant(2, begin);
    CHECK(minimized(q, kLimits, hills).broken);
  }
}
