// SPDX-License-Identifier: GPL-3.0-or-later
// Models with responses in motion: their inertia, what they move like, and that they never gain energy.
#include <doctest/doctest.h>

#include <Eigen/Eigenvalues>
#include <limits>

#include "dynamorph/reduced/modes/static_solver.hpp"
#include "dynamorph/step/simulation.hpp"
#include "reduced/motion.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

/// Two bones that move as one body.
Transforms turned(double angle, const Vector3d& translation) {
  return pose_of(2, [&](int) {
    Affine T;
    T << Eigen::AngleAxisd(angle, Vector3d(0.2, 1, 0.3).normalized()).toRotationMatrix(), translation;
    return T;
  });
}

/// The same body, with nodes that each move with their first bone alone.
std::shared_ptr<const SoftBody> unblended(const SoftBody& body) {
  MatrixXd weights = MatrixXd::Zero(Eigen::Index(body.free_of_node.size()), body.skin.cols());
  std::vector<bool> pinned(body.free_of_node.size());
  for (size_t i = 0; i < pinned.size(); ++i) {
    const int free = body.free_of_node[i];
    pinned[i] = free < 0;
    weights(Eigen::Index(i), pinned[i] ? 0 : SkinWeights::InnerIterator(body.skin, free).col()) = 1;
  }
  return std::make_shared<SoftBody>(body.mesh, body.fill, VectorXd::Ones(body.fill.size()), body.region_weights, pinned,
                                    weights);
}

std::vector<MorphTarget> neutral_of(const SoftBody& body) { return {targets(body)[0]}; }

}  // namespace

TEST_CASE("inertia of responses: at rest the mass is the full model's, projected") {
  for (int sets : {1, 2}) {
    const auto body = two_bone_bar(sets);
    const ResponseScene scene(body, targets(*body, sets - 1), MaterialModel::linear, Blending::even);
    const int r = scene.model->modes(), h = scene.model->dofs() - r;
    const MatrixXd basis = side_by_side(scene.basis);
    const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::LinSpaced(sets, 300, 0)};
    const Moving moving(basis, 1, [](int) { return turned(0, Vector3d::Zero()); });
    auto [mass, damped, force] = moving.projected(scene.full, densities);
    const Moving::Inertia found = moving.reduced(*scene.model, densities);
    // The responses act on each other through their diagonal alone: all there is, when the density is one.
    const MatrixXd apart = mass.bottomRightCorner(h, h).diagonal().asDiagonal();
    if (sets == 1) CHECK((mass.bottomRightCorner(h, h) - apart).norm() <= 1e-9 * mass.norm());
    mass.bottomRightCorner(h, h) = apart;
    damped.bottomRightCorner(h, h) = MatrixXd(damped.bottomRightCorner(h, h).diagonal().asDiagonal());
    CHECK((mass - found.mass).norm() <= 1e-6 * mass.norm());
    CHECK((damped - found.damped).norm() <= 1e-6 * damped.norm());
    CHECK(mass.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff() > 0);
    if (sets == 2) continue;
    CHECK((force - found.force).norm() <= 1e-6 * force.norm());
  }
}

TEST_CASE("inertia of responses: of bones that move as one body it is the full model's, projected") {
  for (int sets : {1, 2}) {
    const auto body = two_bone_bar(sets);
    const ResponseScene scene(body, targets(*body, sets - 1), MaterialModel::linear, Blending::even);
    const MatrixXd basis = side_by_side(scene.basis);
    const int h = int(scene.basis.W.cols());
    const SetDensities densities{VectorXd::Constant(sets, 900), VectorXd::Constant(sets, 300)};
    for (bool turns : {true, false}) {  // while the coordinates are still; or the rig only flies while they move
      const Moving moving(basis, turns ? 0 : 1, [&](int n) {
        return turned(turns ? 1.2 - 0.2 * n : 1.2, Vector3d(3 - 0.1 * n, -1, 0.02 * n * n));
      });
      const auto [mass, damped, force] = moving.projected(scene.full, densities);
      const Moving::Inertia found = moving.reduced(*scene.model, densities);
      CHECK((mass - found.mass).norm() <= 1e-6 * mass.norm());
      CHECK((force - found.force).norm() <= 1e-6 * force.norm());
      CHECK((force - found.force).tail(h).norm() <= 1e-5 * force.tail(h).norm());
    }
  }
}

