// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/self_contact.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "dynamorph/core/errors.hpp"

namespace dynamorph {

using Eigen::Index;
using Box = Eigen::AlignedBox3d;

namespace {

constexpr double kIgnored = 0.4;        // distance at rest, in thicknesses, up to which a ball is not touched,
constexpr double kWhole = 1.0;          // and from which it is touched where it is
constexpr double kSharpness = 2e-3;     // tau, of the body's size
constexpr double kCovered = 0.15;       // of the tissue's thickness: points so near to a ball are on its side
constexpr int kFewest = 8, kMost = 48;  // of those
constexpr double kFadeBegins = 0.36;    // depth in thicknesses of both sides, up to which contacts have all weight,
constexpr double kFadeEnds = 0.46;      // and from which they have none
constexpr double kCrushed = 0.25;       // of the volume of a joint: contacts at it have no weight,
constexpr double kFolded = 0.4;         // and all of it
constexpr double kEach = 3e-3;          // of the size: what a contact moves both sides apart in a step, at most
constexpr int kMostParts = 1 << 20;
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
}

template <class Model>
void SelfContact<Model>::find_parts() {
  int count = 0;
  for (const std::vector<int>* parts : {&body_.of_balls, &body_.of_points})
    for (const int part : *parts) count = std::max(count, part + 1);
  parts_.resize(std::size_t(count));
  for (std::size_t k = 0; k < body_.of_balls.size(); ++k)
    parts_[std::size_t(body_.of_balls[k])].balls.push_back(int(k));
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
      const double gap = std::abs((rest_.row(i) - balls_.skin().rest.row(k)).norm() - body_.radius(k));
      nearest.emplace_back(gap / thickness_(i), int(i));
    }
    const auto end = nearest.begin() + std::min<std::ptrdiff_t>(kMost, std::ptrdiff_t(nearest.size()));
    std::partial_sort(nearest.begin(), end, nearest.end());
    for (auto it = nearest.begin(); it != end; ++it)
      if (it - nearest.begin() < kFewest || it->first < kCovered) covers_[std::size_t(k)].push_back(it->second);
  }
}

template <class Model>
double SelfContact<Model>::fade(int point, int ball) const {
  const double gap = (rest_.row(point) - balls_.skin().rest.row(ball)).norm() - body_.radius(ball);
  return smooth_step((gap / std::min(thickness_(point), body_.radius(ball)) - kIgnored) / (kWhole - kIgnored));
}

// --- In a step -------------------------------------------------------------------------------------------------------

template <class Model>
void SelfContact<Model>::find(const PosedSkin& skin, Scratch& scratch, std::vector<Contact>& contacts) const {
  const Body body{*this, skin, scratch, 0};
  std::vector<Found> found;
  begin(body);
  search(body, body, found);
  for (Found& each : found)
    if (each.parts.first > each.parts.second) std::swap(each.parts.first, each.parts.second);
  contacts.clear();
  weigh(body, body, found, contacts);
  sort(contacts);
}

template <class Model>
void SelfContact<Model>::find_between(const std::vector<Body>& bodies, std::vector<Contact>& contacts) {
  contacts.clear();
  for (const Body& body : bodies) begin(body);
  std::vector<Found> found, back;
  for (std::size_t a = 0; a < bodies.size(); ++a)
    for (std::size_t b = a + 1; b < bodies.size(); ++b) {
      found.clear();
      back.clear();
      search(bodies[a], bodies[b], found);
      search(bodies[b], bodies[a], back);
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
  scratch.boxes.assign(parts, Box());
  scratch.centers.resize(of.balls_.size(), 3);
  scratch.turns.resize(parts);
  scratch.scales.resize(parts);
  for (std::size_t p = 0; p < parts; ++p) {
    scratch.turns[p] = transform(skin.now, of.parts_[p].bone).template leftCols<3>();
    scratch.scales[p] = std::cbrt(std::abs(scratch.turns[p].determinant()));
    for (const int ball : of.parts_[p].balls) {
      const Vector3d shape = of.ball_shapes_.middleRows<3>(3 * ball) * skin.weights;
      const Vector3d center = of.balls_.posed(of.balls_.skin().transform(skin.now, ball), ball, shape);
      const Vector3d reach = Vector3d::Constant(scratch.scales[p] * of.body_.radius(ball) + skin.margin);
      scratch.centers.row(ball) = center;
      scratch.boxes[p].extend(center - reach).extend(center + reach);
    }
  }
}

template <class Model>
void SelfContact<Model>::search(const Body& body, const Body& other, std::vector<Found>& found) {
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
      if (!(of.samples_->stiffness()(of.body_.points[std::size_t(point)]) > 0)) continue;
      const Vector3d x = place(body, point);
      around.clear();
      for (const int part : near)
        if (boxes[std::size_t(part)].contains(x)) around.push_back(part);
      const Nearest nearest_ball = nearest(body, point, other, around);
      if (nearest_ball.ball >= 0) touch(body, point, other, nearest_ball, found);
    }
  }
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

