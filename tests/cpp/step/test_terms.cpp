// SPDX-License-Identifier: GPL-3.0-or-later
// Every term of a step's potential, over models and laws: derivatives, and what grabbing a point does.
#include <doctest/doctest.h>

#include <Eigen/Cholesky>

#include "check_term.hpp"
#include "dynamorph/step/simulation.hpp"
#include "scenes.hpp"
#include "skins.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

const VectorXd kBetween = Vector3d(0.2, 0.5, 0.3);

template <class Model>
void check_terms(std::shared_ptr<const Model> model) {
  using Matrix = typename Model::Matrix;
  constexpr double kStep = 1e-2;  // in coordinates in which all stiffness is about one
  typename Model::Blend blend;
  model->blend(kBetween, blend);
  Matrix K = model->zero();
  VectorXd force;
  model->linearize(blend, VectorXd::Zero(model->dofs()), force, K);
  const VectorXd scales = K.diagonal().cwiseAbs().cwiseSqrt().cwiseInverse();

  ElasticTerm<Model> elastic;
  elastic.begin(*model, blend, 0, 0);
  check_term<Matrix>(elastic, scales, kStep);

  QuadraticTerm<Matrix> quadratic;
  quadratic.H = K;
  quadratic.g = random_vector(scales.size(), 1, 22);
  quadratic.origin = kStep * scales;
  check_term<Matrix>(quadratic, scales, kStep);

  const auto skin = std::make_shared<const SkinMap<Model>>(model, skin_of(model->body(), 3));
  const Transforms bones = bent(0.4);
  const Grabs<Model> grabs{skin, {{0, Vector3d(0.4, 0.1, 0.2), 3000}, {2, Vector3d(-0.1, 0.3, 0), 500}}};
  GrabTerm<Model> grabbed;
  grabbed.begin(*model, {bones, kBetween, nullptr, &grabs});
  check_term<Matrix>(grabbed, scales, kStep);

  grabbed.begin(*model, {bones, kBetween});  // nothing is grabbed, and nothing acts
  CHECK(grabbed.value(scales) == 0);
  const auto nothing = grabbed.linearize(scales);
  CHECK(nothing.value == 0);
  CHECK(nothing.gradient.isZero(0));
  CHECK(nothing.hessian.stiffness.size() == 0);
}

}  // namespace

TEST_CASE("terms: gradients and Hessians are the derivatives of the energies, over models and laws") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  for (MaterialModel material_model : kMaterialModels)
    for (Blending blending : kBlendings) {
      check_terms(std::make_shared<const FullModel>(body, all, material_model, blending));
      check_terms(reduced_model(body, all, material_model, blending, 10));
      check_terms(ResponseScene(body, all, material_model, blending).model);
    }
}

namespace {

/// Where the grabbed points come to rest: their distance from the goals, of a linear body, from dense matrices.
template <class Model>
void check_rest(std::shared_ptr<const Model> model, double stiffness) {
  const auto skin = std::make_shared<const SkinMap<Model>>(model, skin_of(model->body(), 3));
  const Transforms bones = bent(0.4);
  const Grabs<Model> grabs{skin, {{0, Vector3d(0.45, 0.35, 0.0), stiffness}, {1, Vector3d(0.4, 0.3, 0.05), stiffness}}};
  StepOptions options{1 / 120., Integrator::bdf2};
  options.tolerance = 1e-10;
  MovingBody<Model> moving(model, options);
  VectorXd q, x;
  CHECK(moving.solve_static({bones, kBetween, nullptr, &grabs}, q).converged);
  skin->positions(bones, kBetween, q, x);

  typename Model::Blend blend;
  typename Model::Matrix K = model->zero();
  VectorXd force, Kd, column;
  model->blend(kBetween, blend);
  model->linearize(blend, VectorXd::Zero(q.size()), force, K);
  const int n = int(q.size());
  MatrixXd stiff(n, n), J(6, n);
  VectorXd unmoved(6), goals(6), still;
  skin->positions(bones, kBetween, VectorXd::Zero(n), still);
  for (int i = 0; i < n; ++i) {
    multiply(K, VectorXd::Unit(n, i), column);
    stiff.col(i) = column;
    skin->positions(bones, kBetween, VectorXd::Unit(n, i), column);
    J.col(i) = (column - still).head(6);
  }
  for (int k = 0; k < 2; ++k) goals.segment<3>(3 * k) = grabs.springs[std::size_t(k)].goal;
  unmoved = still.head(6);
  const MatrixXd sum = stiff + stiffness * J.transpose() * J;
  const VectorXd expected = sum.ldlt().solve(-force - stiffness * J.transpose() * (unmoved - goals));
  CHECK((q - expected).norm() <= 1e-6 * expected.norm());
  // The stiffer the spring, the nearer the points: what is left is the force over the spring's stiffness.
  if (stiffness >= 1e6) CHECK((x.head(6) - goals).cwiseAbs().maxCoeff() < 1e-3);
}

}  // namespace

