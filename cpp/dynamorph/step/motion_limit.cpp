// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/motion_limit.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <string>

#include "dynamorph/contact/contact_law.hpp"
#include "dynamorph/core/errors.hpp"
#include "dynamorph/reduced/modes/polynomial_kernels.hpp"
#include "dynamorph/step/choices.hpp"
#include "dynamorph/step/limited_tissue.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

void check(const SkinLimits& limits, const SoftBody& body) {
  const Index P = limits.rest.rows(), transforms = body.skin.cols();
  check_size("embedding", limits.embedding.nodes.rows(), P);
  check_size("weights", limits.weights.rows(), P);
  check_size("distances", limits.distances.size(), P);
  check_triangles(limits.rest, limits.triangles);
  if (P > 0 && (limits.embedding.nodes.minCoeff() < 0 || limits.embedding.nodes.maxCoeff() >= body.mesh.nodes.rows()))
    throw std::invalid_argument("embedding: it belongs to another mesh");
  if (!(limits.distances.array() > 0).all() || !limits.distances.allFinite())
    throw std::invalid_argument("distances: must be finite and above zero");
  if (limits.painted.size() > 0) check_size("painted", limits.painted.size(), P);
  if (!(limits.painted.array() > 0).all() || !(limits.painted.array() <= 1).all())
    throw std::invalid_argument("painted: must be above zero and at most one");
  const LimitConstants& c = limits.constants;
  if (!std::isfinite(c.stretch) || !(c.stretch > 0) || c.edges_between < 0)
    throw std::invalid_argument("stretch: must be finite and above zero, and edges_between not below it");
  if (body.own_transforms != (limits.groups.size() > 0))
    throw std::invalid_argument("groups: needed where the nodes have transforms of their own, and only there");
  if (body.own_transforms) check_size("groups", limits.groups.rows(), transforms);
  if (limits.weights.cols() != (body.own_transforms ? limits.groups.cols() : transforms))
    throw std::invalid_argument("weights: expected those of " +
                                std::to_string(body.own_transforms ? limits.groups.cols() : transforms) +
                                " bones, got " + std::to_string(limits.weights.cols()));
}

/// Throws std::invalid_argument unless it is of such a skin.
void check(const LimitedTissue& tissue, const SkinLimits& limits) {
  const Index P = limits.rest.rows();
  const auto is_point = [&](int p) { return p >= 0 && p < P; };
  const auto are_edges = [&](const std::vector<Edge>& edges) {
    return std::all_of(edges.begin(), edges.end(), [&](const Edge& edge) {
      return is_point(edge.first) && is_point(edge.second) &&
             limits.rest.row(edge.first) != limits.rest.row(edge.second);
    });
  };
  bool fits = tissue.square_frequency > 0 && std::isfinite(tissue.square_frequency) &&
              std::all_of(tissue.chosen.begin(), tissue.chosen.end(), is_point) &&
              std::all_of(tissue.pulled.begin(), tissue.pulled.end(), is_point) &&
              tissue.area.size() == Index(tissue.chosen.size()) &&
              tissue.pulled_mass.size() == Index(tissue.pulled.size()) && tissue.area.allFinite() &&
              tissue.pulled_mass.allFinite() && Index(tissue.edges.size()) == limits.weights.cols();
  for (const BoneEdges& of_bone : tissue.edges)
    fits = fits && are_edges(of_bone.critical) && are_edges(of_bone.between) && std::isfinite(of_bone.stiffness);
  if (!fits) throw std::invalid_argument("tissue: it is of another skin");
}

/// The numbers over few points, and which points (P) these are.
std::pair<PointRows, std::vector<int>> packed(const PointRows& numbers) {
  std::vector<int> used;
  for (int k = 0; k < numbers.parts(); ++k) used.push_back(numbers.point(k));
  make_unique(used);
  PointRows out;
  for (int row = 0; row < numbers.size(); ++row) {
    out.add_row();
    for (int k = numbers.first(row); k < numbers.first(row + 1); ++k)
      out.add(int(std::lower_bound(used.begin(), used.end(), numbers.point(k)) - used.begin()), numbers.direction(k));
  }
  return {out, used};
}

