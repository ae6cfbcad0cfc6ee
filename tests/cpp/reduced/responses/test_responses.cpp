// SPDX-License-Identifier: GPL-3.0-or-later
// Models with responses: their energy, their targets, their basis, and what they move like.
#include <doctest/doctest.h>

#include <Eigen/Eigenvalues>
#include <limits>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/reduced/modes/static_solver.hpp"
#include "dynamorph/step/simulation.hpp"
#include "reduced/motion.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

ReducedModel::Blend blended(const ReducedModel& model, const VectorXd& w) {
  ReducedModel::Blend out;
  model.blend(w, out);
  return out;
}

VectorXd weights(double neutral, double bulge, double twist) { return Vector3d(neutral, bulge, twist); }

/// Weights at which every set has its sum of one: of the targets in one set or in two.
std::vector<VectorXd> full_weights(int sets) {
  if (sets == 1) return {weights(0, 1, 0), weights(0.5, 0.2, 0.3)};
  return {weights(0, 1, 1), weights(0.6, 0.4, 1)};
}

/// The blended targets' coordinates.
VectorXd shape_of(const ReducedModel& model, const VectorXd& w) {
  VectorXd out = VectorXd::Zero(model.modes());
  for (int j = 0; j < w.size(); ++j) out += w(j) * model.target(j).head(model.modes());
  return out;
}

VectorXd joined(const VectorXd& z, const VectorXd& y) {
  VectorXd out(z.size() + y.size());
  out << z, y;
  return out;
}

StepOptions precise() {
  StepOptions out;
  out.tolerance = 1e-10;
  return out;
}

/// How much condensed responses reduce the energy, by what they would without a limit: theta^2 of responses.hpp.
double kept(double P, double energy, double linear) {
  const double pay = energy * energy / (energy + linear), ratio = P / pay, x = (ratio - 0.7) / 0.3;
  return ratio <= 0.7 ? 1 : (0.7 + 0.3 * x / std::sqrt(1 + x * x)) / ratio;
}

/// The bar of two bones with a hold, pinned at its end or nowhere.
std::shared_ptr<const SoftBody> held_bar(bool pinned) {
  const auto body = two_bone_bar();
  const Eigen::Index n = body->mesh.nodes.rows(), m = body->mesh.tets.rows();
  MatrixXd bones(n, 2);
  std::vector<bool> pins(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double s = std::min(1.0, body->mesh.nodes(i, 0) / 0.3);
    bones.row(i) << 1 - s, s;
    pins[i] = pinned && body->free_of_node[i] < 0;
  }
  return std::make_shared<SoftBody>(body->mesh, body->fill, VectorXd::Ones(m), MatrixXd::Ones(m, 1), pins, bones,
                                    VectorXd::LinSpaced(m, 400, 900));
}

}  // namespace

TEST_CASE("responses: force and tangent are the energy's derivatives, near the shape and far away") {
  for_each_response_scene([](const ResponseScene& scene, int sets) {
    const ReducedModel& model = *scene.model;
    ReducedTables tables = scene.tables;
    tables.responses.resize(tables.basis.rows(), 0);
    const ReducedModel modes(scene.full.shared_body(), scene.full.targets(), tables, scene.full.blending());
    const int r = model.modes(), h = model.dofs() - r;
    for (const VectorXd& w : full_weights(sets)) {
      const ReducedModel::Blend blend = blended(model, w), of_modes = blended(modes, w);
      const VectorXd shape = shape_of(model, w);
      VectorXd force;
      ArrowMatrix rest = model.zero();
      model.linearize(blend, joined(shape, VectorXd::Zero(h)), force, rest);
      // In coordinates in which all stiffness is about one, so that no term is hidden behind stiffer ones.
      const VectorXd scales = rest.diagonal().cwiseAbs().cwiseSqrt().cwiseInverse();
      for (double distance : {0.01, 0.1, 0.4}) {  // of the body's size
        const VectorXd z = shape + distance * motion_of_size(scene, 3);
        ArrowMatrix K = model.zero();
        model.linearize(blend, joined(z, VectorXd::Zero(h)), force, K);
        const VectorXd answer = force.tail(h).cwiseQuotient(K.rest());
        const VectorXd y = (answer.norm() / std::sqrt(h)) * random_vector(h, 2, 4) - answer;
        const VectorXd x = joined(z, y).cwiseQuotient(scales);
        // Without the part of the modes alone, whose sums in single precision would hide small steps.
        check_derivatives(
            [&](const VectorXd& at, VectorXd& f, VectorXd& Kd, const VectorXd& d) {
              const VectorXd q = scales.cwiseProduct(at), along = scales.cwiseProduct(d);
              VectorXd own, own_Kd;
              double energy = evaluator(model, blend)(q, f, Kd, along);
              energy -= evaluator(modes, of_modes)(q.head(r), own, own_Kd, along.head(r));
              f.head(r) -= own;
              Kd.head(r) -= own_Kd;
              f = scales.cwiseProduct(f);
              Kd = scales.cwiseProduct(Kd);
              return energy;
            },
            x, 2e-4 * (z - shape).cwiseQuotient(scales.head(r)).norm());
      }
    }
  });
}

