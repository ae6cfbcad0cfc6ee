// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/inertia/response_inertia.hpp"

#include <cmath>
#include <map>

#include "dynamorph/elastic/dense_kernels.hpp"
#include "dynamorph/reduced/inertia/bone_pairs.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph {

using bone_pairs::BonePair;
using Eigen::Index;

namespace {

/// Pairs of bones that share less of the body are left out, and those with less of the largest load in a pose.
constexpr double kNegligible = 1e-5, kInsignificant = 1e-4;
/// Bones whose mean square scales differ by less scale alike.
constexpr double kEven = 1e-6;

using Affine = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

/// What pulls the rest positions of bones, or of nodes with their own transforms, if nothing moves in bind space.
void take_target(const InertialTarget& inertial, Transforms& out) {
  out = inertial.coefficients.col(0).sum() * *inertial.bones[0];
  for (int n = 1; n < InertialTarget::kPoses; ++n) out += inertial.coefficients.col(n).sum() * *inertial.bones[n];
  for (int axis = 0; axis < 3; ++axis) out.col(4 * axis + 3).array() -= inertial.gravity_offset(axis);
}

/// The mean of the squares of a transform's scales, less one.
double growth(const TransformMap& pose) { return pose.leftCols<3>().squaredNorm() / 3 - 1; }

/// Whether some bones or nodes scale otherwise than others.
bool uneven(const VectorXd& growth) { return growth.maxCoeff() - growth.minCoeff() > kEven * (1 + growth.maxCoeff()); }

}  // namespace

ResponseInertia::ResponseInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U, const MatrixXd& W)
    : body_(std::move(body)), count_(W.cols()), rows_(whole_chunks(W.cols())) {
  if (count_ == 0) return;
  const SoftBody& b = *body_;
  std::vector<int> place(b.skin.cols(), -1);
  for (Index bone = 0; !b.own_transforms && bone < b.skin.cols(); ++bone)
    if (b.moments[bone](3, 3) > 0) {
      place[bone] = int(bones_.size());
      bones_.push_back(int(bone));
      pairs_.push_back({place[bone], place[bone], 0});
    }
  if (!b.own_transforms) {
    std::map<BonePair, double> shared;  // volumes, relative to all
    for (int s = 0; s < b.sets(); ++s)
      bone_pairs::for_each_bone_pair(b, s, [&](Index, const BonePair& pair, double part) {
        if (pair.first != pair.second) shared[pair] += part / b.volume;
      });
    for (const auto& [pair, volume] : shared)
      if (volume > kNegligible) pairs_.push_back({place[pair.first], place[pair.second], 0});
  }
  const VectorXd mass = b.unit_mass();
  modal_ = W.transpose() * (mass.asDiagonal() * U);
  bound_ = (1 + MatrixXd(modal_.transpose() * modal_).selfadjointView<Eigen::Lower>().eigenvalues().maxCoeff()) / 2;
  const MatrixXd remainder = W - U * modal_.transpose();
  for (int s = 0; s < b.sets(); ++s) {
    Set& set = sets_.emplace_back();
    const VectorXd part = at_coordinates(b.volumes.col(s));
    set.border = remainder.transpose() * (part.asDiagonal() * U);
    tabulate_mass(W, s, set);
    tabulate_loads(remainder, s, set);
  }
}

void ResponseInertia::tabulate_mass(const MatrixXd& W, int s, Set& set) {
  const SoftBody& b = *body_;
  MatrixXd parts = MatrixXd::Zero(rows_, b.skin.cols());  // nodes with transforms of their own are each a bone there
  for (Index i = 0; i < b.skin.rows(); ++i) {
    const VectorXd mass = b.volumes(i, s) * W.middleRows<3>(3 * i).colwise().squaredNorm();
    for (SkinWeights::InnerIterator it(b.skin, i); it; ++it) parts.col(it.col()).head(count_) += it.value() * mass;
  }
  if (!b.own_transforms) {  // bones_ ascends
    for (size_t c = 0; c < bones_.size(); ++c) parts.col(Index(c)) = parts.col(bones_[c]);
    parts.conservativeResize(Eigen::NoChange, Index(bones_.size()));
  }
  set.mass = parts.rowwise().sum().head(count_);
  for (Index k = 0; k < count_; ++k)
    if (set.mass(k) > 0) parts.row(k) /= set.mass(k);
  set.parts.assign(parts.data(), parts.data() + parts.size());
}

