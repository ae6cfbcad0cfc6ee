// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/self_contact.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <queue>

#include "dynamorph/contact/choices.hpp"
#include "dynamorph/core/errors.hpp"

namespace dynamorph {

using Eigen::Index;
using Box = Eigen::AlignedBox3d;

namespace {

constexpr int kCluster = 8;  // balls
constexpr int kMostParts = 1 << 20;
constexpr int kBeside = 9;      // samples around one, with itself
constexpr double kSame = 1e-6;  // relative difference of distances that are the same
constexpr double kAgree = 0.1;  // length of the mean of the balls' directions, below which there is none

void check(const BodyParts& body, Index samples) {
  const std::vector<int>& points = body.points;
  check_size("radius", body.radius.size(), body.centers.rest.rows());
  check_size("of_balls", Index(body.of_balls.size()), body.centers.rest.rows());
  check_size("of_points", Index(body.of_points.size()), Index(points.size()));
  if (!body.radius.allFinite() || !(body.radius.array() > 0).all())
    throw std::invalid_argument("radius: must be finite and above zero");
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i] < 0 || points[i] >= samples || (i > 0 && points[i] <= points[i - 1]))
      throw std::invalid_argument("points: must be numbers of samples, ascending");
  for (const std::vector<int>* parts : {&body.of_balls, &body.of_points})
    if (std::any_of(parts->begin(), parts->end(), [](int part) { return part < 0 || part > kMostParts; }))
      throw std::invalid_argument("of_balls, of_points: must be numbers of parts, from 0 on");
}

/// Of samples with distances, those that are nearest. Their weights fade out where another one comes nearer.
OtherSide nearest_of(std::vector<std::pair<double, int>>& all) {
  OtherSide out;
  if (all.size() < 2) return out;
  const std::size_t count = std::min(out.samples.size(), all.size() - 1);
  std::partial_sort(all.begin(), all.begin() + std::ptrdiff_t(count) + 1, all.end());
  double sum = 0;
  for (std::size_t k = 0; k < count; ++k) {
    out.samples[k] = all[k].second;
    out.weights[k] = std::pow(1 - all[k].first / std::max(all[count].first, 1e-300), 2);
    sum += out.weights[k];
  }
  for (std::size_t k = 0; k < count; ++k) out.weights[k] = sum > 0 ? out.weights[k] / sum : 1.0 / double(count);
  return out;
}

/// Skin between samples that surround a place of it.
struct CurvedSkin {
  Vector3d mean;    ///< of their places
  Vector3d normal;  ///< unit; zero where they face everywhere
  double bends;     ///< how far above their mean it is, because it bends, meters
  double gap(const Vector3d& x) const { return normal.dot(x - mean) - bends; }
};

/// Each sample's tangent plane is as far above bent skin as the mean is below it. at(sample, x, normal) sets both; x is
/// zero before.
template <class At>
CurvedSkin curved_skin(const OtherSide& others, const At& at) {
  std::array<Vector3d, 4> places, normals;
  CurvedSkin out{Vector3d::Zero(), Vector3d::Zero(), 0};
  for (std::size_t k = 0; k < places.size(); ++k) {
    places[k].setZero();
    normals[k].setZero();
    if (others.weights[k] > 0) at(others.samples[k], places[k], normals[k]);
    out.mean += others.weights[k] * places[k];
    out.normal += others.weights[k] * normals[k];
  }
  out.normal = out.normal.norm() > kAgree ? out.normal.normalized().eval() : Vector3d::Zero().eval();
  for (std::size_t k = 0; k < places.size(); ++k)
    out.bends += 0.5 * others.weights[k] * normals[k].dot(places[k] - out.mean);
  return out;
}

