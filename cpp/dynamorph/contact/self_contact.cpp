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
constexpr double kEach = 3e-3;          // of the size: what a contact moves both sides apart in a step, at most

/// The bone that moves a point most; of several vertices, of their mean.
template <class F>
Index strongest(const F& each_weight) {
  std::map<Index, double> sums;
  each_weight([&](Index bone, double weight) { sums[bone] += weight; });
  Index best = 0;
  double most = -1;
  for (const auto& [bone, sum] : sums)
    if (sum > most) best = bone, most = sum;
  return best;
}

}  // namespace

template <class Model>
SelfContact<Model>::SelfContact(std::shared_ptr<const ContactSamples<Model>> samples, BodyBalls balls,
                                std::vector<int> points)
    : samples_(std::move(samples)),
      balls_(samples_->shared_model(), std::move(balls.centers)),
      radius_(std::move(balls.radius)),
      points_(std::move(points)),
      sharpness_(kSharpness * samples_->model().body().size) {
  const Index K = balls_.size(), P = Index(points_.size()), J = Index(samples_->model().targets().size());
  check_size("radius", radius_.size(), K);
  if (!radius_.allFinite() || !(radius_.array() > 0).all())
    throw std::invalid_argument("radius: must be finite and above zero");
  for (Index i = 0; i < P; ++i)
    if (points_[i] < 0 || points_[i] >= samples_->size() || (i > 0 && points_[i] <= points_[i - 1]))
      throw std::invalid_argument("points: must be numbers of samples, ascending");
  ball_shapes_.resize(3 * K, J);
  for (Index j = 0; j < J; ++j) {
    VectorXd shape;
    balls_.displacement(VectorXd::Unit(J, j), samples_->model().target(int(j)), shape);
    ball_shapes_.col(j) = shape;
  }

  rest_.resize(P, 3);
  thickness_.resize(P);
  const Skin &skin = samples_->map().skin(), &centers = balls_.skin();
  std::map<Index, Part> parts;
  for (Index i = 0; i < P; ++i) {
    rest_.row(i) = samples_->rest().row(points_[i]);
    thickness_(i) = samples_->thickness()(points_[i]);
    const Index bone = strongest([&](const auto& add) {
      samples_->points().each_corner(points_[i], [&](int v, double weight) {
        for (SkinWeights::InnerIterator it(skin.weights, v); it; ++it) add(it.col(), weight * it.value());
      });
    });
    parts[bone].points.samples.push_back(int(i));
  }
  for (Index k = 0; k < K; ++k) {
    const Index bone = strongest([&](const auto& add) {
      for (SkinWeights::InnerIterator it(centers.weights, k); it; ++it) add(it.col(), it.value());
    });
    parts[bone].balls.push_back(int(k));
  }
  part_of_point_.resize(std::size_t(P));
  part_of_ball_.resize(std::size_t(K));
  for (auto& [bone, part] : parts) {
    for (const int i : part.points.samples) part_of_point_[std::size_t(i)] = int(parts_.size());
    for (const int k : part.balls) part_of_ball_[std::size_t(k)] = int(parts_.size());
    std::map<Index, Box> boxes;
    for (const int i : part.points.samples)
      samples_->points().each_corner(points_[std::size_t(i)], [&](int v, double) {
        for (SkinWeights::InnerIterator it(skin.weights, v); it; ++it)
          boxes[it.col()].extend(Vector3d(skin.rest.row(v)));
      });
    part.points.boxes.assign(boxes.begin(), boxes.end());
    parts_.push_back(std::move(part));
  }

  covers_.resize(std::size_t(K));
  std::vector<std::pair<double, int>> nearest;
  for (Index k = 0; k < K; ++k) {
    nearest.clear();
    for (Index i = 0; i < P; ++i) {
      const double gap = std::abs((rest_.row(i) - centers.rest.row(k)).norm() - radius_(k));
      nearest.emplace_back(gap / thickness_(i), int(i));
    }
    std::sort(nearest.begin(), nearest.end());
    for (int i = 0; i < std::min(kMost, int(nearest.size())); ++i)
      if (i < kFewest || nearest[std::size_t(i)].first < kCovered)
        covers_[std::size_t(k)].push_back(nearest[std::size_t(i)].second);
  }
}