/// The free nodes as points: each in one of its tets.
Embedding free_nodes(const SoftBody& body) {
  const Index free = Index(body.free_nodes.size());
  Embedding out{Tets::Zero(free, 4), {}, VectorXd::Zero(free)};
  out.weights.setZero(free, 4);
  for (Index t = 0; t < body.mesh.tets.rows(); ++t)
    for (int k = 0; k < 4; ++k)
      if (const int node = body.free_of_node[std::size_t(body.mesh.tets(t, k))]; node >= 0) {
        out.nodes.row(node) = body.mesh.tets.row(t);
        out.weights.row(node) = Eigen::RowVector4d::Unit(k);
      }
  return out;
}

void append(const Embedding& more, Embedding& points) {
  const Index before = points.nodes.rows(), after = before + more.nodes.rows();
  points.nodes.conservativeResize(after, Eigen::NoChange);
  points.weights.conservativeResize(after, Eigen::NoChange);
  points.nodes.bottomRows(after - before) = more.nodes;
  points.weights.bottomRows(after - before) = more.weights;
  // Not setZero: Eigen 3.4 frees a vector again whose new size is refused.
  points.distances.conservativeResizeLike(VectorXd::Zero(after));
}

/// Values at points of the skin, extended to the free nodes.
VectorXd at_free_nodes(const SoftBody& body, const Embedding& embedding, const VectorXd& values) {
  const MatrixXd nodes = extend_to_nodes(body.mesh, embedding, values);
  VectorXd out(Index(body.free_nodes.size()));
  for (Index i = 0; i < out.size(); ++i)
    out(i) = std::clamp(nodes(body.free_nodes[std::size_t(i)], 0), values.minCoeff(), values.maxCoeff());
  return out;
}

/// Adds the stretch of an edge, over its limit, to numbers in which its ends are the points a and b.
void add_stretch(const SkinLimits& limits, const Edge& edge, int a, int b, PointRows& numbers) {
  const Vector3d along = limits.rest.row(edge.first) - limits.rest.row(edge.second);
  const double limit = limits.constants.stretch * along.squaredNorm();
  numbers.add_row();
  numbers.add(a, along / limit);
  numbers.add(b, -along / limit);
}

/// numbers: over the skin's points (P), three of each chosen point, then one of each edge.
std::vector<LimitedBone> limited_bones(const LimitedTissue& tissue, const SkinLimits& limits, const SoftBody& body,
                                       PointRows& numbers) {
  for (int p : tissue.chosen)
    for (int axis = 0; axis < 3; ++axis) {
      numbers.add_row();
      numbers.add(p, Vector3d::Unit(axis) / limits.distances(p));
    }
  const MatrixXd volumes = carried_by_bones(body, limits).transpose() * body.volumes;  // (G, S)
  std::vector<LimitedBone> out(tissue.edges.size());
  for (std::size_t b = 0; b < out.size(); ++b) {
    LimitedBone& bone = out[b];
    bone.share = volumes.row(Index(b)).transpose() / std::max(volumes.row(Index(b)).sum(), 1e-300);
    for (std::size_t k = 0; k < tissue.chosen.size(); ++k)
      if (const double weight = limits.weights(tissue.chosen[k], Index(b)); weight > kOwns) {
        bone.points.push_back({int(k), weight * tissue.area(Index(k))});
        bone.above += (1 - kPercentile) * bone.points.back().second;
      }
    Eigen::AlignedBox3d box;
    bone.least_distance = kInfinity;
    for (const auto& [point, weight] : bone.points) {
      box.extend(Vector3d(limits.rest.row(tissue.chosen[std::size_t(point)])));
      bone.least_distance = std::min(bone.least_distance, limits.distances(tissue.chosen[std::size_t(point)]));
    }
    if (!box.isEmpty()) {
      bone.center = box.center();
      bone.radius = box.diagonal().norm() / 2;
    }
    bone.first_edge = numbers.size();
    for (const Edge& edge : tissue.edges[b].critical) add_stretch(limits, edge, edge.first, edge.second, numbers);
    bone.last_edge = numbers.size();
  }
  return out;
}

