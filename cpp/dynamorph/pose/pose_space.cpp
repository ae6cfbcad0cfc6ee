// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/pose/pose_space.hpp"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"

namespace dynamorph {

namespace {

constexpr double kHalfRound = 150 * kPi / 180;  // radians; beyond it, angles the other way round matter
constexpr double kSamePose = 0.5 * kPi / 180;   // radians; closer poses make the interpolation ill-conditioned
constexpr double kChannel = kPi / 2;            // radians that a channel's whole range counts: a bent elbow

/// The angle between two rotations, the short way round.
double joint_angle(const Rotations& reference, const Rotations& pose, int bone) {
  const Eigen::Quaterniond a(reference(bone, 0), reference(bone, 1), reference(bone, 2), reference(bone, 3));
  const Eigen::Quaterniond b(pose(bone, 0), pose(bone, 1), pose(bone, 2), pose(bone, 3));
  const Eigen::Quaterniond q = a.conjugate() * b;
  return 2 * std::atan2(q.vec().norm(), std::abs(q.w()));
}

/// The fraction of its weight that a target keeps at a distance. A radius of 0 means no limit.
double fade(double distance, double radius) { return radius > 0 ? 1 - smooth_step(2 * distance / radius - 1) : 1; }

}  // namespace

void rotation_of(const LocalTransforms& transforms, int bone, Rotations& rotations) {
  const Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> m(transforms.row(bone).data());
  if (!m.allFinite())
    throw Error("Bone " + std::to_string(bone) + " has a transform that is not a number. Check what poses it.");
  const Matrix3d A = m.topLeftCorner<3, 3>();
  const Matrix3d square = A.transpose() * A;
  const double scale = square.trace() / 3;
  Eigen::Quaterniond q;
  if ((square - scale * Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-6 * scale && A.determinant() > 0) {
    q = Eigen::Quaterniond(Matrix3d(A / std::sqrt(scale)));  // nearly every bone: rotated, scaled uniformly
  } else {
    const Eigen::JacobiSVD<Matrix3d> svd(A, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Matrix3d U = svd.matrixU();
    if (U.determinant() * svd.matrixV().determinant() < 0) U.col(2) *= -1;  // mirrored: the nearest proper rotation
    q = Eigen::Quaterniond(Matrix3d(U * svd.matrixV().transpose()));
  }
  rotations.row(bone) << q.w(), q.x(), q.y(), q.z();
}

double PoseSpace::Interpolant::distance(const Pose& a, const Pose& b, bool with_chords) const {
  double sum = 0;
  for (int bone : set.bones) {
    const double angle = joint_angle(a.rotations, b.rotations, bone);
    const double distance = with_chords ? 2 * std::sin(angle / 2) : angle;
    sum += distance * distance;
  }
  for (size_t k = 0; k < set.channels.size(); ++k) {
    const int channel = set.channels[k];
    const double distance = angles(Eigen::Index(k)) * (a.channels(channel) - b.channels(channel));
    sum += distance * distance;
  }
  return std::sqrt(sum);
}

PoseSpace::PoseSpace(std::vector<TargetSet> sets) {
  if (sets.empty()) throw std::invalid_argument("sets: at least one target set is needed");
  for (TargetSet& set : sets) {
    if (set.poses.empty() || set.names.size() != set.poses.size())
      throw std::invalid_argument("sets: every target set needs at least one target, and a name for each");
    for (const Pose& pose : set.poses) {
      for (int bone : set.bones)
        if (bone < 0 || bone >= pose.rotations.rows())
          throw std::invalid_argument("sets: bone index " + std::to_string(bone) + " is not in a pose of " +
                                      std::to_string(pose.rotations.rows()) + " bones");
      for (int channel : set.channels)
        if (channel < 0 || channel >= pose.channels.size())
          throw std::invalid_argument("sets: channel index " + std::to_string(channel) + " is not in a pose of " +
                                      std::to_string(pose.channels.size()) + " channels");
    }
    if (!set.radii.empty() && set.radii.size() != set.poses.size())
      throw std::invalid_argument("sets: expected a radius for each of " + std::to_string(set.poses.size()) +
                                  " targets, got " + std::to_string(set.radii.size()));
    for (double radius : set.radii)
      if (!(radius >= 0)) throw std::invalid_argument("sets: a radius must be 0, for unlimited, or more");
    targets_ += int(set.poses.size());
    bones_.insert(bones_.end(), set.bones.begin(), set.bones.end());
    for (int channel : set.channels) channels_ = std::max(channels_, channel + 1);
    sets_.push_back(interpolate(std::move(set)));
  }
  std::sort(bones_.begin(), bones_.end());
  bones_.erase(std::unique(bones_.begin(), bones_.end()), bones_.end());
}

PoseSpace::Interpolant PoseSpace::interpolate(TargetSet set) {
  Interpolant in;
  in.set = std::move(set);
  const std::vector<Pose>& poses = in.set.poses;
  in.angles = VectorXd::Zero(Eigen::Index(in.set.channels.size()));
  double widest = 0;
  for (const Pose& a : poses)
    for (const Pose& b : poses) {
      for (int bone : in.set.bones) widest = std::max(widest, joint_angle(a.rotations, b.rotations, bone));
      for (size_t k = 0; k < in.set.channels.size(); ++k)
        in.angles(Eigen::Index(k)) =
            std::max(in.angles(Eigen::Index(k)), a.channels(in.set.channels[k]) - b.channels(in.set.channels[k]));
    }
  in.angles = in.angles.unaryExpr([](double range) { return range > 0 ? kChannel / range : 0; }).eval();
  for (size_t j = 0; j < poses.size(); ++j)
    for (size_t k = 0; k < j; ++k)
      if (!(in.distance(poses[j], poses[k]) >= kSamePose))
        throw Error("Targets '" + in.set.names[k] + "' and '" + in.set.names[j] +
                    "' have the same pose. Give one of them another.");
  if ((widest <= kHalfRound && in.fit(false)) || in.fit(true)) return in;
  throw Error("The poses of targets '" + in.set.names.front() + "' to '" + in.set.names.back() +
              "' cannot be interpolated. Give them poses that differ more, or remove a target.");
}

/// Returns false when the kernel is not definite at these distances, or the system is too ill-conditioned to be
/// cardinal.
bool PoseSpace::Interpolant::fit(bool with_chords) {
  chordal = with_chords;
  const int count = int(set.poses.size());
  MatrixXd A = MatrixXd::Zero(count, count);
  for (int j = 0; j < count; ++j)
    for (int k = 0; k < count; ++k) A(j, k) = distance(set.poses[j], set.poses[k], chordal);

  // The kernel must be definite (here negative) on the coefficients that sum to zero. Otherwise weights overshoot and
  // jump between the targets.
  if (count > 1) {
    const MatrixXd ones = MatrixXd::Ones(count, 1);
    const MatrixXd Q = MatrixXd(Eigen::HouseholderQR<MatrixXd>(ones).householderQ()).rightCols(count - 1);
    const VectorXd values = Eigen::SelfAdjointEigenSolver<MatrixXd>(Q.transpose() * A * Q).eigenvalues();
    if (!(values.maxCoeff() < 0)) return false;
  }
  MatrixXd system = MatrixXd::Ones(count + 1, count + 1);
  system.topLeftCorner(count, count) = A;
  system(count, count) = 0;
  MatrixXd cardinal = MatrixXd::Zero(count + 1, count);
  cardinal.topRows(count).setIdentity();
  const MatrixXd solution = system.fullPivLu().solve(cardinal);
  coefficients = solution.topRows(count);
  constant = solution.row(count);
  return solution.allFinite() && (system * solution - cardinal).cwiseAbs().maxCoeff() < 1e-8;
}

void PoseSpace::weights(const Pose& pose, Eigen::Ref<VectorXd> w) const {
  Eigen::Index first = 0;
  for (const Interpolant& in : sets_) {
    const TargetSet& set = in.set;
    auto out = w.segment(first, Eigen::Index(set.poses.size()));
    out = in.constant;
    for (size_t k = 0; k < set.poses.size(); ++k)
      out += in.distance(set.poses[k], pose, in.chordal) * in.coefficients.row(k).transpose();
    out = out.cwiseMax(0.0);
    out /= out.sum();  // the sum is >= 1, because clamping only adds to a sum of one
    for (size_t k = 1; k < set.radii.size(); ++k) {
      const double kept = out(k) * fade(in.distance(set.poses[k], pose), set.radii[k]);
      out(0) += out(k) - kept;
      out(k) = kept;
    }
    first += out.size();
  }
}

void PoseSpace::distances(const Pose& pose, Eigen::Ref<VectorXd> d) const {
  Eigen::Index target = 0;
  for (const Interpolant& in : sets_)
    for (const Pose& target_pose : in.set.poses) d(target++) = in.distance(target_pose, pose);
}

}  // namespace dynamorph
