// SPDX-License-Identifier: GPL-3.0-or-later
// Reduced models and their bases against full ones.
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "dynamorph/core/errors.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
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
  for (MaterialModel material_model : kMaterialModels)
    for (Blending blending : kBlendings) {
      const FullModel full(body, targets, material_model, blending);
      FullModel::Blend blend;
      full.blend(w, blend);
      check_derivatives(evaluator(full, blend), random_vector(full.dofs(), 0.01, 4), 1e-4);

      const MatrixXd U = make_basis(full, 12).U;
      const ReducedModel reduced(body, targets, reduce(full, U), blending);
      ReducedModel::Blend small;
      reduced.blend(w, small);
      // Exact for a polynomial of fourth degree, so that a long step loses nothing but round-off.
      check_derivatives(evaluator(reduced, small), random_vector(12, 5e-4, 5), 5e-4);
    }
}

TEST_CASE("reduced = U^T F(U z), energy and tangent too, to 1e-12 of the largest force term") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  for (MaterialModel material_model : kMaterialModels) {
    const FullModel full(body, targets, material_model, Blending::forces);
    const int r =
        material_model == MaterialModel::stvk ? 27 : 12;  // more and fewer pairs than a tile of the sums holds
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
  for (MaterialModel material_model : kMaterialModels)
    for (Blending blending : kBlendings) {
      const FullModel full(body, targets, material_model, blending);
      const MatrixXd U = make_basis(full, 12).U;
      const ReducedModel reduced(body, targets, reduce(full, U), blending);
      FullModel::Blend big;
      ReducedModel::Blend small;
      full.blend(w, big);
      reduced.blend(w, small);
      const VectorXd z = random_vector(12, 1e-3, 6);
      VectorXd F, f;
      SparseMatrix K = full.zero();
      ArrowMatrix tangent;
      const double E = full.linearize(big, U * z, F, K), e = reduced.linearize(small, z, f, tangent);
      const MatrixXd k = tangent.dense();
      const double largest = f.cwiseAbs().maxCoeff();
      CHECK((f - U.transpose() * F).cwiseAbs().maxCoeff() <= 1e-6 * largest);  // 1.4e-7 measured
      CHECK(std::abs(e - E) <= 1e-6 * E);
      CHECK((k - U.transpose() * (K * U)).norm() <= 1e-6 * k.norm());
    }
}

TEST_CASE("a target that is stiffer at the moment is one of a stiffer material") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const Vector3d stiffness(2, 0.5, 3);
  auto stiffer = targets;
  for (int j = 0; j < 3; ++j)
    stiffer[std::size_t(j)].lame = {stiffness(j) * targets[std::size_t(j)].lame.lambda,
                                    stiffness(j) * targets[std::size_t(j)].lame.mu};
  const auto compare = [&](const auto& plain, const auto& stiff, double tolerance) {
    using Model = std::decay_t<decltype(plain)>;
    typename Model::Blend at_the_moment;  // which was of other poses and materials before
    for (const Vector3d& w : {Vector3d(0.3, 0.5, 0.2), Vector3d(0, 1, 0), Vector3d(0.3, 0.5, 0.2)}) {
      typename Model::Blend of_material;
      plain.blend(w, at_the_moment);
      plain.blend(w, w.cwiseProduct(stiffness), at_the_moment);
      stiff.blend(w, of_material);
      const VectorXd q = random_vector(plain.dofs(), 1e-3, 7);
      VectorXd force, expected;
      typename Model::Matrix K = plain.zero(), expected_K = plain.zero();
      const double energy = plain.linearize(at_the_moment, q, force, K);
      CHECK(std::abs(energy - stiff.linearize(of_material, q, expected, expected_K)) <= tolerance * energy);
      CHECK((force - expected).norm() <= tolerance * expected.norm());
      CHECK((values(K) - values(expected_K)).norm() <= tolerance * values(expected_K).norm());
      CHECK((values(at_the_moment.damping) - values(of_material.damping)).norm() <=
            tolerance * values(of_material.damping).norm());
      CHECK(at_the_moment.mass.density == of_material.mass.density);
    }
  };
  for (MaterialModel material_model : kMaterialModels)
    for (Blending blending : kBlendings) {
      const FullModel full(body, targets, material_model, blending);
      compare(full, FullModel(body, stiffer, material_model, blending), 1e-11);
      const ReducedTables tables = reduce(full, make_response_basis(full, 8, 12));
      compare(ReducedModel(body, targets, tables, blending), ReducedModel(body, stiffer, tables, blending), 1e-5);
    }
}

