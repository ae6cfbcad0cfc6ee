// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/inertia/nodal_inertia.hpp"

#include "dynamorph/reduced/inertia/nodal_kernels.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph {

using bone_pairs::kPoses;
using Eigen::Index;

namespace {

static_assert(kPoses == InertialTarget::kPoses, "see modal_arithmetic.hpp");

double sum(const DoubleW& lanes) {
  double out = 0;
  for (int lane = 0; lane < kLanes; ++lane) out += lanes[lane];
  return out;
}

/// packed: of the upper triangle, with a lane for each of several parts of the sum.
void unpack_sum(const LaneVector<DoubleW>& packed, Index r, MatrixXd& out) {
  out.resize(r, r);
  unpack([&](Index p) { return sum(packed[p]); }, out);
}

}  // namespace

NodalInertia::NodalInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U)
    : body_(std::move(body)), r_(U.cols()) {
  const Index nodes = body_->volumes.rows(), size = 3 * (r_ + 1);
  table_.assign((nodes + kLanes - 1) / kLanes * size, DoubleW{});
  for (Index i = 0; i < nodes; ++i)
    for (int c = 0; c < 3; ++c) {
      DoubleW* eight = table_.data() + i / kLanes * size + c;
      for (Index k = 0; k < r_; ++k) eight[3 * k][i % kLanes] = U(3 * i + c, k);
      eight[3 * r_][i % kLanes] = body_->rest(3 * i + c);
    }
}

void NodalInertia::evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch,
                            MatrixXd& mass, MatrixXd& damped, VectorXd& force) const {
  const Index nodes = body_->volumes.rows(), pairs = r_ * (r_ + 1) / 2;
  const bool several = body_->sets() > 1;
  const double* poses[kPoses];
  for (int n = 0; n < kPoses; ++n) {
    if (!body_->own_transforms) {
      scratch.poses[n].bones = *inertial.bones[n];
      pose_nodes(body_->skin, scratch.poses[n]);
    }
    poses[n] = (body_->own_transforms ? *inertial.bones[n] : scratch.poses[n].nodes).data();
  }
  scratch.displacements.resize(kPoses, r_);  // column-major: the poses of a mode are contiguous
  for (Index k = 0; k < r_; ++k)
    for (int n = 0; n < kPoses; ++n) {
      double all = 0;
      for (int m = 0; m < InertialTarget::kMoments; ++m) all += inertial.coefficients(m, n) * (*inertial.q[m])(k);
      scratch.displacements(n, k) = all;
    }
  const Eigen::Matrix<double, 1, kPoses> sums = inertial.coefficients.colwise().sum();

  scratch.modes.resize(3 * r_);
  scratch.force.assign(r_, DoubleW{});
  scratch.mass.assign(pairs, DoubleW{});
  scratch.damped.assign(several ? pairs : 0, DoubleW{});
  for (Index first = 0; first < nodes; first += kLanes) {
    EightNodes eight{};
    for (Index i = first; i < std::min(first + kLanes, nodes); ++i) {
      const Index lane = i - first;
      for (int n = 0; n < kPoses; ++n)
        for (int e = 0; e < 12; ++e) eight.poses[n][e][int(lane)] = poses[n][12 * i + e];
      eight.mass[int(lane)] = body_->volumes.row(i).dot(densities.density);
      eight.damped[int(lane)] = body_->volumes.row(i).dot(densities.damped);
    }
    add_eight_nodes(eight, table_.data() + first / kLanes * 3 * (r_ + 1), r_, scratch.displacements.data(), sums.data(),
                    inertial.gravity_offset.data(), scratch.modes.data(), scratch.force.data(), scratch.mass.data(),
                    several ? scratch.damped.data() : nullptr);
  }
  force.resize(r_);
  for (Index k = 0; k < r_; ++k) force(k) = sum(scratch.force[k]);
  unpack_sum(scratch.mass, r_, mass);
  if (several)
    unpack_sum(scratch.damped, r_, damped);
  else
    damped = densities.damped(0) / densities.density(0) * mass;
}

void NodalInertia::rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities,
                               Scratch& scratch, Eigen::Ref<VectorXd> force) const {
  const Index nodes = body_->volumes.rows();
  scratch.force.assign(r_, DoubleW{});
  for (Index first = 0; first < nodes; first += kLanes) {
    DoubleW y[3] = {};
    for (Index i = first; i < std::min(first + kLanes, nodes); ++i) {
      const TransformMap D = transform(moved, i);
      const Vector3d target = D.leftCols<3>() * body_->rest.segment<3>(3 * i) + D.col(3);
      const Vector3d load = transform(now, i).leftCols<3>().transpose() * target;
      const double mass = body_->volumes.row(i).dot(densities.density);
      for (int c = 0; c < 3; ++c) y[c][int(i - first)] = mass * load(c);
    }
    const DoubleW* u = table_.data() + first / kLanes * 3 * (r_ + 1);
    for (Index k = 0; k < r_; ++k, u += 3) scratch.force[k] += u[0] * y[0] + u[1] * y[1] + u[2] * y[2];
  }
  for (Index k = 0; k < r_; ++k) force(k) = sum(scratch.force[k]);
}

}  // namespace dynamorph
