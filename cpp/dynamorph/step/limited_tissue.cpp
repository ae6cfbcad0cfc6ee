// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/limited_tissue.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/symmetry.hpp"
#include "dynamorph/step/choices.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr double kSplinter = 1e-4;  // of the size; shorter edges do not count

SoftSkin soft_skin(const SkinLimits& limits) {
  SoftSkin skin{VectorXd::Zero(limits.rest.rows()), 0, {}};
  Eigen::AlignedBox3d box;
  for (Index t = 0; t < limits.triangles.rows(); ++t) {
    const std::array<int, 3> c = {limits.triangles(t, 0), limits.triangles(t, 1), limits.triangles(t, 2)};
    const Vector3d p = limits.rest.row(c[0]), q = limits.rest.row(c[1]), r = limits.rest.row(c[2]);
    const double area = (q - p).cross(r - p).norm() / 6;
    for (int k = 0; k < 3; ++k) {
      skin.areas(c[k]) += area;
      skin.edges.push_back(undirected(c[k], c[(k + 1) % 3]));
      box.extend(Vector3d(limits.rest.row(c[k])));
    }
  }
  if (!(skin.areas.sum() > 0) || !std::isfinite(skin.areas.sum()))
    throw std::invalid_argument("triangles: their area must be finite and above zero");
  skin.size = box.diagonal().norm();
  std::sort(skin.edges.begin(), skin.edges.end());
  skin.edges.erase(std::unique(skin.edges.begin(), skin.edges.end()), skin.edges.end());
  const auto splinter = [&](const Edge& e) {
    return (limits.rest.row(e.first) - limits.rest.row(e.second)).norm() <= kSplinter * skin.size;
  };
  skin.edges.erase(std::remove_if(skin.edges.begin(), skin.edges.end(), splinter), skin.edges.end());
  return skin;
}

/// Which points, edges and bones of a mirror-symmetric skin are images of each other; -1 where one has no image.
class Mirror {
 public:
  /// Completes the skin's edges: of faces whose diagonals are not symmetric, the images of these are edges too.
  Mirror(const SkinLimits& limits, SoftSkin& skin) : points_(mirror_images(limits.rest, limits.triangles)) {
    std::vector<Edge> all;
    for (const Edge& edge : skin.edges) {
      const Edge image = image_of(edge), again = image_of(image);
      if (again.first < 0 || again.first == again.second)
        all.push_back(edge);
      else
        all.insert(all.end(), {image, again});  // of the points at one place, the same for all edges
    }
    std::sort(all.begin(), all.end());
    all.erase(std::unique(all.begin(), all.end()), all.end());
    skin.edges = std::move(all);
    for (const Edge& edge : skin.edges) {
      const auto found = std::lower_bound(skin.edges.begin(), skin.edges.end(), image_of(edge));
      const bool is_edge = found != skin.edges.end() && *found == image_of(edge);
      edges_.push_back(is_edge ? int(found - skin.edges.begin()) : -1);
    }
    find_bones(limits.weights.sparseView());
  }
  int point(Index p) const { return points_[std::size_t(p)]; }
  int edge(int e) const { return edges_[std::size_t(e)]; }
  int bone(Index b) const { return bones_[std::size_t(b)]; }

  /// Values of chosen points, each averaged with that of its image: what is on the plane is as near to both.
  VectorXd evened(const std::vector<int>& chosen, const VectorXd& values) const {
    std::map<int, Index> place;
    for (std::size_t k = 0; k < chosen.size(); ++k) place.emplace(chosen[k], Index(k));
    VectorXd out = values;
    for (std::size_t k = 0; k < chosen.size(); ++k)
      if (const auto image = place.find(point(chosen[k])); image != place.end())
        out(Index(k)) = 0.5 * (values(Index(k)) + values(image->second));
    return out;
  }

 private:
  Edge image_of(const Edge& edge) const {
    return edge.first < 0 ? edge : undirected(point(edge.first), point(edge.second));
  }
  /// The image of a bone is that whose weights are most like the image of its own.
  void find_bones(const SkinWeights& weights) {
    MatrixXd shared = MatrixXd::Zero(weights.cols(), weights.cols());
    VectorXd squares = VectorXd::Zero(weights.cols());
    for (Index p = 0; p < weights.rows(); ++p)
      if (point(p) >= 0)
        for (SkinWeights::InnerIterator b(weights, p); b; ++b) {
          squares(b.col()) += b.value() * b.value();
          for (SkinWeights::InnerIterator c(weights, point(p)); c; ++c)
            shared(b.col(), c.col()) += b.value() * c.value();
        }
    for (Index b = 0; b < weights.cols(); ++b) {
      Index image = 0;
      const auto alike = shared.row(b).array() / squares.transpose().array().max(1e-300).sqrt();
      bones_.push_back(alike.maxCoeff(&image) > 0 ? int(image) : -1);
    }
  }

