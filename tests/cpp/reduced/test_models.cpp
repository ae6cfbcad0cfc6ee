// SPDX-License-Identifier: GPL-3.0-or-later
// Element laws, full and reduced models: derivatives, exactness at the targets, reduced against full.
#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <map>
#include <random>

#include "dynamorph/reduced/basis.hpp"
#include "dynamorph/reduced/modal_terms.hpp"
#include "dynamorph/step/integrator.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

VectorXd random_vector(Eigen::Index size, double amplitude, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> uniform(-amplitude, amplitude);
  VectorXd x(size);
  for (double& value : x) value = uniform(generator);
  return x;
}

/// The one finite-difference check: f = dE/dx and K = df/dx along random directions, fourth-order central differences.
/// `evaluate(x, f, Kd, d)` returns E and writes f and K d.
template <class Evaluate>
void check_derivatives(const Evaluate& evaluate, const VectorXd& x, double h) {
  for (unsigned seed = 0; seed < 3; ++seed) {
    const VectorXd d = random_vector(x.size(), 1, 100 + seed).normalized();
    VectorXd f, Kd, ignored, f1, f_1, f2, f_2;
    evaluate(x, f, Kd, d);
    const double e1 = evaluate(x + h * d, f1, ignored, d), e_1 = evaluate(x - h * d, f_1, ignored, d);
    const double e2 = evaluate(x + 2 * h * d, f2, ignored, d), e_2 = evaluate(x - 2 * h * d, f_2, ignored, d);
    const double slope = (8 * (e1 - e_1) - (e2 - e_2)) / (12 * h);
    const VectorXd curve = (8 * (f1 - f_1) - (f2 - f_2)) / (12 * h);
    CHECK(std::abs(slope - f.dot(d)) <= 1e-6 * (std::abs(slope) + f.norm()));
    CHECK((curve - Kd).norm() <= 1e-6 * Kd.norm());
  }
}

template <class Model>
auto evaluator(const Model& model, const typename Model::Blend& blend) {
  return [&model, &blend](const VectorXd& q, VectorXd& f, VectorXd& Kd, const VectorXd& d) {
    typename Model::Matrix K = model.zero();
    const double e = model.linearize(blend, q, f, K);
    CHECK(std::abs(e - model.energy(blend, q)) <= 1e-9 * (1e-12 + std::abs(e)));
    Kd = K * d;
    return e;
  };
}

Motion still(const VectorXd& q, const Transforms& bones) {
  Motion motion;
  motion.q.fill(&q);
  motion.bones.fill(&bones);
  return motion;
}

constexpr Law kLaws[] = {Law::linear, Law::stvk, Law::stable_stvk};
constexpr Blending kBlendings[] = {Blending::forces, Blending::even};

}  // namespace

TEST_CASE("element laws: stress is the derivative of the energy, stiffness of the force") {
  const TetMesh mesh = scenes::bar(1, 1, 1, 0.1);
  const RestShape shape = rest_shape(mesh, random_vector(24, 0.01, 1), VectorXd::Ones(6));
  const Element& element = shape.elements[2];
  const Lame lame{3e4, 1e4};
  for (Law law : kLaws)
    check_derivatives(
        [&](const VectorXd& x, VectorXd& f, VectorXd& Kd, const VectorXd& d) {
          const Matrix3d F = deformation_gradient(element, Eigen::Map<const Eigen::Matrix<double, 3, 4>>(x.data()));
          const ElementForce force = element.volume * stress(law, lame, F) * element.gradients;
          f = Eigen::Map<const VectorXd>(force.data(), 12);
          ElementStiffness K;
          element_stiffness(law, lame, element, F, K);
          Kd = K * d;
          return element.volume * energy_density(law, lame, F);
        },
        random_vector(12, 0.03, 2), 1e-5);
}