TEST_CASE("responses: every target is exact, its force and energy are zero, and it is the static solution") {
  for_each_response_scene([](const ResponseScene& scene, int sets) {
    const auto& model = scene.model;
    const int r = model->modes(), h = model->dofs() - r;
    for (int j = 0; j < 3; ++j) {
      const VectorXd at = model->target(j);
      VectorXd u, force;
      model->displacement(at, u);
      CHECK(at.tail(h) == VectorXd::Zero(h));
      CHECK((u - scene.full.target(j)).norm() <= 1e-10 * (1e-3 + u.norm()));
      ArrowMatrix K = model->zero();
      const double energy = model->linearize(blended(*model, VectorXd::Unit(3, j)), at, force, K);
      const double stiff = K.corner().norm(), size = model->target(1).norm();
      CHECK(force.head(r).norm() <= 1e-6 * stiff * size);  // with forces blending, about z = 0 in single precision
      CHECK(force.tail(h).norm() <= 1e-6 * stiff * size);
      CHECK(std::abs(energy) <= 1e-6 * stiff * size * size);

      VectorXd w = VectorXd::Unit(3, j);
      if (sets == 2 && j == 2) {
        if (scene.full.blending() == Blending::forces) continue;  // overlapping sets are exact with even blending alone
        w(0) = 1;
      } else if (sets == 2) {
        continue;  // set 1 has the twist alone, whose weight is always one
      }
      MovingBody<ReducedModel> moving(model, precise());
      Simulation<ReducedModel> simulation(moving);
      VectorXd q = at + 0.02 * model->meter() * random_vector(r + h, 0.05, 9);
      CHECK(moving.solve_static({bent(0.8), w}, q).converged);
      model->displacement(q, u);
      CHECK((u - scene.full.target(j)).cwiseAbs().maxCoeff() <= 1e-6 * scene.full.body().size);
    }
  });
}

TEST_CASE("responses: balanced targets do not sag, and a held body's targets are exact") {
  for (Blending blending : kBlendings) {
    const auto body = two_bone_bar();
    const ResponseScene scene(body, targets(*body), MaterialModel::stable_stvk, blending);
    MovingBody<ReducedModel> moving(scene.model, {1 / 120., Integrator::bdf2, Vector3d(0, 0, -9.81), 1e-9});
    Simulation<ReducedModel> simulation(moving);
    const Transforms pose = bent(0.5);
    VectorXd q, u;
    moving.solve_static({pose, VectorXd::Unit(3, 1)}, q);
    CHECK((q - scene.model->target(1)).tail(20).norm() > 1e-7);  // gravity moves the responses
    moving.balance_targets({bent(0), pose, bent(1)});
    for (const auto& [j, rig] : {std::pair{0, bent(0)}, {1, pose}, {2, bent(1)}}) {
      VectorXd found;
      CHECK(moving.solve_static({rig, VectorXd::Unit(3, j)}, found).converged);
      scene.model->displacement(found, u);
      CHECK((u - scene.full.target(j)).cwiseAbs().maxCoeff() <= 1e-6 * body->size);
    }
    for (bool pinned : {true, false}) {
      const auto held = held_bar(pinned);
      const ResponseScene other(held, targets(*body), MaterialModel::stvk, blending);
      MovingBody<ReducedModel> still(other.model, precise());
      for (int j = 0; j < 3; ++j) {
        VectorXd at = other.model->target(j) + 0.02 * other.model->meter() * random_vector(30, 0.05, 9);
        CHECK(still.solve_static({bent(0.3), VectorXd::Unit(3, j)}, at).converged);
        other.model->displacement(at, u);
        CHECK((u - other.full.target(j)).cwiseAbs().maxCoeff() <= 1e-6 * body->size);
      }
    }
  }
}

