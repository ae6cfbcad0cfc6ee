// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/contact_samples.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "dynamorph/contact/at_rest.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/mesh/bvh.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr double kFirmness = 30;        // times the stiffness of the body: what is left of a dent is 1/30
constexpr double kStep = 2.0 / 3 / 96;  // s, where the mass is fitted: c h of BDF2 at 24 fps and 4 substeps
constexpr double kFree = 0.3;           // of a sample's weights on free nodes; with less, pins hold it
constexpr int kTogether = 256;          // samples solved at a time, so that memory stays small
constexpr Index kSolved = 3000;         // samples whose compliance is solved for; others have that of the most alike
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

/// What a force of one along each row of J (k) does to the coordinates: (dofs, k).
MatrixXd answers_to(const ArrowMatrix& A, const RowMajor& J) {
  const Eigen::LLT<MatrixXd> factor(A.dense());
  if (factor.info() != Eigen::Success) return MatrixXd::Zero(J.cols(), J.rows());
  return factor.solve(J.transpose());
}

/// `stays_local` of pushes that move their own places by `own` (k) and others by `moved` (3 others, k).
VectorXd stay_local(const VectorXd& own, const MatrixXd& moved) {
  VectorXd farthest = own;
  for (Index p = 0; p < moved.rows(); p += 3)
    farthest = farthest.cwiseMax(moved.middleRows<3>(p).colwise().norm().transpose());
  VectorXd out(own.size());
  for (Index k = 0; k < own.size(); ++k) out(k) = stays_local(own(k), farthest(k));
  return out;
}

/// The rows of chosen points (3 points, columns).
RowMajor points_of(const RowMajor& basis, const std::vector<int>& points) {
  RowMajor out(3 * Index(points.size()), basis.cols());
  for (std::size_t i = 0; i < points.size(); ++i) out.middleRows<3>(3 * Index(i)) = basis.middleRows<3>(3 * points[i]);
  return out;
}