/// What is pulled back, and its numbers over `points`: of a mesh the free nodes, of few coordinates the pulled points
/// with the mass of the nodes nearby; then the ends of the edges.
/// node_mass: of the free nodes.
std::vector<Pull> pulls_of(const LimitedTissue& tissue, const SkinLimits& limits, const SoftBody& body, bool nodal,
                           const VectorXd& node_mass, PointRows& numbers, Embedding& points) {
  const double pull = kPull * tissue.square_frequency;
  points = nodal ? free_nodes(body) : of_points(limits.embedding, tissue.pulled);
  const auto at_points = [&](const VectorXd& of_skin) {
    return nodal ? at_free_nodes(body, limits.embedding, of_skin) : VectorXd(of_skin(tissue.pulled));
  };
  const VectorXd distances = at_points(limits.distances);
  VectorXd painted = VectorXd::Ones(distances.size());
  if (limits.painted.size() > 0) painted = at_points(limits.painted);
  const VectorXd& mass = nodal ? node_mass : tissue.pulled_mass;
  std::vector<Pull> out;
  for (int p = 0; p < int(points.nodes.rows()); ++p) {
    out.push_back({numbers.size(), 3, painted(p) * distances(p), pull / painted(p) * mass(p)});
    for (int axis = 0; axis < 3; ++axis) {
      numbers.add_row();
      numbers.add(p, Vector3d::Unit(axis));
    }
  }
  std::vector<int> ends;
  for (const BoneEdges& of_bone : tissue.edges)
    for (const std::vector<Edge>* edges : {&of_bone.critical, &of_bone.between})
      for (const Edge& edge : *edges) {
        const int first = int(points.nodes.rows() + Index(ends.size()));
        out.push_back({numbers.size(), 1, 1, of_bone.stiffness});
        add_stretch(limits, edge, first, first + 1, numbers);
        ends.insert(ends.end(), {edge.first, edge.second});
      }
  append(of_points(limits.embedding, ends), points);
  return out;
}

}  // namespace

double load_scale(double excess) {
  if (excess <= kLoadBegins) return 1;
  const double rest = 1 - kLoadBegins;
  return (kLoadBegins + rest * std::tanh((excess - kLoadBegins) / rest)) / excess;
}

Ramp ramp(double r, double limit) {
  const ContactRamp at = contact_ramp(r - kRampBegins * limit, (1 - kRampBegins) * limit);
  return {at.energy, at.stiffness, at.force > 0 ? at.force / r : 0};
}

SingleRows::SingleRows(const Eigen::Ref<const MatrixXd>& rows)
    : size_(rows.rows()),
      padded_((size_ + kRowBlock - 1) / kRowBlock * kRowBlock),
      table_(std::size_t(padded_ * rows.cols()), 0.0F) {
  for (Index column = 0; column < rows.cols(); ++column)
    for (Index row = 0; row < size_; ++row) {
      const Index block = row / kRowBlock * rows.cols();
      table_[std::size_t((block + column) * kRowBlock + row % kRowBlock)] = float(rows(row, column));
    }
}

void SingleRows::multiply(const VectorXd& x, std::vector<float>& scratch, VectorXd& out) const {
  scratch.assign(x.data(), x.data() + x.size());
  out.resize(padded_);
  multiply_row_blocks(table_.data(), padded_ / kRowBlock, scratch.data(), x.size(), out.data());
}

void SingleRows::multiply(const MatrixX2d& x, std::vector<float>& scratch, MatrixX2d& out) const {
  scratch.resize(std::size_t(x.size()));
  Eigen::Map<Eigen::Matrix<float, 2, Eigen::Dynamic>>(scratch.data(), 2, x.rows()) = x.transpose().cast<float>();
  out.resize(padded_, 2);
  multiply_row_blocks_twice(table_.data(), padded_ / kRowBlock, scratch.data(), x.rows(), out.data());
}

