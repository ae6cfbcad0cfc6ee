// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/nodal_inertia.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

void set_square(const MatrixXd& B, MatrixXd& out) {
  out.setZero(B.cols(), B.cols());
  out.selfadjointView<Eigen::Lower>().rankUpdate(B.transpose());
  out.triangularView<Eigen::StrictlyUpper>() = out.transpose();
}

}  // namespace

void NodalInertia::evaluate(const Motion& motion, const SetDensities& densities, Scratch& scratch, MatrixXd& mass,
                            MatrixXd& damped, VectorXd& force) const {
  Motion displaced = motion;
  for (int m = 0; m < Motion::kMoments; ++m) {
    scratch.displacements[m].noalias() = U_ * *motion.q[m];
    displaced.q[m] = &scratch.displacements[m];
  }
  scratch.nodes.evaluate(*body_, displaced);

  const Index nodes = body_->volumes.rows();
  scratch.root = (body_->volumes * densities.density).cwiseSqrt();
  scratch.modes.resize(U_.rows(), U_.cols());
  for (Index k = 0; k < U_.cols(); ++k)
    for (Index i = 0; i < nodes; ++i)
      scratch.modes.col(k).segment<3>(3 * i).noalias() =
          scratch.root(i) * transform(scratch.nodes.frame.nodes, i).leftCols<3>() * U_.col(k).segment<3>(3 * i);
  set_square(scratch.modes, mass);
  for (Index i = 0; i < nodes; ++i) scratch.nodes.sum.segment<3>(3 * i) *= scratch.root(i);
  force.noalias() = scratch.modes.transpose() * scratch.nodes.sum;

  if (body_->sets() == 1) {
    damped = densities.damped(0) / densities.density(0) * mass;
    return;
  }
  scratch.damped = scratch.modes;
  for (Index i = 0; i < nodes; ++i)
    scratch.damped.middleRows<3>(3 * i) *= std::sqrt(body_->volumes.row(i).dot(densities.damped)) / scratch.root(i);
  set_square(scratch.damped, damped);
}

}  // namespace dynamorph