TEST_CASE("element laws: energy is zero at the rest shape, also for an element that had to fall back") {
  const TetMesh mesh = scenes::bar(1, 1, 1, 0.1);
  VectorXd d = random_vector(24, 0.01, 3);
  d(3 * mesh.tets(0, 3) + 2) -= 0.3;  // turns tets inside out
  const RestShape shape = rest_shape(mesh, d, VectorXd::Ones(6));
  CHECK(shape.fallbacks > 0);
  CHECK(shape.fallbacks < 6);
  for (size_t e = 0; e < 6; ++e) {
    Eigen::Matrix<double, 3, 4> u;
    for (int a = 0; a < 4; ++a) u.col(a) = d.segment<3>(3 * mesh.tets(Eigen::Index(e), a));
    const Matrix3d F = deformation_gradient(shape.elements[e], u);
    CHECK((F - Matrix3d::Identity()).norm() < 1e-10);
    for (Law law : kLaws) CHECK(std::abs(energy_density(law, {1, 1}, F)) < 1e-10);
  }
}

TEST_CASE("a shifted target has the neutral's stiffness about its own shape") {
  const auto body = scenes::two_bone_bar();
  auto targets = scenes::targets(*body);
  for (MorphTarget& target : targets) {
    target.lame = targets[0].lame;
    target.shifted = true;
  }
  for (Law law : kLaws) {
    const FullModel model(body, targets, law, Blending::even);
    for (int j = 0; j < int(targets.size()); ++j) {
      CHECK(model.shape(j).fallbacks == 0);
      VectorXd w = VectorXd::Zero(targets.size()), force;
      SparseMatrix stiffness;
      w(j) = 1;
      FullModel::Blend blend;
      model.blend(w, blend);
      CHECK(std::abs(model.linearize(blend, model.target(j), force, stiffness)) < 1e-12);
      const VectorXd neutral = values(model.rest_stiffness(0));
      CHECK((values(stiffness) - neutral).norm() < 1e-9 * neutral.norm());
    }
  }
}

TEST_CASE("stable StVK resists inversion, and has StVK's stiffness at rest") {
  const Lame lame{2e4, 1e4};
  const Matrix3d mirrored = Vector3d(-1, 1, 1).asDiagonal();
  CHECK(energy_density(Law::stvk, lame, mirrored) == doctest::Approx(0));
  CHECK(energy_density(Law::stable_stvk, lame, mirrored) == doctest::Approx(2 * lame.mu));
  const TetMesh mesh = scenes::bar(1, 1, 1, 0.1);
  const RestShape shape = rest_shape(mesh, VectorXd::Zero(24), VectorXd::Ones(6));
  ElementStiffness linear, stvk, stable;
  element_stiffness(Law::linear, lame, shape.elements[0], Matrix3d::Identity(), linear);
  element_stiffness(Law::stvk, lame, shape.elements[0], Matrix3d::Identity(), stvk);
  element_stiffness(Law::stable_stvk, lame, shape.elements[0], Matrix3d::Identity(), stable);
  CHECK((stvk - linear).norm() < 1e-12 * linear.norm());
  CHECK((stable - linear).norm() < 1e-12 * linear.norm());
}

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
  CHECK(basis.captured > 0.9);
  CHECK_THROWS_AS(make_basis(model, 2), Error);
}

TEST_CASE("modal inertia is U^T A^T M (...) over the nodes: mass, and the force of any motion, rigid or stretched") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  const FullModel full(body, targets, Law::linear, Blending::forces);
  const MatrixXd U = make_basis(full, 10).U;
  const ReducedModel reduced(body, targets, reduce(full, U), Blending::forces);
  VectorXd density(2), damped(2);
  density << 700, 1300;
  damped << 300, 0;
  for (double stretch : {1.0, 1.3}) {
    std::array<VectorXd, Motion::kMoments> z, u;
    std::array<Transforms, Motion::kPoses> poses;
    Motion small, big;
    for (int m = 0; m < Motion::kMoments; ++m) {
      z[m] = random_vector(10, 1e-3, 40 + m);
      u[m] = U * z[m];
      small.q[m] = &z[m];
      big.q[m] = &u[m];
    }
    for (int n = 0; n < Motion::kPoses; ++n) {
      poses[n] = stretch * scenes::bent(1.2 - 0.2 * n);
      small.bones[n] = big.bones[n] = &poses[n];
      for (int m = 0; m < Motion::kMoments; ++m) small.share(m, n) = big.share(m, n) = 0.3 * m - 0.2 * n;
    }
    small.lift = big.lift = Vector3d(0.1, -0.2, 0.3);
    FullModel::Inertia expected;
    ReducedModel::Inertia found;
    full.inertia(big, {density, damped}, expected);
    reduced.inertia(small, {density, damped}, found);
    const MatrixXd mass = U.transpose() * (expected.mass * U), less = U.transpose() * (expected.damped * U);
    const VectorXd force = U.transpose() * expected.force;
    CHECK((mass - found.mass).norm() < 1e-7 * mass.norm());  // stored in single precision
    CHECK((less - found.damped).norm() < 1e-7 * less.norm());
    CHECK((force - found.force).norm() < 1e-6 * force.norm());
  }
}