template <class Model>
double SelfContact<Model>::fade(int point, int ball) const {
  const double gap = (rest_.row(point) - balls_.skin().rest.row(ball)).norm() - radius_(ball);
  return smooth_step((gap / std::min(thickness_(point), radius_(ball)) - kIgnored) / (kWhole - kIgnored));
}

template <class Model>
Vector3d SelfContact<Model>::ball_center(int ball, const PosedSkin& skin) const {
  return balls_.posed(balls_.skin().transform(skin.now, ball), ball,
                      ball_shapes_.middleRows<3>(3 * ball) * skin.weights);
}

template <class Model>
const Vector3d& SelfContact<Model>::place(int point, const PosedSkin& skin, Scratch& scratch) const {
  int& at = scratch.place_of[std::size_t(point)];
  if (at < 0) {
    at = int(scratch.places.size());
    const SkinMap<Model>& map = samples_->map();
    Vector3d x = Vector3d::Zero();
    samples_->points().each_corner(points_[std::size_t(point)], [&](int v, double weight) {
      x += weight * map.posed(map.skin().transform(skin.now, v), v, samples_->shape(skin.weights, v));
    });
    scratch.places.push_back(x);
  }
  return scratch.places[std::size_t(at)];
}

template <class Model>
void SelfContact<Model>::find(const PosedSkin& skin, Scratch& scratch, std::vector<Contact>& contacts) const {
  contacts.clear();
  scratch.places.clear();
  scratch.parts.clear();
  scratch.place_of.assign(points_.size(), -1);
  scratch.centers.resize(balls_.size(), 3);
  std::vector<Box> boxes(parts_.size());
  for (std::size_t part = 0; part < parts_.size(); ++part)
    for (const int ball : parts_[part].balls) {
      const Vector3d center = ball_center(ball, skin), reach = Vector3d::Constant(radius_(ball) + skin.margin);
      scratch.centers.row(ball) = center;
      boxes[part].extend(center - reach).extend(center + reach);
    }
  const double farthest = samples_->farthest(skin.weights, skin.shape);
  std::vector<const Part*> around;
  for (std::size_t own = 0; own < parts_.size(); ++own) {
    const auto& points = parts_[own].points;
    const Box region = ContactSamples<Model>::region(points, skin.now, farthest);
    std::vector<std::size_t> others;
    for (std::size_t part = 0; part < parts_.size(); ++part)
      if (part != own && region.intersects(boxes[part])) others.push_back(part);
    for (const int point : others.empty() ? std::vector<int>() : points.samples) {
      if (!(samples_->stiffness()(points_[std::size_t(point)]) > 0)) continue;
      const Vector3d x = place(point, skin, scratch);
      around.clear();
      for (const std::size_t part : others)
        if (boxes[part].contains(x)) around.push_back(&parts_[part]);
      if (!around.empty()) touch(point, skin, around, scratch, contacts);
    }
  }
  std::map<std::pair<int, int>, double> deepest;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    double& depth = deepest[scratch.parts[i]];
    depth = std::max(depth, contacts[i].weight);
  }
  for (std::size_t i = 0; i < contacts.size(); ++i)
    contacts[i].weight = 1 - smooth_step((deepest[scratch.parts[i]] - kFadeBegins) / (kFadeEnds - kFadeBegins));
  std::sort(contacts.begin(), contacts.end(), [](const Contact& a, const Contact& b) { return a.sample < b.sample; });
}

