// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/response_tables.hpp"

#include <cmath>
#include <random>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/reduced/modes/static_solver.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

/// `model` with the given Lame parameters at all targets.
FullModel with_lame(const FullModel& model, Lame lame) {
  std::vector<MorphTarget> targets = model.targets();
  for (MorphTarget& target : targets) target.lame = lame;
  return FullModel(model.shared_body(), std::move(targets), model.law(), model.blending());
}

/// D, then S of one target.
VectorXd response_table(const FullModel& model, int target, const ResponseBasis& basis) {
  const MatrixXd& W = basis.W;
  const Index h = W.cols(), r = basis.U.cols(), pairs = model.law() == Law::linear ? 0 : r * (r + 1) / 2;
  VectorXd out(h * (1 + pairs));
  out.head(h) = W.cwiseProduct(model.rest_stiffness(target) * W).colwise().sum();
  if (pairs > 0)
    Eigen::Map<MatrixXd>(out.data() + h, h, pairs) = W.transpose() * force_curvatures_alone(model, target, basis.U);
  return out;
}

/// The polynomial in t of the energy at t v: its terms of degree 2 to 4, and by how much the condensed responses reduce
/// the last.
struct Ray {
  double square, cube, fourth, coupling;
};

/// Tables with their materials about a target, with those of the other sets' neutral targets.
struct Summed {
  TableLayout layout;
  VectorXd modes, responses;
};

Summed summed(const FullModel& model, const ReducedTables& tables, int target) {
  const TableLayout layout = tables.layout();
  VectorXd modes = VectorXd::Zero(layout.distinct()), responses = VectorXd::Zero(tables.response_mu[target].size());
  for (int j : summed_at(model.targets(), target)) {
    const Lame lame = model.targets()[j].lame;
    modes += lame.lambda * tables.lambda[j] + lame.mu * tables.mu[j];
    responses += lame.lambda * tables.response_lambda[j] + lame.mu * tables.response_mu[j];
  }
  return {layout, unfolded(modes, layout), std::move(responses)};
}

Ray along(const Summed& tables, const VectorXd& v) {
  const TableLayout& layout = tables.layout;
  const VectorXd &table = tables.modes, &responses = tables.responses;
  const Index pairs = layout.pairs(), h = responses.size() / (1 + pairs);
  VectorXd vv(pairs);
  Index at = 0;
  for_pairs(layout.r, [&](Index k, Index l) { vv(at++) = (k == l ? 1 : 2) * v(k) * v(l); });
  Ray out{0.5 * vv.dot(table.head(pairs)), 0, 0, 0};
  out.cube = vv.dot(Eigen::Map<const MatrixXd>(table.data() + layout.linear(), pairs, layout.r) * v) / 6;
  for (Index q = 0; q < pairs; ++q) {
    double row = 0;
    for (Index p = q; p < pairs; ++p) row += (p == q ? 1 : 2) * vv(p) * table(layout.quadratic(p, q));
    out.fourth += vv(q) * row / 12;
  }
  const VectorXd curved = 0.5 * (Eigen::Map<const MatrixXd>(responses.data() + h, h, pairs) * vv);
  out.coupling = 0.5 * curved.cwiseAbs2().cwiseQuotient(responses.head(h)).sum();
  return out;
}

/// The smallest t > 0, at most `most`, at which the condensed energy is only kLeft of its linear part.
double where_soft(const Ray& ray, double most) {
  constexpr double kLeft = 0.1;
  const double a = (1 - kLeft) * ray.square, b = ray.cube, c = ray.fourth - ray.coupling;
  for (double sign : {1.0, -1.0}) {  // a + sign b t + c t^2 = 0
    const double root = b * b - 4 * a * c;
    if (root < 0) continue;
    for (double t : {(-sign * b - std::sqrt(root)) / (2 * c), (-sign * b + std::sqrt(root)) / (2 * c)})
      if (t > 0) most = std::min(most, t);
  }
  return most;
}

/// How far the coupling may act in each mode (r): to where it makes the energy much too small, in directions drawn at
/// random from the motion that the modes' amplitudes describe, and never much farther than a body moves.
VectorXd reach(const FullModel& model, const ReducedTables& tables, const VectorXd& amplitudes) {
  constexpr int kDirections = 128;
  constexpr double kLeast = 0.05, kFar = 0.5;  // of the largest amplitude; of the body's size
  const Index r = tables.basis.cols();
  const VectorXd scales = amplitudes.cwiseMax(kLeast * amplitudes.maxCoeff());
  // Coordinates of a body that moves by kFar of its size in the root mean square.
  const double farthest = kFar * model.body().size * std::sqrt(model.body().volume);
  double least = farthest / scales.norm();
  for (int j = 0; j < int(tables.lambda.size()); ++j) {
    const Summed about = summed(model, tables, j);
    std::mt19937 random(1);  // the same directions on every machine: no distribution of the library
    for (int d = 0; d < kDirections; ++d) {
      VectorXd v(r);
      for (double& x : v) x = double(random()) / double(std::mt19937::max()) - 0.5;
      v = v.normalized().cwiseProduct(scales);
      least = where_soft(along(about, v), least);
    }
  }
  return least * scales;
}

}  // namespace

ReducedTables reduce(const FullModel& model, const ResponseBasis& basis, const ProgressFn& progress) {
  ReducedTables tables = reduce(model, basis.U, [&](double done) { return !progress || progress(0.6 * done); });
  tables.responses = basis.W;
  // lambda = 0 is a material, mu = 0 is none: the part of lambda alone is a difference.
  const FullModel both = with_lame(model, {1, 1}), mu = with_lame(model, {0, 1});
  const int targets = int(model.targets().size());
  tables.response_lambda.resize(targets);
  tables.response_mu.resize(targets);
  run_tasks(targets, {}, [&](int j, const ProgressFn&) {
    tables.response_mu[j] = response_table(mu, j, basis);
    tables.response_lambda[j] = response_table(both, j, basis) - tables.response_mu[j];
  });
  report(progress, 0.9);
  tables.reach = model.law() == Law::linear ? VectorXd::Ones(basis.U.cols()) : reach(model, tables, basis.amplitudes);
  report(progress, 1);
  return tables;
}

}  // namespace dynamorph