TEST_CASE("modal inertia of many bones: the pairs that are simplified stay within the bounds that it states") {
  for (int count : {1, 2, 4, 5, 20}) {
    const auto body = scenes::chain_bar(count);
    MorphTarget target;
    target.displacement = VectorXd::Zero(3 * body->mesh.nodes.rows());
    target.lame = {2e4, 1e4};
    const FullModel full(body, {target}, Law::linear, Blending::even);
    const MatrixXd U = make_basis(full, 10).U;
    const ReducedModel reduced(body, {target}, reduce(full, U), Blending::even);
    for (double bend : {0.0, 1e-3, 0.05, 0.5}) {
      std::array<VectorXd, Motion::kMoments> z, u;
      std::array<Transforms, Motion::kPoses> poses;
      Motion small, big;
      small.share = big.share = StepRule(StepOptions{1 / 120.}).share();
      for (int m = 0; m < Motion::kMoments; ++m) {
        z[m] = VectorXd::LinSpaced(10, -1, 1) * 1e-3 * (m + 1);
        u[m] = U * z[m];
        small.q[m] = &z[m];
        big.q[m] = &u[m];
      }
      for (int n = 0; n < Motion::kPoses; ++n) {
        poses[n].resize(count, 12);
        for (int b = 0; b < count; ++b) {
          Eigen::Matrix<double, 3, 4, Eigen::RowMajor> T;
          const double angle = bend * (0.3 * b + 1) * (1 - 0.01 * n * n);
          T.leftCols<3>() = Eigen::AngleAxisd(angle, Vector3d(0.2, 1, 0.3).normalized()).toRotationMatrix();
          T.col(3) = Vector3d(0, 0, 0.01 * n * n * bend);
          poses[n].row(b) = Eigen::Map<Eigen::Matrix<double, 1, 12>>(T.data());
        }
        small.bones[n] = big.bones[n] = &poses[n];
      }
      const SetDensities densities{VectorXd::Constant(1, 1000), VectorXd::Ones(1)};
      FullModel::Inertia expected;
      ReducedModel::Inertia found;
      full.inertia(big, densities, expected);
      reduced.inertia(small, densities, found);
      const MatrixXd mass = U.transpose() * (expected.mass * U);
      const VectorXd force = U.transpose() * expected.force;
      CHECK((mass - found.mass).norm() <= (count < 3 ? 1e-6 : 1e-3) * mass.norm());
      CHECK((force - found.force).norm() <= (count < 3 ? 1e-6 : 3e-5) * force.norm() + 1e-12);
    }
  }
}