TEST_CASE("no target at all: no force and no energy") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const FullModel full(body, targets, MaterialModel::stvk, Blending::forces);
  const ReducedModel reduced(body, targets, reduce(full, make_basis(full, 10).U), Blending::forces);
  ReducedModel::Blend blend;
  reduced.blend(VectorXd::Zero(3), blend);
  VectorXd force;
  ArrowMatrix stiffness;
  CHECK(reduced.linearize(blend, VectorXd::Ones(10), force, stiffness) == 0);
  CHECK(force.norm() == 0);
}

TEST_CASE("basis: orthonormal in mass, holds the targets' shapes, zero rank deficiency") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  const FullModel model(body, targets, MaterialModel::stvk, Blending::even);
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

namespace {

/// The largest principal angle's cosine between the spans of two bases that are orthonormal in mass.
double least_cosine(const SoftBody& body, const MatrixXd& U, const MatrixXd& V) {
  const VectorXd mass = body.unit_mass();
  const MatrixXd across = U.transpose() * mass.asDiagonal() * V;
  return Eigen::JacobiSVD<MatrixXd>(across).singularValues().minCoeff();
}

}  // namespace

TEST_CASE("curvatures are the second derivatives of the force, of all sets together and in any order of targets") {
  const auto body = scenes::two_bone_bar(2);
  auto targets = scenes::targets(*body, 1);
  targets.push_back(targets[0]);  // the neutral of set 1, after its other target's neutral in no order of sets
  targets.back().set = 1;
  targets.back().lame = {7e3, 3e4};
  std::swap(targets[2], targets[3]);
  std::swap(targets[1], targets[2]);  // sets 0, 1, 0, 1
  const int neutral_of_other[] = {1, 0, 1, 0};
  for (int trial = 0; trial < 12; ++trial) {
    const int j = trial / 3;
    const FullModel model(body, targets, kMaterialModels[trial % 3], Blending::even);
    VectorXd w = VectorXd::Unit(4, j);
    w(neutral_of_other[j]) = 1;
    FullModel::Blend blend;
    model.blend(w, blend);
    MatrixXd modes(model.dofs(), 2);
    modes << random_vector(model.dofs(), 0.01, 7), random_vector(model.dofs(), 0.01, 8);
    const auto image = [&](double step, int k, int l) {
      VectorXd force;
      SparseMatrix K = model.zero();
      model.linearize(blend, model.target(j) + step * modes.col(k), force, K);
      return VectorXd(K * modes.col(l));
    };
    const MatrixXd curvatures = force_curvatures(model, j, modes);
    for (int k = 0, pair = 0; k < 2; ++k)
      for (int l = k; l < 2; ++l, ++pair) {
        const VectorXd expected = (image(1, k, l) - image(-1, k, l)) / 2;  // exact: K is quadratic
        CHECK((curvatures.col(pair) - expected).norm() <= 1e-10 * expected.norm());
      }
  }
}

TEST_CASE("a bar in two sets of half the weight each has the modes of the bar in one set") {
  const auto one = scenes::two_bone_bar(1), two = scenes::two_bone_bar(2);
  MorphTarget first = scenes::targets(*one)[0], second = first;
  second.set = 1;
  for (MaterialModel material_model : kMaterialModels) {
    const MatrixXd U = make_basis(FullModel(one, {first}, material_model, Blending::even), 20).U;
    const MatrixXd V = make_basis(FullModel(two, {first, second}, material_model, Blending::even), 20).U;
    CHECK(least_cosine(*one, U, V) > 1 - 1e-9);
  }
}

TEST_CASE("modes do not depend on the order of the targets") {
  const auto body = scenes::two_bone_bar(2);
  auto targets = scenes::targets(*body, 1);
  targets.push_back(targets[2]);
  targets[2] = targets[0];
  targets[2].set = 1;  // neutral 0, bulge 0, neutral 1, twist 1
  const MatrixXd U = make_basis(FullModel(body, targets, MaterialModel::stvk, Blending::even), 20).U;
  std::swap(targets[1], targets[2]);
  const MatrixXd V = make_basis(FullModel(body, targets, MaterialModel::stvk, Blending::even), 20).U;
  CHECK(least_cosine(*body, U, V) > 1 - 1e-9);
}
