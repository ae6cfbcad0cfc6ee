// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/response_tables.hpp"

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/reduced/modes/gram_accumulator.hpp"
#include "dynamorph/reduced/modes/static_solver.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

/// D of one target for lambda = 1 Pa, and for mu = 1 Pa (h, 2). About its shape every material model has the energy
/// 1/2 lambda tr(E)^2 + mu E:E, to which the hold adds its own.
MatrixXd response_stiffness(const FullModel& model, int target, const RowMajor& W) {
  using Row = Eigen::Array<double, 1, Eigen::Dynamic>;
  const SoftBody& body = model.body();
  Row lambda = Row::Zero(W.cols()), mu = lambda;
  RowMajor G;
  for (Index e = 0; e < body.mesh.tets.rows(); ++e) {
    const Element& element = model.shape(target).elements[e];
    if (element.weight == 0 || !mode_gradients(body, element, e, W, G)) continue;
    const auto entry = [&](int c) { return G.row(c).array(); };
    lambda += element.weight * (entry(0) + entry(4) + entry(8)).square();
    mu += element.weight *
          (2 * (entry(0).square() + entry(4).square() + entry(8).square()) + (entry(1) + entry(3)).square() +
           (entry(5) + entry(7)).square() + (entry(6) + entry(2)).square());
  }
  for (Index i = 0; i < body.hold_stiffness.rows(); ++i)
    mu += body.hold_stiffness(i, model.targets()[target].set) * W.middleRows<3>(3 * i).array().square().colwise().sum();
  MatrixXd out(W.cols(), 2);
  out << lambda.matrix().transpose(), mu.matrix().transpose();
  return out;
}

/// D, then S of one target with the given Lame parameters, whose relaxed modes are U (3 free, r).
VectorXd response_table(const FullModel& model, int target, Lame lame, const VectorXd& D, const MatrixXd& U,
                        const RowMajor& W) {
  const Index h = W.cols(), r = U.cols(), pairs = model.material_model() == MaterialModel::linear ? 0 : r * (r + 1) / 2;
  VectorXd out(h * (1 + pairs));
  out.head(h) = D;
  if (pairs > 0)
    Eigen::Map<MatrixXd>(out.data() + h, h, pairs) = inner_products(W, force_curvatures_alone(model, target, lame, U));
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
  const RowMajor W = basis.W;
  tables.response_lambda.resize(targets);
  tables.response_mu.resize(targets);
  run_tasks(targets, {}, [&](int j, const ProgressFn&) {
    const MatrixXd D = response_stiffness(model, j, W);
    tables.response_lambda[j] = response_table(model, j, {1, 0}, D.col(0), relaxed[j], W);
    tables.response_mu[j] = response_table(model, j, {0, 1}, D.col(1), relaxed[j], W);
  });
  report(progress, 1);
  return tables;
}

}  // namespace dynamorph