void NodalAnswers::multiply(const MatrixX2d& loads, std::vector<float>& scratch, MatrixX2d& out) const {
  VectorXd load, x, answers;
  out.resize(size(), 2);
  for (Index k = 0; k < 2; ++k) {
    load = loads.col(k);
    factor_.solve(load, x, scratch);
    dynamorph::multiply(rows_, x, answers);
    out.col(k) = answers;
  }
}

template <class Model>
MotionLimit<Model>::MotionLimit(std::shared_ptr<const Model> model, const SkinLimits& limits,
                                std::optional<LimitedTissue> tissue)
    : model_(std::move(model)), groups_(limits.groups), pull_points_(model_->skin_points({})) {
  check(limits, model_->body());
  Neutral<Model> neutral(*model_);
  neutral_stiffness_.resize(model_->body().sets());
  for (std::size_t j = 0; j < model_->targets().size(); ++j)
    if (const MorphTarget& target = model_->targets()[j]; neutral.weights(Index(j)) == 1)
      neutral_stiffness_(target.set) = target.lame.mu;
  if (tissue) check(*tissue, limits);
  tissue_ = tissue ? std::move(*tissue) : looked_at(tissue_of(neutral, limits));
  sampled_rest_ = limits.rest(tissue_.chosen, Eigen::all);
  sampled_distances_ = limits.distances(tissue_.chosen);
  group_shares_ = groups_;
  for (Index b = 0; b < groups_.cols(); ++b) group_shares_.col(b) /= std::max(groups_.col(b).sum(), 1e-300);

  PointRows numbers;
  bones_ = limited_bones(tissue_, limits, model_->body(), numbers);
  const auto [few, used] = packed(numbers);
  typename Model::SkinPoints::Rows rows, pulled;
  model_->skin_points(of_points(limits.embedding, used)).rows(few, rows);
  Embedding points;
  pulls_ = pulls_of(tissue_, limits, model_->body(), kNodal, neutral.mass, pull_numbers_, points);
  pull_points_ = model_->skin_points(points);
  pull_points_.rows(pull_numbers_, pulled);
  if constexpr (kNodal) {
    answers_ = std::make_unique<Answers>(std::move(neutral.factor).nodal(), std::move(rows));
    pull_rows_ = std::move(pulled);
  } else {
    answers_ = std::make_unique<Answers>(neutral.K.dense().ldlt().solve(rows.transpose()).transpose());
    pull_rows_.emplace(pulled);
  }
}

template <class Model>
void MotionLimit<Model>::drive(const VectorXd& load, const VectorXd& elastic, double stiffer,
                               const Transforms& acceleration, double h, const DrivenLoad& before, Scratch& scratch,
                               DrivenLoad& out) const {
  const std::complex<double> k = std::exp(std::complex(-kLoadDamping, 1.0) * h * std::sqrt(stiffer) * frequency());
  const double kept = std::abs(k), turn = k.imag();
  out.swing.resize(load.size(), 2);
  out.swing.col(0) = k.real() * before.swing.col(0) - turn * before.swing.col(1) + (1 - k.real()) * load;
  out.swing.col(1) = turn * before.swing.col(0) + k.real() * before.swing.col(1) - turn * load;
  reach(out.swing, elastic, scratch, out.reach);
  VectorXd &held = scratch.held, &jump = scratch.jump;
  held = (out.reach / kept).cwiseMin(before.reach).cwiseMax(kept * before.held);
  jumped(acceleration, out.reach.cwiseMin(held), scratch, jump);
  out.held = (out.reach / kept).cwiseMax(jump).cwiseMin(before.reach).cwiseMax(kept * before.held);
  out.reach = out.reach.cwiseMax(jump);
  out.excess[0] = jump.cwiseMax(out.held);
  out.excess[1] = before.excess[0];
  out.excess[2] = before.excess[1];
}

