// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/pose/skinning.hpp"

#include <Eigen/LU>
#include <cmath>

namespace dynamorph {

SkinWeights normalized(const Eigen::Ref<const MatrixXd>& weights) {
  if (!weights.allFinite() || (weights.array() < 0).any())
    throw std::invalid_argument("weights: skin weights must be finite and not negative");
  constexpr double kNegligible = 1e-2;  // keeps the number of pairs of bones that share nodes small
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index i = 0; i < weights.rows(); ++i) {
    const double total = weights.row(i).sum();
    if (total <= 0) throw std::invalid_argument("weights: node " + std::to_string(i) + " has no skin weight");
    double kept = 0;
    for (Eigen::Index b = 0; b < weights.cols(); ++b)
      if (weights(i, b) >= kNegligible * total) kept += weights(i, b);
    for (Eigen::Index b = 0; b < weights.cols(); ++b)
      if (weights(i, b) >= kNegligible * total) entries.emplace_back(int(i), int(b), weights(i, b) / kept);
  }
  SkinWeights out(weights.rows(), weights.cols());
  out.setFromTriplets(entries.begin(), entries.end());
  return out;
}

void pose_nodes(const SkinWeights& weights, SkinFrame& frame) {
  frame.nodes.resize(weights.rows(), 12);
  for (Eigen::Index i = 0; i < weights.rows(); ++i) {
    auto node = frame.nodes.row(i);
    node.setZero();
    for (SkinWeights::InnerIterator it(weights, i); it; ++it) node += it.value() * frame.bones.row(it.col());
  }
}

void to_world(const SkinFrame& frame, double translation_weight, const VectorXd& bind, VectorXd& world) {
  world.resize(bind.size());
  for (Eigen::Index i = 0; i < frame.nodes.rows(); ++i) {
    const TransformMap T = transform(frame.nodes, i);
    world.segment<3>(3 * i).noalias() = T.leftCols<3>() * bind.segment<3>(3 * i) + translation_weight * T.col(3);
  }
}

void pull_back(const SkinFrame& frame, VectorXd& f) {
  for (Eigen::Index i = 0; i < frame.nodes.rows(); ++i)
    f.segment<3>(3 * i) = transform(frame.nodes, i).leftCols<3>().transpose() * f.segment<3>(3 * i).eval();
}

namespace {

/// Whether a transform flattens what it moves, as far as single precision can tell: its inverse is round-off.
bool is_flat(const Eigen::Matrix4d& transform) {
  const Matrix3d A = transform.topLeftCorner<3, 3>();
  return !(std::abs(A.determinant()) > 1e-5 * std::pow(A.norm(), 3));
}

}  // namespace

Transforms extrapolate_back(const Transforms& now, const Transforms& next, int k) {
  Transforms past = now;
  for (Eigen::Index b = 0; b < now.rows(); ++b) {
    Eigen::Matrix4d here = Eigen::Matrix4d::Identity(), there = here;
    here.topRows<3>() = transform(now, b);
    there.topRows<3>() = transform(next, b);
    // A bone that collapses or springs up stays at rest, because its motion could extrapolate to anything.
    const double growth = there.topLeftCorner<3, 3>().determinant() / here.topLeftCorner<3, 3>().determinant();
    if (!(growth > 0.1 && growth < 10) || is_flat(here) || is_flat(there)) continue;
    const Eigen::Matrix4d back = here * there.inverse();
    if (!(back.topLeftCorner<3, 3>().norm() < 10)) continue;
    for (int i = 0; i < k; ++i) here = back * here;
    Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(past.data() + 12 * b) = here.topRows<3>();
  }
  return past;
}

}  // namespace dynamorph