/// Adds clusters of at most kCluster of these numbers of points, which are halved along their longest side.
void cluster(const Points& points, std::vector<int>::iterator begin, std::vector<int>::iterator end,
             std::vector<std::vector<int>>& out) {
  if (end - begin <= kCluster) {
    if (begin != end) out.emplace_back(begin, end);
    return;
  }
  Box box;
  for (auto it = begin; it != end; ++it) box.extend(Vector3d(points.row(*it)));
  Index side;
  box.sizes().maxCoeff(&side);
  const auto middle = begin + (end - begin) / 2;
  std::nth_element(begin, middle, end, [&](int a, int b) { return points(a, side) < points(b, side); });
  cluster(points, begin, middle, out);
  cluster(points, middle, end, out);
}

/// f of a ball.
double touched_of(const NearBalls& near, int ball) {
  const auto it = std::lower_bound(near.begin(), near.end(), ball,
                                   [](const std::pair<int, double>& each, int wanted) { return each.first < wanted; });
  return it != near.end() && it->first == ball ? it->second : 1;
}

void sort(std::vector<Contact>& contacts) {
  std::stable_sort(contacts.begin(), contacts.end(),
                   [](const Contact& a, const Contact& b) { return a.sample < b.sample; });
}

}  // namespace

// --- What stays the same ---------------------------------------------------------------------------------------------

template <class Model>
SelfContact<Model>::SelfContact(std::shared_ptr<const ContactSamples<Model>> samples, BodyParts body)
    : samples_((check(body, samples->size()), std::move(samples))),
      balls_(samples_->shared_model(), std::move(body.centers)),
      body_(std::move(body)),
      sharpness_(kSharpness * samples_->model().body().size) {
  const Index P = Index(body_.points.size()), J = Index(samples_->model().targets().size());
  ball_shapes_.resize(3 * balls_.size(), J);
  for (Index j = 0; j < J; ++j) {
    VectorXd shape;
    balls_.displacement(VectorXd::Unit(J, j), samples_->model().target(int(j)), shape);
    ball_shapes_.col(j) = shape;
  }
  rest_.resize(P, 3);
  thickness_.resize(P);
  for (Index i = 0; i < P; ++i) {
    rest_.row(i) = samples_->rest().row(body_.points[std::size_t(i)]);
    thickness_(i) = samples_->thickness()(body_.points[std::size_t(i)]);
  }
  for (const auto& [first, second] : body_.joints) joints_.insert(std::minmax(first, second));
  find_parts();
  find_covers();
  find_ways();
  find_beyond();
  for (Index i = 0; i < P; ++i) near_.push_back(near_at_rest(rest_.row(i), normal(i), thickness_(i)));
}

template <class Model>
void SelfContact<Model>::find_parts() {
  int count = 0;
  for (const std::vector<int>* parts : {&body_.of_balls, &body_.of_points})
    for (const int part : *parts) count = std::max(count, part + 1);
  parts_.resize(std::size_t(count));
  std::vector<std::vector<int>> balls(parts_.size());
  for (std::size_t k = 0; k < body_.of_balls.size(); ++k) balls[std::size_t(body_.of_balls[k])].push_back(int(k));
  std::size_t clusters = 0;
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    cluster(balls_.skin().rest, balls[p].begin(), balls[p].end(), parts_[p].clusters);
    parts_[p].first_cluster = clusters;
    clusters += parts_[p].clusters.size();
  }
  for (std::size_t i = 0; i < body_.of_points.size(); ++i)
    parts_[std::size_t(body_.of_points[i])].points.samples.push_back(int(i));

  const Skin& skin = samples_->map().skin();
  for (Part& part : parts_) {
    std::map<Index, Box> boxes;
    std::map<Index, double> weights;
    double most = 0;
    for (const int i : part.points.samples)
      samples_->points().each_corner(body_.points[std::size_t(i)], [&](int v, double weight) {
        for (SkinWeights::InnerIterator it(skin.weights, v); it; ++it) {
          boxes[it.col()].extend(Vector3d(skin.rest.row(v)));
          weights[it.col()] += weight * it.value();
        }
      });
    part.points.boxes.assign(boxes.begin(), boxes.end());
    for (const auto& [bone, sum] : weights)
      if (sum > most) part.bone = bone, most = sum;
  }
}

