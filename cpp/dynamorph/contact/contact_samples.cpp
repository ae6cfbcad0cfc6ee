// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/contact_samples.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/elastic/sparse_cholesky.hpp"

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
  const SkinWeights& weights = map_.skin().weights;
  std::vector<Eigen::AlignedBox3d> boxes(std::size_t(weights.cols()));
  for (Index p = 0; p < size(); ++p)
    for (SkinWeights::InnerIterator it(weights, p); it; ++it)
      boxes[std::size_t(it.col())].extend(Vector3d(map_.skin().rest.row(p)));
  for (std::size_t b = 0; b < boxes.size(); ++b)
    if (!boxes[b].isEmpty()) boxes_.push_back({Index(b), boxes[b]});
  moved_ = size() > 0 ? most_moved(points, map_.skin().embedding) : VectorXd::Zero(model->dofs());
  const MatrixXd& R = map_.skin().residual_shapes;
  residual_.setZero(R.size() > 0 ? R.cols() : 0);
  for (Index j = 0; j < residual_.size(); ++j) residual_(j) = R.col(j).reshaped(3, size()).colwise().norm().maxCoeff();

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
Eigen::AlignedBox3d ContactSamples<Model>::region(const Transforms& bones, double farthest) const {
  // A sample is between the places to which its bones would take it.
  Eigen::AlignedBox3d out;
  for (const auto& [bone, box] : boxes_) {
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
void ContactSamples<Model>::normals(const Transforms& bones, Points& out) const {
  out.resize(size(), 3);
  for (Index p = 0; p < size(); ++p) {
    const Matrix3d A = map_.skin().transform(bones, p).template leftCols<3>();
    // The cofactors of A turn a surface as A does, and exist where A has no inverse.
    Matrix3d cofactors;
    for (int c = 0; c < 3; ++c) cofactors.row(c) = A.row((c + 1) % 3).cross(A.row((c + 2) % 3));
    const Vector3d turned = cofactors * normals_.row(p).transpose() * (A.determinant() < 0 ? -1 : 1);
    const double length = turned.norm();
    if (length > 0)
      out.row(p) = turned / length;
    else
      out.row(p) = normals_.row(p);
  }
}

template class ContactSamples<FullModel>;
template class ContactSamples<ReducedModel>;

}  // namespace dynamorph
