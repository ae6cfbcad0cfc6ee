// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/nodal_inertia.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr int kPoses = InertialTarget::kPoses;

/// Eight nodes' transforms in the poses of an inertial target, [A | a] row-major, and by how much they count.
struct EightNodes {
  Doubles poses[kPoses][12];
  Doubles mass, damped;
};

/// y = sum_n A_n (sums_n X + U d_n) + sums_n a_n - gravity_offset. table: U (r, 3), then X; d (r, kPoses) row-major.
DYNAMORPH_INLINE void add_up(const EightNodes& nodes, const Doubles* table, Index r, const double* d,
                             const double* sums, const double* gravity_offset, Doubles* y) {
  Doubles bind[kPoses][3];
  for (int n = 0; n < kPoses; ++n)
    for (int c = 0; c < 3; ++c) bind[n][c] = table[3 * r + c] * sums[n];
  for (Index k = 0; k < r; ++k)
    for (int n = 0; n < kPoses; ++n)
      for (int c = 0; c < 3; ++c) bind[n][c] += table[3 * k + c] * d[kPoses * k + n];
  for (int i = 0; i < 3; ++i) {
    y[i] = Doubles{} - gravity_offset[i];
    for (int n = 0; n < kPoses; ++n) {
      const Doubles* row = nodes.poses[n] + 4 * i;
      y[i] += row[0] * bind[n][0] + row[1] * bind[n][1] + row[2] * bind[n][2] + row[3] * sums[n];
    }
  }
}

/// What eight nodes add to the force (r) and to the packed mass, and if `damped` is not null to that. modes (r, 3):
/// scratch.
DYNAMORPH_MULTIVERSION
void add_eight_nodes(const EightNodes& nodes, const Doubles* table, Index r, const double* d, const double* sums,
                     const double* gravity_offset, Doubles* __restrict modes, Doubles* __restrict force,
                     Doubles* __restrict mass, Doubles* __restrict damped) {
  Doubles y[3];
  add_up(nodes, table, r, d, sums, gravity_offset, y);
  const Doubles* A = nodes.poses[0];
  for (Index k = 0; k < r; ++k) {
    const Doubles* u = table + 3 * k;
    for (int i = 0; i < 3; ++i) modes[3 * k + i] = A[4 * i] * u[0] + A[4 * i + 1] * u[1] + A[4 * i + 2] * u[2];
  }
  for (Index k = 0; k < r; ++k) {
    const Doubles own[3] = {modes[3 * k], modes[3 * k + 1], modes[3 * k + 2]};
    const Doubles heavy[3] = {nodes.mass * own[0], nodes.mass * own[1], nodes.mass * own[2]};
    force[k] += heavy[0] * y[0] + heavy[1] * y[1] + heavy[2] * y[2];
    for (Index l = k; l < r; ++l) {
      const Doubles* other = modes + 3 * l;
      *mass++ += heavy[0] * other[0] + heavy[1] * other[1] + heavy[2] * other[2];
    }
    if (!damped) continue;
    const Doubles braked[3] = {nodes.damped * own[0], nodes.damped * own[1], nodes.damped * own[2]};
    for (Index l = k; l < r; ++l) {
      const Doubles* other = modes + 3 * l;
      *damped++ += braked[0] * other[0] + braked[1] * other[1] + braked[2] * other[2];
    }
  }
}

double sum(const Doubles& lanes) {
  double out = 0;
  for (int lane = 0; lane < kLanes; ++lane) out += lanes[lane];
  return out;
}

void unpack(const LaneVector<Doubles>& packed, Index r, MatrixXd& out) {
  out.resize(r, r);
  for (Index k = 0, p = 0; k < r; ++k)
    for (Index l = k; l < r; ++l, ++p) out(k, l) = out(l, k) = sum(packed[p]);
}

}  // namespace

NodalInertia::NodalInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U)
    : body_(std::move(body)), r_(U.cols()) {
  const Index nodes = body_->volumes.rows(), size = 3 * (r_ + 1);
  table_.assign((nodes + kLanes - 1) / kLanes * size, Doubles{});
  for (Index i = 0; i < nodes; ++i)
    for (int c = 0; c < 3; ++c) {
      Doubles* eight = table_.data() + i / kLanes * size + c;
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
  scratch.displacements.resize(kPoses, r_);  // column-major: pose after pose of each mode
  for (Index k = 0; k < r_; ++k)
    for (int n = 0; n < kPoses; ++n) {
      double all = 0;
      for (int m = 0; m < InertialTarget::kMoments; ++m) all += inertial.coefficients(m, n) * (*inertial.q[m])(k);
      scratch.displacements(n, k) = all;
    }
  const Eigen::Matrix<double, 1, kPoses> sums = inertial.coefficients.colwise().sum();

  scratch.modes.resize(3 * r_);
  scratch.force.assign(r_, Doubles{});
  scratch.mass.assign(pairs, Doubles{});
  scratch.damped.assign(several ? pairs : 0, Doubles{});
  for (Index first = 0; first < nodes; first += kLanes) {
    alignas(64) EightNodes eight{};
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
  unpack(scratch.mass, r_, mass);
  if (several)
    unpack(scratch.damped, r_, damped);
  else
    damped = densities.damped(0) / densities.density(0) * mass;
}

}  // namespace dynamorph
