// SPDX-License-Identifier: GPL-3.0-or-later
// How a skin gives way locally, against the mesh itself and against finite differences.
#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "contact_skins.hpp"
#include "derivatives.hpp"
#include "dynamorph/contact/at_rest.hpp"
#include "dynamorph/contact/contact_law.hpp"
#include "dynamorph/contact/dents.hpp"
#include "dynamorph/contact/local_responses.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

struct LocalScene {
  std::shared_ptr<const SoftBody> body = two_bone_bar();
  std::vector<MorphTarget> all = targets(*body);
  FullModel full{body, all, MaterialModel::stable_stvk, Blending::even};
  std::shared_ptr<const ReducedModel> few;
  ContactSkin skin = contact_skin_of(*body, 0.05);
  SkinPlaces places{skin.skin.rest, skin.normals.rowwise().normalized(), skin.points};

  explicit LocalScene(int modes) : few(reduced_model(body, all, MaterialModel::stable_stvk, Blending::even, modes)) {}
  LocalResponses responses(const std::vector<int>& centers) const {
    return {full, few->basis(), places, skin.skin.embedding, centers};
  }
  /// f_P (3 free, P).
  MatrixXd loads(const LocalResponses& local) const {
    MatrixXd out = MatrixXd::Zero(full.dofs(), local.size());
    std::vector<std::pair<int, double>> found;
    for (Eigen::Index p = 0; p < places.rest.rows(); ++p) {
      local.patches_at(places.rest.row(p), places.normals.row(p), found);
      double sum = 0;
      for (const auto& [patch, weight] : found) {
        sum += weight;
        for (int k = 0; k < 4; ++k)
          if (const int node = body->free_of_node[std::size_t(skin.skin.embedding.nodes(p, k))]; node >= 0)
            out.col(patch).segment<3>(3 * node) +=
                weight * skin.skin.embedding.weights(p, k) * places.normals.row(p).transpose();
      }
      CHECK(sum == doctest::Approx(1));
    }
    return out;
  }
};

}  // namespace

TEST_CASE("with the coordinates, local responses are the mesh's own answer to a load on all of the skin") {
  const LocalScene scene(6);
  const LocalResponses local = scene.responses({3, 17, 40});
  const VectorXd neutral = Vector3d(1, 0, 0);
  const MatrixXd K = lasting_stiffness(scene.full, neutral), B = scene.few->basis(), R = local.shapes();
  CHECK((R.transpose() * K * R - local.stiffness()).norm() < 1e-6 * local.stiffness().norm());
  const MatrixXd loads = scene.loads(local);
  // Every K^-1 f lies in the span of (B, R), and there it is the static answer.
  MatrixXd space(K.rows(), B.cols() + R.cols());
  space << B, R;
  const MatrixXd answers = K.ldlt().solve(loads);
  const MatrixXd found_in = space * (space.transpose() * K * space).ldlt().solve(space.transpose() * loads);
  CHECK((answers - found_in).norm() < 1e-6 * answers.norm());
}

TEST_CASE("local responses leave to the coordinates what those do nearby") {
  const LocalScene scene(40);
  std::vector<int> centers;
  for (int p = 0; p < int(scene.places.rest.rows()); p += 5) centers.push_back(p);
  const LocalResponses local = scene.responses(centers);
  const MatrixXd K = lasting_stiffness(scene.full, Vector3d(1, 0, 0)), B = scene.few->basis(), R = local.shapes();
  const MatrixXd loads = scene.loads(local), all = K.ldlt().solve(loads);
  const MatrixXd taken = B * (B.transpose() * K * B).ldlt().solve(B.transpose() * loads);
  double least = 1, most = 0;
  for (Eigen::Index patch = 0; patch < local.size(); ++patch) {
    MatrixXd two(R.rows(), 2);
    two << all.col(patch), -taken.col(patch);
    const Eigen::Vector2d parts = two.colPivHouseholderQr().solve(R.col(patch));
    CHECK((two * parts - R.col(patch)).norm() < 1e-6 * R.col(patch).norm());
    const double share = parts(1) / parts(0);
    CHECK(share > -1e-6);
    CHECK(share < 1 + 1e-6);
    least = std::min(least, share);
    most = std::max(most, share);
  }
  CHECK(least < 1e-6);
  CHECK(most > 0.05);
}

