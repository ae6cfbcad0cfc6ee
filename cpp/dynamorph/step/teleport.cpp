// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/teleport.hpp"

#include <Eigen/SVD>

namespace dynamorph {

namespace {

using Affine = Eigen::Matrix<double, 3, 4>;

/// The transform of rest positions relative to `center`.
template <class Row>
Affine about(const Vector3d& center, const Row& row) {
  const Eigen::Matrix<double, 1, 12> entries = row;
  Affine T = TransformMap(entries.data());
  T.col(3) += T.leftCols<3>() * center;
  return T;
}

}  // namespace

RigidMotion fit_jump(const SoftBody& body, const Transforms& now, const Transforms& before, const Transforms& to) {
  const auto course = [&](Eigen::Index b) { return about(body.center, 2 * now.row(b) - before.row(b)); };
  Matrix3d across = Matrix3d::Zero();
  Vector3d old_center = Vector3d::Zero(), new_center = old_center;
  for (Eigen::Index b = 0; b < to.rows(); ++b) {
    old_center += course(b) * body.moments[b].col(3) / body.volume;
    new_center += about(body.center, to.row(b)) * body.moments[b].col(3) / body.volume;
  }
  for (Eigen::Index b = 0; b < to.rows(); ++b) {
    Affine a = course(b), c = about(body.center, to.row(b));
    a.col(3) -= old_center;
    c.col(3) -= new_center;
    across += c * body.moments[b] * a.transpose();
  }
  const Eigen::JacobiSVD<Matrix3d> svd(across, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3d flip = Matrix3d::Identity();
  flip(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
  const Matrix3d turn = svd.matrixU() * flip * svd.matrixV().transpose();
  return {turn, new_center - turn * old_center};
}

bool jumps(const SoftBody& body, double distance, const Transforms& bones,
           const std::array<Transforms, InertialTarget::kMoments>& past) {
  if (distance <= 0) return false;
  // How far the bones' soft tissue is from where it would be without a jump, by its moments.
  double jump = 0;
  for (Eigen::Index b = 0; b < bones.rows(); ++b) {
    const Eigen::Matrix4d& moments = body.moments[b];
    if (moments(3, 3) == 0) continue;
    const Affine off = about(body.center, bones.row(b) - 2 * past[0].row(b) + past[1].row(b));
    for (int i = 0; i < 3; ++i) jump += off.row(i) * moments * off.row(i).transpose();
  }
  return !(jump < distance * distance * body.volume);
}

void carry_past(const SoftBody& body, const Transforms& bones, std::array<Transforms, InertialTarget::kMoments>& past) {
  const RigidMotion motion = fit_jump(body, past[0], past[1], bones);
  for (Transforms& moment : past)
    for (Eigen::Index b = 0; b < bones.rows(); ++b) {
      Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> T(moment.data() + 12 * b);
      T = (motion.turn * T).eval();
      T.col(3) += motion.shift;
    }
}

}  // namespace dynamorph