  std::vector<int> points_, edges_, bones_;
};

/// Points of a skin as far from each other as possible (farthest point sampling), with their mirror images where they
/// have such.
class Sampling {
 public:
  Sampling(const Points& points, const VectorXd& areas, const Mirror& mirror)
      : points_(points), areas_(areas), mirror_(mirror), nearest_(points.rows()) {
    for (Index p = 0; p < points.rows(); ++p) nearest_(p) = areas(p) > 0 ? kInfinity : -1;
    owner_.assign(std::size_t(points.rows()), 0);
  }
  void add(int count) {
    Index farthest = 0;
    while (int(chosen_.size()) < count && nearest_.size() > 0 && nearest_.maxCoeff(&farthest) > 0) take(farthest);
  }
  /// More where the weight of a bone is largest, until it owns so many.
  void add(const Eigen::Ref<const VectorXd>& weight, int count) {
    int owned = 0;
    for (int p : chosen_) owned += weight(p) > kOwns;
    for (; owned < count; ++owned) {
      Index farthest = 0;
      if (!((weight.array() > kOwns).select(nearest_.array(), -1.0).maxCoeff(&farthest) > 0)) return;
      take(farthest);
    }
  }
  const std::vector<int>& chosen() const { return chosen_; }
  /// Of values at all points: at each chosen point, the sum over those that are nearest to it.
  VectorXd sums(const VectorXd& values) const {
    VectorXd out = VectorXd::Zero(Index(chosen_.size()));
    for (Index p = 0; p < values.size(); ++p)
      if (areas_(p) > 0) out(owner_[std::size_t(p)]) += values(p);
    return out;
  }

 private:
  void take(Index point) {
    take_alone(point);
    if (const int image = mirror_.point(point); image >= 0 && nearest_(image) > 0) take_alone(image);
  }
  void take_alone(Index point) {
    const int number = int(chosen_.size());
    chosen_.push_back(int(point));
    for (Index p = 0; p < points_.rows(); ++p) {
      if (nearest_(p) < 0) continue;
      const double distance = (points_.row(p) - points_.row(point)).squaredNorm();
      if (distance < nearest_(p)) {
        nearest_(p) = distance;
        owner_[std::size_t(p)] = number;
      }
    }
  }
  const Points& points_;
  const VectorXd& areas_;
  const Mirror& mirror_;
  VectorXd nearest_;  ///< square of the distance from the nearest chosen point
  std::vector<int> owner_, chosen_;
};

/// The same for values (n) at other places (3n).
VectorXd sums_at_nearest(const Points& chosen, const VectorXd& places, const VectorXd& values) {
  VectorXd out = VectorXd::Zero(chosen.rows());
  for (Index i = 0; i < values.size(); ++i) {
    Index nearest = 0;
    (chosen.rowwise() - places.segment<3>(3 * i).transpose()).rowwise().squaredNorm().minCoeff(&nearest);
    out(nearest) += values(i);
  }
  return out;
}

/// Adds the edge, of a bone's own, whose stretch under an answer u (3P) is at the percentile, where `weight` (P)
/// counts, and raises the strain of each of them to its stretch over that. Returns the percentile over the limit.
double add_critical(const VectorXd& u, const SoftSkin& skin, const SkinLimits& limits, const VectorXd& weight,
                    CriticalEdges& of_bone) {
  VectorXd stretch(Index(of_bone.own.size())), part(stretch.size());
  std::vector<std::pair<double, int>> largest;  // a heap, with places in of_bone.own
  for (Index k = 0; k < stretch.size(); ++k) {
    const auto [a, b] = skin.edges[std::size_t(of_bone.own[std::size_t(k)])];
    const Vector3d edge = (limits.rest.row(a) - limits.rest.row(b)).transpose();
    const double length = edge.norm();
    stretch(k) = std::abs(edge.dot(u.segment<3>(3 * a) - u.segment<3>(3 * b))) / (length * length);
    part(k) = length * (weight(a) + weight(b));
    largest.push_back({stretch(k), int(k)});
  }
  std::make_heap(largest.begin(), largest.end());
  double beyond = (1 - kEdgePercentile) * part.sum();
  while (largest.size() > 1 && (beyond -= part(largest.front().second)) >= 0) {
    std::pop_heap(largest.begin(), largest.end());
    largest.pop_back();
  }
  const auto [critical, at] = largest.front();
  of_bone.edges.insert(of_bone.own[std::size_t(at)]);
  of_bone.strain = of_bone.strain.cwiseMax((stretch / std::max(critical, 1e-300)).cwiseMin(1.0)).eval();
  return critical / limits.constants.stretch;
}