TEST_CASE("places without a patch nearby belong to the nearest, and centers must be places") {
  const LocalScene scene(6);
  const LocalResponses local = scene.responses({3, 17});
  std::vector<std::pair<int, double>> found;
  local.patches_at(Vector3d(100, 0, 0), Vector3d::UnitX(), found);
  REQUIRE(found.size() == 1);
  CHECK(found[0].second == 1);
  CHECK_THROWS_WITH_AS(scene.responses({}), "centers: at least one is needed", std::invalid_argument);
  CHECK_THROWS_WITH_AS(scene.responses({100000}), "centers: there is no such place", std::invalid_argument);
}

TEST_CASE("dents settle in the minimum of their energy, whose derivatives are forces and their stiffness") {
  constexpr int n = 7, m = 4;
  constexpr double kWidth = 0.01;
  double most = kInfinity;
  SUBCASE("as far as they are pushed") { most = 1; }
  SUBCASE("not much further than they may") { most = 0.004; }
  const MatrixXd rows = random_vector(n * m, 1, 5).reshaped(n, m), root = random_vector(m * m, 1, 6).reshaped(m, m);
  const MatrixXd C = root * root.transpose() + MatrixXd::Identity(m, m);
  const VectorXd k = 20 * (VectorXd::Ones(n) + random_vector(n, 0.9, 7)), depths = random_vector(n, 0.05, 8);
  Dents dents;
  dents.begin({0, 2, 3, 5}, rows, C, VectorXd::Constant(m, most));
  const auto energy = [&](const VectorXd& d) {
    dents.settle(d, k, kWidth);
    double sum = dents.energy();
    for (int i = 0; i < n; ++i) sum += k(i) * contact_ramp(d(i) - dents.given_way()(i), kWidth).energy;
    return sum;
  };
  const auto forces = [&](const VectorXd& d) {
    dents.settle(d, k, kWidth);
    VectorXd out(n);
    for (int i = 0; i < n; ++i) out(i) = k(i) * contact_ramp(d(i) - dents.given_way()(i), kWidth).force;
    return out;
  };
  const VectorXd pressed = forces(depths);
  VectorXd a(6);
  dents.amplitudes(a);
  const VectorXd own = (VectorXd(m) << a(0), a(2), a(3), a(5)).finished();
  CHECK(a(1) == 0);
  VectorXd resisting = C * own;
  for (int j = 0; j < m; ++j)
    resisting(j) += std::copysign(1000 * C(j, j) * contact_ramp(std::abs(own(j)) - most, most / 2).force, own(j));
  CHECK((resisting - rows.transpose() * pressed).norm() < 1e-9 * pressed.norm());
  CHECK(own.cwiseAbs().maxCoeff() < 1.2 * most);
  if (most < 1) CHECK(own.cwiseAbs().maxCoeff() > most);
  CHECK((rows * own - dents.given_way()).norm() < 1e-12);
  constexpr double e = 1e-6;
  std::vector<int> contacts;
  VectorXd stiffness(n);
  for (int i = 0; i < n; ++i)
    if (const double s = k(i) * contact_ramp(depths(i) - dents.given_way()(i), kWidth).stiffness; s > 0) {
      stiffness(Eigen::Index(contacts.size())) = s;
      contacts.push_back(i);
    }
  REQUIRE(contacts.size() > 2);
  stiffness.conservativeResize(Eigen::Index(contacts.size()));
  RowMajor unit = RowMajor::Zero(stiffness.size(), n);
  for (std::size_t i = 0; i < contacts.size(); ++i) unit(Eigen::Index(i), contacts[i]) = 1;
  dents.soften(contacts, unit, stiffness);
  const MatrixXd S = unit.transpose() * stiffness.asDiagonal() * unit;
  for (int i = 0; i < n; ++i) {
    const VectorXd step = e * VectorXd::Unit(n, i);
    CHECK((energy(depths + step) - energy(depths - step)) / (2 * e) == doctest::Approx(pressed(i)).epsilon(1e-5));
    const VectorXd slope = (forces(depths + step) - forces(depths - step)) / (2 * e);
    CHECK((slope - S.col(i)).norm() < 1e-4 * (S.norm() + 1));
  }
  dents.settle(-VectorXd::Ones(n), k, kWidth);  // nothing presses
  CHECK(dents.energy() == 0);
}
