// SPDX-License-Identifier: GPL-3.0-or-later
// Static answers of a body at one of its targets, from which bases are made.
#pragma once

#include <functional>
#include <vector>

#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

/// The width of the body through its center, meters. It does not depend on the axes, as `SoftBody::size` does.
double width(const SoftBody& body);

/// The targets with energies in K about target j's shape: j itself, and of every other set the first target, which is
/// its neutral. Targets need not be ordered by set.
std::vector<int> summed_at(const std::vector<MorphTarget>& targets, int j);

/// The targets whose K differ: each set's first target is the same neutral.
std::vector<int> distinct_targets(const std::vector<MorphTarget>& targets);

/// K_j + epsilon M, factored. The shift keeps K positive definite for a body that is hardly held, and is far below the
/// first elastic frequency. Throws Error when the target's shape is degenerate.
struct StaticSolver {
  StaticSolver(const FullModel& model, int target, std::function<void()> tick_ = {});
  VectorXd solve(const VectorXd& load) const;
  MatrixXd solve_all(MatrixXd loads) const;

  VectorXd mass;               ///< (3 free), kg
  double shift;                ///< 1/s^2
  SparseMatrix stiffness;      ///< K + shift M
  std::function<void()> tick;  ///< called for every solve: reports progress, may throw Cancelled
  BlockCholesky<double> solver;
};

}  // namespace dynamorph