void ResponseInertia::tabulate_loads(const MatrixXd& remainder, int s, Set& set) {
  const SoftBody& b = *body_;
  const Index nodes = b.volumes.rows();
  MatrixXd loads = MatrixXd::Zero(rows_, b.own_transforms ? 3 * nodes : 12 * Index(pairs_.size()));
  if (b.own_transforms) {
    for (Index i = 0; i < nodes; ++i)
      loads.block(0, 3 * i, count_, 3) = b.volumes(i, s) * remainder.middleRows<3>(3 * i).transpose();
  } else {
    std::map<BonePair, Index> column;
    for (size_t t = 0; t < pairs_.size(); ++t)
      column.emplace(std::pair(bones_[pairs_[t].first], bones_[pairs_[t].second]), 12 * Index(t));
    bone_pairs::for_each_bone_pair(b, s, [&](Index i, const BonePair& pair, double part) {
      const auto found = column.find(pair);
      if (found == column.end()) return;
      Eigen::Vector4d X;
      X << b.rest.segment<3>(3 * i) - b.center, 1;
      for (int axis = 0; axis < 3; ++axis)
        for (int j = 0; j < 4; ++j)
          loads.col(found->second + 4 * axis + j).head(count_) += part * X(j) * remainder.row(3 * i + axis).transpose();
    });
    for (size_t t = 0; t < pairs_.size(); ++t)
      pairs_[t].size = std::max(pairs_[t].size, loads.middleCols(12 * Index(t), 12).norm());
  }
  set.loads.assign(loads.data(), loads.data() + loads.size());
}

void ResponseInertia::take_loads(const Transforms& now, const Transforms& target, Scratch& scratch) const {
  scratch.loads.resize(12 * Index(pairs_.size()));
  scratch.centered.resize(bones_.size());
  scratch.active.clear();
  double largest = 0;
  const auto pose = [&](int bone) { return transform(now, bones_[bone]).leftCols<3>(); };
  for (size_t t = 0; t < pairs_.size(); ++t) {
    const auto [first, second, size] = pairs_[t];
    Eigen::Map<Affine> load(scratch.loads.data() + 12 * t);
    if (first == second) {
      Affine& centered = scratch.centered[first] = transform(target, bones_[first]);
      centered.col(3) += centered.leftCols<3>() * body_->center;
      load.noalias() = pose(first).transpose() * centered;
      largest = std::max(largest, load.norm() * size);
    } else {
      load.noalias() = (pose(second) - pose(first)).transpose() * (scratch.centered[first] - scratch.centered[second]);
      if (load.norm() * size < kInsignificant * largest) continue;
    }
    scratch.active.push_back(int(t));
  }
}

void ResponseInertia::take_nodal_loads(const Transforms& now, const Transforms& target, Scratch& scratch) const {
  const Index nodes = body_->volumes.rows();
  scratch.loads.resize(3 * nodes);
  for (Index i = 0; i < nodes; ++i) {
    const TransformMap D = transform(target, i);
    scratch.loads.segment<3>(3 * i) =
        transform(now, i).leftCols<3>().transpose() * (D.leftCols<3>() * body_->rest.segment<3>(3 * i) + D.col(3));
  }
}

void ResponseInertia::take_growth(const Transforms& now, Scratch& scratch) const {
  scratch.growth.resize(body_->own_transforms ? now.rows() : Index(bones_.size()));
  for (Index k = 0; k < scratch.growth.size(); ++k)
    scratch.growth(k) = growth(transform(now, body_->own_transforms ? k : bones_[std::size_t(k)]));
}

void ResponseInertia::add_loads(const Set& set, Scratch& scratch) const {
  scratch.force.setZero(rows_);
  if (body_->own_transforms)
    add_single_product(set.loads.data(), rows_, scratch.loads.data(), scratch.loads.size(), scratch.force.data());
  for (int t : scratch.active)
    add_single_product(set.loads.data() + 12 * t * rows_, rows_, scratch.loads.data() + 12 * t, 12,
                       scratch.force.data());
}

