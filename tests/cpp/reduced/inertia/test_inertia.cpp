// SPDX-License-Identifier: GPL-3.0-or-later
// Inertia in modes against the nodes' own.
#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <map>

#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/inertia/bone_pairs.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/step/simulation.hpp"
#include "reduced/motion.hpp"

using namespace dynamorph;
using namespace scenes;

TEST_CASE("modal inertia is U^T A^T M (...) over the nodes: mass, and the force of any motion, rigid or stretched") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  const FullModel full(body, targets, MaterialModel::linear, Blending::forces);
  const MatrixXd U = make_basis(full, 10).U;
  const ReducedModel reduced(body, targets, reduce(full, U), Blending::forces);
  const SetDensities densities{Eigen::Vector2d(700, 1300), Eigen::Vector2d(300, 0)};
  for (double stretch : {1.0, 1.3}) {
    Moving moving(U, 1, [&](int n) { return Transforms(stretch * scenes::bent(1.2 - 0.2 * n)); });
    for (int m = 0; m < InertialTarget::kMoments; ++m)
      for (int n = 0; n < InertialTarget::kPoses; ++n)
        moving.small.coefficients(m, n) = moving.big.coefficients(m, n) = 0.3 * m - 0.2 * n;
    moving.small.gravity_offset = moving.big.gravity_offset = Vector3d(0.1, -0.2, 0.3);
    const auto [mass, damped, force] = moving.projected(full, densities);
    const Moving::Inertia found = moving.reduced(reduced, densities);
    CHECK((mass - found.mass).norm() < 1e-7 * mass.norm());  // stored in single precision
    CHECK((damped - found.damped).norm() < 1e-7 * damped.norm());
    CHECK((force - found.force).norm() < 1e-6 * force.norm());
  }
}

namespace {

/// Bone b of a chain that bends and flies, n steps back.
Affine of_chain(int b, int n, double bend, const Vector3d& axis, const Vector3d& translation) {
  Affine T;
  T << Eigen::AngleAxisd(bend * (0.3 * b + 1) * (1 - 0.01 * n * n), axis.normalized()).toRotationMatrix(), translation;
  return T;
}

MorphTarget neutral_of(const SoftBody& body) {
  MorphTarget target;
  target.displacement = VectorXd::Zero(3 * body.mesh.nodes.rows());
  target.lame = {2e4, 1e4};
  return target;
}

}  // namespace

TEST_CASE("modal inertia of many bones: the pairs that are simplified stay within the bounds that it states") {
  for (int count : {1, 2, 4, 5, 20}) {
    const auto body = scenes::chain_bar(count);
    const std::vector<MorphTarget> neutral{neutral_of(*body)};
    const FullModel full(body, neutral, MaterialModel::linear, Blending::even);
    const MatrixXd U = make_basis(full, 10).U;
    const ReducedModel reduced(body, neutral, reduce(full, U), Blending::even);
    for (double bend : {0.0, 1e-3, 0.05, 0.5}) {
      Moving moving(U, 1, [&](int n) {
        return pose_of(count, [&](int b) {
          return of_chain(b, n, bend, Vector3d(0.2, 1, 0.3), Vector3d(0, 0, 0.01 * n * n * bend));
        });
      });
      for (int m = 0; m < InertialTarget::kMoments; ++m) {  // smooth in time: the bounds are for motion
        moving.q[m] = VectorXd::LinSpaced(10, -1, 1) * 1e-3 * (m + 1);
        moving.u[m] = U * moving.q[m];
      }
      const SetDensities densities{VectorXd::Constant(1, 1000), VectorXd::Ones(1)};
      const auto [mass, damped, force] = moving.projected(full, densities);
      const Moving::Inertia found = moving.reduced(reduced, densities);
      CHECK((mass - found.mass).norm() <= (count < 3 ? 1e-6 : 1e-3) * mass.norm());
      CHECK((force - found.force).norm() <= (count < 3 ? 1e-6 : 3e-5) * force.norm() + 1e-12);
    }
  }
}

TEST_CASE("inertia of nodes with transforms of their own: as if their bones had posed them, to round-off") {
  for (int sets : {1, 2}) {
    const auto body = scenes::two_bone_bar(sets);
    const auto targets = scenes::targets(*body, sets - 1);
    const FullModel full(body, targets, MaterialModel::linear, Blending::even);
    const MatrixXd U = make_basis(full, 10).U;
    const auto own = with_own_transforms(*body);
    const ReducedModel reduced(own, targets, reduce(full, U), Blending::even);
    CHECK(make_basis(FullModel(own, targets, MaterialModel::linear, Blending::even), 10).U.cols() == 10);
    Moving moving(U, 1, [](int n) { return Transforms(1.1 * scenes::bent(1.2 - 0.2 * n)); });
    const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::LinSpaced(sets, 300, 100)};
    const auto [mass, damped, force] = moving.projected(full, densities);
    ModalInertia::Result posed;  // by the body with bones
    NodalInertia::Scratch scratch;
    NodalInertia(body, U).evaluate(moving.small, densities, scratch, posed.mass, posed.damped, posed.force);
    moving.use_nodes(*body);
    const Moving::Inertia found = moving.reduced(reduced, densities);
    CHECK((mass - found.mass).norm() < 1e-12 * mass.norm());
    CHECK((damped - found.damped).norm() < 1e-12 * damped.norm());
    CHECK((force - found.force).norm() < 1e-12 * force.norm());
    CHECK((posed.mass - found.mass).norm() < 1e-14 * mass.norm());
    CHECK((posed.force - found.force).norm() < 1e-14 * force.norm());
  }
}