template <class Model>
void SelfContact<Model>::find_covers() {
  covers_.resize(std::size_t(balls_.size()));
  std::vector<std::pair<double, int>> nearest;
  for (Index k = 0; k < balls_.size(); ++k) {
    nearest.clear();
    for (Index i = 0; i < rest_.rows(); ++i) {
      const Vector3d out = rest_.row(i) - balls_.skin().rest.row(k);
      if (!(normal(i).dot(out) > 0)) continue;
      nearest.emplace_back(std::abs(out.norm() - body_.radius(k)) / thickness_(i), int(i));
    }
    // Several may be as near as the last one: round-off must not choose among them.
    double as_near = kCovered;
    if (!nearest.empty()) {
      const auto last = nearest.begin() + std::min<std::ptrdiff_t>(kCovering, std::ptrdiff_t(nearest.size())) - 1;
      std::nth_element(nearest.begin(), last, nearest.end());
      as_near = std::max(as_near, last->first * (1 + kSame));
    }
    for (const auto& [away, point] : nearest)
      if (away <= as_near) covers_[std::size_t(k)].push_back(point);
  }
}

template <class Model>
Vector3d SelfContact<Model>::normal(Index point) const {
  return samples_->normal(PointTransform::Identity(), body_.points[std::size_t(point)]);
}

template <class Model>
void SelfContact<Model>::find_ways() {
  const Points& centers = balls_.skin().rest;
  beside_.resize(std::size_t(balls_.size()));
  for (int a = 0; a < int(balls_.size()); ++a)
    for (int b = 0; b < a; ++b) {
      if (!((centers.row(a) - centers.row(b)).norm() < std::max(body_.radius(a), body_.radius(b)))) continue;
      beside_[std::size_t(a)].push_back(b);
      beside_[std::size_t(b)].push_back(a);
    }
}

template <class Model>
void SelfContact<Model>::find_beyond() {
  const Points& centers = balls_.skin().rest;
  beyond_.setZero(rest_.rows());
  for (Index i = 0; i < rest_.rows(); ++i) {
    double sum = 0;
    for (Index k = 0; k < balls_.size(); ++k) {
      const Vector3d out = rest_.row(i) - centers.row(k);
      if (normal(i).dot(out) > 0) sum += std::exp((body_.radius(k) - out.norm()) / sharpness_);
    }
    if (sum > 0) beyond_(i) = std::min(-sharpness_ * std::log(sum), kCovered * thickness_(i));
  }
  covered_ = body_.radius;
  for (Index k = 0; k < balls_.size(); ++k)
    for (const int i : covers_[std::size_t(k)]) covered_(k) = std::max(covered_(k), body_.radius(k) + beyond_(i));
}

template <class Model>
NearBalls SelfContact<Model>::near_at_rest(const Vector3d& place, const Vector3d& normal, double thickness) const {
  const Points& centers = balls_.skin().rest;
  // In thicknesses of tissue: what is one away through the body is touched where it is.
  const auto away = [&](int ball) {
    const double radius = body_.radius(ball);
    return ((centers.row(ball) - place.transpose()).norm() - radius) / std::min(thickness, radius);
  };
  using Way = std::pair<double, int>;  // the farthest that it leads from the place, and to which ball
  std::priority_queue<Way, std::vector<Way>, std::greater<>> next;
  Way begins(kInfinity, -1);
  for (int k = 0; k < int(balls_.size()); ++k)
    if (normal.dot(place - centers.row(k).transpose()) > 0) begins = std::min(begins, Way(away(k), k));
  if (begins.second >= 0) next.push(begins);
  std::map<int, double> farthest;
  while (!next.empty() && next.top().first < 1) {
    const auto [far, ball] = next.top();
    next.pop();
    if (!farthest.emplace(ball, far).second) continue;
    for (const int other : beside_[std::size_t(ball)])
      if (!farthest.count(other)) next.emplace(std::max(far, away(other)), other);
  }

  NearBalls out;
  double sum = 0;
  for (int k = 0; k < int(balls_.size()); ++k) {
    const auto it = farthest.find(k);
    const double touched = it == farthest.end() ? 1 : smooth_step(it->second);
    if (touched < 1 || away(k) < 1) out.emplace_back(k, touched);
    if (touched > 0)
      sum += std::exp((touched * covered_(k) - (centers.row(k) - place.transpose()).norm()) / sharpness_);
  }
  const double nearer = sharpness_ * (1 + std::log(std::max(sum, 1e-300)));
  if (nearer > 0)
    for (auto& [ball, touched] : out) touched = std::max(0.0, touched - nearer / body_.radius(ball));
  return out;
}

