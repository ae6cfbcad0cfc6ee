// SPDX-License-Identifier: GPL-3.0-or-later
// The limits of a motion: their formulas and derivatives. What they do to a motion is in
// tests/engine/test_motion_limit.py.
#include <doctest/doctest.h>

#include <cmath>

#include "check_term.hpp"
#include "dynamorph/step/limited_tissue.hpp"
#include "dynamorph/step/simulation.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

/// The surface of a body. Each node may move by `distance` meters.
SkinLimits limits_of(const SoftBody& body, double distance) {
  SkinLimits out;
  out.rest = body.mesh.nodes;
  out.embedding = embed(body.mesh, out.rest);
  out.triangles = surface_of(body.mesh);
  out.weights = MatrixXd::Zero(out.rest.rows(), body.skin.cols());
  for (Eigen::Index i = 0; i < out.rest.rows(); ++i)
    if (const int free = body.free_of_node[std::size_t(i)]; free >= 0)
      out.weights.row(i) = body.skin.row(free);
    else
      out.weights(i, 0) = 1;
  out.distances = VectorXd::Constant(out.rest.rows(), distance);
  return out;
}

const VectorXd kBetween = Vector3d(0.2, 0.5, 0.3);

/// Its derivatives where the limit lets go of some points and pulls others.
template <class Model>
void check_far_term(std::shared_ptr<const Model> model) {
  const MotionLimit<Model> limit(model, limits_of(model->body(), 0.02));
  typename Model::Blend blend;
  model->blend(kBetween, blend);
  typename Model::Matrix K = model->zero();
  VectorXd force, shape;
  model->linearize(blend, VectorXd::Zero(model->dofs()), force, K);
  const VectorXd scales = K.diagonal().cwiseAbs().cwiseSqrt().cwiseInverse();
  blended_shape(*model, kBetween, shape);
  PullTerm<Model> far;
  const VectorXd moved = shape + scales.cwiseProduct(random_vector(scales.size(), 1, 5));
  far.begin(&limit, kBetween, 1, moved, 0.4);
  Around<PullTerm<Model>> around{far, moved};
  check_term<typename Model::Matrix>(around, scales, 1e-5);
  CHECK(far.acts());

  far.begin(&limit, kBetween, 1, shape, 0.4);  // in the targets' shape nothing is far
  const auto near = far.linearize(scales);
  CHECK(near.value == 0);
  CHECK(near.gradient.isZero(0));
  CHECK(near.hessian.stiffness.size() == 0);
}

/// Of which edges between the critical ones are held, the oracle: at each turn all edges are compared with all that
/// were taken, and the one with the largest product of squared strain and squared distance is next.
std::vector<std::vector<std::pair<int, double>>> chosen_by_comparison(const Tissue& tissue, const SkinLimits& limits) {
  const auto& edges = tissue.skin.edges;
  std::vector<double> strain(edges.size(), 0.0);
  std::vector<std::size_t> by(edges.size(), 0);
  std::vector<int> taken;
  for (std::size_t b = 0; b < tissue.edges.size(); ++b) {
    const CriticalEdges& critical = tissue.edges[b];
    taken.insert(taken.end(), critical.edges.begin(), critical.edges.end());
    for (std::size_t k = 0; k < critical.own.size(); ++k)
      if (const auto e = std::size_t(critical.own[k]); critical.strain(Eigen::Index(k)) > strain[e]) {
        strain[e] = critical.strain(Eigen::Index(k));
        by[e] = b;
      }
  }
  const auto middle = [&](std::size_t e) -> Vector3d {
    return 0.5 * (limits.rest.row(edges[e].first) + limits.rest.row(edges[e].second));
  };
  std::vector<std::vector<std::pair<int, double>>> out(tissue.edges.size());
  for (int count = 0; count < limits.constants.edges_between; ++count) {
    double most = 0;
    std::size_t best = 0;
    for (std::size_t e = 0; e < edges.size(); ++e) {
      double nearest = tissue.skin.size * tissue.skin.size;
      for (int t : taken) nearest = std::min(nearest, (middle(e) - middle(std::size_t(t))).squaredNorm());
      if (strain[e] * strain[e] * nearest > most) most = strain[e] * strain[e] * nearest, best = e;
    }
    if (most == 0) break;
    out[by[best]].push_back({int(best), strain[best]});
    taken.push_back(int(best));
  }
  return out;
}

}  // namespace

