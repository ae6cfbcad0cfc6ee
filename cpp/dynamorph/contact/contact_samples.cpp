// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/contact_samples.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/mesh/bvh.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr double kFirmness = 30;        // times the stiffness of the body: what is left of a dent is 1/30
constexpr double kStep = 2.0 / 3 / 96;  // s, where the mass is fitted: c h of BDF2 at 24 fps and 4 substeps
constexpr double kAtRest = 10;          // s: a step so long is a static answer, also of a body that nothing holds
constexpr double kFree = 0.3;           // of a sample's weights on free nodes; with less, pins hold it
constexpr int kTogether = 256;          // samples solved at a time, so that memory stays small
constexpr Index kSolved = 3000;         // samples whose compliance is solved for; others have that of the most alike
constexpr double kTurned = 0.1;         // of the body's size: as far as a normal at a right angle is unlike
constexpr double kOwn[] = {0.5, 0.9};   // own motion of a sample below which it is not pushed, and from which it is
constexpr int kGrouped = 64;            // samples in a group, at most
constexpr Index kLookedAt = 300;        // samples whose motion is compared with that of one that is pushed

/// j^T A^-1 j of each row j.
VectorXd compliance(const SparseMatrix& A, const SparseRows& J) {
  BlockCholesky<double> factor;
  VectorXd out = VectorXd::Zero(J.rows());
  if (!factor.factorize(A)) return out;
  MatrixXd columns;
  for (Index first = 0; first < J.rows(); first += kTogether) {
    const Index count = std::min<Index>(kTogether, J.rows() - first);
    columns.setZero(A.rows(), count);
    for (Index k = 0; k < count; ++k) {
      const auto column = J.parts.row(J.first(first + k));
      columns.col(k) = column.transpose();
    }
    factor.solve_in_place(columns);
    for (Index k = 0; k < count; ++k) out(first + k) = J.parts.row(J.first(first + k)).dot(columns.col(k));
  }
  return out;
}
VectorXd compliance(const ArrowMatrix& A, const RowMajor& J) {
  const Eigen::LLT<MatrixXd> factor(A.dense());
  if (factor.info() != Eigen::Success) return VectorXd::Zero(J.rows());
  return factor.matrixL().solve(J.transpose()).colwise().squaredNorm();
}

/// How far a sample moves that is pushed, each along its row of J, over how far that moves any of them.
VectorXd own_motion(const SparseMatrix&, const SparseRows& J, const NodalPoints&) {
  return VectorXd::Ones(J.rows());  // a mesh gives way where it is pushed
}
VectorXd own_motion(const ArrowMatrix& A, const RowMajor& J, const ModalPoints& points) {
  const Eigen::LLT<MatrixXd> factor(A.dense());
  if (factor.info() != Eigen::Success) return VectorXd::Zero(J.rows());
  const MatrixXd answers = factor.solve(J.transpose());
  VectorXd farthest = VectorXd::Constant(J.rows(), 1e-300);
  const Index count = points.basis().rows() / 3, stride = (count + kLookedAt - 1) / kLookedAt;
  for (Index p = 0; p < count; p += stride)
    farthest = farthest.cwiseMax((points.basis().middleRows<3>(3 * p) * answers).colwise().norm().transpose());
  const VectorXd own = J.cwiseProduct(answers.transpose()).rowwise().sum();
  return (own.array() / farthest.array()).min(1.0);
}

/// For each sample the number of the solved one (every `stride`-th) that is nearest and faces the same way.
std::vector<Index> most_alike(const ContactSkin& samples, const Points& normals, Index stride, double size) {
  std::vector<Index> out;
  for (Index p = 0; p < normals.rows(); ++p) {
    Index best = p / stride;
    double least = kInfinity;
    for (Index k = 0; p % stride != 0 && k * stride < normals.rows(); ++k) {
      const double apart = (samples.skin.rest.row(p) - samples.skin.rest.row(k * stride)).squaredNorm();
      const double unlike = apart + kTurned * kTurned * size * size * (1 - normals.row(p).dot(normals.row(k * stride)));
      if (unlike < least) {
        least = unlike;
        best = k;
      }
    }
    out.push_back(best);
  }
  return out;
}

/// The sum of the weights of each point's free nodes.
VectorXd free_weights(const SoftBody& body, const Embedding& embedding) {
  VectorXd out = VectorXd::Zero(embedding.nodes.rows());
  for (Index p = 0; p < out.size(); ++p)
    for (int k = 0; k < 4; ++k)
      if (body.free_of_node[std::size_t(embedding.nodes(p, k))] >= 0) out(p) += embedding.weights(p, k);
  return out;
}

