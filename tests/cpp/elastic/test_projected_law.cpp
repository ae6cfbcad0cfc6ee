// SPDX-License-Identifier: GPL-3.0-or-later
// The laws with a projected tangent: derivatives by finite differences, and what projection leaves out.
#include <doctest/doctest.h>

#include <Eigen/Eigenvalues>

#include "dynamorph/elastic/projected_law.hpp"

using namespace dynamorph;

namespace {

constexpr double kVolume = 0.7, kLambda = 20, kMu = 1.5, kLeast = 0.1;

struct Law {
  double c;
  VolumeLaw (*at)(double J);
};
const Law kLaws[] = {{kMu, [](double J) { return stable_volume(kLambda, kMu, J); }},
                     {0, [](double J) { return volume_barrier(0.3, kLeast, J); }}};

Gradients gradients() {
  Matrix3d edges;
  edges << 1, 0.2, 0.1, 0, 0.9, 0.3, 0.1, 0, 1.2;
  return gradients_of(edges);
}

Matrix3d gradient_at(const VectorXd& u) {
  return Matrix3d::Identity() + Eigen::Map<const Eigen::Matrix<double, 3, 4>>(u.data()) * gradients().transpose();
}

double energy_at(const Law& law, const VectorXd& u) {
  const Matrix3d F = gradient_at(u);
  return kVolume * energy(law.c, law.at(F.determinant()), F);
}

void linearize_at(const Law& law, const VectorXd& u, VectorXd& forces, Tangent& tangent) {
  const Matrix3d F = gradient_at(u);
  Forces f = Forces::Zero();
  tangent.setZero();
  linearize(law.c, law.at(F.determinant()), F, gradients(), kVolume, f, tangent);
  forces = f.reshaped();
}

VectorXd some(double size) { return size * VectorXd::LinSpaced(12, -1, 1).array().cos() - 0.3 * size; }

}  // namespace

TEST_CASE("forces are the energy's derivative, the tangent theirs where nothing is left out") {
  for (const Law& law : kLaws)
    for (const double size : {0.02, 0.2}) {
      const VectorXd u = some(size);
      VectorXd forces, ahead, behind;
      Tangent tangent, other;
      linearize_at(law, u, forces, tangent);
      Tangent exact;
      const double h = 1e-6;
      for (int i = 0; i < 12; ++i) {
        const VectorXd step = h * VectorXd::Unit(12, i);
        CHECK(forces(i) ==
              doctest::Approx((energy_at(law, u + step) - energy_at(law, u - step)) / (2 * h)).epsilon(1e-5));
        linearize_at(law, u + step, ahead, other);
        linearize_at(law, u - step, behind, other);
        exact.col(i) = (ahead - behind) / (2 * h);
      }
      // The projected tangent is never below the exact one, and equal to it where that has no negative part.
      const Eigen::SelfAdjointEigenSolver<Tangent> more(tangent - exact), own(tangent), eigen(exact);
      const double scale = exact.norm();
      CHECK(more.eigenvalues().minCoeff() > -1e-6 * scale);
      CHECK(own.eigenvalues().minCoeff() > -1e-12 * scale);
      if (eigen.eigenvalues().minCoeff() > -1e-6 * scale) CHECK((tangent - exact).norm() < 1e-6 * scale);
    }
}

TEST_CASE("at rest the laws exert nothing, and the stable one is as stiff as Hooke's") {
  VectorXd forces;
  Tangent tangent;
  for (const Law& law : kLaws) {
    linearize_at(law, VectorXd::Zero(12), forces, tangent);
    CHECK(forces.norm() < 1e-12);
  }
  // A small shear costs 2 mu e:e.
  linearize_at(kLaws[0], VectorXd::Zero(12), forces, tangent);
  Matrix3d edges;
  edges << 1, 0.2, 0.1, 0, 0.9, 0.3, 0.1, 0, 1.2;
  VectorXd u = VectorXd::Zero(12);
  const double shear = 1e-3;
  for (int k = 0; k < 3; ++k) u(3 * (k + 1)) = shear * edges(1, k);  // x by y
  CHECK(0.5 * u.dot(tangent * u) == doctest::Approx(kVolume * kMu * shear * shear / 2).epsilon(1e-9));
}

TEST_CASE("the projected tangent has no negative part where tissue is crushed or inside out") {
  for (const double size : {0.6, 0.9, 1.5}) {
    VectorXd forces;
    Tangent tangent;
    linearize_at(kLaws[0], some(size), forces, tangent);
    CHECK(forces.allFinite());
    CHECK(Eigen::SelfAdjointEigenSolver<Tangent>(tangent).eigenvalues().minCoeff() > -1e-9 * tangent.norm());
  }
}

TEST_CASE("no volume passes the barrier") {
  CHECK(volume_barrier(1, kLeast, kLeast).value == kInfinity);
  CHECK(volume_barrier(1, kLeast, -1).value == kInfinity);
  CHECK(volume_barrier(1, kLeast, 0.11).value > volume_barrier(1, kLeast, 0.2).value);
  CHECK(volume_barrier(1, kLeast, 1).value == doctest::Approx(0));
  CHECK(volume_barrier(1, kLeast, 1).slope == doctest::Approx(0));
}
