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

double kernel(Kernel kind, double width, double distance) {
  const double d = distance / width;
  switch (kind) {
    case Kernel::gaussian:
      return std::exp(-d * d);
    case Kernel::thin_plate:
      return d > 0 ? d * d * std::log(d) : 0;
    default:
      return d;
  }
}

/// Rotation vector from the reference to the pose, the short way round.
Vector3d rotation_vector(const Rotations& reference, const Eigen::Ref<const Rotations>& pose, int bone) {
  const Eigen::Quaterniond a(reference(bone, 0), reference(bone, 1), reference(bone, 2), reference(bone, 3));
  Eigen::Quaterniond q = a.conjugate() * Eigen::Quaterniond(pose(bone, 0), pose(bone, 1), pose(bone, 2), pose(bone, 3));
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  const double sine = q.vec().norm();
  return sine > 0 ? Vector3d(q.vec() * (2 * std::atan2(sine, q.w()) / sine)) : Vector3d::Zero();
}

/// The rotation matrix from the reference to the pose minus the identity, its columns stacked.
Eigen::Matrix<double, 9, 1> turn(const Rotations& reference, const Eigen::Ref<const Rotations>& pose, int bone) {
  const Eigen::Quaterniond a(reference(bone, 0), reference(bone, 1), reference(bone, 2), reference(bone, 3));
  const Eigen::Quaterniond b(pose(bone, 0), pose(bone, 1), pose(bone, 2), pose(bone, 3));
  const Matrix3d matrix = (a.conjugate() * b).toRotationMatrix() - Matrix3d::Identity();
  return Eigen::Map<const Eigen::Matrix<double, 9, 1>>(matrix.data());
}

/// 0 for t <= 0, 1 for t >= 1, smooth in between.
double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

/// The fraction of its weight that a target keeps at a distance. A radius of 0 means no limit.
double fade(double distance, double radius) { return radius > 0 ? 1 - smooth_step(2 * distance / radius - 1) : 1; }

/// 0 if every joint is less than 150 degrees from the set's first pose, 1 if one is at 180.
double turned_round(const TargetSet& set, const Eigen::Ref<const Rotations>& pose) {
  double kept = 1;
  for (int bone : set.bones)
    kept *= 1 - smooth_step((rotation_vector(set.poses[0], pose, bone).norm() - kHalfRound) / (kPi - kHalfRound));
  return 1 - kept;
}

}  // namespace