/// The target sets' shares of the tissue at the nodes of each point (P, S).
MatrixXd set_shares(const SoftBody& body, const Embedding& embedding) {
  MatrixXd out = MatrixXd::Zero(embedding.nodes.rows(), body.sets());
  for (Index p = 0; p < out.rows(); ++p) {
    for (int k = 0; k < 4; ++k)
      if (const int free = body.free_of_node[std::size_t(embedding.nodes(p, k))]; free >= 0)
        out.row(p) += std::abs(embedding.weights(p, k)) * body.volumes.row(free);
    const double sum = out.row(p).sum();
    if (sum > 0) out.row(p) /= sum;
  }
  return out;
}

/// Groups of at most kGrouped samples.
template <class Group>
std::vector<Group> grouped(const Skin& skin, const VectorXd& thickness) {
  std::vector<Eigen::AlignedBox3d> places;
  for (Index p = 0; p < skin.rest.rows(); ++p) places.emplace_back(Vector3d(skin.rest.row(p)));
  const Bvh tree(places);
  std::vector<Group> out;
  for (std::size_t n = 0; n < tree.nodes.size();) {  // a node's children follow it
    const Bvh::Node& node = tree.nodes[n];
    const int count = node.end - node.begin;
    if (count > kGrouped) {
      ++n;
      continue;
    }
    Group& group = out.emplace_back();
    group.samples.assign(tree.order.begin() + node.begin, tree.order.begin() + node.end);
    std::map<Index, Eigen::AlignedBox3d> boxes;
    for (const int p : group.samples) {
      group.thickness = std::max(group.thickness, thickness(p));
      for (SkinWeights::InnerIterator it(skin.weights, p); it; ++it) boxes[it.col()].extend(Vector3d(skin.rest.row(p)));
    }
    group.boxes.assign(boxes.begin(), boxes.end());
    n += std::size_t(2 * count - 1);  // the nodes of a tree with as many leaves
  }
  return out;
}

/// The most that a unit displacement of a node moves a point.
VectorXd most_moved(const NodalPoints&, const Embedding& embedding) {
  return VectorXd::Constant(1, embedding.weights.rowwise().lpNorm<1>().maxCoeff());
}
/// The most that a unit of each coordinate moves a point.
VectorXd most_moved(const ModalPoints& points, const Embedding&) {
  VectorXd out(points.basis().cols());
  for (Index k = 0; k < out.size(); ++k)
    out(k) = points.basis().col(k).reshaped<Eigen::AutoOrder>(3, points.basis().rows() / 3).colwise().norm().maxCoeff();
  return out;
}

/// K at the neutral targets, and M in the pose of the targets' sculpts.
template <class Model>
std::pair<typename Model::Matrix, typename Model::Matrix> stiffness_and_mass(const Model& model,
                                                                             const VectorXd& weights) {
  typename Model::Blend blend;
  model.blend(weights, blend);
  VectorXd rest, force;
  blended_shape(model, weights, rest);
  typename Model::Matrix K = model.zero();
  model.linearize(blend, rest, force, K);
  Transforms still(model.body().skin.cols(), 12);
  still.rowwise() = Eigen::Matrix<double, 1, 12>{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
  InertialTarget inertial;
  inertial.q.fill(&rest);
  inertial.bones.fill(&still);
  typename Model::Inertia inertia;
  model.inertia(inertial, blend.mass, inertia);
  return {K, inertia.mass};
}

const ContactSkin& checked(const ContactSkin& samples) {
  const Index P = samples.skin.rest.rows();
  check_size("normals", samples.normals.rows(), P);
  check_size("thickness", samples.thickness.size(), P);
  if (!samples.normals.allFinite() || !(samples.normals.rowwise().norm().array() > 0).all())
    throw std::invalid_argument("normals: must be finite and longer than zero");
  if (!samples.thickness.allFinite() || !(samples.thickness.array() > 0).all())
    throw std::invalid_argument("thickness: must be finite and above zero");
  return samples;
}

}  // namespace

