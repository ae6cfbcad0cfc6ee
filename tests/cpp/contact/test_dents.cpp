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

/// Of the patches 0, 2, 3 and 5 of six.
VectorXd amplitudes(const Dents& dents) {
  VectorXd all(6);
  dents.amplitudes(all);
  CHECK(all(1) == 0);
  return (VectorXd(4) << all(0), all(2), all(3), all(5)).finished();
}

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
  for (int p = 0; p < int(scene.places.rest.rows()); p += 3) centers.push_back(p);
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

TEST_CASE("dents resist with the derivative of their energy, which is that of their amplitudes") {
  constexpr int n = 7, m = 4;
  double most = kInfinity;
  SUBCASE("as far as they are pushed") { most = 1; }
  SUBCASE("not much further than they may") { most = 0.004; }
  const MatrixXd rows = random_vector(n * m, 1, 5).reshaped(n, m), root = random_vector(m * m, 1, 6).reshaped(m, m);
  const MatrixXd C = root * root.transpose() + MatrixXd::Identity(m, m);
  const RowMajor alike = RowMajor::Identity(m, m) + random_vector(m * m, 0.5, 7).reshaped(m, m);
  Dents dents;
  const VectorXd begun = random_vector(6, 0.02, 9);  // of all patches
  dents.begin({0, 2, 3, 5}, rows, C, alike, VectorXd::Constant(m, most), begun);
  CHECK((amplitudes(dents) - begun({0, 2, 3, 5})).norm() < 1e-12);
  const VectorXd own = random_vector(m, 0.02, 8);
  dents.at(own);
  CHECK(amplitudes(dents) == own);
  double energy = 0.5 * own.dot(C * own);
  const VectorXd together = alike * own;
  for (const VectorXd& bounded : {own, together})
    for (int j = 0; j < m; ++j) energy += 300 * C(j, j) * contact_ramp(std::abs(bounded(j)) - most, most / 2).energy;
  CHECK(dents.energy() == doctest::Approx(energy).epsilon(1e-9));
  CHECK((rows * own - dents.given_way()).norm() < 1e-12);

  const VectorXd resisting = dents.resisting();
  MatrixXd stiffness = dents.stiffness();
  int hard = 0;
  dents.each_hard([&](const auto& row, double d) {
    stiffness += d * row.transpose() * row;
    ++hard;
  });
  CHECK((hard > 0) == (most < 1));
  constexpr double e = 1e-7;
  for (int j = 0; j < m; ++j) {
    const VectorXd step = e * VectorXd::Unit(m, j);
    dents.at(own + step);
    const double more = dents.energy();
    const VectorXd after = dents.resisting();
    dents.at(own - step);
    CHECK((more - dents.energy()) / (2 * e) == doctest::Approx(resisting(j)).epsilon(1e-5));
    CHECK(((after - dents.resisting()) / (2 * e) - stiffness.col(j)).norm() < 1e-4 * stiffness.norm());
  }
}