TEST_CASE("response basis: orthonormal in mass, decoupled from the modes in stiffness, exact shapes") {
  for (int sets : {1, 2})
    for (MaterialModel material_model : kMaterialModels) {
      const auto body = two_bone_bar(sets);
      const FullModel full(body, targets(*body, sets - 1), material_model, Blending::even);
      const ResponseBasis basis = make_response_basis(full, 9, 22);
      const MatrixXd &U = basis.U, &W = basis.W;
      CHECK(U.cols() == 9);
      CHECK(W.cols() == 22);
      CHECK(basis.amplitudes.size() == 9);
      CHECK(basis.amplitudes.minCoeff() > 0);
      const VectorXd mass = body->unit_mass();
      const auto M = mass.asDiagonal();
      CHECK((U.transpose() * M * U - MatrixXd::Identity(9, 9)).norm() < 1e-10);
      CHECK((W.transpose() * M * W - MatrixXd::Identity(22, 22)).norm() < 1e-10);
      const StaticSolver neutral(full, 0);
      const MatrixXd WKW = W.transpose() * (neutral.stiffness * W), WKU = W.transpose() * (neutral.stiffness * U);
      const MatrixXd UKU = U.transpose() * (neutral.stiffness * U);
      const VectorXd d = WKW.diagonal();
      CHECK(d.minCoeff() > 0);
      const VectorXd inverse = d.cwiseSqrt().cwiseInverse();
      CHECK((inverse.asDiagonal() * WKW * inverse.asDiagonal() - MatrixXd::Identity(22, 22)).cwiseAbs().maxCoeff() <
            1e-9);
      CHECK(
          (inverse.asDiagonal() * WKU * UKU.diagonal().cwiseSqrt().cwiseInverse().asDiagonal()).cwiseAbs().maxCoeff() <
          1e-9);
      for (int j = 0; j < 3; ++j) {
        const VectorXd shape = full.target(j);
        CHECK((U * (U.transpose() * M * shape) - shape).norm() <= 1e-10 * (1e-3 + shape.norm()));
      }
    }
}

TEST_CASE("response basis: reports its progress, can be stopped, and refuses what it cannot make") {
  const auto body = two_bone_bar();
  const FullModel full(body, targets(*body), MaterialModel::stvk, Blending::even);
  std::vector<double> reported;
  const auto note = [&](double done) {
    reported.push_back(done);
    return true;
  };
  const ResponseBasis basis = make_response_basis(full, 9, 12, note);
  CHECK(reported.size() >= 3);
  CHECK(reported.front() == 0);
  CHECK(reported.back() == 1);
  CHECK(std::is_sorted(reported.begin(), reported.end()));
  const ResponseBasis again = make_response_basis(full, 9, 12);
  CHECK(basis.U == again.U);
  CHECK(basis.W == again.W);
  reported.clear();
  reduce(full, basis, note);
  CHECK(reported.back() == 1);
  CHECK(std::is_sorted(reported.begin(), reported.end()));
  for (double when : {0.0, 0.1, 0.4, 0.6, 0.84}) {
    const auto stop = [&](double done) { return done < when; };
    CHECK_THROWS_AS(make_response_basis(full, 9, 12, stop), Cancelled);
    CHECK_THROWS_AS(reduce(full, basis, stop), Cancelled);
  }
  CHECK_THROWS_WITH_AS(make_response_basis(full, 2, 12),
                       "2 modes in full detail are too few: the shapes of the targets alone take 2. Ask for 3 or more.",
                       Error);
  CHECK_THROWS_WITH_AS(
      make_response_basis(full, 9, 72),
      "81 modes and responses are too many for this cage, whose nodes can move in 162 ways. Ask for fewer "
      "than 81, or use more nodes.",
      Error);
  CHECK_THROWS_AS(make_response_basis(full, -3, 12), Error);
  const FullModel neutral(body, {targets(*body)[0]}, MaterialModel::stvk, Blending::even);
  CHECK(make_response_basis(neutral, 30, 12).U.cols() == 30);  // more than two bones' loads
}

TEST_CASE("response basis: how the modes bend takes a while, reports progress and can be stopped") {
  const auto body = chain_bar(8, 1, 2);
  const FullModel full(body, {targets(*body)[0]}, MaterialModel::stvk, Blending::even);
  const auto bending = [](double done) { return done > 0.5 && done < 0.85; };
  int reports = 0;
  make_response_basis(full, 25, 10, [&](double done) {
    reports += bending(done);
    return true;
  });
  CHECK(reports > 0);
  CHECK_THROWS_AS(make_response_basis(full, 25, 10, [&](double done) { return !bending(done); }), Cancelled);
}

TEST_CASE("response basis: of a body that nothing but a hold keeps in place") {
  const auto body = two_bone_bar(), held = held_bar(false);
  for (MaterialModel material_model : kMaterialModels) {
    const ResponseScene scene(held, targets(*body), material_model, Blending::even, 12, 20);
    const VectorXd mass = held->unit_mass();
    const MatrixXd &U = scene.basis.U, &W = scene.basis.W;
    const SparseMatrix K = scene.full.rest_stiffness(0);
    CHECK(W.cols() == 20);
    CHECK((U.transpose() * mass.asDiagonal() * U - MatrixXd::Identity(12, 12)).norm() < 1e-10);
    CHECK((W.transpose() * mass.asDiagonal() * W - MatrixXd::Identity(20, 20)).norm() < 1e-10);
    CHECK((W.transpose() * (K * U)).norm() <= 1e-6 * (W.transpose() * (K * W)).norm());
  }
}