template <class Model>
Worn SelfContact<Model>::wear(int clothes, int body, const SelfContact& other, const PointTransform& to_body) const {
  const Points &skin = other.samples_->rest(), &centers = other.balls_.skin().rest;
  Worn out{clothes, body, {}, {}, {}, {}, VectorXd::Zero(rest_.rows())};
  std::vector<std::pair<double, int>> all;
  for (Index i = 0; i < skin.rows(); ++i) {
    all.clear();
    for (Index s = 0; s < skin.rows(); ++s) all.emplace_back((skin.row(s) - skin.row(i)).squaredNorm(), int(s));
    std::partial_sort(all.begin(), all.begin() + std::min<std::ptrdiff_t>(kBeside, skin.rows()), all.end());
    out.beside.emplace_back();
    for (Index k = 0; k < std::min<Index>(kBeside, skin.rows()); ++k)
      out.beside.back().push_back(all[std::size_t(k)].second);
  }
  for (Index i = 0; i < rest_.rows(); ++i) {
    const Eigen::RowVector3d place = (to_body * rest_.row(i).transpose().homogeneous()).transpose();
    all.clear();
    for (Index s = 0; s < skin.rows(); ++s) all.emplace_back((skin.row(s) - place).norm(), int(s));
    out.below.push_back(nearest_of(all));
    const CurvedSkin below = curved_skin(out.below.back(), [&](int sample, Vector3d& x, Vector3d& normal) {
      x = skin.row(sample);
      normal = other.samples_->normal(PointTransform::Identity(), sample);
    });
    out.deep(i) = std::min(0.0, below.gap(place.transpose()));
    out.near.push_back(other.near_at_rest(place.transpose(), below.normal, kInfinity));
    Index ball;
    ((centers.rowwise() - place).rowwise().norm() - other.body_.radius).minCoeff(&ball);
    out.parts.push_back(other.body_.of_balls[std::size_t(ball)]);
  }
  return out;
}

// --- In a step -------------------------------------------------------------------------------------------------------

template <class Model>
void SelfContact<Model>::find(const PosedSkin& skin, Scratch& scratch, std::vector<Contact>& contacts) const {
  const Body body{*this, skin, scratch, 0, false};
  std::vector<Found> found;
  begin(body);
  search(body, body, nullptr, found);
  for (Found& each : found)
    if (each.parts.first > each.parts.second) std::swap(each.parts.first, each.parts.second);
  contacts.clear();
  weigh(body, body, found, contacts);
  sort(contacts);
}

template <class Model>
void SelfContact<Model>::find_between(const std::vector<Body>& bodies, const std::vector<Worn>& worn,
                                      std::vector<Contact>& contacts) {
  contacts.clear();
  for (const Body& body : bodies) begin(body);
  std::vector<Found> found, back;
  const auto lies_on = [&](std::size_t clothes, std::size_t body) {
    const auto it = std::find_if(worn.begin(), worn.end(), [&](const Worn& each) {
      return each.clothes == int(clothes) && each.body == int(body);
    });
    return it == worn.end() ? nullptr : &*it;
  };
  for (std::size_t a = 0; a < bodies.size(); ++a)
    for (std::size_t b = a + 1; b < bodies.size(); ++b) {
      if (bodies[a].jumps || bodies[b].jumps) continue;
      found.clear();
      back.clear();
      const Worn *on = lies_on(a, b), *under = lies_on(b, a);
      if (!under) search(bodies[a], bodies[b], on, found);
      if (!on) search(bodies[b], bodies[a], under, back);
      if (on) lie(bodies[a], bodies[b], *on, found);
      if (under) lie(bodies[b], bodies[a], *under, back);
      for (std::vector<Found>* each : {&found, &back})
        for (Found& one : *each) one.contact.alone = on || under;
      for (Found& each : back) {
        std::swap(each.parts.first, each.parts.second);
        found.push_back(each);
      }
      weigh(bodies[a], bodies[b], found, contacts);
    }
  sort(contacts);
}