template <class Model>
typename SelfContact<Model>::Nearest SelfContact<Model>::nearest(const Body& body, int point, const Body& other,
                                                                 const std::vector<int>& parts) {
  const SelfContact& of = other.of;
  const bool itself = &other == &body;
  const double margin = other.skin.margin;
  const Vector3d x = place(body, point);
  auto& near = body.scratch.near;
  near.clear();
  for (const int part : parts)
    for (const int ball : of.parts_[std::size_t(part)].balls) {
      const double radius = other.scratch.scales[std::size_t(part)] * of.body_.radius(ball), reach = radius + margin;
      const double square = (x.transpose() - other.scratch.centers.row(ball)).squaredNorm();
      if (square > reach * reach) continue;
      const double touched = itself ? of.fade(point, ball) : 1, distance = std::sqrt(square) - touched * radius;
      if (touched > 0 && distance < margin) near.emplace_back(distance, ball);
    }
  Nearest out{0, Vector3d::Zero(), -1};
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
  return out;
}

template <class Model>
void SelfContact<Model>::touch(const Body& body, int point, const Body& other, const Nearest& nearest,
                               std::vector<Found>& found) {
  const Vector3d& normal = nearest.normal;
  const int sample = body.first_sample + body.of.body_.points[std::size_t(point)];
  Contact contact{sample, kSkin, {}, normal, {}, {}, 1, 0};
  contact.others = other_side(body, point, other, nearest);
  // Of all samples of both sides: their places, the first with the tissue where it was, and where it is predicted.
  Vector3d unmoved = Vector3d::Zero(), kept = unmoved, predicted = unmoved, before = unmoved;
  Matrix3d turned_before = Matrix3d::Zero(), turned = turned_before;
  const int own = body.of.body_.of_points[std::size_t(point)];
  const int others = other.of.body_.of_balls[std::size_t(nearest.ball)];
  double room = 0;
  contact.each_sample([&](int numbered, double share) {
    const bool first = numbered == sample;
    const Body& side = first ? body : other;
    const ContactSamples<Model>& samples = *side.of.samples_;
    const SkinMap<Model>& map = samples.map();
    const PosedSkin& skin = side.skin;
    const int at = numbered - side.first_sample, part = first ? own : others;
    if (samples.stiffness()(at) > 0)
      room += std::abs(share) * side.scratch.scales[std::size_t(part)] * samples.thickness()(at);
    samples.points().each_corner(at, [&](int v, double weight) {
      const PointTransform now = map.skin().transform(skin.now, v), then = map.skin().transform(skin.before, v);
      const Vector3d was = map.displacement(skin.weights, skin.was, v);
      unmoved += share * weight * map.posed(now, v, samples.shape(skin.weights, v));
      kept += share * weight * map.posed(now, v, was);
      predicted += share * weight * map.posed(now, v, map.displacement(skin.weights, skin.predicted, v));
      before += share * weight * map.posed(then, v, was);
      if (!first) return;
      turned_before += weight * then.leftCols<3>();
      turned += weight * now.leftCols<3>();
    });
  });
  const double at_first = nearest.gap + normal.dot(kept - unmoved);
  const double at_last = nearest.gap + normal.dot(predicted - unmoved);
  if (std::min(at_first, at_last) > body.skin.near) return;
  // What is deep already comes out slowly.
  const double push = -std::max(at_first, at_last), most = kEach * body.of.samples_->model().body().size;
  contact.point = unmoved - (nearest.gap + std::max(0.0, push - most)) * normal;
  contact.before = before;
  const Vector3d carried = turned * turned_before.inverse() * before;  // as the bones turn it
  contact.motion = carried.allFinite() ? Vector3d(carried - before) : Vector3d(Vector3d::Zero());
  found.push_back({contact, {own, others}, -nearest.gap, room});
}

/// Those of the ball's points that are nearest to the place that is touched. Their weights fade out where another one
/// comes nearer.
template <class Model>
OtherSide SelfContact<Model>::other_side(const Body& body, int point, const Body& other, const Nearest& nearest) {
  const Vector3d touched = place(body, point) - nearest.gap * nearest.normal;
  auto& others = body.scratch.others;
  others.clear();
  for (const int each : other.of.covers_[std::size_t(nearest.ball)])
    if (each != point || &other != &body) others.emplace_back((place(other, each) - touched).norm(), each);
  OtherSide out;
  if (others.size() < 2) return out;
  const std::size_t count = std::min(out.samples.size(), others.size() - 1);
  std::partial_sort(others.begin(), others.begin() + std::ptrdiff_t(count) + 1, others.end());
  double sum = 0;
  for (std::size_t k = 0; k < count; ++k) {
    out.weights[k] = std::pow(1 - others[k].first / std::max(others[count].first, 1e-300), 2);
    sum += out.weights[k];
  }
  for (std::size_t k = 0; k < count; ++k) {
    out.samples[k] = other.first_sample + other.of.body_.points[std::size_t(others[k].second)];
    out.weights[k] = sum > 0 ? out.weights[k] / sum : 1.0 / double(count);
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
  return smooth_step((left - kCrushed) / (kFolded - kCrushed));
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
    contacts.back().weight = folded * (1 - smooth_step((deepest - kFadeBegins) / (kFadeEnds - kFadeBegins)));
    contacts.back().too_deep = each.depth - folded * kFadeBegins * each.room;
  }
}

template class SelfContact<FullModel>;
template class SelfContact<ReducedModel>;

}  // namespace dynamorph
