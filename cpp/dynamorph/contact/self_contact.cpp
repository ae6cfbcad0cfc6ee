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
  scratch.found.clear();
  scratch.places.clear();
  scratch.place_of.assign(body_.points.size(), -1);
  const std::vector<Box> boxes = pose_balls(skin, scratch);
  const double farthest = samples_->farthest(skin.weights, skin.shape);
  std::vector<int> others, around;
  for (std::size_t own = 0; own < parts_.size(); ++own) {
    const auto& points = parts_[own].points;
    const Box region = ContactSamples<Model>::region(points, skin.now, farthest);
    others.clear();
    for (std::size_t part = 0; part < parts_.size(); ++part)
      if (part != own && region.intersects(boxes[part])) others.push_back(int(part));
    if (others.empty()) continue;
    for (const int point : points.samples) {
      if (!(samples_->stiffness()(body_.points[std::size_t(point)]) > 0)) continue;
      const Vector3d x = place(point, skin, scratch);
      around.clear();
      for (const int part : others)
        if (boxes[std::size_t(part)].contains(x)) around.push_back(part);
      const Nearest found = nearest(x, point, around, skin.margin, scratch);
      if (found.ball >= 0) touch(point, found, skin, scratch);
    }
  }
  weigh(scratch);
  contacts.clear();
  for (const auto& found : scratch.found) contacts.push_back(found.contact);
  std::sort(contacts.begin(), contacts.end(), [](const Contact& a, const Contact& b) { return a.sample < b.sample; });
}

template <class Model>
std::vector<Box> SelfContact<Model>::pose_balls(const PosedSkin& skin, Scratch& scratch) const {
  std::vector<Box> boxes(parts_.size());
  scratch.centers.resize(balls_.size(), 3);
  scratch.turns.resize(parts_.size());
  scratch.scales.resize(parts_.size());
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    scratch.turns[p] = transform(skin.now, parts_[p].bone).template leftCols<3>();
    scratch.scales[p] = std::cbrt(std::abs(scratch.turns[p].determinant()));
    for (const int ball : parts_[p].balls) {
      const Vector3d shape = ball_shapes_.middleRows<3>(3 * ball) * skin.weights;
      const Vector3d center = balls_.posed(balls_.skin().transform(skin.now, ball), ball, shape);
      const Vector3d reach = Vector3d::Constant(scratch.scales[p] * body_.radius(ball) + skin.margin);
      scratch.centers.row(ball) = center;
      boxes[p].extend(center - reach).extend(center + reach);
    }
  }
  return boxes;
}

template <class Model>
Vector3d SelfContact<Model>::place(int point, const PosedSkin& skin, Scratch& scratch) const {
  int& at = scratch.place_of[std::size_t(point)];
  if (at < 0) {
    at = int(scratch.places.size());
    const SkinMap<Model>& map = samples_->map();
    Vector3d x = Vector3d::Zero();
    samples_->points().each_corner(body_.points[std::size_t(point)], [&](int v, double weight) {
      x += weight * map.posed(map.skin().transform(skin.now, v), v, samples_->shape(skin.weights, v));
    });
    scratch.places.push_back(x);
  }
  return scratch.places[std::size_t(at)];
}

template <class Model>
typename SelfContact<Model>::Nearest SelfContact<Model>::nearest(const Vector3d& x, int point,
                                                                 const std::vector<int>& parts, double margin,
                                                                 Scratch& scratch) const {
  scratch.near.clear();
  for (const int part : parts)
    for (const int ball : parts_[std::size_t(part)].balls) {
      const double radius = scratch.scales[std::size_t(part)] * body_.radius(ball), reach = radius + margin;
      const double square = (x.transpose() - scratch.centers.row(ball)).squaredNorm();
      if (square > reach * reach) continue;
      const double touched = fade(point, ball), distance = std::sqrt(square) - touched * radius;
      if (touched > 0 && distance < margin) scratch.near.emplace_back(distance, ball);
    }
  Nearest out{0, Vector3d::Zero(), -1};
  if (scratch.near.empty()) return out;
  const auto [least, ball] = *std::min_element(scratch.near.begin(), scratch.near.end());
  double sum = 0;
  for (const auto& [distance, other] : scratch.near) {
    const double weight = std::exp((least - distance) / sharpness_);
    sum += weight;
    out.normal += weight * (x - scratch.centers.row(other).transpose()).normalized();
  }
  if (!(out.normal.norm() > kAgree * sum)) return out;  // in the middle of all of them
  out.gap = least - sharpness_ * std::log(sum);
  out.normal.normalize();
  out.ball = ball;
  return out;
}