template <class Model>
void SelfContact<Model>::begin(const Body& body) {
  const SelfContact& of = body.of;
  const PosedSkin& skin = body.skin;
  Scratch& scratch = body.scratch;
  const std::size_t parts = of.parts_.size();
  scratch.places.clear();
  scratch.place_of.assign(of.body_.points.size(), -1);
  scratch.vertices.clear();
  scratch.vertex_of.assign(std::size_t(of.samples_->map().size()), -1);
  scratch.boxes.assign(parts, Box());
  scratch.clusters.clear();
  scratch.centers.resize(of.balls_.size(), 3);
  scratch.turns.resize(parts);
  scratch.scales.resize(parts);
  for (std::size_t p = 0; p < parts; ++p) {
    scratch.turns[p] = transform(skin.now, of.parts_[p].bone).template leftCols<3>();
    scratch.scales[p] = std::cbrt(std::abs(scratch.turns[p].determinant()));
    for (const std::vector<int>& cluster : of.parts_[p].clusters) {
      scratch.clusters.emplace_back();
      for (const int ball : cluster) {
        const Vector3d shape = of.ball_shapes_.template middleRows<3>(3 * ball) * skin.weights;
        const Vector3d center = of.balls_.posed(of.balls_.skin().transform(skin.now, ball), ball, shape);
        const Vector3d reach = Vector3d::Constant(scratch.scales[p] * of.body_.radius(ball) + skin.margin);
        scratch.centers.row(ball) = center;
        scratch.clusters.back().extend(center - reach).extend(center + reach);
      }
      scratch.boxes[p].extend(scratch.clusters.back());
    }
  }
}

template <class Model>
void SelfContact<Model>::search(const Body& body, const Body& other, const Worn* worn, std::vector<Found>& found) {
  const SelfContact& of = body.of;
  const std::vector<Box>& boxes = other.scratch.boxes;
  const double farthest = of.samples_->farthest(body.skin.weights, body.skin.shape);
  std::vector<int> near, around;
  for (std::size_t own = 0; own < of.parts_.size(); ++own) {
    const auto& points = of.parts_[own].points;
    const Box region = ContactSamples<Model>::region(points, body.skin.now, farthest);
    near.clear();
    for (std::size_t part = 0; part < boxes.size(); ++part)
      if ((part != own || &other != &body) && region.intersects(boxes[part])) near.push_back(int(part));
    if (near.empty()) continue;
    for (const int point : points.samples) {
      if (!worn && !(of.samples_->stiffness()(of.body_.points[std::size_t(point)]) > 0)) continue;
      const Vector3d x = place(body, point);
      around.clear();
      for (const int part : near)
        if (boxes[std::size_t(part)].contains(x)) around.push_back(part);
      Nearest skin = nearest(body, point, other, worn, around);
      if (skin.ball < 0) continue;
      const int part = other.of.body_.of_balls[std::size_t(skin.ball)];
      const OtherSide others = other_side(body, point, other, skin);
      touch(body, point, other, skin, others, {int(own), part}, found);
    }
  }
}

