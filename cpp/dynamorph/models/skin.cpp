// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/skin.hpp"

#include <algorithm>
#include <array>

namespace dynamorph {

using Eigen::Index;

PointTransform Skin::transform(const Transforms& bones, Index point) const {
  Eigen::Matrix<double, 1, 12> sum = Eigen::Matrix<double, 1, 12>::Zero();
  for (SkinWeights::InnerIterator it(weights, point); it; ++it) sum += it.value() * bones.row(it.col());
  return TransformMap(sum.data());
}

SurfacePoints SurfacePoints::vertices(Index count) {
  SurfacePoints out;
  out.corners.resize(count, 3);
  out.weights.setZero(count, 3);
  for (Index p = 0; p < count; ++p) out.corners.row(p).setConstant(std::int32_t(p));
  if (count > 0) out.weights.col(0).setOnes();
  return out;
}

void check_points(const SurfacePoints& points, Index vertices) {
  check_size("corner_weights", points.weights.rows(), points.size());
  if (points.size() == 0) return;
  if (points.corners.minCoeff() < 0 || points.corners.maxCoeff() >= vertices)
    throw std::invalid_argument("corners: there are " + std::to_string(vertices) + " vertices");
  if (!points.weights.allFinite() || !(points.weights.minCoeff() >= 0) ||
      !((points.weights.rowwise().sum().array() - 1).abs().maxCoeff() < 1e-9))
    throw std::invalid_argument("corner_weights: must not be negative, and sum to one");
}

const Embedding& checked_embedding(const Skin& skin, const SoftBody& body, Index targets) {
  const Index P = skin.rest.rows();
  check_size("embedding", skin.embedding.nodes.rows(), P);
  check_size("weights", skin.weights.rows(), P);
  if (skin.weights.cols() != body.skin.cols())
    throw std::invalid_argument("weights: expected those of " + std::to_string(body.skin.cols()) + " bones, got " +
                                std::to_string(skin.weights.cols()));
  const MatrixXd& R = skin.residual_shapes;
  if (R.size() > 0 && (R.rows() != 3 * P || R.cols() != targets))
    throw std::invalid_argument("residual_shapes: expected those of " + std::to_string(P) + " points and " +
                                std::to_string(targets) + " targets");
  if (P > 0 && (skin.embedding.nodes.minCoeff() < 0 || skin.embedding.nodes.maxCoeff() >= body.mesh.nodes.rows()))
    throw std::invalid_argument("embedding: it belongs to another mesh");
  return skin.embedding;
}

void PointRows::clear() {
  points_.clear();
  ends_.clear();
  directions_.clear();
}

void PointRows::add_row() { ends_.push_back(int(points_.size())); }

void PointRows::add(int point, const Vector3d& direction) {
  points_.push_back(point);
  directions_.push_back(direction);
  ends_.back() = int(points_.size());
}

NodalPoints::NodalPoints(const SoftBody& body, const Embedding& embedding)
    : free_(Index(body.free_nodes.size())), nodes_(embedding.nodes), weights_(embedding.weights) {
  for (std::int32_t& node : nodes_.reshaped()) node = body.free_of_node[std::size_t(node)];
}

void NodalPoints::displacement(const VectorXd& q, VectorXd& out) const {
  out.setZero(3 * nodes_.rows());
  for (Index p = 0; p < nodes_.rows(); ++p)
    for (int k = 0; k < 4; ++k)
      if (nodes_(p, k) >= 0) out.segment<3>(3 * p) += weights_(p, k) * q.segment<3>(3 * nodes_(p, k));
}

Vector3d NodalPoints::displacement(const VectorXd& q, Index point) const {
  Vector3d out = Vector3d::Zero();
  for (int k = 0; k < 4; ++k)
    if (const int node = nodes_(point, k); node >= 0) out += weights_(point, k) * q.segment<3>(3 * node);
  return out;
}

void NodalPoints::project(const VectorXd& f, VectorXd& out) const {
  out.setZero(3 * free_);
  for (Index p = 0; p < nodes_.rows(); ++p)
    for (int k = 0; k < 4; ++k)
      if (nodes_(p, k) >= 0) out.segment<3>(3 * nodes_(p, k)) += weights_(p, k) * f.segment<3>(3 * p);
}

void NodalPoints::rows(const PointRows& numbers, Rows& out) const {
  const int rows = numbers.size(), parts = numbers.parts();
  out.ends.resize(rows);
  out.parts.resize(parts, 3 * free_);
  out.parts.reserve(12 * parts);
  for (int row = 0; row < rows; ++row) {
    out.ends[row] = numbers.first(row + 1);
    for (int k = numbers.first(row); k < numbers.first(row + 1); ++k) {
      const int point = numbers.point(k);
      const Vector3d& direction = numbers.direction(k);
      std::array<std::pair<int, double>, 4> nodes;
      for (int a = 0; a < 4; ++a) nodes[a] = {nodes_(point, a), weights_(point, a)};
      std::sort(nodes.begin(), nodes.end());
      out.parts.startVec(k);
      for (const auto& [node, weight] : nodes)
        for (int c = 0; c < 3 && node >= 0; ++c) out.parts.insertBack(k, 3 * node + c) = weight * direction(c);
    }
  }
  out.parts.finalize();
}

ModalPoints::ModalPoints(const SoftBody& body, const Embedding& embedding, const MatrixXd& U)
    : basis_(RowMajor::Zero(3 * embedding.nodes.rows(), U.cols())) {
  for (Index p = 0; p < embedding.nodes.rows(); ++p)
    for (int k = 0; k < 4; ++k)
      if (const int free = body.free_of_node[std::size_t(embedding.nodes(p, k))]; free >= 0)
        basis_.middleRows<3>(3 * p) += embedding.weights(p, k) * U.middleRows<3>(3 * free);
}

void ModalPoints::rows(const PointRows& numbers, Rows& out) const {
  out.setZero(numbers.size(), basis_.cols());
  for (int row = 0; row < numbers.size(); ++row)
    for (int k = numbers.first(row); k < numbers.first(row + 1); ++k) {
      const Index first = 3 * numbers.point(k);
      const Vector3d& along = numbers.direction(k);
      out.row(row) +=
          along(0) * basis_.row(first) + along(1) * basis_.row(first + 1) + along(2) * basis_.row(first + 2);
    }
}

}  // namespace dynamorph