TEST_CASE("grabbed points rest where the springs and the body balance, soft and stiff, for every model") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  for (double stiffness : {10.0, 1e6}) {
    check_rest(std::make_shared<const FullModel>(body, all, MaterialModel::linear, Blending::even), stiffness);
    check_rest(reduced_model(body, all, MaterialModel::linear, Blending::even, 12), stiffness);
    check_rest(ResponseScene(body, all, MaterialModel::linear, Blending::even).model, stiffness);
  }
}

TEST_CASE("a point that is grabbed follows its goal through a step, and what is let go swings back") {
  const auto body = two_bone_bar();
  const auto model = ResponseScene(body, targets(*body), MaterialModel::stable_stvk, Blending::even).model;
  const auto skin = std::make_shared<const SkinMap<ReducedModel>>(model, skin_of(*body, 3));
  MovingBody<ReducedModel> moving(model, {1 / 120., Integrator::bdf2});
  Simulation<ReducedModel> simulation(moving);
  const Transforms bones = bent(0);
  const VectorXd neutral = Vector3d(1, 0, 0);
  moving.start({bones, neutral}, bones);
  VectorXd x;
  skin->positions(bones, neutral, moving.coordinates(), x);
  const Vector3d rest = x.head<3>();
  Grabs<ReducedModel> grabs{skin, {{0, rest, 1e5}}};
  for (int i = 1; i <= 40; ++i) {
    grabs.springs[0].goal = rest + Vector3d(0, 0, 0.03 * std::min(1.0, i / 20.0));
    CHECK(simulation.step({bones, neutral, nullptr, &grabs}).converged);
  }
  skin->positions(bones, neutral, moving.coordinates(), x);
  CHECK((x.head<3>() - grabs.springs[0].goal).norm() < 1e-3);
  for (int i = 0; i < 4000; ++i) CHECK(simulation.step({bones, neutral}).converged);
  skin->positions(bones, neutral, moving.coordinates(), x);
  CHECK((x.head<3>() - rest).norm() < 1e-4);
}

TEST_CASE("a grab of a point that is not there is refused before anything moves") {
  const auto body = two_bone_bar();
  const auto model = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 8);
  MovingBody<ReducedModel> moving(model, {1 / 120.});
  Simulation<ReducedModel> simulation(moving);
  const Transforms bones = bent(0);
  const VectorXd neutral = Vector3d(1, 0, 0);
  moving.start({bones, neutral}, bones);
  const VectorXd before = moving.coordinates();
  auto skin = std::make_shared<const SkinMap<ReducedModel>>(model, skin_of(*body, 3));
  const auto refused = [&](const char* what, const Grab& grab) {
    const Grabs<ReducedModel> grabs{skin, {grab}};
    CHECK_THROWS_WITH_AS(simulation.step({bones, neutral, nullptr, &grabs}), doctest::Contains(what),
                         std::invalid_argument);
    CHECK(moving.coordinates() == before);
  };
  refused("expected points from 0 to 2, got 3", {3, Vector3d::Zero(), 1});
  refused("goals must be finite", {0, Vector3d(0, NAN, 0), 1});
  refused("not negative", {0, Vector3d::Zero(), -1});
  const auto other = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 8);
  skin = std::make_shared<const SkinMap<ReducedModel>>(other, skin_of(*body, 3));
  refused("another model", {0, Vector3d::Zero(), 1});
}