TEST_CASE("inertia of responses: nodes with transforms of their own are as if their bones had posed them") {
  for (int sets : {1, 2}) {
    const auto body = two_bone_bar(sets);
    const auto all = targets(*body, sets - 1);
    const ResponseScene scene(body, all, MaterialModel::linear, Blending::even);
    const auto own = with_own_transforms(*body);
    const ReducedModel nodal(own, all, scene.tables, Blending::even);
    const MatrixXd basis = side_by_side(scene.basis);
    const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::LinSpaced(sets, 300, 100)};
    for (double stretch : {1.0, 1.2}) {
      Moving moving(basis, 1, [&](int n) {
        return Transforms(stretch * turned(1.2 - 0.2 * n, Vector3d(3 - 0.1 * n, -1, 0.02 * n * n)));
      });
      const Moving::Inertia expected = moving.reduced(*scene.model, densities);
      moving.use_nodes(*body);
      const Moving::Inertia found = moving.reduced(nodal, densities);
      CHECK((expected.mass - found.mass).norm() <= 1e-6 * expected.mass.norm());
      CHECK((expected.damped - found.damped).norm() <= 1e-6 * expected.damped.norm());
      CHECK((expected.force - found.force).norm() <= 1e-6 * expected.force.norm());
    }
  }
}

TEST_CASE(
    "inertia of responses: where one bone scales, the mass of each is the full model's, up to the blending of bones") {
  for (int sets : {1, 2})
    for (bool blended : {false, true}) {
      const auto whole = chain_bar(4, sets), body = blended ? whole : unblended(*whole);
      const auto all = targets(*body, sets - 1);
      const ResponseScene scene(body, all, MaterialModel::linear, Blending::even);
      const ReducedModel nodal(with_own_transforms(*body), all, scene.tables, Blending::even);
      const MatrixXd basis = side_by_side(scene.basis);
      const int h = int(scene.basis.W.cols());
      const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::LinSpaced(sets, 300, 100)};
      for (int bone = 0; bone < 4; ++bone)
        for (double scale : {0.7, 1.5}) {
          Moving moving(basis, 1, [&](int) {
            return pose_of(4, [&](int b) {
              Affine T;
              T << (b == bone ? scale : 1) * Matrix3d::Identity(), Vector3d(0.1, 0, 0);
              return T;
            });
          });
          const Moving::Inertia expected = moving.projected(scene.full, densities);
          const auto off = [&](const Moving::Inertia& found) {
            const auto parts = [&](const MatrixXd& mass) { return mass.diagonal().tail(h); };
            return std::max((parts(found.mass) - parts(expected.mass)).norm() / parts(expected.mass).norm(),
                            (parts(found.damped) - parts(expected.damped)).norm() / parts(expected.damped).norm());
          };
          CAPTURE(bone);
          CAPTURE(scale);
          const Moving::Inertia found = moving.reduced(*scene.model, densities);
          CHECK(off(found) <= (blended ? 0.03 : 1e-6));  // a mean scale of all bones is 15 and 26 % off
          CHECK(found.mass.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff() > 0);
          moving.use_nodes(*body);
          CHECK(off(moving.reduced(nodal, densities)) <= 1e-6);
        }
    }
}

TEST_CASE("inertia of responses: the mass is positive definite in poses that bend and stretch") {
  const auto body = two_bone_bar();
  const ResponseScene scene(body, neutral_of(*body), MaterialModel::linear, Blending::even);
  const MatrixXd basis = side_by_side(scene.basis);
  const SetDensities densities{VectorXd::Constant(1, 1000), VectorXd::Constant(1, 300)};
  const auto least = [&](const Transforms& pose) {
    const Moving moving(basis, 1, [&](int) { return pose; });
    return moving.reduced(*scene.model, densities).mass.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff();
  };
  for (double angle : {0.0, 0.5, 1.5, 3.0}) CHECK(least(bent(angle)) > 0);
  for (double scale : {0.3, 0.5, 2.0, 3.0}) {
    CHECK(least(scale * bent(0.5)) > 0);
    for (int bone : {0, 1}) {
      Transforms one = bent(0.0);
      one.row(bone) *= scale;
      CAPTURE(bone);
      CAPTURE(scale);
      CHECK(least(one) > 0);
    }
  }
}