/// The mass (free) of the nodes at the neutral targets.
VectorXd neutral_mass(const SoftBody& body, const std::vector<MorphTarget>& targets, const VectorXd& weights) {
  SetDensities densities;
  densities.blend(targets, body.sets(), weights);
  return body.volumes * densities.density;
}

/// Loads (3 free): what is `carried` (free) of the nodes' mass, accelerated along an axis, or turned about one through
/// its center.
VectorXd accelerated(const VectorXd& carried, int axis) {
  VectorXd out = VectorXd::Zero(3 * carried.size());
  for (Index i = 0; i < carried.size(); ++i) out(3 * i + axis) = carried(i);
  return out;
}
VectorXd turned(const VectorXd& carried, const VectorXd& rest, int axis) {
  const double sum = carried.sum();
  Vector3d center = Vector3d::Zero();
  for (Index i = 0; i < carried.size(); ++i) center += carried(i) / sum * rest.segment<3>(3 * i);
  VectorXd out(rest.size());
  for (Index i = 0; i < carried.size(); ++i)
    out.segment<3>(3 * i) = carried(i) * Vector3d::Unit(axis).cross(rest.segment<3>(3 * i) - center);
  return out;
}

/// Displacements of some points of a skin by those of the few nodes that carry them.
template <class Model>
class Carried {
 public:
  Carried(const Model& model, const Embedding& embedding, std::vector<int> points)
      : embedding_(embedding), points_(std::move(points)), at_nodes_(model.skin_points(used_nodes(model))) {}

  /// By coordinates (dofs), in u (3P).
  void displace(const VectorXd& coordinates, VectorXd& u) {
    at_nodes_.displacement(coordinates, of_nodes_);
    for (int p : points_) {
      u.segment<3>(3 * p).setZero();
      for (int k = 0; k < 4; ++k) {
        const int place = place_[std::size_t(embedding_.nodes(p, k))];
        u.segment<3>(3 * p) += embedding_.weights(p, k) * of_nodes_.segment<3>(3 * place);
      }
    }
  }

 private:
  /// The nodes of the points, as points themselves.
  Embedding used_nodes(const Model& model) {
    std::vector<int> used;
    for (int p : points_)
      for (int node : embedding_.nodes.row(p)) used.push_back(node);
    make_unique(used);
    place_.assign(std::size_t(model.body().mesh.nodes.rows()), -1);
    const auto count = Index(used.size());
    Embedding out{Tets::Zero(count, 4), {}, VectorXd::Zero(count)};
    out.weights.setZero(count, 4);
    for (Index k = 0; k < count; ++k) {
      place_[std::size_t(used[std::size_t(k)])] = int(k);
      out.nodes.row(k).setConstant(used[std::size_t(k)]);
      out.weights(k, 0) = 1;
    }
    return out;
  }

  const Embedding& embedding_;
  std::vector<int> points_, place_;  ///< place_: of each node among those that are used
  typename Model::SkinPoints at_nodes_;
  VectorXd of_nodes_;
};

/// weight (P): of the bone; carried (free): its part of the mass; of_body: the answers to accelerations of the whole
/// body.
template <class Model>
CriticalEdges critical_edges(const Neutral<Model>& neutral, const SkinLimits& limits, const SoftSkin& skin,
                             const VectorXd& weight, const VectorXd& carried, const std::array<VectorXd, 3>& of_body) {
  CriticalEdges out;
  std::vector<int> vertices;
  for (std::size_t e = 0; e < skin.edges.size(); ++e)
    if (const auto [a, b] = skin.edges[e]; weight(a) + weight(b) > 2 * kOwns) {
      out.own.push_back(int(e));
      vertices.insert(vertices.end(), {a, b});
    }
  if (out.own.empty()) return out;
  out.strain.setZero(Index(out.own.size()));
  make_unique(vertices);
  Carried points(neutral.model, limits.embedding, std::move(vertices));
  VectorXd u(3 * limits.rest.rows());
  const auto add = [&](const VectorXd& answer) {
    points.displace(answer, u);
    return add_critical(u, skin, limits, weight, out);
  };
  for (int axis = 0; axis < 3; ++axis) {
    add(of_body[std::size_t(axis)]);
    for (const VectorXd& nodal : {accelerated(carried, axis), turned(carried, neutral.model.body().rest, axis)}) {
      VectorXd load;
      neutral.model.project_force(nodal, load);
      const VectorXd answer = neutral.solved(load);
      const double stretch = add(answer);
      out.energy = std::min(out.energy, answer.dot(load) / std::max(stretch * stretch, 1e-300));
    }
  }
  return out;
}