template <class Model>
void SelfContact<Model>::touch(int point, const PosedSkin& skin, const std::vector<const Part*>& parts,
                               Scratch& scratch, std::vector<Contact>& contacts) const {
  const Vector3d x = place(point, skin, scratch);
  scratch.near.clear();
  for (const Part* part : parts)
    for (const int ball : part->balls) {
      const double reach = radius_(ball) + skin.margin,
                   square = (x.transpose() - scratch.centers.row(ball)).squaredNorm();
      if (square > reach * reach) continue;
      const double part_of_it = fade(point, ball), distance = std::sqrt(square) - part_of_it * radius_(ball);
      if (part_of_it > 0 && distance < skin.margin) scratch.near.emplace_back(distance, ball);
    }
  if (scratch.near.empty()) return;
  const auto [least, ball] = *std::min_element(scratch.near.begin(), scratch.near.end());
  Vector3d normal = Vector3d::Zero();
  double sum = 0;
  for (const auto& [distance, other] : scratch.near) {
    const double weight = std::exp((least - distance) / sharpness_);
    sum += weight;
    normal += weight * (x - scratch.centers.row(other).transpose()).normalized();
  }
  const double gap = least - sharpness_ * std::log(sum);
  if (!(normal.norm() > 0.1 * sum)) return;  // in the middle of all of them
  normal.normalize();

  Contact contact{points_[std::size_t(point)], kOwnSkin, {}, normal, {}, {}, 1, 0};
  if (!find_other_side(ball, x - gap * normal, skin, scratch, contact)) return;
  // Of all samples of both sides: their places, the first with the tissue where it was, and where it is predicted.
  const SkinMap<Model>& map = samples_->map();
  Vector3d unmoved = Vector3d::Zero(), kept = unmoved, predicted = unmoved, before = unmoved;
  Matrix3d turn = Matrix3d::Zero(), turned = turn;
  double room = 0;
  contact.each_sample([&](int sample, double part) {
    room += std::abs(part) * samples_->thickness()(sample);
    samples_->points().each_corner(sample, [&](int v, double weight) {
      const PointTransform now = map.skin().transform(skin.now, v), then = map.skin().transform(skin.before, v);
      const Vector3d was = map.displacement(skin.weights, skin.was, v);
      unmoved += part * weight * map.posed(now, v, samples_->shape(skin.weights, v));
      kept += part * weight * map.posed(now, v, was);
      predicted += part * weight * map.posed(now, v, map.displacement(skin.weights, skin.predicted, v));
      before += part * weight * map.posed(then, v, was);
      if (sample != contact.sample) return;
      turn += weight * then.leftCols<3>();
      turned += weight * now.leftCols<3>();
    });
  });
  const double at_first = gap + normal.dot(kept - unmoved), at_last = gap + normal.dot(predicted - unmoved);
  if (std::min(at_first, at_last) > skin.near) return;
  // What is deep already comes out slowly.
  const double push = -std::max(at_first, at_last), most = kEach * samples_->model().body().size;
  contact.point = unmoved - (gap + std::max(0.0, push - most)) * normal;
  contact.before = before;
  const Matrix3d turning = turned * turn.inverse();
  contact.motion = turning.allFinite() ? Vector3d(turning * before - before) : Vector3d(Vector3d::Zero());
  contact.weight = -gap / room;  // until all are found
  scratch.parts.emplace_back(std::minmax(part_of_point_[std::size_t(point)], part_of_ball_[std::size_t(ball)]));
  contact.too_deep = -gap - kFadeBegins * room;
  contacts.push_back(contact);
}

/// Those of a ball's points that are nearest to a place. Their weights fade out where another one comes nearer.
template <class Model>
bool SelfContact<Model>::find_other_side(int ball, const Vector3d& place_on_it, const PosedSkin& skin, Scratch& scratch,
                                         Contact& contact) const {
  auto& others = scratch.others;
  others.clear();
  for (const int point : covers_[std::size_t(ball)])
    if (points_[std::size_t(point)] != contact.sample)
      others.emplace_back((place(point, skin, scratch) - place_on_it).norm(), point);
  const std::size_t count =
      std::min(contact.others.samples.size(), others.size() - std::min<std::size_t>(others.size(), 1));
  if (count == 0) return false;
  std::partial_sort(others.begin(), others.begin() + std::ptrdiff_t(count) + 1, others.end());
  double sum = 0;
  for (std::size_t k = 0; k < count; ++k) {
    contact.others.samples[k] = points_[std::size_t(others[k].second)];
    contact.others.weights[k] = std::pow(1 - others[k].first / std::max(others[count].first, 1e-300), 2);
    sum += contact.others.weights[k];
  }
  for (std::size_t k = 0; k < count; ++k) {
    const bool moves = samples_->stiffness()(contact.others.samples[k]) > 0;
    contact.others.weights[k] = !moves ? 0 : sum > 0 ? contact.others.weights[k] / sum : 1.0 / double(count);
  }
  return true;
}

template class SelfContact<FullModel>;
template class SelfContact<ReducedModel>;

}  // namespace dynamorph
