// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/response_inertia.hpp"

#include "dynamorph/reduced/table_layout.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

using Affine = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

/// What pulls the rest positions relative to `centre` of bone b, or of node b with its own transform.
Affine inertial_target(const InertialTarget& inertial, Index b, const Vector3d& centre) {
  Affine target = Affine::Zero();
  for (int n = 0; n < InertialTarget::kPoses; ++n)
    target += inertial.coefficients.col(n).sum() * Eigen::Map<const Affine>(inertial.bones[n]->data() + 12 * b);
  target.col(3) += target.leftCols<3>() * centre - inertial.gravity_offset;
  return target;
}

}  // namespace

ResponseInertia::ResponseInertia(std::shared_ptr<const SoftBody> body, const MatrixXd& U, const MatrixXd& W)
    : body_(std::move(body)), count_(W.cols()), rows_(whole_chunks(W.cols())) {
  const SoftBody& b = *body_;
  const Index nodes = b.volumes.rows();
  for (Index bone = 0; !b.own_transforms && bone < b.skin.cols(); ++bone)
    if (b.moments[bone](3, 3) > 0) {
      bones_.push_back(int(bone));
      volumes_.push_back(b.moments[bone](3, 3) / b.volume);
    }
  std::vector<Index> place(b.skin.cols(), -1);
  for (size_t k = 0; k < bones_.size(); ++k) place[bones_[k]] = Index(k);
  for (int s = 0; s < b.sets(); ++s) {
    Set& set = sets_.emplace_back();
    const VectorXd mass = b.volumes.col(s).replicate(1, 3).transpose().reshaped();
    set.mass = (mass.asDiagonal() * W.cwiseAbs2()).colwise().sum();
    set.border = W.transpose() * (mass.asDiagonal() * U);
    MatrixXd loads = MatrixXd::Zero(rows_, b.own_transforms ? 3 * nodes : 12 * Index(bones_.size()));
    for (Index i = 0; i < nodes; ++i) {
      const auto moved = W.middleRows<3>(3 * i).transpose();  // (h, 3)
      if (b.own_transforms) {
        loads.block(0, 3 * i, count_, 3) = b.volumes(i, s) * moved;
        continue;
      }
      Eigen::Vector4d X;
      X << b.rest.segment<3>(3 * i) - b.centre, 1;
      for (SkinWeights::InnerIterator it(b.skin, i); it; ++it)
        for (int axis = 0; axis < 3 && place[it.col()] >= 0; ++axis)
          for (int j = 0; j < 4; ++j)
            loads.col(12 * place[it.col()] + 4 * axis + j).head(count_) +=
                b.volumes(i, s) * it.value() * X(j) * moved.col(axis);
    }
    set.loads.resize(loads.size());
    for (Index k = 0; k < loads.size(); ++k) set.loads[k] = float(loads.data()[k]);
  }
}

double ResponseInertia::take_loads(const InertialTarget& inertial, VectorXd& loads) const {
  loads.resize(12 * Index(bones_.size()));
  double scale = 0, all = 0;
  for (size_t k = 0; k < bones_.size(); ++k) {
    const Eigen::Map<const Affine> pose(inertial.bones[0]->data() + 12 * bones_[k]);
    Eigen::Map<Affine> load(loads.data() + 12 * k);
    load.noalias() = pose.leftCols<3>().transpose() * inertial_target(inertial, bones_[k], body_->centre);
    scale += volumes_[k] * pose.leftCols<3>().squaredNorm() / 3;
    all += volumes_[k];
  }
  return scale / all;
}

double ResponseInertia::take_nodal_loads(const InertialTarget& inertial, VectorXd& loads) const {
  const Index nodes = body_->volumes.rows();
  loads.resize(3 * nodes);
  double scale = 0;
  for (Index i = 0; i < nodes; ++i) {
    const Eigen::Map<const Affine> pose(inertial.bones[0]->data() + 12 * i);
    const Affine target = inertial_target(inertial, i, Vector3d::Zero());
    loads.segment<3>(3 * i) =
        pose.leftCols<3>().transpose() * (target.leftCols<3>() * body_->rest.segment<3>(3 * i) + target.col(3));
    scale += pose.leftCols<3>().squaredNorm() / 3;
  }
  return scale / double(nodes);
}

void ResponseInertia::evaluate(const InertialTarget& inertial, const SetDensities& densities, Scratch& scratch,
                               ArrowMatrix& mass, ArrowMatrix& damped, VectorXd& force) const {
  if (count_ == 0) return;
  const Index r = mass.corner_size();
  const double scale =
      body_->own_transforms ? take_nodal_loads(inertial, scratch.loads) : take_loads(inertial, scratch.loads);
  scratch.past.setZero(r + count_);
  for (int m = 0; m < InertialTarget::kMoments; ++m)
    scratch.past += inertial.coefficients.row(m).sum() * *inertial.q[m];
  mass.border().setZero();
  mass.rest().setZero();
  damped.border().setZero();
  damped.rest().setZero();
  force.tail(count_).setZero();
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Set& set = sets_[s];
    const double density = densities.density(Index(s)), damping = densities.damped(Index(s));
    scratch.force.setZero(rows_);
    add_single_product(set.loads.data(), rows_, scratch.loads.data(), scratch.loads.size(), scratch.force.data());
    force.tail(count_) += density * scratch.force.head(count_);
    mass.border() += density * scale * set.border;
    mass.rest() += density * scale * set.mass;
    damped.border() += damping * scale * set.border;
    damped.rest() += damping * scale * set.mass;
  }
  force.head(r).noalias() += mass.border().transpose() * scratch.past.tail(count_);
  force.tail(count_).noalias() += mass.border() * scratch.past.head(r);
  force.tail(count_) += mass.rest().cwiseProduct(scratch.past.tail(count_));
}

}  // namespace dynamorph
