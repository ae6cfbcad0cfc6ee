// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/response_tables.hpp"

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
  return FullModel(model.shared_body(), std::move(targets), model.material_model(), model.blending());
}

/// D, then S of one target, whose relaxed modes are U (3 free, r).
VectorXd response_table(const FullModel& model, int target, const MatrixXd& U, const MatrixXd& W) {
  const Index h = W.cols(), r = U.cols(), pairs = model.material_model() == MaterialModel::linear ? 0 : r * (r + 1) / 2;
  VectorXd out(h * (1 + pairs));
  out.head(h) = W.cwiseProduct(model.rest_stiffness(target) * W).colwise().sum();
  if (pairs > 0)
    Eigen::Map<MatrixXd>(out.data() + h, h, pairs) = W.transpose() * force_curvatures_alone(model, target, U);
  return out;
}

/// A of one target (h, r) at its material. Zero for a neutral, about which W is K-orthogonal to U, and in several
/// sets: there no K_j alone is that of the body.
MatrixXd relaxation(const FullModel& model, int target, const ResponseBasis& basis) {
  const std::vector<int> neutral = summed_at(model.targets(), 0);
  if (target == 0 || neutral.size() > 1) return MatrixXd::Zero(basis.W.cols(), basis.U.cols());
  const MatrixXd KW = model.rest_stiffness(target) * basis.W;
  return (basis.W.transpose() * KW).ldlt().solve(KW.transpose() * basis.U);
}

}  // namespace

ReducedTables reduce(const FullModel& model, const ResponseBasis& basis, const ProgressFn& progress) {
  const int targets = int(model.targets().size());
  std::vector<MatrixXd> relaxations(targets), relaxed(targets);
  run_tasks(targets, {}, [&](int j, const ProgressFn&) {
    relaxations[j] = relaxation(model, j, basis);
    relaxed[j] = basis.U - basis.W * relaxations[j];
  });
  ReducedTables tables =
      reduce(model, basis.U, [&](double done) { return !progress || progress(0.6 * done); }, relaxed);
  tables.responses = basis.W;
  tables.relaxation = std::move(relaxations);
  // lambda = 0 is a material, mu = 0 is none: the part of lambda alone is a difference.
  const FullModel both = with_lame(model, {1, 1}), mu = with_lame(model, {0, 1});
  tables.response_lambda.resize(targets);
  tables.response_mu.resize(targets);
  run_tasks(targets, {}, [&](int j, const ProgressFn&) {
    tables.response_mu[j] = response_table(mu, j, relaxed[j], basis.W);
    tables.response_lambda[j] = response_table(both, j, relaxed[j], basis.W) - tables.response_mu[j];
  });
  report(progress, 1);
  return tables;
}

}  // namespace dynamorph