TEST_CASE("responses: small motion of a bending rig is that of the whole subspace without simplification") {
  const auto body = two_bone_bar();
  const auto neutral = neutral_of(*body);
  const ResponseScene scene(body, neutral, MaterialModel::stvk, Blending::even, 8, 16);
  // The linear law in modes alone that span the same.
  const VectorXd mass = body->unit_mass();
  const MatrixXd both = side_by_side(scene.basis);
  const MatrixXd inverse =
      MatrixXd(both.transpose() * mass.asDiagonal() * both).llt().matrixL().solve(both.transpose());
  const FullModel linear(body, neutral, MaterialModel::linear, Blending::even);
  const auto reference =
      std::make_shared<ReducedModel>(body, neutral, reduce(linear, inverse.transpose()), Blending::even);
  const auto motion = [&](const auto& model, double angle) {
    StepOptions options{1 / 240.};
    options.tolerance = 1e-12;
    MovingBody<ReducedModel> moving(model, options);
    Simulation<ReducedModel> simulation(moving);
    const auto rig = [&](int step) { return bent(angle * std::sin(0.15 * step)); };
    moving.start({rig(0), VectorXd::Ones(1)}, rig(1));
    MatrixXd path(model->basis().rows(), 80);
    for (int step = 1; step <= 80; ++step) {
      CHECK(simulation.step({rig(step), VectorXd::Ones(1)}).converged);
      VectorXd u;
      model->displacement(moving.coordinates(), u);
      path.col(step - 1) = u;
    }
    return path;
  };
  double before = 0.2;  // at 0.1
  for (double angle : {1e-2, 1e-3, 1e-4}) {
    const MatrixXd expected = motion(reference, angle);
    const double error = (motion(scene.model, angle) - expected).norm() / expected.norm();
    CHECK(error <= 0.2 * before);  // what differs is of second order
    before = error;
  }
  CHECK(before < 1e-3);
}

TEST_CASE("responses: stiffness, density and damping can change without a rebuild") {
  const auto body = two_bone_bar();
  const auto before = neutral_of(*body);
  auto after = before;
  after[0].lame = {3 * before[0].lame.lambda, 3 * before[0].lame.mu};
  after[0].density = 700;
  after[0].mass_damping = 0.3;
  after[0].stiffness_damping = 0.001;
  for (MaterialModel material_model : kMaterialModels)
    for (Blending blending : kBlendings) {
      const ResponseScene old(body, before, material_model, blending), rebuilt(body, after, material_model, blending);
      const auto retuned = std::make_shared<ReducedModel>(body, after, old.tables, blending);
      const auto motion = [&](const auto& model) {
        MovingBody<ReducedModel> moving(model, {1 / 120., Integrator::bdf2, Vector3d(0, 0, -9.81), 1e-10});
        Simulation<ReducedModel> simulation(moving);
        moving.start({bent(0), VectorXd::Ones(1)}, bent(0.02));
        VectorXd u;
        for (int step = 1; step <= 40; ++step) simulation.step({bent(0.02 * step), VectorXd::Ones(1)});
        model->displacement(moving.coordinates(), u);
        return u;
      };
      const VectorXd expected = motion(rebuilt.model);
      CHECK((motion(retuned) - expected).norm() <= 1e-5 * expected.norm());
      CHECK((motion(old.model) - expected).norm() > 0.1 * expected.norm());
    }
}

TEST_CASE("responses: retuned to other ratios of stiffness, the relaxed modes have the full model's energy") {
  for (MaterialModel material_model : kMaterialModels) {
    const auto body = two_bone_bar();
    auto all = targets(*body);
    const ResponseScene old(body, all, material_model, Blending::even);
    for (MorphTarget& target : all) std::swap(target.lame.lambda, target.lame.mu);
    const FullModel full(body, all, material_model, Blending::even);
    const ReducedModel retuned(body, all, old.tables, Blending::even);
    for (int j = 0; j < 3; ++j) {
      const VectorXd w = VectorXd::Unit(3, j), v = 0.05 * motion_of_size(old, 4);
      VectorXd q = retuned.target(j), u;
      q.head(retuned.modes()) += v;
      q.tail(retuned.dofs() - retuned.modes()) -= old.tables.relaxation[j] * v;
      retuned.displacement(q, u);
      FullModel::Blend exact;
      full.blend(w, exact);
      ReducedModel::Blend blend;
      retuned.blend(w, blend);
      CHECK(retuned.energy(blend, q) == doctest::Approx(full.energy(exact, u)).epsilon(1e-5));
    }
  }
}

TEST_CASE("responses: free motion from afar never gains energy, over 2,000 steps") {
  for (int sets : {1, 2}) {
    const auto body = two_bone_bar(sets);
    auto all = targets(*body, sets - 1);
    for (MorphTarget& target : all) target.mass_damping = target.stiffness_damping = 0;
    for (MaterialModel material_model : {MaterialModel::stvk, MaterialModel::stable_stvk})
      for (Integrator integrator : {Integrator::bdf2, Integrator::implicit_euler}) {
        const ResponseScene scene(body, all, material_model, Blending::even);
        const int r = scene.model->modes();
        const VectorXd w = sets == 1 ? Vector3d(0.7, 0.3, 0) : Vector3d(0.7, 0.3, 1);
        for (double distance : {0.05, 0.3}) {  // of the body's size
          MovingBody<ReducedModel> moving(scene.model, {1 / 240., integrator});
          Simulation<ReducedModel> simulation(moving);
          moving.start({bent(0), w}, bent(0));
          State state = moving.state();
          const double rest = moving.elastic_energy();
          const VectorXd far = motion_of_size(scene, 12);
          for (VectorXd& q : state.q) q.head(r) += distance * far;
          moving.set_state(state);
          const double begin = moving.elastic_energy() - rest;
          CHECK(begin > 0);
          double most = 0, end = 0;
          int open = 0;
          for (int step = 1; step <= 2000; ++step) {
            open += !simulation.step({bent(0), w}).converged;
            end = moving.elastic_energy() + moving.kinetic_energy() - rest;
            most = std::max(most, end);
          }
          CHECK(open == 0);
          CHECK(moving.coordinates().allFinite());
          CHECK(most <= 1.01 * begin);
          CHECK(end < begin);
          CHECK(end >= -1e-6 * begin);
        }
      }
  }
}

