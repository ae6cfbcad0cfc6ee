// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/static_solver.hpp"

#include <algorithm>
#include <set>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"

namespace dynamorph {

double width(const SoftBody& body) {
  double farthest = 0;
  for (Eigen::Index i = 0; i < body.rest.size(); i += 3)
    farthest = std::max(farthest, (body.rest.segment<3>(i) - body.center).norm());
  return 2 * farthest;
}

std::vector<int> summed_at(const std::vector<MorphTarget>& targets, int j) {
  std::vector<int> summed{j};
  std::set<int> sets{targets[j].set};
  for (int other = 0; other < int(targets.size()); ++other)
    if (sets.insert(targets[other].set).second) summed.push_back(other);
  return summed;
}

std::vector<int> distinct_targets(const std::vector<MorphTarget>& targets) {
  const std::vector<int> neutral = summed_at(targets, 0);
  std::vector<int> distinct{0};
  for (int j = 1; j < int(targets.size()); ++j)
    if (std::find(neutral.begin(), neutral.end(), j) == neutral.end()) distinct.push_back(j);
  return distinct;
}

StaticSolver::StaticSolver(const FullModel& model, int target, std::function<void()> tick_)
    : mass(model.body().unit_mass() * model.targets()[target].density),
      stiffness(model.zero()),
      tick(std::move(tick_)) {
  for (int j : summed_at(model.targets(), target)) values(stiffness) += values(model.rest_stiffness(j));
  shift = 1e-9 * (stiffness.diagonal().array() / mass.array()).maxCoeff();
  stiffness.diagonal() += shift * mass;
  if (!solver.factorize(stiffness))
    throw Error("Target '" + model.targets()[target].name +
                "' has a shape with degenerate elements. Smooth its sculpt, or raise the cage resolution.");
}

VectorXd StaticSolver::solve(const VectorXd& load) const {
  if (tick) tick();
  return solver.solve(load);
}

MatrixXd StaticSolver::solve_all(MatrixXd loads) const {
  constexpr Eigen::Index kBlock = 8;  // as many as the solver takes at a time
  constexpr Eigen::Index kTurn = 16 * kBlock;
  for (Eigen::Index first = 0; first < loads.cols(); first += kTurn) {
    auto turn = loads.middleCols(first, std::min(kTurn, loads.cols() - first));
    run_tasks(int((turn.cols() + kBlock - 1) / kBlock), {}, [&](int block, const ProgressFn&) {
      solver.solve_in_place(turn.middleCols(block * kBlock, std::min(kBlock, turn.cols() - block * kBlock)));
    });
    for (Eigen::Index c = 0; tick && c < turn.cols(); ++c) tick();
  }
  return loads;
}

}  // namespace dynamorph