template <class Model>
const typename SelfContact<Model>::PosedVertex& SelfContact<Model>::vertex(const Body& body, int vertex) {
  const ContactSamples<Model>& samples = *body.of.samples_;
  const SkinMap<Model>& map = samples.map();
  const PosedSkin& skin = body.skin;
  std::vector<PosedVertex>& vertices = body.scratch.vertices;
  int& at = body.scratch.vertex_of[std::size_t(vertex)];
  if (at < 0) {
    at = int(vertices.size());
    const PointTransform now = map.skin().transform(skin.now, vertex), then = map.skin().transform(skin.before, vertex);
    const Vector3d was = map.displacement(skin.weights, skin.was, vertex);
    vertices.push_back({map.posed(now, vertex, samples.shape(skin.weights, vertex)), map.posed(now, vertex, was),
                        map.posed(now, vertex, map.displacement(skin.weights, skin.predicted, vertex)),
                        map.posed(then, vertex, was), then.leftCols<3>(), now.leftCols<3>()});
  }
  return vertices[std::size_t(at)];
}

template <class Model>
Vector3d SelfContact<Model>::place(const Body& body, int point) {
  const ContactSamples<Model>& samples = *body.of.samples_;
  const PosedSkin& skin = body.skin;
  std::vector<Vector3d>& places = body.scratch.places;
  int& at = body.scratch.place_of[std::size_t(point)];
  if (at < 0) {
    at = int(places.size());
    const SkinMap<Model>& map = samples.map();
    Vector3d x = Vector3d::Zero();
    samples.points().each_corner(body.of.body_.points[std::size_t(point)], [&](int v, double weight) {
      x += weight * map.posed(map.skin().transform(skin.now, v), v, samples.shape(skin.weights, v));
    });
    places.push_back(x);
  }
  return places[std::size_t(at)];
}

/// Where the tissue of a sample was, with the bones at the end of the step, world space.
template <class Model>
Vector3d SelfContact<Model>::kept(const Body& body, int sample) {
  Vector3d x = Vector3d::Zero();
  body.of.samples_->points().each_corner(sample, [&](int v, double weight) { x += weight * vertex(body, v).kept; });
  return x;
}

template <class Model>
OtherSide SelfContact<Model>::followed(const Body& clothes, int point, const Body& body, const Worn& worn) {
  const OtherSide& below = worn.below[std::size_t(point)];
  if (!(below.weights[0] > 0)) return below;  // the body has a single sample, or none
  const Vector3d x = kept(clothes, clothes.of.body_.points[std::size_t(point)]);
  auto& around = clothes.scratch.others;
  std::pair<double, int> nearest{kInfinity, below.samples[0]};
  for (bool comes_nearer = true; comes_nearer;) {
    around.clear();
    for (const int sample : worn.beside[std::size_t(nearest.second)])
      around.emplace_back((kept(body, sample) - x).norm(), sample);
    const auto next = *std::min_element(around.begin(), around.end());
    comes_nearer = next.first < nearest.first;
    if (comes_nearer) nearest = next;
  }
  return nearest_of(around);
}

template <class Model>
typename SelfContact<Model>::Nearest SelfContact<Model>::above(const Body& clothes, int point, const Body& body,
                                                               const OtherSide& others, double deep) {
  const ContactSamples<Model>& samples = *body.of.samples_;
  const CurvedSkin skin = curved_skin(others, [&](int sample, Vector3d& x, Vector3d& normal) {
    PointTransform carried = PointTransform::Zero();
    samples.points().each_corner(sample, [&](int v, double weight) {
      const PosedVertex& known = vertex(body, v);
      carried.template leftCols<3>() += weight * known.turned;
      x += weight * known.unmoved;
    });
    normal = samples.normal(carried, sample);
  });
  return {skin.gap(place(clothes, point)) - deep, skin.normal, skin.normal.isZero() ? -1 : 0, 1};
}