namespace {

/// A rigid force is that of an inertial target at zero coordinates.
template <class Model>
void check_rigid_force(const Model& model, const Transforms& now, const Transforms& moved) {
  const int sets = model.body().sets();
  const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::LinSpaced(sets, 300, 100)};
  const VectorXd rest = VectorXd::Zero(model.dofs());
  InertialTarget inertial;
  inertial.q.fill(&rest);
  inertial.bones.fill(&now);
  inertial.bones[1] = &moved;
  inertial.coefficients(0, 1) = 1;
  typename Model::Inertia expected, scratch;
  model.inertia(inertial, densities, expected);
  VectorXd force;
  model.rigid_force(now, moved, densities, scratch, force);
  CHECK(expected.force.norm() > 0);
  CHECK((force - expected.force).norm() < 1e-6 * expected.force.norm());
}

}  // namespace

TEST_CASE("a rigid force is that of inertia at rest in bind space, over all kinds of models") {
  const Transforms now = 1.1 * bent(0.7), moved = 30 * bent(-0.2) - 28 * bent(0.5);
  for_each_response_scene([&](const ResponseScene& scene, int) {
    check_rigid_force(scene.full, now, moved);
    check_rigid_force(*scene.model, now, moved);
  });
  for (int sets : {1, 2}) {
    const auto body = two_bone_bar(sets), own = with_own_transforms(*body);
    const auto all = targets(*body, sets - 1);
    const FullModel full(body, all, MaterialModel::linear, Blending::even);
    const ReducedTables tables = reduce(full, make_basis(full, 10).U);
    check_rigid_force(ReducedModel(body, all, tables, Blending::even), now, moved);
    SkinFrame of_now{now, {}}, of_moved{moved, {}};
    pose_nodes(body->skin, of_now);
    pose_nodes(body->skin, of_moved);
    check_rigid_force(FullModel(own, all, MaterialModel::linear, Blending::even), of_now.nodes, of_moved.nodes);
    check_rigid_force(ReducedModel(own, all, tables, Blending::even), of_now.nodes, of_moved.nodes);
  }
}

namespace {

/// Mass and force of the motion from the tensors of all bones and pairs of bones, in double throughout.
void contract_in_double(const SoftBody& body, const MatrixXd& U, const InertialTarget& inertial,
                        const SetDensities& densities, MatrixXd& mass, VectorXd& force) {
  using namespace bone_pairs;
  struct BoneMotion {
    double values[1 + InertialTarget::kMoments][12];
  };
  const Index r = U.cols();
  const DifferenceCoefficients coefficients = coefficients_of_differences(inertial.coefficients);
  std::vector<BoneMotion> bones(body.skin.cols());
  for (Index b = 0; b < body.skin.cols(); ++b) {
    const double* poses[InertialTarget::kPoses];
    for (int n = 0; n < InertialTarget::kPoses; ++n) poses[n] = inertial.bones[n]->data() + 12 * b;
    combine(poses, coefficients.data(), body.center.data(), inertial.gravity_offset.data(), bones[b].values);
  }
  std::vector<double> y, slopes(9 * r);
  take_differences(inertial, y);
  mass.setZero(r, r);
  force.setZero(r);
  for (int s = 0; s < body.sets(); ++s) {
    std::map<BonePair, VectorXd> tensors;
    VectorXd entry(entries(r)), own_force = VectorXd::Zero(r), change = VectorXd::Zero(r * (r + 1) / 2);
    for_each_bone_pair(body, s, [&](Index i, const BonePair& pair, double part) {
      node_tensor(U.middleRows<3>(3 * i), body.rest.segment<3>(3 * i) - body.center, entry);
      tensors.try_emplace(pair, VectorXd::Zero(entries(r))).first->second += part * entry;
    });
    for (const auto& [pair, tensor] : tensors) {
      const bool single = pair.first == pair.second;
      double moved[1 + InertialTarget::kMoments][12];
      for (int m = 0; m <= InertialTarget::kMoments; ++m)
        for (int e = 0; e < 12; ++e)
          moved[m][e] = bones[pair.first].values[m][e] - (single ? 0 : bones[pair.second].values[m][e]);
      Coefficients<double> c;
      contract_bones(moved, single ? 1.0 : -1.0, c);
      take_slopes(c, y.data(), r, slopes.data());
      add_tensors<true>(tensor.data(), r, slopes.data(), c, own_force.data(), change.data());
    }
    const VectorXd volumes = at_coordinates(body.volumes.col(s));
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
      const FullModel full(body, {neutral_of(*body)}, MaterialModel::linear, Blending::even);
      const MatrixXd U = make_basis(full, 10).U;
      const SetDensities densities{VectorXd::LinSpaced(sets, 700, 1300), VectorXd::Ones(sets)};
      for (double bend : {0.0, 0.05, 0.5})
        for (double stretch : {1.0, 1.2}) {
          const Moving moving(U, 1, [&](int n) {
            return pose_of(count, [&](int b) {
              Affine T = of_chain(b, n, bend, Vector3d(0.2, 1, 0.3 - 0.1 * b), Vector3d(5 + 0.1 * b, -3, 0.01 * n * n));
              T.leftCols<3>() *= stretch;
              return T;
            });
          });
          const Moving::Inertia expected = moving.projected(full, densities);
          MatrixXd mass;
          VectorXd force;
          contract_in_double(*body, U, moving.small, densities, mass, force);
          CHECK((mass - expected.mass).norm() <= 1e-10 * expected.mass.norm());
          CHECK((force - expected.force).norm() <= 1e-10 * expected.force.norm());
        }
    }
}