/// For each sample the number of the solved one (every `stride`-th) that is nearest and faces the same way.
std::vector<Index> most_alike(const Points& rest, const Points& normals, Index stride, double size) {
  std::vector<Index> out;
  for (Index p = 0; p < normals.rows(); ++p) {
    Index best = p / stride;
    double least = kInfinity;
    for (Index k = 0; p % stride != 0 && k * stride < normals.rows(); ++k) {
      const double unlike =
          squared_unlikeness(rest.row(p), normals.row(p), rest.row(k * stride), normals.row(k * stride), size);
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
ContactSamples<Model>::ContactSamples(std::shared_ptr<const Model> model, ContactSkin samples,
                                      std::shared_ptr<const LocalResponses> local)
    : map_(model, checked(samples).skin),
      normals_(samples.normals.rowwise().normalized()),
      thickness_(std::move(samples.thickness)),
      groups_(grouped<Group>(map_.skin(), thickness_)),
      share_(set_shares(model->body(), map_.skin().embedding)),
      softness_(model->body().sets()),
      local_(std::move(local)) {
  const VectorXd neutral = neutral_weights(model->body(), model->targets());
  for (std::size_t j = 0; j < model->targets().size(); ++j)
    if (neutral(Index(j)) == 1) softness_(model->targets()[j].set) = 1 / model->targets()[j].lame.mu;
  stiffness_.setZero(size());
  mass_.setZero(size());
  taken_.setOnes(size());
  moved_.setZero(model->dofs());
  residual_.setZero(0);
  if (size() == 0) return;
  const typename Model::SkinPoints points = model->skin_points(map_.skin().embedding);
  bound_motion(points);
  find_patches();
  find_stiffness(points, neutral);
}

template <class Model>
void ContactSamples<Model>::bound_motion(const typename Model::SkinPoints& points) {
  moved_ = most_moved(points, map_.skin().embedding);
  const MatrixXd& R = map_.skin().residual_shapes;
  residual_.setZero(R.size() > 0 ? R.cols() : 0);
  for (Index j = 0; j < residual_.size(); ++j) residual_(j) = R.col(j).reshaped(3, size()).colwise().norm().maxCoeff();
  shapes_.resize(3 * size(), Index(model().targets().size()));
  for (Index j = 0; j < shapes_.cols(); ++j) {
    VectorXd shape;
    map_.displacement(VectorXd::Unit(shapes_.cols(), j), model().target(int(j)), shape);
    shapes_.col(j) = shape;
  }
}

template <class Model>
void ContactSamples<Model>::find_patches() {
  if (!local_) return;
  if (std::is_same_v<Model, FullModel>) throw std::invalid_argument("local: an unreduced model has no local responses");
  if (local_->shapes().rows() != 3 * Index(model().body().free_nodes.size()))
    throw std::invalid_argument("local: they belong to another mesh");
  patches_.resize(std::size_t(size()));
  std::vector<std::pair<int, double>> found;
  for (Index p = 0; p < size(); ++p) {
    local_->patches_at(map_.skin().rest.row(p), normals_.row(p), found);
    for (const auto& [patch, weight] : found) patches_[std::size_t(p)].push_back(patch);
  }
}

template <class Model>
void ContactSamples<Model>::find_stiffness(const typename Model::SkinPoints& points, const VectorXd& neutral) {
  const Index stride = (size() + kSolved - 1) / kSolved;
  const std::vector<Index> solved = most_alike(map_.skin().rest, normals_, stride, model().body().size);
  PointRows numbers;
  for (int p = 0; p < int(size()); p += int(stride)) {
    numbers.add_row();
    numbers.add(p, normals_.row(p));
  }
  typename SkinMap<Model>::Rows rows;
  points.rows(numbers, rows);
  const typename Model::Matrix A = lasting_stiffness(model(), neutral);
  auto [K, M] = stiffness_and_mass(model(), neutral);
  values(K) += values(M) / (kStep * kStep);
  VectorXd lasting = compliance(A, rows), in_step = compliance(K, rows), pushed = VectorXd::Ones(lasting.size());
  if constexpr (std::is_same_v<Model, ReducedModel>) {
    std::vector<int> others;
    for (Index p = 0; p < size(); p += (size() + kLookedAt - 1) / kLookedAt) others.push_back(int(p));
    MatrixXd moved = points_of(points.basis(), others) * answers_to(A, rows);
    pushed = stay_local(lasting, moved);
    if (local_) {
      const VectorXd taken = pushed;
      for (Index p = 0; p < size(); ++p) taken_(p) = taken(solved[std::size_t(p)]);
      const auto [local, dents] = local_answers(numbers, others, neutral);
      moved = moved * taken.asDiagonal() + dents;
      pushed = stay_local(lasting.cwiseProduct(taken) + local, moved);
      lasting = lasting.cwiseProduct(taken.cwiseAbs2()) + local;
      in_step = in_step.cwiseProduct(taken.cwiseAbs2()) + local;
    }
  }
  const VectorXd free = free_weights(model().body(), map_.skin().embedding);
  for (Index p = 0; p < size(); ++p) {
    const Index k = solved[std::size_t(p)];
    if (!(in_step(k) > 0)) continue;
    // A sample that moves little with its nodes, or with its modes, would move them far: no more than it moves itself
    // is asked for.
    const double counts = std::pow(std::clamp(free(p) / kFree, 0.0, 1.0), 4) * pushed(k);
    stiffness_(p) = counts / lasting(k);
    mass_(p) = counts * std::max(1 / in_step(k) - 1 / lasting(k), 0.0) * kStep * kStep;
  }
}

template <class Model>
std::pair<VectorXd, MatrixXd> ContactSamples<Model>::local_answers(const PointRows& numbers,
                                                                   const std::vector<int>& others,
                                                                   const VectorXd& neutral) const {
  std::vector<int> all(std::size_t(local_->size()));
  std::iota(all.begin(), all.end(), 0);
  MatrixXd rows(local_->size(), numbers.size());
  for (int k = 0; k < numbers.size(); ++k)
    rows.col(k) = local_row(numbers.point(k), numbers.direction(k), all).transpose();
  MatrixXd answers = local_->stiffness().llt().solve(rows);
  for (int k = 0; k < numbers.size(); ++k) answers.col(k) /= local_stiffer(numbers.point(k), neutral);
  RowMajor places(3 * Index(others.size()), local_->size());
  for (std::size_t i = 0; i < others.size(); ++i)
    for (int axis = 0; axis < 3; ++axis)
      places.row(3 * Index(i) + axis) = local_row(others[i], Vector3d::Unit(axis), all);
  return {rows.cwiseProduct(answers).colwise().sum().transpose(), places * answers};
}

template <class Model>
Eigen::RowVectorXd ContactSamples<Model>::local_row(Index sample, const Vector3d& direction,
                                                    const std::vector<int>& patches) const {
  const Embedding& embedding = map_.skin().embedding;
  Eigen::RowVectorXd out = Eigen::RowVectorXd::Zero(Index(patches.size()));
  for (int k = 0; k < 4; ++k) {
    const int node = model().body().free_of_node[std::size_t(embedding.nodes(sample, k))];
    if (node < 0) continue;
    for (int axis = 0; axis < 3; ++axis) {
      const double factor = embedding.weights(sample, k) * direction(axis);
      const double* row = local_->shapes().row(3 * node + axis).data();
      for (std::size_t m = 0; m < patches.size(); ++m) out(Index(m)) += factor * row[patches[m]];
    }
  }
  return out;
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
double ContactSamples<Model>::stiffer(Index sample, const VectorXd& weights, const VectorXd& softness) const {
  double out = 0;
  const auto& targets = model().targets();
  for (std::size_t j = 0; j < targets.size(); ++j)
    if (const double w = weights(Index(j)); w != 0)
      out += share_(sample, targets[j].set) * w * targets[j].lame.mu * softness(targets[j].set);
  return out;
}

template <class Model>
double ContactSamples<Model>::stiffness(Index sample, const VectorXd& weights, double square) const {
  return kFirmness * (stiffer(sample, weights, softness_) * stiffness_(sample) + mass_(sample) / square);
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