TEST_CASE("inertia of nodes with transforms of their own: as if their bones had posed them, to round-off") {
  for (int sets : {1, 2}) {
    const auto body = scenes::two_bone_bar(sets);
    const auto targets = scenes::targets(*body, sets - 1);
    const FullModel full(body, targets, Law::linear, Blending::even);
    const MatrixXd U = make_basis(full, 10).U;
    std::vector<bool> pinned(body->free_of_node.size());
    for (size_t i = 0; i < pinned.size(); ++i) pinned[i] = body->free_of_node[i] < 0;
    const auto own = std::make_shared<SoftBody>(body->mesh, body->fill, VectorXd::Ones(body->fill.size()), body->shares,
                                                pinned, MatrixXd(pinned.size(), 0));
    const ReducedModel reduced(own, targets, reduce(full, U), Blending::even);
    CHECK_THROWS_AS(reduced.modal_inertia(), std::invalid_argument);
    CHECK(make_basis(FullModel(own, targets, Law::linear, Blending::even), 10).U.cols() == 10);
    std::array<VectorXd, Motion::kMoments> z, u;
    std::array<SkinFrame, Motion::kPoses> poses;
    Motion small, big;
    small.share = big.share = StepRule(StepOptions{1 / 120.}).share();
    small.lift = big.lift = Vector3d(0.1, -0.2, 0.3);
    for (int m = 0; m < Motion::kMoments; ++m) {
      z[m] = random_vector(10, 1e-3, 40 + m);
      u[m] = U * z[m];
      small.q[m] = &z[m];
      big.q[m] = &u[m];
    }
    for (int n = 0; n < Motion::kPoses; ++n) {
      poses[n].bones = 1.1 * scenes::bent(1.2 - 0.2 * n);
      pose_nodes(body->skin, poses[n]);
      big.bones[n] = &poses[n].bones;
      small.bones[n] = &poses[n].nodes;
    }
    const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::LinSpaced(sets, 300, 100)};
    FullModel::Inertia expected;
    ReducedModel::Inertia found;
    full.inertia(big, densities, expected);
    reduced.inertia(small, densities, found);
    const MatrixXd mass = U.transpose() * (expected.mass * U), damped = U.transpose() * (expected.damped * U);
    const VectorXd force = U.transpose() * expected.force;
    CHECK((mass - found.mass).norm() < 1e-12 * mass.norm());
    CHECK((damped - found.damped).norm() < 1e-12 * damped.norm());
    CHECK((force - found.force).norm() < 1e-12 * force.norm());

    for (int n = 0; n < Motion::kPoses; ++n) small.bones[n] = &poses[n].bones;  // of the body with bones
    ReducedModel::Inertia posed;
    NodalInertia(body, U).evaluate(small, densities, posed.nodes, posed.mass, posed.damped, posed.force);
    CHECK((posed.mass - found.mass).norm() < 1e-14 * mass.norm());
    CHECK((posed.force - found.force).norm() < 1e-14 * force.norm());
  }
}

namespace {

/// Mass and force of the motion from the tensors of all bones and pairs of bones, in double throughout.
void contract_in_double(const SoftBody& body, const MatrixXd& U, const Motion& motion, const SetDensities& densities,
                        MatrixXd& mass, VectorXd& force) {
  using namespace terms;
  struct BoneMotion {
    double values[1 + Motion::kMoments][12];
  };
  const Index r = U.cols();
  const Shares shares = shares_of_differences(motion.share);
  std::vector<BoneMotion> bones(body.skin.cols());
  for (Index b = 0; b < body.skin.cols(); ++b) {
    const double* poses[Motion::kPoses];
    for (int n = 0; n < Motion::kPoses; ++n) poses[n] = motion.bones[n]->data() + 12 * b;
    combine(poses, shares.data(), body.centre, motion.lift, bones[b].values);
  }
  std::vector<double> y, slopes(9 * r);
  take_differences(motion, y);
  mass.setZero(r, r);
  force.setZero(r);
  for (int s = 0; s < body.sets(); ++s) {
    std::map<std::pair<int, int>, VectorXd> tensors;
    VectorXd entry(entries(r)), own_force = VectorXd::Zero(r), change = VectorXd::Zero(r * (r + 1) / 2);
    for_each_term(body, s, [&](Index i, const std::pair<int, int>& pair, double part) {
      node_tensor(U.middleRows<3>(3 * i), body.rest.segment<3>(3 * i) - body.centre, entry);
      tensors.try_emplace(pair, VectorXd::Zero(entries(r))).first->second += part * entry;
    });
    for (const auto& [pair, tensor] : tensors) {
      const bool single = pair.first == pair.second;
      double moved[1 + Motion::kMoments][12];
      for (int m = 0; m <= Motion::kMoments; ++m)
        for (int e = 0; e < 12; ++e)
          moved[m][e] = bones[pair.first].values[m][e] - (single ? 0 : bones[pair.second].values[m][e]);
      Coefficients<double> c;
      contract_bones(moved, single ? 1.0 : -1.0, c);
      take_slopes(c, y.data(), r, slopes.data());
      add_terms<true>(tensor.data(), r, slopes.data(), c, own_force.data(), change.data());
    }
    const VectorXd volumes = body.volumes.col(s).replicate(1, 3).transpose().reshaped();
    MatrixXd own_mass = U.transpose() * volumes.asDiagonal() * U;
    for (Index k = 0, p = 0; k < r; ++k)
      for (Index l = k; l < r; ++l, ++p) {
        own_mass(l, k) += change(p);
        own_mass(k, l) = own_mass(l, k);
      }
    mass += densities.density(s) * own_mass;
    force += densities.density(s) * own_force;
  }
}

}  // namespace