void rotation_of(const LocalTransforms& transforms, int bone, Rotations& rotations) {
  const Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> m(transforms.row(bone).data());
  if (!m.allFinite())
    throw Error("Bone " + std::to_string(bone) +
                " has a transform that is not a number. Check its drivers and constraints.");
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

double pose_distance(const std::vector<int>& bones, const Rotations& a, const Eigen::Ref<const Rotations>& b,
                     bool chordal) {
  double sum = 0;
  for (int bone : bones) {
    const double angle = rotation_vector(a, b, bone).norm();
    const double distance = chordal ? 2 * std::sin(angle / 2) : angle;
    sum += distance * distance;
  }
  return std::sqrt(sum);
}

PoseSpace::PoseSpace(std::vector<TargetSet> sets) {
  if (sets.empty()) throw std::invalid_argument("sets: at least one target set is needed");
  for (TargetSet& set : sets) {
    if (set.poses.empty() || set.names.size() != set.poses.size())
      throw std::invalid_argument("sets: every target set needs at least one target, and a name for each");
    for (const Rotations& pose : set.poses)
      for (int bone : set.bones)
        if (bone < 0 || bone >= pose.rows())
          throw std::invalid_argument("sets: bone index " + std::to_string(bone) + " is not in a pose of " +
                                      std::to_string(pose.rows()) + " bones");
    if (!set.radii.empty() && set.radii.size() != set.poses.size())
      throw std::invalid_argument("sets: expected a radius for each of " + std::to_string(set.poses.size()) +
                                  " targets, got " + std::to_string(set.radii.size()));
    for (double radius : set.radii)
      if (!(radius >= 0)) throw std::invalid_argument("sets: a radius must be 0, for unlimited, or more");
    targets_ += int(set.poses.size());
    bones_.insert(bones_.end(), set.bones.begin(), set.bones.end());
    sets_.push_back(interpolate(std::move(set)));
  }
  std::sort(bones_.begin(), bones_.end());
  bones_.erase(std::unique(bones_.begin(), bones_.end()), bones_.end());
}

PoseSpace::Interpolated PoseSpace::interpolate(TargetSet set) {
  for (size_t j = 0; j < set.poses.size(); ++j)
    for (size_t k = 0; k < j; ++k)
      if (!(pose_distance(set.bones, set.poses[j], set.poses[k]) >= kSamePose))
        throw Error("Targets '" + set.names[k] + "' and '" + set.names[j] +
                    "' have the same pose. Pose the character differently and capture one of them again.");
  Interpolated in;
  in.set = std::move(set);
  if (in.set.kernel == Kernel::thin_plate) {
    Interpolant turned;
    turned.chordal = turned.matrices = true;
    if (turned.fit(in.set)) in.turned = turned;
  }
  double widest = 0;
  for (const Rotations& a : in.set.poses)
    for (const Rotations& b : in.set.poses)
      for (int bone : in.set.bones) widest = std::max(widest, rotation_vector(a, b, bone).norm());
  for (bool chordal : {false, true}) {
    if (!chordal && widest > kHalfRound) continue;
    in.usual.chordal = chordal;
    if (in.usual.fit(in.set)) return in;
  }
  throw Error("The poses of targets '" + in.set.names.front() + "' to '" + in.set.names.back() +
              "' cannot be interpolated. Capture poses that differ more, or remove a target.");
}

/// Returns false when the kernel is not definite at these distances, or the system is too ill-conditioned to be
/// cardinal.
bool PoseSpace::Interpolant::fit(const TargetSet& set) {
  const int count = int(set.poses.size());
  MatrixXd A = MatrixXd::Zero(count, count);
  for (int j = 0; j < count; ++j)
    for (int k = 0; k < count; ++k) A(j, k) = pose_distance(set.bones, set.poses[j], set.poses[k], chordal);
  width = count > 1 ? A.sum() / (count * (count - 1.0)) : 1.0;
  A = A.unaryExpr([&](double d) { return kernel(set.kernel, width, d); });

  const Eigen::Index entries = matrices ? 9 : 3;  // per bone
  span.resize(entries * set.bones.size(), 0);
  MatrixXd P = MatrixXd::Ones(count, 1);
  if (set.kernel == Kernel::thin_plate && count > 1) {
    // Linear terms exist only in directions in which the poses differ; in others they could not be determined.
    MatrixXd coordinates(span.rows(), count);
    for (int j = 0; j < count; ++j)
      for (size_t i = 0; i < set.bones.size(); ++i)
        if (matrices)
          coordinates.col(j).segment<9>(9 * i) = turn(set.poses[0], set.poses[j], set.bones[i]);
        else
          coordinates.col(j).segment<3>(3 * i) = rotation_vector(set.poses[0], set.poses[j], set.bones[i]);
    const Eigen::JacobiSVD<MatrixXd> svd(coordinates, Eigen::ComputeThinU);
    const int rank = std::min<int>(count - 1, (svd.singularValues().array() > 1e-6).count());
    span = svd.matrixU().leftCols(rank);
    P.conservativeResize(count, 1 + rank);
    P.rightCols(rank) = coordinates.transpose() * span;
  }

  // The kernel must be definite on the coefficients that the polynomial leaves. Otherwise weights overshoot and jump
  // between the targets.
  if (count > P.cols()) {
    const MatrixXd Q = MatrixXd(Eigen::HouseholderQR<MatrixXd>(P).householderQ()).rightCols(count - P.cols());
    const VectorXd values = Eigen::SelfAdjointEigenSolver<MatrixXd>(Q.transpose() * A * Q).eigenvalues();
    const double sign = set.kernel == Kernel::linear ? -1 : 1;
    if (set.kernel != Kernel::thin_plate && !((sign * values).minCoeff() > 0)) return false;
  }
  MatrixXd system = MatrixXd::Zero(count + P.cols(), count + P.cols());
  system.topLeftCorner(count, count) = A;
  system.topRightCorner(count, P.cols()) = P;
  system.bottomLeftCorner(P.cols(), count) = P.transpose();
  MatrixXd cardinal = MatrixXd::Zero(count + P.cols(), count);
  cardinal.topRows(count).setIdentity();
  const MatrixXd solution = system.fullPivLu().solve(cardinal);
  coefficients = solution.topRows(count);
  polynomial = solution.bottomRows(P.cols());
  return solution.allFinite() && (system * solution - cardinal).cwiseAbs().maxCoeff() < 1e-8;
}

void PoseSpace::Interpolant::add_weights(const TargetSet& set, const Eigen::Ref<const Rotations>& pose, double factor,
                                         Eigen::Ref<VectorXd> w) const {
  w += factor * polynomial.row(0).transpose();
  for (size_t k = 0; k < set.poses.size(); ++k)
    w += factor * kernel(set.kernel, width, pose_distance(set.bones, set.poses[k], pose, chordal)) *
         coefficients.row(k).transpose();
  for (Eigen::Index term = 0; term < span.cols(); ++term) {
    double coordinate = 0;
    for (size_t i = 0; i < set.bones.size(); ++i)
      coordinate += matrices ? turn(set.poses[0], pose, set.bones[i]).dot(span.col(term).segment<9>(9 * i))
                             : rotation_vector(set.poses[0], pose, set.bones[i]).dot(span.col(term).segment<3>(3 * i));
    w += factor * coordinate * polynomial.row(1 + term).transpose();
  }
}

void PoseSpace::weights(const Eigen::Ref<const Rotations>& pose, Eigen::Ref<VectorXd> w) const {
  Eigen::Index first = 0;
  for (const Interpolated& in : sets_) {
    const TargetSet& set = in.set;
    auto out = w.segment(first, Eigen::Index(set.poses.size()));
    out.setZero();
    const double turned = in.turned ? turned_round(set, pose) : 0;
    if (turned < 1) in.usual.add_weights(set, pose, 1 - turned, out);
    if (turned > 0) in.turned->add_weights(set, pose, turned, out);
    out = out.cwiseMax(0.0);
    out /= out.sum();  // the sum is >= 1, because clamping only adds to a sum of one
    for (size_t k = 1; k < set.radii.size(); ++k) {
      const double kept = out(k) * fade(pose_distance(set.bones, set.poses[k], pose), set.radii[k]);
      out(0) += out(k) - kept;
      out(k) = kept;
    }
    first += out.size();
  }
}

void PoseSpace::distances(const Eigen::Ref<const Rotations>& pose, Eigen::Ref<VectorXd> d) const {
  Eigen::Index target = 0;
  for (const Interpolated& in : sets_)
    for (const Rotations& own : in.set.poses) d(target++) = pose_distance(in.set.bones, own, pose);
}

}  // namespace dynamorph
