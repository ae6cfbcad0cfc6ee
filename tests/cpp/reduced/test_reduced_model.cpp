// SPDX-License-Identifier: GPL-3.0-or-later
// Reduced models and their bases against full ones.
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "dynamorph/core/errors.hpp"
#include "dynamorph/reduced/basis.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

InertialTarget still(const VectorXd& q, const Transforms& bones) {
  InertialTarget inertial;
  inertial.q.fill(&q);
  inertial.bones.fill(&bones);
  return inertial;
}

}  // namespace

TEST_CASE("full and reduced models: derivatives by finite differences at blended poses") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  VectorXd w(3);
  w << 0.3, 0.7, 1.0;
  for (Law law : kLaws)
    for (Blending blending : kBlendings) {
      const FullModel full(body, targets, law, blending);
      FullModel::Blend blend;
      full.blend(w, blend);
      check_derivatives(evaluator(full, blend), random_vector(full.dofs(), 0.01, 4), 1e-4);

      const MatrixXd U = make_basis(full, 12).U;
      const ReducedModel reduced(body, targets, reduce(full, U), blending);
      ReducedModel::Blend small;
      reduced.blend(w, small);
      check_derivatives(evaluator(reduced, small), random_vector(12, 5e-4, 5), 1e-5);
    }
}

TEST_CASE("reduced = U^T F(U z), energy and tangent too, to 1e-12 of the largest force term") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  for (Law law : kLaws) {
    const FullModel full(body, targets, law, Blending::forces);
    const int r = law == Law::stvk ? 27 : 12;  // more and fewer pairs than a tile of the sums holds
    const MatrixXd U = make_basis(full, r).U;
    const ReducedTables tables = reduce(full, U);
    for (int j = 0; j < 3; ++j) {
      const VectorXd v = random_vector(r, 1e-3, 6);
      FullModel::Blend alone;
      full.blend(VectorXd::Unit(3, j), alone);
      VectorXd F, f;
      SparseMatrix K = full.zero();
      MatrixXd k;
      const double E = full.linearize(alone, full.target(j) + U * v, F, K);
      const VectorXd table =
          unfolded(targets[j].lame.lambda * tables.lambda[j] + targets[j].lame.mu * tables.mu[j], tables.layout());
      const double e = linearize(table, tables.layout(), v, f, k);
      CHECK((f - U.transpose() * F).cwiseAbs().maxCoeff() <= 1e-12 * f.cwiseAbs().maxCoeff());
      CHECK(std::abs(e - E) <= 1e-11 * E);
      CHECK((k - U.transpose() * (K * U)).norm() <= 1e-11 * k.norm());
    }
  }
}

TEST_CASE("blended and in single precision, as it is stepped: to 1e-6 of the largest force term") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  VectorXd w(3);
  w << 0.6, 0.4, 1.0;
  for (Law law : kLaws)
    for (Blending blending : kBlendings) {
      const FullModel full(body, targets, law, blending);
      const MatrixXd U = make_basis(full, 12).U;
      const ReducedModel reduced(body, targets, reduce(full, U), blending);
      FullModel::Blend big;
      ReducedModel::Blend small;
      full.blend(w, big);
      reduced.blend(w, small);
      const VectorXd z = random_vector(12, 1e-3, 6);
      VectorXd F, f;
      SparseMatrix K = full.zero();
      MatrixXd k;
      const double E = full.linearize(big, U * z, F, K), e = reduced.linearize(small, z, f, k);
      const double largest = f.cwiseAbs().maxCoeff();
      CHECK((f - U.transpose() * F).cwiseAbs().maxCoeff() <= 1e-6 * largest);  // 1.4e-7 measured
      CHECK(std::abs(e - E) <= 1e-6 * E);
      CHECK((k - U.transpose() * (K * U)).norm() <= 1e-6 * k.norm());
    }
}

TEST_CASE("no target at all: no force and no energy") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const FullModel full(body, targets, Law::stvk, Blending::forces);
  const ReducedModel reduced(body, targets, reduce(full, make_basis(full, 10).U), Blending::forces);
  ReducedModel::Blend blend;
  reduced.blend(VectorXd::Zero(3), blend);
  VectorXd force;
  MatrixXd stiffness;
  CHECK(reduced.linearize(blend, VectorXd::Ones(10), force, stiffness) == 0);
  CHECK(force.norm() == 0);
}

TEST_CASE("basis: orthonormal in mass, holds the targets' shapes, zero rank deficiency") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const FullModel model(body, targets, Law::stvk, Blending::even);
  const Basis basis = make_basis(model, 14);
  const VectorXd zero = VectorXd::Zero(model.dofs());
  const Transforms rest = scenes::bent(0);
  FullModel::Inertia inertia;
  model.inertia(still(zero, rest), {VectorXd::Ones(1), VectorXd::Zero(1)}, inertia);
  const SparseMatrix& M = inertia.mass;
  CHECK((basis.U.transpose() * (M * basis.U) - MatrixXd::Identity(14, 14)).norm() < 1e-10);
  for (int j = 0; j < 3; ++j) {
    const VectorXd d = model.target(j);
    CHECK((basis.U * (basis.U.transpose() * (M * d)) - d).norm() <= 1e-10 * (1e-3 + d.norm()));
  }
  CHECK(basis.explained_variance > 0.9);
  CHECK_THROWS_AS(make_basis(model, 2), Error);
}