/// Finds edges that loads strain, far from those that are there: between few edges that are held, others would give
/// way. With their mirror images. strain, bone (of all edges): by which bone's load, and how much.
void add_between(const SkinLimits& limits, const std::vector<double>& strain, const std::vector<int>& bone,
                 const Mirror& mirror, Tissue& tissue) {
  const std::vector<Edge>& edges = tissue.skin.edges;
  Points middles(Index(edges.size()), 3);
  for (std::size_t e = 0; e < edges.size(); ++e)
    middles.row(Index(e)) = 0.5 * (limits.rest.row(edges[e].first) + limits.rest.row(edges[e].second));
  std::vector<int> taken;
  for (const CriticalEdges& critical : tissue.edges)
    taken.insert(taken.end(), critical.edges.begin(), critical.edges.end());

  // Square distances from the nearest of those that were taken. They only shrink, so an old one is a bound: only edges
  // that may be next are compared with what was taken since.
  VectorXd nearest = VectorXd::Constant(Index(edges.size()), tissue.skin.size * tissue.skin.size);
  std::vector<std::size_t> compared(edges.size(), 0);
  const auto score = [&](int e) { return strain[std::size_t(e)] * strain[std::size_t(e)] * nearest(e); };
  const auto update = [&](int e) {
    for (std::size_t& k = compared[std::size_t(e)]; k < taken.size(); ++k)
      nearest(e) = std::min(nearest(e), (middles.row(e) - middles.row(taken[k])).squaredNorm());
  };
  parallel_parts(nearest.size(), [&](Index first, Index end) {
    for (Index e = first; e < end; ++e) update(int(e));
  });
  std::vector<std::pair<double, int>> next;  // a heap; of equal scores the first edge is next
  for (int e = 0; e < int(edges.size()); ++e)
    if (score(e) > 0) next.push_back({score(e), -e});
  std::make_heap(next.begin(), next.end());

  int count = 0;
  const auto hold = [&](int e, int b) {
    tissue.edges[std::size_t(b)].between.push_back({e, strain[std::size_t(e)]});
    taken.push_back(e);
    ++count;
  };
  while (count < limits.constants.edges_between && !next.empty()) {
    std::pop_heap(next.begin(), next.end());
    const int best = -next.back().second;
    const bool is_new = compared[std::size_t(best)] == taken.size();
    next.pop_back();
    if (!is_new) {
      update(best);
      if (!(score(best) > 0)) continue;
      next.push_back({score(best), -best});
      std::push_heap(next.begin(), next.end());
      continue;
    }
    const int b = bone[std::size_t(best)], image = mirror.edge(best), other = mirror.bone(b);
    hold(best, b);
    if (image < 0 || other < 0) continue;
    update(image);
    if (nearest(image) > 0) hold(image, tissue.edges[std::size_t(other)].any() ? other : b);
  }
}

/// Gives bones that are images of each other the same critical edges, and a bone that is its own image those on both
/// sides. Bones with edges that have no image keep theirs, and so do those whose image has none.
void make_symmetric(const Mirror& mirror, std::vector<CriticalEdges>& of_bones) {
  for (Index b = 0; b < Index(of_bones.size()); ++b) {
    const Index image = mirror.bone(b);
    if (image < b || mirror.bone(image) != b) continue;
    if (!of_bones[std::size_t(b)].any() || !of_bones[std::size_t(image)].any()) continue;
    const std::set<int>& own = of_bones[std::size_t(b)].edges;
    std::set<int> images;
    for (int e : own) images.insert(mirror.edge(e));
    if (images.count(-1) > 0) continue;
    if (image == b) images.insert(own.begin(), own.end());
    of_bones[std::size_t(image)].edges = std::move(images);
  }
}

}  // namespace

void make_unique(std::vector<int>& numbers) {
  std::sort(numbers.begin(), numbers.end());
  numbers.erase(std::unique(numbers.begin(), numbers.end()), numbers.end());
}

SkinWeights carried_by_bones(const SoftBody& body, const SkinLimits& limits) {
  return limits.groups.size() > 0 ? SkinWeights(limits.groups.sparseView()) : body.skin;
}