template <class Model>
void MotionLimit<Model>::drive_long(const VectorXd& load, const VectorXd& elastic, Scratch& scratch,
                                    DrivenLoad& out) const {
  out.swing.resize(load.size(), 2);
  out.swing << load, VectorXd::Zero(load.size());
  reach(out.swing, elastic, scratch, out.reach);
  out.held = out.reach;
  out.excess.fill(out.reach);
}

template <class Model>
void MotionLimit<Model>::jumped(const Transforms& acceleration, const VectorXd& least, Scratch& scratch,
                                VectorXd& out) const {
  out.setZero(bones());
  if (groups_.size() > 0) scratch.moved.noalias() = group_shares_.transpose() * acceleration;
  for (Index b = 0; b < bones(); ++b) {
    const LimitedBone& bone = bones_[std::size_t(b)];
    Eigen::Matrix<double, 1, 12> row = acceleration.row(groups_.size() > 0 ? 0 : b);
    if (groups_.size() > 0) row = scratch.moved.row(b);
    const TransformMap by(row.data());
    const double farthest = (by.leftCols<3>() * bone.center + by.col(3)).norm() + by.leftCols<3>().norm() * bone.radius;
    if (farthest <= least(b) * bone.least_distance) continue;
    for (const auto& [point, weight] : bone.points) {
      const Vector3d moved = by.leftCols<3>() * sampled_rest_.row(point).transpose() + by.col(3);
      scratch.answers(point) = moved.norm() / sampled_distances_(point);
    }
    out(b) = percentile(bone, scratch);
  }
}

template <class Model>
void MotionLimit<Model>::reach(const MatrixX2d& swing, const VectorXd& elastic, Scratch& scratch, VectorXd& out) const {
  VectorXd &answers = scratch.answers, &stiffness = scratch.stiffness;
  answers_->multiply(swing, scratch.single, scratch.swings);
  answers = (scratch.swings.col(0).array().square() + scratch.swings.col(1).array().square()).sqrt();
  if (!answers.allFinite())
    throw Error("A step failed because a force is not finite. Check the rig and the materials at this frame.");
  stiffness.setZero(neutral_stiffness_.size());
  const auto& targets = model_->targets();
  for (std::size_t j = 0; j < targets.size(); ++j)
    stiffness(targets[j].set) += elastic(Index(j)) * targets[j].lame.mu / neutral_stiffness_(targets[j].set);
  for (int p = 0; p < int(sampled_distances_.size()); ++p) answers(p) = answers.segment<3>(3 * p).norm();
  out.resize(bones());
  for (Index b = 0; b < bones(); ++b) {
    const LimitedBone& bone = bones_[std::size_t(b)];
    double largest = percentile(bone, scratch);
    for (int e = bone.first_edge; e < bone.last_edge; ++e) largest = std::max(largest, answers(e));
    out(b) = largest / std::max(kLoadSwing * bone.share.dot(stiffness), 1e-300);
  }
}

template <class Model>
double MotionLimit<Model>::percentile(const LimitedBone& bone, Scratch& scratch) const {
  auto& heap = scratch.heap;
  heap.clear();
  for (const auto& [point, weight] : bone.points) heap.push_back({scratch.answers(point), weight});
  std::make_heap(heap.begin(), heap.end());
  double value = 0;
  for (double above = 0; !heap.empty() && above < bone.above; heap.pop_back()) {  // few points are above
    std::pop_heap(heap.begin(), heap.end());
    value = heap.back().first;
    above += heap.back().second;
  }
  return value;
}

template <class Model>
void MotionLimit<Model>::scales(const VectorXd& excess, VectorXd& out) const {
  const VectorXd of_bones = excess.unaryExpr(&load_scale);
  if (groups_.size() > 0)
    out = groups_ * of_bones;
  else
    out = of_bones;
}

template <class Model>
void MotionLimit<Model>::pull_values(const VectorXd& from_shape, Scratch& scratch, VectorXd& out) const {
  if constexpr (kNodal)
    multiply(pull_rows_, from_shape, out);
  else
    pull_rows_->multiply(from_shape, scratch.single, out);
}

template class MotionLimit<FullModel>;
template class MotionLimit<ReducedModel>;

}  // namespace dynamorph