TEST_CASE("response basis: a number of responses that is none is refused") {
  const auto body = two_bone_bar();
  const FullModel full(body, targets(*body), MaterialModel::stvk, Blending::even);
  for (int h : {0, -1, -100})
    CHECK_THROWS_WITH_AS(make_response_basis(full, 9, h), doctest::Contains("h: expected at least one response"),
                         std::invalid_argument);
}

TEST_CASE("responses couple as the second-order part of the full model's force, as far as the modes can pay") {
  int limited = 0;
  for_each_response_scene([&](const ResponseScene& scene, int sets) {
    const MaterialModel material_model = scene.full.material_model();
    const bool even = scene.full.blending() == Blending::even;
    const ReducedModel& model = *scene.model;
    const MatrixXd &U = scene.basis.U, &W = scene.basis.W;
    const int r = int(U.cols()), h = int(W.cols());
    std::vector<VectorXd> all = full_weights(sets);
    for (int j = 0; j < 3; ++j) all.push_back(VectorXd::Unit(3, j));
    for (const VectorXd& w : all)
      for (double distance : {1e-2, 0.1, 0.5, 2.0}) {
        const VectorXd shape = shape_of(model, w), z = shape + distance * motion_of_size(scene, 6);
        // Sums over the targets of E and E_2 in their relaxed modes, c, b and D.
        VectorXd c = VectorXd::Zero(h), b = c, D = c;
        double energy = 0, linear = 0, lent = 0;
        for (int j = 0; j < 3; ++j) {
          if (w(j) == 0) continue;
          const MatrixXd &A = scene.tables.relaxation[j], relaxed = U - W * A;
          const VectorXd v = even ? VectorXd(z - shape) : VectorXd(z - model.target(j).head(r)), u = relaxed * v;
          const SparseMatrix K = scene.full.rest_stiffness(j);
          const VectorXd own = (W.transpose() * (K * W)).diagonal();
          FullModel::Blend alone;
          scene.full.blend(VectorXd::Unit(3, j), alone);
          SparseMatrix tangent = scene.full.zero();
          VectorXd plus, minus;
          energy += w(j) * scene.full.linearize(alone, scene.full.target(j) + u, plus, tangent);
          scene.full.linearize(alone, scene.full.target(j) - u, minus, tangent);
          linear += 0.5 * w(j) * u.dot(K * u);
          // The even part of a cubic force about a place where it is zero is its second-order part.
          if (material_model != MaterialModel::linear) c += w(j) * VectorXd(W.transpose() * (plus + minus) / 2);
          b += w(j) * own.cwiseProduct(A * v);
          lent += 0.5 * w(j) * (A * v).dot(own.cwiseProduct(A * v));
          D += w(j) * own;
        }
        const double excess = lent - 0.5 * b.dot(b.cwiseQuotient(D));
        const double part = kept(0.5 * c.dot(c.cwiseQuotient(D)), energy + excess, linear + excess);
        limited += part < 0.9;
        const VectorXd expected = b + std::sqrt(part) * c;
        VectorXd force;
        ArrowMatrix K = model.zero();
        model.linearize(blended(model, w), joined(z, VectorXd::Zero(h)), force, K);
        CHECK((force.tail(h) - expected).norm() <= 2e-6 * expected.norm() + 1e-14 * (D * (z - shape).norm()).norm());
        CHECK((K.rest() - D).norm() <= 1e-10 * D.norm());
      }
  });
  CHECK(limited > 4);
}

TEST_CASE("responses: the modes are as stiff at every target as with all responses free") {
  for (MaterialModel material_model : kMaterialModels)
    for (Blending blending : kBlendings) {
      const auto body = two_bone_bar();
      const ResponseScene scene(body, targets(*body), material_model, blending);
      const MatrixXd basis = side_by_side(scene.basis);
      for (int j = 0; j < 3; ++j) {
        const MatrixXd exact = basis.transpose() * (scene.full.rest_stiffness(j) * basis);
        VectorXd force;
        ArrowMatrix K = scene.model->zero();
        scene.model->linearize(blended(*scene.model, VectorXd::Unit(3, j)), scene.model->target(j), force, K);
        const Eigen::Index r = scene.model->modes();
        const MatrixXd expected = exact.inverse().topLeftCorner(r, r), found = K.dense().inverse().topLeftCorner(r, r);
        CHECK((found - expected).norm() <= 1e-5 * expected.norm());
      }
    }
}