LimitedTissue looked_at(const Tissue& tissue) {
  LimitedTissue out{tissue.square_frequency, tissue.chosen, tissue.area, tissue.pulled, tissue.pulled_mass, {}};
  for (const CriticalEdges& critical : tissue.edges) {
    BoneEdges edges;
    for (int e : critical.edges) edges.critical.push_back(tissue.skin.edges[std::size_t(e)]);
    double stretched = double(critical.edges.size());
    for (const auto& [e, stretch] : critical.between) {
      edges.between.push_back(tissue.skin.edges[std::size_t(e)]);
      stretched += stretch * stretch;
    }
    if (critical.any()) edges.stiffness = kPull * critical.energy / stretched;
    out.edges.push_back(std::move(edges));
  }
  return out;
}

Embedding of_points(const Embedding& all, const std::vector<int>& chosen) {
  return {all.nodes(chosen, Eigen::all), all.weights(chosen, Eigen::all), VectorXd::Zero(Index(chosen.size()))};
}

template <class Model>
Neutral<Model>::Neutral(const Model& of)
    : model(of),
      weights(neutral_weights(of.body(), of.targets())),
      mass(neutral_mass(of.body(), of.targets(), weights)),
      K(of.zero()) {
  typename Model::Blend blend;
  model.blend(weights, blend);
  VectorXd rest, force;
  blended_shape(model, weights, rest);
  model.linearize(blend, rest, force, K);
  if (!factor.compute(K)) throw Error("The soft skin has no stiffness at rest. Check its material.");
}

template <class Model>
Tissue tissue_of(const Neutral<Model>& neutral, const SkinLimits& limits) {
  const Model& model = neutral.model;
  Tissue out;
  const VectorXd& mass = neutral.mass;
  // The static answers to accelerations of the whole body, and the frequency of what follows from them by one inverse
  // iteration (Rayleigh's quotient).
  std::array<VectorXd, 3> of_body;
  out.square_frequency = kInfinity;
  for (int axis = 0; axis < 3; ++axis) {
    VectorXd u, again;
    of_body[std::size_t(axis)] = neutral.answer(accelerated(mass, axis));
    model.displacement(of_body[std::size_t(axis)], u);
    const VectorXd load = at_coordinates(mass).cwiseProduct(u);
    model.displacement(neutral.answer(load), again);
    const double quotient = again.dot(load) / again.cwiseAbs2().dot(at_coordinates(mass));
    out.square_frequency = std::min(out.square_frequency, quotient);
  }
  const SkinWeights carried = carried_by_bones(model.body(), limits);
  const VectorXd carried_mass = carried.transpose() * mass;
  out.skin = soft_skin(limits);
  const Mirror mirror(limits, out.skin);
  Sampling sampling(limits.rest, out.skin.areas, mirror);
  sampling.add(kLimitedPoints);
  std::vector<int> with_tissue;
  for (Index b = 0; b < carried_mass.size(); ++b)
    if (carried_mass(b) > kBoneOfTissue * mass.sum()) with_tissue.push_back(int(b));
  out.edges.resize(std::size_t(carried_mass.size()));
  run_tasks(int(with_tissue.size()), {}, [&](int k, const ProgressFn&) {
    const int b = with_tissue[std::size_t(k)];
    const VectorXd part = carried.col(b).cwiseProduct(mass);
    out.edges[std::size_t(b)] = critical_edges(neutral, limits, out.skin, limits.weights.col(b), part, of_body);
  });
  std::vector<double> strain(out.skin.edges.size(), 0.0);
  std::vector<int> strained_by(strain.size(), 0);
  for (int b : with_tissue) {
    sampling.add(limits.weights.col(b), kPointsOfBone);
    const CriticalEdges& critical = out.edges[std::size_t(b)];
    for (std::size_t k = 0; k < critical.own.size(); ++k)
      if (const auto e = std::size_t(critical.own[k]); critical.strain(Index(k)) > strain[e]) {
        strain[e] = critical.strain(Index(k));
        strained_by[e] = b;
      }
  }
  make_symmetric(mirror, out.edges);
  add_between(limits, strain, strained_by, mirror, out);
  out.chosen = sampling.chosen();
  out.area = mirror.evened(out.chosen, sampling.sums(out.skin.areas));
  if (limits.painted.size() > 0) sampling.add((1 - limits.painted.array()).matrix(), kPaintedPoints);
  out.pulled = sampling.chosen();
  out.pulled_mass =
      mirror.evened(out.pulled, sums_at_nearest(limits.rest(out.pulled, Eigen::all), model.body().rest, mass));
  return out;
}

template struct Neutral<FullModel>;
template struct Neutral<ReducedModel>;
template Tissue tissue_of(const Neutral<FullModel>&, const SkinLimits&);
template Tissue tissue_of(const Neutral<ReducedModel>&, const SkinLimits&);

}  // namespace dynamorph