template <class Model>
void SelfContact<Model>::lie(const Body& clothes, const Body& body, const Worn& worn, std::vector<Found>& found) {
  for (int point = 0; point < int(worn.below.size()); ++point) {
    const double deep = worn.deep(point);
    OtherSide below = followed(clothes, point, body, worn);
    const Nearest posed = above(clothes, point, body, worn.below[std::size_t(point)], deep);
    const Nearest skin = above(clothes, point, body, below, deep);
    if (posed.ball < 0 || skin.ball < 0) continue;
    for (int& sample : below.samples) sample += body.first_sample;
    const std::size_t before = found.size();
    touch(clothes, point, body, skin, below,
          {clothes.of.body_.of_points[std::size_t(point)], worn.parts[std::size_t(point)]}, found);
    // What the bones leave no room for is known from where they alone put both.
    if (found.size() > before) found.back().depth = -posed.gap;
  }
}

template <class Model>
typename SelfContact<Model>::Nearest SelfContact<Model>::nearest(const Body& body, int point, const Body& other,
                                                                 const Worn* worn, const std::vector<int>& parts) {
  const SelfContact& of = other.of;
  const NearBalls* at_rest = worn              ? &worn->near[std::size_t(point)]
                             : &other == &body ? &of.near_[std::size_t(point)]
                                               : nullptr;
  const double margin = other.skin.margin;
  const Vector3d x = place(body, point);
  auto& near = body.scratch.near;
  near.clear();
  for (const int part : parts) {
    const auto& clusters = of.parts_[std::size_t(part)].clusters;
    const double scale = other.scratch.scales[std::size_t(part)];
    for (std::size_t c = 0; c < clusters.size(); ++c) {
      if (!other.scratch.clusters[of.parts_[std::size_t(part)].first_cluster + c].contains(x)) continue;
      for (const int ball : clusters[c]) {
        const double radius = scale * of.body_.radius(ball), reach = radius + margin;
        const double square = (x.transpose() - other.scratch.centers.row(ball)).squaredNorm();
        if (square > reach * reach) continue;
        const double touched = at_rest ? touched_of(*at_rest, ball) : 1;
        const double distance = std::sqrt(square) - touched * radius;
        if (touched > 0 && distance < margin) near.emplace_back(distance, ball);
      }
    }
  }
  Nearest out{0, Vector3d::Zero(), -1, 1};
  if (near.empty()) return out;
  const auto [least, ball] = *std::min_element(near.begin(), near.end());
  double sum = 0;
  for (const auto& [distance, each] : near) {
    const double weight = std::exp((least - distance) / of.sharpness_);
    sum += weight;
    out.normal += weight * (x - other.scratch.centers.row(each).transpose()).normalized();
  }
  if (!(out.normal.norm() > kAgree * sum)) return out;  // in the middle of all of them
  out.gap = least - of.sharpness_ * std::log(sum);
  out.normal.normalize();
  out.ball = ball;
  if (at_rest) out.touched = touched_of(*at_rest, ball);
  return out;
}

template <class Model>
void SelfContact<Model>::touch(const Body& body, int point, const Body& other, const Nearest& nearest,
                               const OtherSide& others, const std::pair<int, int>& parts, std::vector<Found>& found) {
  const Vector3d& normal = nearest.normal;
  const int sample = body.first_sample + body.of.body_.points[std::size_t(point)];
  Contact contact{sample, kSkin, {}, normal, {}, {}, 1, 0, 0, others};
  // Of all samples of both sides: their places, the first with the tissue where it was, and where it is predicted.
  Vector3d unmoved = Vector3d::Zero(), kept = unmoved, predicted = unmoved, before = unmoved;
  Matrix3d turned_before = Matrix3d::Zero(), turned = turned_before;
  double room = 0;
  contact.each_sample([&](int numbered, double share) {
    const bool first = numbered == sample;
    const Body& side = first ? body : other;
    const ContactSamples<Model>& samples = *side.of.samples_;
    const int at = numbered - side.first_sample, part = first ? parts.first : parts.second;
    if (samples.stiffness()(at) > 0)
      room += std::abs(share) * side.scratch.scales[std::size_t(part)] * samples.thickness()(at);
    samples.points().each_corner(at, [&](int v, double weight) {
      const PosedVertex& known = vertex(side, v);
      unmoved += share * weight * known.unmoved;
      kept += share * weight * known.kept;
      predicted += share * weight * known.predicted;
      before += share * weight * known.before;
      if (!first) return;
      turned_before += weight * known.turned_before;
      turned += weight * known.turned;
    });
  });
  if (!(room > 0)) return;  // neither side gives way
  // What a bad frame of its rig has thrown farther than the body is large presses nothing.
  if (std::max((kept - unmoved).norm(), (predicted - unmoved).norm()) > body.of.samples_->model().body().size) return;
  const double at_first = nearest.gap + normal.dot(kept - unmoved);
  const double at_last = nearest.gap + normal.dot(predicted - unmoved);
  contact.gap = std::min(at_first, at_last);
  if (contact.gap > body.skin.near) return;
  // What is deep already comes out slowly.
  const double push = -std::max(at_first, at_last), most = kOwnApart * body.of.samples_->model().body().size;
  contact.point = unmoved - (nearest.gap + std::max(0.0, push - most)) * normal;
  contact.before = before;
  const Vector3d carried = turned * turned_before.inverse() * before;  // as the bones turn it
  contact.motion = carried.allFinite() ? Vector3d(carried - before) : Vector3d(Vector3d::Zero());
  found.push_back({contact, parts, -nearest.gap, room});
}