void ResponseInertia::rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities,
                                  Scratch& scratch, VectorXd& force) const {
  if (count_ == 0) return;
  if (body_->own_transforms)
    take_nodal_loads(now, moved, scratch);
  else
    take_loads(now, moved, scratch);
  const Index r = force.size() - count_;
  force.tail(count_).setZero();
  add_product(modal_.data(), count_, force.data(), r, force.data() + r);
  for (size_t s = 0; s < sets_.size(); ++s) {
    add_loads(sets_[s], scratch);
    force.tail(count_) += densities.density(Index(s)) * scratch.force.head(count_);
  }
}

double ResponseInertia::definite_border(const ArrowMatrix& matrix, Scratch& scratch) const {
  scratch.corner.compute(matrix.corner());
  if (scratch.corner.info() != Eigen::Success) return 1;  // also where a target set has no damping
  // The matrix [A, B^T; B, S] is positive definite when all eigenvalues of L^-1 B^T S^-1 B L^-T are below 1, A = L L^T.
  scratch.between = matrix.border().transpose() * matrix.rest().cwiseSqrt().cwiseInverse().asDiagonal();
  scratch.corner.matrixL().solveInPlace(scratch.between);
  scratch.gram.noalias() = scratch.between * scratch.between.transpose();
  scratch.eigen.compute(scratch.gram, Eigen::EigenvaluesOnly);
  const double largest = scratch.eigen.eigenvalues().maxCoeff();
  return largest > bound_ ? std::sqrt(bound_ / largest) : 1;
}

void ResponseInertia::evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch,
                               ArrowMatrix& mass, ArrowMatrix& damped, VectorXd& force) const {
  if (count_ == 0) return;
  const Index r = mass.corner_size();
  const Transforms& now = *inertial.bones[0];
  take_target(inertial, scratch.target);
  if (body_->own_transforms)
    take_nodal_loads(now, scratch.target, scratch);
  else
    take_loads(now, scratch.target, scratch);
  take_growth(now, scratch);
  scratch.past.setZero(r + count_);
  for (int m = 0; m < InertialTarget::kMoments; ++m)
    scratch.past += inertial.coefficients.row(m).sum() * *inertial.q[m];
  multiply_dense(modal_.data(), count_, r, mass.corner().data(), r, mass.border().data());
  if (sets_.size() > 1) multiply_dense(modal_.data(), count_, r, damped.corner().data(), r, damped.border().data());
  mass.rest().setZero();
  damped.rest().setZero();
  force.tail(count_).setZero();
  add_product(modal_.data(), count_, force.data(), r, force.data() + r);
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Set& set = sets_[s];
    const double density = densities.density(Index(s)), damping = densities.damped(Index(s));
    add_loads(set, scratch);
    force.tail(count_) += density * scratch.force.head(count_);
    scratch.scales.setOnes(rows_);
    add_single_product(set.parts.data(), rows_, scratch.growth.data(), scratch.growth.size(), scratch.scales.data());
    const auto scales = scratch.scales.head(count_);
    mass.rest() += density * scales.cwiseProduct(set.mass);
    damped.rest() += damping * scales.cwiseProduct(set.mass);
    if (sets_.size() == 1) continue;  // its own border is zero
    mass.border() += density * scales.asDiagonal() * set.border;
    damped.border() += damping * scales.asDiagonal() * set.border;
    scratch.border_force.noalias() = set.border * scratch.past.head(r);
    force.tail(count_) += density * scales.cwiseProduct(scratch.border_force);
  }
  if (uneven(scratch.growth)) {
    const double kept = definite_border(mass, scratch);
    if (sets_.size() > 1) damped.border() *= definite_border(damped, scratch);
    scratch.border_force.noalias() = mass.border() * scratch.past.head(r);
    force.tail(count_) -= (1 - kept) * scratch.border_force;
    mass.border() *= kept;
  }
  if (sets_.size() == 1) damped.border() = densities.damped(0) / densities.density(0) * mass.border();
  add_dots(mass.border().data(), count_, r, scratch.past.data() + r, force.data());
  force.tail(count_) += mass.rest().cwiseProduct(scratch.past.tail(count_));
}

}  // namespace dynamorph
