// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/inertia/modal_inertia.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "dynamorph/reduced/inertia/modal_kernels.hpp"

namespace dynamorph {

namespace {

using namespace bone_pairs;

/// Two bones with a smaller part of the force are left out, whatever the pose (see modal_kernels.cpp).
constexpr double kNegligible = 1e-5;
using BoneMotion = ModalInertia::BoneMotion;

/// lanes[m][e][p] = entry e of matrix m < count of pair p: that of its bone, or the difference of its two bones.
void gather(const std::vector<BoneMotion>& bones, const std::vector<BonePair>& pairs,
            const std::array<float, kLanes>& signs, int count, FloatW lanes[][12]) {
  for (size_t p = 0; p < pairs.size(); ++p) {
    const auto &a = bones[pairs[p].first].values, &b = bones[pairs[p].second].values;
    const float less = signs[p] < 0;
    for (int m = 0; m < count; ++m)
      for (int e = 0; e < 12; ++e) lanes[m][e][p] = a[m][e] - less * b[m][e];
  }
}

}  // namespace

ModalInertia::ModalInertia(const SoftBody& body, const MatrixXd& U) : r_(U.cols()), center_(body.center) {
  const Index nodes = body.skin.rows();
  VectorXd motion(nodes);  // how much each node moves in the modes
  for (Index i = 0; i < nodes; ++i) motion(i) = U.middleRows<3>(3 * i).squaredNorm();
  const double all_motion = body.volumes.rowwise().sum().dot(motion);
  for (int s = 0; s < body.sets(); ++s) {
    std::map<BonePair, double> volumes, motions;
    for_each_bone_pair(body, s, [&](Index i, const BonePair& pair, double part) {
      volumes[pair] += part / body.volume;
      motions[pair] += part * motion(i) / all_motion;
    });
    // With a bound (Cauchy-Schwarz) on their part of the force.
    std::vector<std::pair<double, BonePair>> pairs, of_two;
    for (const auto& [pair, volume] : volumes) {
      const double largest_force = std::sqrt(volume * motions[pair]);
      if (largest_force > kNegligible) (pair.first == pair.second ? pairs : of_two).push_back({largest_force, pair});
    }
    Tensors& set = sets_.emplace_back();
    std::sort(of_two.rbegin(), of_two.rend());
    const size_t bones = pairs.size();
    pairs.insert(pairs.end(), of_two.begin(), of_two.end());
    for (size_t p = 0; p < pairs.size(); ++p) {
      if (p % kLanes == 0) {
        set.groups.push_back({{}, {}, p < bones ? HUGE_VAL : pairs[p].first});
        set.groups.back().signs.fill(-1);  // a lane without a pair looks like two bones that move together
      }
      set.groups.back().pairs.push_back(pairs[p].second);
      set.groups.back().signs[p % kLanes] = p < bones ? 1 : -1;
    }
    tabulate(body, U, s, set);
  }
  for (Tensors& set : sets_)
    for (Group& group : set.groups)
      for (BonePair& pair : group.pairs) pair = {used(pair.first), used(pair.second)};
}

int ModalInertia::used(int bone) {
  const auto found = std::find(used_.begin(), used_.end(), bone);
  if (found != used_.end()) return int(found - used_.begin());
  used_.push_back(bone);
  return int(used_.size()) - 1;
}

void ModalInertia::tabulate(const SoftBody& body, const MatrixXd& U, int s, Tensors& set) const {
  set.mass.setZero(r_ * (r_ + 1) / 2);
  std::map<BonePair, Index> column;
  for (const Group& group : set.groups)
    for (const BonePair& pair : group.pairs) column.emplace(pair, Index(column.size()));
  MatrixXd sums = MatrixXd::Zero(entries(r_), Index(column.size()));
  VectorXd entry(entries(r_));
  Index seen = -1;
  for_each_bone_pair(body, s, [&](Index i, const BonePair& pair, double part) {
    const auto found = column.find(pair);
    if (found == column.end()) return;
    if (i != seen) node_tensor(U.middleRows<3>(3 * i), body.rest.segment<3>(3 * i) - center_, entry);
    seen = i;
    sums.col(found->second) += part * entry;
  });
  for (Index k = 0, p = 0; k < r_; ++k)
    for (Index l = k; l < r_; ++l, ++p)
      for (Index i = 0; i < body.volumes.rows(); ++i)
        set.mass(p) += body.volumes(i, s) * U.col(k).segment<3>(3 * i).dot(U.col(l).segment<3>(3 * i));
  set.table.assign(set.groups.size() * entries(r_), FloatW{});
  Index next = 0;
  for (size_t g = 0; g < set.groups.size(); ++g)
    for (size_t lane = 0; lane < set.groups[g].pairs.size(); ++lane, ++next)
      for (Index e = 0; e < entries(r_); ++e) set.table[g * entries(r_) + e][lane] = float(sums(e, next));
}

void ModalInertia::evaluate(const InertialTarget& inertial, const SetDensities& densities, Result& out) const {
  const Index pairs = r_ * (r_ + 1) / 2;
  take_differences(inertial, out.differences);
  out.bones.resize(used_.size());
  const DifferenceCoefficients coefficients = coefficients_of_differences(inertial.coefficients);
  for (size_t b = 0; b < used_.size(); ++b) {
    const double* poses[InertialTarget::kPoses];
    for (int n = 0; n < InertialTarget::kPoses; ++n) poses[n] = inertial.bones[n]->data() + 12 * used_[b];
    combine_poses(poses, coefficients.data(), center_.data(), inertial.gravity_offset.data(), out.bones[b].values);
  }

  out.slopes.resize(9 * r_);
  out.sums.resize((r_ + pairs + kLanes - 1) / kLanes * kLanes);
  out.totals.resize(out.sums.size());
  out.mass.setZero(r_, r_);
  out.damped.setZero(r_, r_);
  out.force.setZero(r_);
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Tensors& set = sets_[s];
    std::fill(out.sums.begin(), out.sums.end(), FloatW{});
    for (size_t g = 0; g < set.groups.size(); ++g) {
      constexpr int kMatrices = 1 + InertialTarget::kMoments;
      FloatW lanes[kMatrices][12] = {};
      gather(out.bones, set.groups[g].pairs, set.groups[g].signs, kMatrices, lanes);
      FloatW sign;
      std::copy_n(set.groups[g].signs.data(), kLanes, reinterpret_cast<float*>(&sign));
      add_eight_pairs(lanes, sign, set.groups[g].largest_force, out.differences.data(), r_,
                      set.table.data() + g * entries(r_), out.slopes.data(), out.sums.data(), out.sums.data() + r_);
    }
    add_lanes(out.sums.data(), Index(out.sums.size()) / kLanes, out.totals.data());
    const double density = densities.density(s), damped = densities.damped(s);
    for (Index k = 0; k < r_; ++k) out.force(k) += density * out.totals[k];
    const float* change = out.totals.data() + r_;
    for (Index k = 0, p = 0; k < r_; ++k)
      for (Index l = k; l < r_; ++l, ++p) {
        const double mass = set.mass(p) + change[p];
        out.mass(l, k) += density * mass;
        out.damped(l, k) += damped * mass;
      }
  }
  out.mass.triangularView<Eigen::StrictlyUpper>() = out.mass.transpose();
  out.damped.triangularView<Eigen::StrictlyUpper>() = out.damped.transpose();
}