template <class Model>
void SelfContact<Model>::touch(int point, const Nearest& nearest, const PosedSkin& skin, Scratch& scratch) const {
  const int part = body_.of_points[std::size_t(point)];
  const Vector3d& normal = nearest.normal;
  Contact contact{body_.points[std::size_t(point)], kOwnSkin, {}, normal, {}, {}, 1, 0};
  contact.others = other_side(point, nearest, skin, scratch);
  // Of all samples of both sides: their places, the first with the tissue where it was, and where it is predicted.
  const SkinMap<Model>& map = samples_->map();
  Vector3d unmoved = Vector3d::Zero(), kept = unmoved, predicted = unmoved, before = unmoved;
  Matrix3d turned_before = Matrix3d::Zero(), turned = turned_before;
  double room = 0;
  contact.each_sample([&](int sample, double share) {
    room += std::abs(share) * scratch.scales[std::size_t(part)] * samples_->thickness()(sample);
    samples_->points().each_corner(sample, [&](int v, double weight) {
      const PointTransform now = map.skin().transform(skin.now, v), then = map.skin().transform(skin.before, v);
      const Vector3d was = map.displacement(skin.weights, skin.was, v);
      unmoved += share * weight * map.posed(now, v, samples_->shape(skin.weights, v));
      kept += share * weight * map.posed(now, v, was);
      predicted += share * weight * map.posed(now, v, map.displacement(skin.weights, skin.predicted, v));
      before += share * weight * map.posed(then, v, was);
      if (sample != contact.sample) return;
      turned_before += weight * then.leftCols<3>();
      turned += weight * now.leftCols<3>();
    });
  });
  const double at_first = nearest.gap + normal.dot(kept - unmoved);
  const double at_last = nearest.gap + normal.dot(predicted - unmoved);
  if (std::min(at_first, at_last) > skin.near) return;
  // What is deep already comes out slowly.
  const double push = -std::max(at_first, at_last), most = kEach * samples_->model().body().size;
  contact.point = unmoved - (nearest.gap + std::max(0.0, push - most)) * normal;
  contact.before = before;
  const Vector3d carried = turned * turned_before.inverse() * before;  // as the bones turn it
  contact.motion = carried.allFinite() ? Vector3d(carried - before) : Vector3d(Vector3d::Zero());
  scratch.found.push_back(
      {contact, std::minmax({part, body_.of_balls[std::size_t(nearest.ball)]}), -nearest.gap, room});
}

/// Those of the ball's points that are nearest to the place that is touched. Their weights fade out where another one
/// comes nearer.
template <class Model>
OtherSide SelfContact<Model>::other_side(int point, const Nearest& nearest, const PosedSkin& skin,
                                         Scratch& scratch) const {
  const Vector3d touched = place(point, skin, scratch) - nearest.gap * nearest.normal;
  auto& others = scratch.others;
  others.clear();
  for (const int other : covers_[std::size_t(nearest.ball)])
    if (other != point) others.emplace_back((place(other, skin, scratch) - touched).norm(), other);
  OtherSide out;
  if (others.size() < 2) return out;
  const std::size_t count = std::min(out.samples.size(), others.size() - 1);
  std::partial_sort(others.begin(), others.begin() + std::ptrdiff_t(count) + 1, others.end());
  double sum = 0;
  for (std::size_t k = 0; k < count; ++k) {
    out.samples[k] = body_.points[std::size_t(others[k].second)];
    out.weights[k] = std::pow(1 - others[k].first / std::max(others[count].first, 1e-300), 2);
    sum += out.weights[k];
  }
  for (std::size_t k = 0; k < count; ++k) {
    const bool moves = samples_->stiffness()(out.samples[k]) > 0;
    out.weights[k] = !moves ? 0 : sum > 0 ? out.weights[k] / sum : 1.0 / double(count);
  }
  return out;
}

template <class Model>
void SelfContact<Model>::weigh(Scratch& scratch) const {
  struct Between {
    double deepest = 0, folded = 1;
  };
  std::map<std::pair<int, int>, Between> all;
  for (const auto& found : scratch.found) {
    Between& between = all[found.parts];
    between.deepest = std::max(between.deepest, found.depth / found.room);
  }
  for (auto& [parts, between] : all) {
    if (!joints_.count(parts)) continue;
    const auto [a, b] = parts;
    const Matrix3d mean = 0.5 * (scratch.turns[std::size_t(a)] + scratch.turns[std::size_t(b)]);
    const double whole = std::pow(scratch.scales[std::size_t(a)] * scratch.scales[std::size_t(b)], 1.5);
    const double left = std::abs(mean.determinant()) / std::max(whole, 1e-300);
    between.folded = smooth_step((left - kCrushed) / (kFolded - kCrushed));
  }
  for (auto& found : scratch.found) {
    const auto& [deepest, folded] = all[found.parts];
    found.contact.weight = folded * (1 - smooth_step((deepest - kFadeBegins) / (kFadeEnds - kFadeBegins)));
    found.contact.too_deep = found.depth - folded * kFadeBegins * found.room;
  }
}

template class SelfContact<FullModel>;
template class SelfContact<ReducedModel>;

}  // namespace dynamorph