template <class Model>
ContactSamples<Model>::ContactSamples(std::shared_ptr<const Model> model, ContactSkin samples)
    : map_(model, checked(samples).skin),
      normals_(samples.normals.rowwise().normalized()),
      thickness_(std::move(samples.thickness)),
      groups_(grouped<Group>(map_.skin(), thickness_)),
      share_(set_shares(model->body(), map_.skin().embedding)),
      softness_(model->body().sets()) {
  const VectorXd neutral = neutral_weights(model->body(), model->targets());
  for (std::size_t j = 0; j < model->targets().size(); ++j)
    if (neutral(Index(j)) == 1) softness_(model->targets()[j].set) = 1 / model->targets()[j].lame.mu;

  const Index stride = (size() + kSolved - 1) / kSolved;
  const std::vector<Index> solved = most_alike(samples, normals_, stride, model->body().size);
  PointRows numbers;
  for (int p = 0; p < int(size()); p += int(stride)) {
    numbers.add_row();
    numbers.add(p, normals_.row(p));
  }
  typename SkinMap<Model>::Rows rows;
  const typename Model::SkinPoints points = model->skin_points(map_.skin().embedding);
  points.rows(numbers, rows);
  moved_ = size() > 0 ? most_moved(points, map_.skin().embedding) : VectorXd::Zero(model->dofs());
  const MatrixXd& R = map_.skin().residual_shapes;
  residual_.setZero(R.size() > 0 ? R.cols() : 0);
  for (Index j = 0; j < residual_.size(); ++j) residual_(j) = R.col(j).reshaped(3, size()).colwise().norm().maxCoeff();
  shapes_.resize(3 * size(), Index(model->targets().size()));
  for (Index j = 0; j < shapes_.cols(); ++j) {
    VectorXd shape;
    map_.displacement(VectorXd::Unit(shapes_.cols(), j), model->target(int(j)), shape);
    shapes_.col(j) = shape;
  }

  auto [K, M] = stiffness_and_mass(*model, neutral);
  typename Model::Matrix A = K;
  values(A) = values(K) + values(M) / (kAtRest * kAtRest);
  const VectorXd lasting = compliance(A, rows), own = own_motion(A, rows, points);
  values(A) = values(K) + values(M) / (kStep * kStep);
  const VectorXd in_step = compliance(A, rows);
  const VectorXd free = free_weights(model->body(), map_.skin().embedding);
  stiffness_.setZero(size());
  mass_.setZero(size());
  for (Index p = 0; p < size(); ++p) {
    const Index k = solved[std::size_t(p)];
    if (!(in_step(k) > 0)) continue;
    // A sample that moves little with its nodes, or with its modes, would move them far: no more than it moves itself
    // is asked for.
    const double counts =
        std::pow(std::clamp(free(p) / kFree, 0.0, 1.0), 4) * smooth_step((own(k) - kOwn[0]) / (kOwn[1] - kOwn[0]));
    stiffness_(p) = counts / lasting(k);
    mass_(p) = counts * std::max(1 / in_step(k) - 1 / lasting(k), 0.0) * kStep * kStep;
  }
}

template <class Model>
double ContactSamples<Model>::farthest(const VectorXd& weights, const VectorXd& q) const {
  double residual = 0;
  if (residual_.size() > 0) residual = residual_.dot(weights.cwiseAbs());
  if constexpr (std::is_same_v<typename Model::Matrix, SparseMatrix>)
    return residual + moved_(0) * as_points(q).rowwise().norm().maxCoeff();
  else
    return residual + moved_.dot(q.cwiseAbs());
}

template <class Model>
Eigen::AlignedBox3d ContactSamples<Model>::region(const Group& group, const Transforms& bones, double farthest) {
  // A sample is between the places to which its bones would take it.
  Eigen::AlignedBox3d out;
  for (const auto& [bone, box] : group.boxes) {
    const PointTransform T = transform(bones, bone);
    const Vector3d center = T.leftCols<3>() * box.center() + T.col(3);
    const Vector3d half = T.leftCols<3>().cwiseAbs() * (box.sizes() / 2 + Vector3d::Constant(farthest));
    out.extend(center - half).extend(center + half);
  }
  return out;
}

template <class Model>
double ContactSamples<Model>::stiffness(Index sample, const VectorXd& weights, double square) const {
  double stiffer = 0;
  const auto& targets = model().targets();
  for (std::size_t j = 0; j < targets.size(); ++j)
    if (const double w = weights(Index(j)); w != 0)
      stiffer += share_(sample, targets[j].set) * w * targets[j].lame.mu * softness_(targets[j].set);
  return kFirmness * (stiffer * stiffness_(sample) + mass_(sample) / square);
}

template <class Model>
Vector3d ContactSamples<Model>::normal(const PointTransform& T, Index sample) const {
  // The cofactors of A turn a surface as A does, and exist where A has no inverse.
  const Matrix3d A = T.leftCols<3>();
  Matrix3d cofactors;
  for (int c = 0; c < 3; ++c) cofactors.row(c) = A.row((c + 1) % 3).cross(A.row((c + 2) % 3));
  const Vector3d turned = cofactors * normals_.row(sample).transpose() * (A.determinant() < 0 ? -1 : 1);
  const double length = turned.norm();
  if (length > 0) return turned / length;
  return normals_.row(sample);
}

template class ContactSamples<FullModel>;
template class ContactSamples<ReducedModel>;

}  // namespace dynamorph