TEST_CASE("the scale of a load is one up to four tenths of the limit, and what it lets through saturates smoothly") {
  CHECK(load_scale(0) == 1);
  CHECK(load_scale(0.4) == 1);
  double before = 0.4;
  for (double excess = 0.41; excess < 40; excess *= 1.02) {
    const double through = load_scale(excess) * excess;
    CHECK(load_scale(excess) < 1);
    CHECK(through > before - 1e-12);
    CHECK(through <= 1);
    before = through;
  }
  CHECK(before == doctest::Approx(1));
  constexpr double e = 1e-3;  // slope and curvature are continuous where it begins: through = excess up to third order
  CHECK(load_scale(0.4 + e) * (0.4 + e) == doctest::Approx(0.4 + e).epsilon(1e-8));
}

TEST_CASE("the ramp of the largest distance: stiffness along and across the pull are derivatives of its energy") {
  constexpr double limit = 0.3, e = 1e-6;
  for (double r : {0.1, 0.18, 0.2, 0.25, 0.299, 0.301, 0.5, 2.0}) {
    const Ramp at = ramp(r, limit), less = ramp(r - e, limit), more = ramp(r + e, limit);
    CHECK((more.energy - less.energy) / (2 * e) == doctest::Approx(at.across * r).epsilon(1e-6));
    CHECK((more.across * (r + e) - less.across * (r - e)) / (2 * e) == doctest::Approx(at.along).epsilon(1e-4));
  }
  CHECK(ramp(0.6 * limit, limit).energy == 0);
  CHECK(ramp(limit - 1e-12, limit).along == doctest::Approx(1));
  CHECK(ramp(limit + 1e-12, limit).along == 1);
}

TEST_CASE("the pull of points that are far out has the derivatives of its energy, over models") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  check_far_term(std::make_shared<const FullModel>(body, all, MaterialModel::stable_stvk, Blending::even));
  check_far_term(reduced_model(body, all, MaterialModel::stable_stvk, Blending::even, 10));
  check_far_term(ResponseScene(body, all, MaterialModel::stable_stvk, Blending::even).model);
}

TEST_CASE("edges between the critical ones are those that a comparison of all with all chooses") {
  const auto body = two_bone_bar();
  const FullModel model(body, targets(*body), MaterialModel::linear, Blending::even);
  SkinLimits limits = limits_of(*body, 0.02);
  const VectorXd shifts = random_vector(limits.rest.size(), 0.02, 7);  // without a mirror plane
  for (Eigen::Index i = 0; i < limits.rest.rows(); ++i) limits.rest.row(i) += shifts.segment<3>(3 * i);
  limits.constants.edges_between = 25;
  const Tissue tissue = tissue_of(Neutral<FullModel>(model), limits);
  const auto expected = chosen_by_comparison(tissue, limits);
  std::size_t count = 0;
  for (std::size_t b = 0; b < expected.size(); ++b) {
    CHECK(tissue.edges[b].between == expected[b]);
    count += expected[b].size();
  }
  CHECK(count == 25);
}

TEST_CASE("limits that do not fit are refused") {
  const auto body = two_bone_bar();
  const auto model = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 8);
  const auto refused = [&](const char* what, auto change) {
    SkinLimits limits = limits_of(*body, 0.02);
    change(limits);
    CHECK_THROWS_WITH_AS(MotionLimit<ReducedModel>(model, limits), doctest::Contains(what), std::invalid_argument);
  };
  refused("distances: must be finite and above zero", [](SkinLimits& l) { l.distances(0) = 0; });
  refused("distances: must be finite and above zero", [](SkinLimits& l) { l.distances(0) = kInfinity; });
  for (double bad : {0., 1.5, double(kInfinity)})
    refused("painted: must be above zero and at most one",
            [&](SkinLimits& l) { l.painted = VectorXd::Constant(l.rest.rows(), bad); });
  refused("painted: expected", [](SkinLimits& l) { l.painted.setOnes(1); });
  refused("weights: expected those of 2 bones, got 1", [](SkinLimits& l) { l.weights = l.weights.col(0).eval(); });
  refused("groups: needed where", [](SkinLimits& l) { l.groups = l.weights; });
  refused("embedding: it belongs to another mesh", [](SkinLimits& l) { l.embedding.nodes(0, 0) = 1 << 20; });
  const auto other = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 8);
  Parts<ReducedModel> parts;
  parts.limit = std::make_shared<const MotionLimit<ReducedModel>>(other, limits_of(*body, 0.02));
  CHECK_THROWS_WITH_AS(MovingBody<ReducedModel>(model, {1 / 120.}, parts), doctest::Contains("another model"),
                       std::invalid_argument);
}