TEST_CASE("responses: the energy is lowest at the shape, in any direction and at any distance") {
  for_each_response_scene([](const ResponseScene& scene, int sets) {
    const ReducedModel& model = *scene.model;
    const int r = model.modes(), h = model.dofs() - r;
    std::vector<VectorXd> all{Vector3d(1, 0, 0), Vector3d(0, 1, 0), Vector3d(0, 0, 1)};
    if (scene.full.blending() == Blending::even) all.push_back(Vector3d(0.3, 0.7, sets == 2 ? 1 : 0));
    for (const VectorXd& w : all) {
      ReducedModel::Blend blend;
      model.blend(w, blend);
      VectorXd shape = VectorXd::Zero(r + h), force;
      for (int j = 0; j < 3; ++j) shape += w(j) * model.target(j);
      ArrowMatrix K = model.zero();
      const double least = model.linearize(blend, shape, force, K);
      for (unsigned seed = 0; seed < 200; ++seed)
        for (double distance : {0.01, 0.05, 0.1, 0.5, 2.0}) {  // of the body's size
          VectorXd q = shape;
          q.head(r) += distance * motion_of_size(scene, seed);
          // y at which the energy is least
          model.linearize(blend, q, force, K);
          q.tail(h) = -force.tail(h).cwiseQuotient(K.rest());
          CHECK(model.energy(blend, q) > least);
        }
    }
  });
}

TEST_CASE("responses that do not fit are refused by name") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  for (MaterialModel material_model : {MaterialModel::linear, MaterialModel::stvk}) {
    const ResponseScene scene(body, all, material_model, Blending::even, 8, 12);
    const auto refused = [&](const char* why, const auto& spoil) {
      ReducedTables tables = scene.tables;
      spoil(tables);
      CHECK_THROWS_WITH_AS(ReducedModel(body, all, tables, Blending::even), doctest::Contains(why),
                           std::invalid_argument);
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    refused("tables: responses must be finite", [&](auto& t) { t.responses(3, 2) = nan; });
    refused("rows of the basis", [&](auto& t) { t.responses.conservativeResize(t.responses.rows() - 3, 12); });
    refused("expected responses for each of 3 targets", [&](auto& t) { t.response_mu.pop_back(); });
    refused("expected responses for each of 3 targets", [&](auto& t) { t.response_lambda.clear(); });
    refused("the responses of 'bulge' do not fit", [&](auto& t) { t.response_mu[1].conservativeResize(5); });
    refused("the responses of 'twist' do not fit", [&](auto& t) { t.response_lambda[2](0) = nan; });
    refused("the responses of 'neutral' do not fit", [&](auto& t) { t.response_mu[0](1) = HUGE_VAL; });
    refused("expected responses for each of 3 targets", [&](auto& t) { t.relaxation.pop_back(); });
    refused("the responses of 'bulge' do not fit", [&](auto& t) { t.relaxation[1].conservativeResize(12, 7); });
    refused("the responses of 'twist' do not fit", [&](auto& t) { t.relaxation[2](3, 4) = nan; });
  }
}

TEST_CASE("tables without responses make a model of modes alone, whatever else they say of responses") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  const ResponseScene scene(body, all, MaterialModel::stvk, Blending::even, 8, 12);
  ReducedTables none = scene.tables;
  none.responses = MatrixXd(none.basis.rows(), 0);
  const ReducedTables plain = reduce(scene.full, scene.basis.U);
  const ReducedModel first(body, all, none, Blending::even), second(body, all, plain, Blending::even);
  CHECK(first.dofs() == 8);
  ReducedModel::Blend a, b;
  first.blend(Vector3d(1, 0, 0), a);  // the others' tables are of relaxed modes
  second.blend(Vector3d(1, 0, 0), b);
  VectorXd f, g;
  ArrowMatrix K = first.zero(), L = second.zero();
  const VectorXd z = random_vector(8, 1e-3, 5);
  CHECK(first.linearize(a, z, f, K) == second.linearize(b, z, g, L));
  CHECK(f == g);
  CHECK(K.dense() == L.dense());
}