/// Those of the ball's points that are nearest to the place that is touched. The gap is less by as much as the skin
/// there is beyond the balls.
template <class Model>
OtherSide SelfContact<Model>::other_side(const Body& body, int point, const Body& other, Nearest& nearest) {
  const SelfContact& of = other.of;
  const Vector3d touched = place(body, point) - nearest.gap * nearest.normal;
  auto& others = body.scratch.others;
  others.clear();
  for (const int each : of.covers_[std::size_t(nearest.ball)])
    if (each != point || &other != &body) others.emplace_back((place(other, each) - touched).norm(), each);
  OtherSide out = nearest_of(others);
  const int part = of.body_.of_balls[std::size_t(nearest.ball)];
  const double counts = nearest.touched * other.scratch.scales[std::size_t(part)];
  for (std::size_t k = 0; k < out.samples.size(); ++k) {
    if (!(out.weights[k] > 0)) continue;
    nearest.gap -= counts * out.weights[k] * of.beyond_(out.samples[k]);
    out.samples[k] = other.first_sample + of.body_.points[std::size_t(out.samples[k])];
  }
  return out;
}

template <class Model>
double SelfContact<Model>::folded(const Body& body, const Body& other, const std::pair<int, int>& parts) {
  if (&other != &body || !body.of.joints_.count(parts)) return 1;
  const auto [a, b] = parts;
  const Scratch& scratch = body.scratch;
  const Matrix3d mean = 0.5 * (scratch.turns[std::size_t(a)] + scratch.turns[std::size_t(b)]);
  const double whole = std::pow(scratch.scales[std::size_t(a)] * scratch.scales[std::size_t(b)], 1.5);
  const double left = std::abs(mean.determinant()) / std::max(whole, 1e-300);
  return smooth_step(3 * left / kFolded - 2);
}

template <class Model>
void SelfContact<Model>::weigh(const Body& body, const Body& other, const std::vector<Found>& found,
                               std::vector<Contact>& contacts) {
  struct Between {
    double deepest = 0, folded = 1;
  };
  std::map<std::pair<int, int>, Between> all;
  for (const Found& each : found) {
    Between& between = all[each.parts];
    between.deepest = std::max(between.deepest, each.depth / each.room);
  }
  for (auto& [parts, between] : all) between.folded = folded(body, other, parts);
  for (const Found& each : found) {
    const auto& [deepest, folded] = all[each.parts];
    contacts.push_back(each.contact);
    contacts.back().weight = folded * (1 - smooth_step((deepest - kOwnFadeBegins) / (kOwnFadeEnds - kOwnFadeBegins)));
    contacts.back().too_deep = each.depth - folded * kOwnFadeBegins * each.room;
  }
}

template class SelfContact<FullModel>;
template class SelfContact<ReducedModel>;

}  // namespace dynamorph
