// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/contact_samples.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "dynamorph/contact/at_rest.hpp"
#include "dynamorph/contact/choices.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/elastic/dense_kernels.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/mesh/bvh.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr int kTogether = 256;   // samples solved at a time, so that memory stays small
constexpr Index kSolved = 3000;  // samples whose compliance is solved for; others have that of the most alike
constexpr int kGrouped = 64;     // samples in a group, at most
constexpr Index kComparedSamples =
    300;  // samples whose motion by the coordinates is compared with that of a pushed one

/// j^T A^-1 j of each row j.
VectorXd compliance(const SparseMatrix& A, const SparseRows& J) {
  BlockCholesky<double> factor;
  VectorXd out = VectorXd::Zero(J.rows()), column;
  if (!factor.factorize(A)) return out;
  MatrixXd columns;
  for (Index first = 0; first < J.rows(); first += kTogether) {
    const Index count = std::min<Index>(kTogether, J.rows() - first);
    columns.resize(A.rows(), count);
    for (Index k = 0; k < count; ++k) {
      column.setZero(A.rows());
      J.add(first + k, 1, column);
      columns.col(k) = column;
    }
    factor.solve_in_place(columns);
    for (Index k = 0; k < count; ++k) out(first + k) = J.dot(first + k, columns.col(k));
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

/// The patches at a sample, and what a newton there does to them.
struct Dent {
  const std::vector<int>* patches;
  VectorXd amplitudes;
};

/// `stays_local` of pushes (k) that move their own places by `own` (k), and others (n) by the coordinates' answers
/// (dofs, k) with their rows of B (3n, dofs), and by dents (k) with their rows of the patches' shapes (3n, P).
VectorXd stay_local(const VectorXd& own, const MatrixXd& B, const MatrixXd& answers, const MatrixXd& shapes = {},
                    const std::vector<Dent>& dents = {}) {
  VectorXd out(own.size());
  const Index blocks = (own.size() + kTogether - 1) / kTogether;
  run_tasks(int(blocks), {}, [&](int block, const ProgressFn&) {
    const Index first = block * kTogether, count = std::min<Index>(kTogether, own.size() - first);
    MatrixXd moved(B.rows(), count);
    multiply_dense(B.data(), B.rows(), B.cols(), answers.col(first).data(), count, moved.data());
    for (Index k = 0; k < count; ++k) {
      if (!dents.empty()) {
        const auto& [patches, amplitudes] = dents[std::size_t(first + k)];
        for (Index i = 0; i < amplitudes.size(); ++i)
          moved.col(k) += amplitudes(i) * shapes.col((*patches)[std::size_t(i)]);
      }
      const double farthest = moved.col(k).reshaped(3, B.rows() / 3).colwise().norm().maxCoeff();
      out(first + k) = stays_local(own(first + k), std::max(own(first + k), farthest));
    }
  });
  return out;
}

/// At most `most` of `count` samples, evenly.
std::vector<int> spaced(Index count, Index most) {
  std::vector<int> out;
  for (Index p = 0; p < count; p += (count + most - 1) / most) out.push_back(int(p));
  return out;
}

/// The rows of chosen points (3 points, columns).
MatrixXd rows_of(const RowMajor& basis, const std::vector<int>& points) {
  MatrixXd out(3 * Index(points.size()), basis.cols());
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

/// The rest positions of points (P) of a skin.
Points places_of(const Skin& skin, const SurfacePoints& points) {
  Points out = Points::Zero(points.size(), 3);
  for (Index p = 0; p < out.rows(); ++p)
    points.each_corner(p, [&](int v, double weight) { out.row(p) += weight * skin.rest.row(v); });
  return out;
}

/// Calls f(free node, weight) for those that carry a point.
template <class F>
void each_free_node(const SoftBody& body, const Embedding& embedding, const SurfacePoints& points, Index point, F&& f) {
  points.each_corner(point, [&](int v, double weight) {
    for (int k = 0; k < 4; ++k)
      if (const int free = body.free_of_node[std::size_t(embedding.nodes(v, k))]; free >= 0)
        f(free, weight * embedding.weights(v, k));
  });
}

/// The sum of the weights of each point's free nodes.
VectorXd free_weights(const SoftBody& body, const Embedding& embedding, const SurfacePoints& points) {
  VectorXd out = VectorXd::Zero(points.size());
  for (Index p = 0; p < out.size(); ++p)
    each_free_node(body, embedding, points, p, [&](int, double weight) { out(p) += weight; });
  return out;
}

/// The target sets' shares of the tissue at the nodes of each point (P, S).
MatrixXd set_shares(const SoftBody& body, const Embedding& embedding, const SurfacePoints& points) {
  MatrixXd out = MatrixXd::Zero(points.size(), body.sets());
  for (Index p = 0; p < out.rows(); ++p) {
    each_free_node(body, embedding, points, p,
                   [&](int free, double weight) { out.row(p) += std::abs(weight) * body.volumes.row(free); });
    const double sum = out.row(p).sum();
    if (sum > 0) out.row(p) /= sum;
  }
  return out;
}

/// Groups of at most kGrouped samples.
template <class Group>
std::vector<Group> grouped(const Skin& skin, const SurfacePoints& points, const Points& rest,
                           const VectorXd& thickness) {
  std::vector<Eigen::AlignedBox3d> places;
  for (Index p = 0; p < rest.rows(); ++p) places.emplace_back(Vector3d(rest.row(p)));
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
      points.each_corner(p, [&](int v, double) {
        for (SkinWeights::InnerIterator it(skin.weights, v); it; ++it)
          boxes[it.col()].extend(Vector3d(skin.rest.row(v)));
      });
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
  const Index P = samples.points.size();
  check_points(samples.points, samples.skin.rest.rows());
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
                                      std::shared_ptr<const LocalResponses> local, std::optional<MatrixXd> found)
    : map_(model, checked(samples).skin),
      points_(std::move(samples.points)),
      rest_(places_of(map_.skin(), points_)),
      normals_(samples.normals.rowwise().normalized()),
      thickness_(std::move(samples.thickness)),
      groups_(grouped<Group>(map_.skin(), points_, rest_, thickness_)),
      share_(set_shares(model->body(), map_.skin().embedding, points_)),
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
  const typename Model::SkinPoints vertices = model->skin_points(map_.skin().embedding);
  bound_motion(vertices);
  find_patches();
  if (found) {
    check_size("found", found->rows(), size());
    check_size("found", found->cols(), 3);
    if (!found->allFinite() || (found->array() < 0).any())
      throw std::invalid_argument("found: must be finite and not negative");
    stiffness_ = found->col(0);
    mass_ = found->col(1);
    taken_ = found->col(2);
  } else {
    find_stiffness(vertices, neutral);
  }
}

template <class Model>
MatrixXd ContactSamples<Model>::found() const {
  MatrixXd out(size(), 3);
  out << stiffness_, mass_, taken_;
  return out;
}

template <class Model>
void ContactSamples<Model>::bound_motion(const typename Model::SkinPoints& vertices) {
  moved_ = most_moved(vertices, map_.skin().embedding);
  const MatrixXd& R = map_.skin().residual_shapes;
  residual_.setZero(R.size() > 0 ? R.cols() : 0);
  for (Index j = 0; j < residual_.size(); ++j)
    residual_(j) = R.col(j).reshaped(3, map_.size()).colwise().norm().maxCoeff();
  shapes_.resize(3 * map_.size(), Index(model().targets().size()));
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
  if (local_->shapes().rows() != 3 * Index(model().body().free_nodes.size()) ||
      local_->shear().size() != model().body().sets())
    throw std::invalid_argument("local: they belong to another mesh");
  patches_.resize(std::size_t(size()));
  std::vector<std::pair<int, double>> found;
  for (Index p = 0; p < size(); ++p) {
    local_->patches_at(rest_.row(p), normals_.row(p), found);
    for (const auto& [patch, weight] : found) patches_[std::size_t(p)].push_back(patch);
  }
}

template <class Model>
void ContactSamples<Model>::find_stiffness(const typename Model::SkinPoints& vertices, const VectorXd& neutral) {
  const Index stride = (size() + kSolved - 1) / kSolved;
  const std::vector<Index> solved = most_alike(rest_, normals_, stride, model().body().size);
  const std::vector<int> samples = spaced(size(), kSolved);
  PointRows numbers;
  for (const int p : samples) {
    numbers.add_row();
    add(p, normals_.row(p), numbers);
  }
  typename SkinMap<Model>::Rows rows;
  vertices.rows(numbers, rows);
  const typename Model::Matrix A = lasting_stiffness(model(), neutral);
  auto [K, M] = stiffness_and_mass(model(), neutral);
  values(K) += values(M) / (kFirmStep * kFirmStep);
  VectorXd lasting = compliance(A, rows), in_step = compliance(K, rows), pushed = VectorXd::Ones(lasting.size());
  if constexpr (std::is_same_v<Model, ReducedModel>) {
    const MatrixXd answers = answers_to(A, rows);
    pushed = stay_local(lasting, rows_of(vertices.basis(), spaced(map_.size(), kComparedSamples)), answers);
    if (local_) {
      const VectorXd taken = pushed;
      for (Index p = 0; p < size(); ++p) taken_(p) = taken(solved[std::size_t(p)]);
      VectorXd local(numbers.size());
      std::vector<Dent> dents;
      RowMajor own;
      for (int k = 0; k < numbers.size(); ++k) {
        const std::vector<int>& patches = patches_[std::size_t(samples[std::size_t(k)])];
        local_rows(numbers, {k}, patches, own);
        dents.push_back({&patches, local_->stiffness()(patches, patches).llt().solve(own.transpose()) /
                                       local_stiffer(samples[std::size_t(k)], neutral)});
        local(k) = own.row(0).dot(dents.back().amplitudes);
      }
      const std::vector<int> others = spaced(map_.size(), kSolved);  // patches move few, but those may be far off
      pushed = stay_local(lasting.cwiseProduct(taken) + local, rows_of(vertices.basis(), others),
                          answers * taken.asDiagonal(), local_shapes(others), dents);
      lasting = lasting.cwiseProduct(taken.cwiseAbs2()) + local;
      in_step = in_step.cwiseProduct(taken.cwiseAbs2()) + local;
    }
  }
  const VectorXd free = free_weights(model().body(), map_.skin().embedding, points_);
  for (Index p = 0; p < size(); ++p) {
    const Index k = solved[std::size_t(p)];
    if (!(in_step(k) > 0)) continue;
    // A sample that moves little with its nodes, or with its modes, would move them far: no more than it moves itself
    // is asked for.
    const double counts = std::pow(std::clamp(free(p) / kFree, 0.0, 1.0), 4) * pushed(k);
    stiffness_(p) = counts / lasting(k);
    mass_(p) = counts * std::max(1 / in_step(k) - 1 / lasting(k), 0.0) * kFirmStep * kFirmStep;
  }
}

template <class Model>
MatrixXd ContactSamples<Model>::local_shapes(const std::vector<int>& vertices) const {
  std::vector<int> all(std::size_t(local_->size())), each_axis;
  std::iota(all.begin(), all.end(), 0);
  PointRows axes;
  for (const int vertex : vertices)
    for (int axis = 0; axis < 3; ++axis) {
      each_axis.push_back(axes.size());
      axes.add_row();
      axes.add(vertex, Vector3d::Unit(axis));
    }
  RowMajor out;
  local_rows(axes, each_axis, all, out);
  return out;
}

template <class Model>
void ContactSamples<Model>::local_rows(const PointRows& numbers, const std::vector<int>& chosen,
                                       const std::vector<int>& patches, RowMajor& out) const {
  const Embedding& embedding = map_.skin().embedding;
  const std::vector<int>& free_of_node = model().body().free_of_node;
  std::vector<int> place(model().body().free_nodes.size(), -1), rows;  // of a node in `used`, and in the shapes
  const auto each_node = [&](int row, const auto& f) {
    for (int part = numbers.first(row); part < numbers.first(row + 1); ++part)
      for (int k = 0; k < 4; ++k) {
        const int v = numbers.point(part), node = free_of_node[std::size_t(embedding.nodes(v, k))];
        if (node >= 0) f(node, embedding.weights(v, k) * numbers.direction(part));
      }
  };
  for (const int row : chosen)
    each_node(row, [&](int node, const Vector3d&) {
      if (place[std::size_t(node)] >= 0) return;
      place[std::size_t(node)] = int(rows.size());
      rows.insert(rows.end(), {3 * node, 3 * node + 1, 3 * node + 2});
    });
  const RowMajor used = local_->shapes()(rows, patches);
  out.setZero(Index(chosen.size()), Index(patches.size()));
  for (std::size_t i = 0; i < chosen.size(); ++i)
    each_node(chosen[i], [&](int node, const Vector3d& direction) {
      out.row(Index(i)).noalias() += direction.transpose() * used.middleRows<3>(place[std::size_t(node)]);
    });
}

template <class Model>
Vector3d ContactSamples<Model>::unmoved(const Transforms& bones, const VectorXd& weights, Index sample) const {
  Vector3d out = Vector3d::Zero();
  points_.each_corner(sample, [&](int v, double weight) { out += weight * map_.unmoved(bones, weights, v); });
  return out;
}

template <class Model>
void ContactSamples<Model>::add(Index sample, const Vector3d& direction, PointRows& numbers) const {
  points_.each_corner(sample, [&](int v, double weight) { numbers.add(v, weight * direction); });
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
double ContactSamples<Model>::stiffer(Index sample, const VectorXd& elastic, const VectorXd& softness) const {
  double out = 0;
  const auto& targets = model().targets();
  for (std::size_t j = 0; j < targets.size(); ++j)
    if (const double e = elastic(Index(j)); e != 0)
      out += share_(sample, targets[j].set) * e * targets[j].lame.mu * softness(targets[j].set);
  return out;
}

template <class Model>
double ContactSamples<Model>::stiffness(Index sample, const VectorXd& elastic, double square) const {
  return kFirmness * (stiffer(sample, elastic, softness_) * stiffness_(sample) + mass_(sample) / square);
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