TEST_CASE("tensors of bones and of their pairs are the sum over the nodes to 1e-10, before they are rounded") {
  for (int count : {2, 4, 20})
    for (int sets : {1, 3}) {
      const auto body = scenes::chain_bar(count, sets);
      MorphTarget target;
      target.displacement = VectorXd::Zero(3 * body->mesh.nodes.rows());
      target.lame = {2e4, 1e4};
      const FullModel full(body, std::vector<MorphTarget>(1, target), Law::linear, Blending::even);
      const MatrixXd U = make_basis(full, 10).U;
      const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::Ones(sets)};
      for (double bend : {0.0, 0.05, 0.5})
        for (double stretch : {1.0, 1.2}) {
          std::array<VectorXd, Motion::kMoments> z, u;
          std::array<Transforms, Motion::kPoses> poses;
          Motion small, big;
          small.share = big.share = StepRule(StepOptions{1 / 120.}).share();
          small.lift = big.lift = Vector3d(0, 0, 7e-4);
          for (int m = 0; m < Motion::kMoments; ++m) {
            z[m] = random_vector(10, 1e-3, 60 + m);
            u[m] = U * z[m];
            small.q[m] = &z[m];
            big.q[m] = &u[m];
          }
          for (int n = 0; n < Motion::kPoses; ++n) {
            poses[n].resize(count, 12);
            for (int b = 0; b < count; ++b) {
              Eigen::Matrix<double, 3, 4, Eigen::RowMajor> T;
              const double angle = bend * (0.3 * b + 1) * (1 - 0.01 * n * n);
              T.leftCols<3>() =
                  stretch * Eigen::AngleAxisd(angle, Vector3d(0.2, 1, 0.3 - 0.1 * b).normalized()).toRotationMatrix();
              T.col(3) = Vector3d(5 + 0.1 * b, -3, 0.01 * n * n);
              poses[n].row(b) = Eigen::Map<Eigen::Matrix<double, 1, 12>>(T.data());
            }
            small.bones[n] = big.bones[n] = &poses[n];
          }
          FullModel::Inertia expected;
          full.inertia(big, densities, expected);
          MatrixXd mass;
          VectorXd force;
          contract_in_double(*body, U, small, densities, mass, force);
          const MatrixXd dense = U.transpose() * (expected.mass * U);
          const VectorXd pull = U.transpose() * expected.force;
          CHECK((mass - dense).norm() <= 1e-10 * dense.norm());
          CHECK((force - pull).norm() <= 1e-10 * pull.norm());
        }
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

TEST_CASE("between targets the stiffness at rest is positive definite for random weights") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  for (Law law : kLaws) {
    const FullModel model(body, targets, law, Blending::even);
    for (unsigned seed = 0; seed < 5; ++seed) {
      VectorXd w = random_vector(3, 1, seed).cwiseAbs();
      w /= w.sum();
      FullModel::Blend blend;
      model.blend(w, blend);
      VectorXd f;
      SparseMatrix K = model.zero();
      model.linearize(blend, blend.displacement, f, K);
      CHECK(f.norm() < 1e-8 * K.norm());
      CHECK(Eigen::LLT<MatrixXd>(MatrixXd(K)).info() == Eigen::Success);
    }
  }
}