void ModalInertia::rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities,
                               Result& scratch, Eigen::Ref<VectorXd> force) const {
  scratch.bones.resize(used_.size());
  for (size_t b = 0; b < used_.size(); ++b) {
    const double *pose = now.data() + 12 * used_[b], *by = moved.data() + 12 * used_[b];
    auto& motion = scratch.bones[b].values;
    std::copy_n(pose, 12, motion[0]);
    std::copy_n(by, 12, motion[1]);
    for (int e = 0; e < 12; e += 4)  // in double: it may be large and of the other sign
      motion[1][e + 3] = float(by[e + 3] + by[e] * center_(0) + by[e + 1] * center_(1) + by[e + 2] * center_(2));
  }
  scratch.sums.resize((r_ + kLanes - 1) / kLanes * kLanes);
  scratch.totals.resize(scratch.sums.size());
  force.setZero();
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Tensors& set = sets_[s];
    std::fill(scratch.sums.begin(), scratch.sums.end(), FloatW{});
    for (size_t g = 0; g < set.groups.size(); ++g) {
      const Group& group = set.groups[g];
      FloatW lanes[2][12] = {}, sign;
      gather(scratch.bones, group.pairs, group.signs, 2, lanes);
      std::copy_n(group.signs.data(), kLanes, reinterpret_cast<float*>(&sign));
      add_eight_rigid_pairs(lanes, sign, r_, set.table.data() + g * entries(r_), scratch.sums.data());
    }
    add_lanes(scratch.sums.data(), Index(scratch.sums.size()) / kLanes, scratch.totals.data());
    for (Index k = 0; k < r_; ++k) force(k) += densities.density(s) * scratch.totals[k];
  }
}

}  // namespace dynamorph
