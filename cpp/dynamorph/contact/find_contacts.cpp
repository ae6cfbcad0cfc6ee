// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/find_contacts.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <utility>

#include "dynamorph/contact/choices.hpp"
#include "dynamorph/core/errors.hpp"

namespace dynamorph {

namespace {

constexpr double kNudge = 1e-7;    // of a collider's size: what a point is put off its surface
constexpr double kNothing = 1e-6;  // meters, or relative to the longest side: a collider of that size is none
constexpr double kRigid = 1e-5;    // of a stretch; transforms come in single precision
constexpr int kMostPieces = 8;     // of a collider that lie within each other where a sample gets out
constexpr int kMostHits = 8;       // of a sample that slides
constexpr int kMostPlanes = 3;     // of a sample and a collider: a corner of a room

/// Without the last bits, so that a turning collider has the same stretch at each step.
double rounded(double x) {
  int exponent;
  const double mantissa = std::frexp(x, &exponent);
  return std::ldexp(std::round(std::ldexp(mantissa, 16)), exponent - 16);
}

}  // namespace

// --- Colliders -------------------------------------------------------------------------------------------------------

bool ContactFinder::Surface::is(const Collider& other, const Matrix3d& other_stretch) const {
  return collider == other.id() && stretch == other_stretch;
}

bool ContactFinder::Surface::is(const Collider& other, const Eigen::Map<const Points>& points) const {
  return collider == other.id() && stretch.isZero(0) && pose.points == points;
}

void ContactFinder::Surface::set(const Collider& other, const Matrix3d& other_stretch) {
  if (is(other, other_stretch)) return;
  other.refit(other.rest().points * other_stretch, pose);
  collider = other.id();
  stretch = other_stretch;
}

void ContactFinder::Surface::set(const Collider& other, const Eigen::Map<const Points>& points) {
  if (is(other, points)) return;
  other.refit(points, pose);
  collider = other.id();
  stretch.setZero();
}

/// Splits a transform (3, 4) into a symmetric stretch, and what carries the stretched collider to the world without
/// changing its lengths. Returns whether something is left of it.
bool ContactFinder::split(const Eigen::Map<const RowMajor>& transform, Frame& frame, Matrix3d& stretch) {
  if (!transform.allFinite()) return false;
  const Matrix3d linear = transform.leftCols(3), square = linear.transpose() * linear;
  stretch.setIdentity();
  if (!square.isIdentity(kRigid)) {
    const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(square);
    const Vector3d lengths = solver.eigenvalues().cwiseMax(0).cwiseSqrt();
    if (!(lengths[0] > kNothing * lengths[2])) return false;
    const Matrix3d exact = solver.eigenvectors() * lengths.asDiagonal() * solver.eigenvectors().transpose();
    for (int i = 0; i < 3; ++i) stretch(i, i) = rounded(exact(i, i));
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < i; ++j) {
        const double scale = std::sqrt(stretch(i, i) * stretch(j, j));
        stretch(i, j) = stretch(j, i) = scale * std::ldexp(std::round(std::ldexp(exact(i, j) / scale, 16)), -16);
      }
  }
  frame.turn = linear * stretch.inverse();
  frame.back = frame.turn.inverse();
  frame.shift = transform.col(3);
  return frame.turn.allFinite() && frame.back.allFinite();
}

/// Finds where a collider is during the step. Returns whether it can act.
bool ContactFinder::pose(const ColliderStep& step, const Bvh::Box& samples, Posed& posed) {
  const Collider& collider = step.collider;
  // What was last is first in the next step.
  const auto set = [&](const auto& begin, const auto& end, bool at_rest) {
    if (!posed.first.is(collider, begin) && posed.last.is(collider, begin)) std::swap(posed.first, posed.last);
    if (!at_rest) posed.last.set(collider, end);
    posed.begin = posed.end = at_rest ? &collider.rest() : &posed.last.pose;
    if (begin == end) return;
    posed.first.set(collider, begin);
    posed.begin = &posed.first.pose;
  };
  posed.away = false;
  if (step.rigid()) {
    Matrix3d begin, end;
    if (!split(step.after, posed.from_end, end)) return false;
    posed.came = split(step.before, posed.from_begin, begin);
    if (!posed.came) posed.from_begin = posed.from_end, begin = end;
    set(begin, end, end.isIdentity(0));
  } else {
    if (!step.after.allFinite()) return false;
    posed.came = step.before.allFinite();
    posed.from_begin = posed.from_end = {Matrix3d::Identity(), Matrix3d::Identity(), Vector3d::Zero()};
    const Eigen::Map<const Points> end(step.after.data(), step.after.rows(), 3);
    const Eigen::Map<const Points> begin(posed.came ? step.before.data() : end.data(), end.rows(), 3);
    const Bvh::Box box(end.colwise().minCoeff().transpose(), end.colwise().maxCoeff().transpose());
    const Bvh::Box before(begin.colwise().minCoeff().transpose(), begin.colwise().maxCoeff().transpose());
    posed.away = !samples.intersects(box.merged(before));  // then it need not follow its points
    if (posed.away) return box.diagonal().norm() > kNothing;
    set(begin, end, false);
  }
  posed.deforms = 0;
  if (posed.begin != posed.end)
    posed.deforms = std::sqrt((posed.end->points - posed.begin->points).rowwise().squaredNorm().maxCoeff());
  return posed.end->bvh.nodes[0].box.diagonal().norm() > kNothing;
}

// --- One sample and one collider -------------------------------------------------------------------------------------

/// In the collider's own frame, meters.
struct ContactFinder::Sample {
  Vector3d from, to;  ///< its way
  Vector3d normal;    ///< N, outward
  double thickness;
  double limit = kFromWithin;        ///< of n . N
  Vector3d held = Vector3d::Zero();  ///< n of what held it in the last step
};

struct ContactFinder::Plane {
  ColliderPoint at;
  Vector3d normal;
  double depth = kInfinity;  ///< of the sample at the nearest way out, if it is another one
  double most = kInfinity;   ///< how far it pushes in this step
};

/// How deep something reaches, meters: along -N, and under its own surface there.
struct ContactFinder::Below {
  double along = -kInfinity, under = -kInfinity;
};

class ContactFinder::Search {
 public:
  Search(const Collider& collider, const Posed& posed, double near, double margin)
      : collider_(collider),
        begin_(*posed.begin),
        end_(*posed.end),
        deforms_(posed.deforms),
        near_(near),
        margin_(margin),
        size_(end_.bvh.nodes[0].box.diagonal().norm()),
        nudge_(kNudge * size_),
        drift_(end_.bvh.nodes[0].box.center() - begin_.bvh.nodes[0].box.center()) {}

  /// Whether it came so far that it cannot have been a motion: farther than from within the tissue to beyond the ball
  /// around the collider.
  bool jumps(const Sample& sample) const {
    return (sample.to - sample.from - drift_).norm() > sample.thickness + 0.5 * size_;
  }
  Vector3d let_out(const Vector3d& x, const Vector3d& point, const Vector3d& normal) const;
  Below last_below(const Vector3d& unmoved, const Sample& sample) const;
  void run(const Sample& sample);
  void appear(const Sample& sample);

  Plane planes[kMostPlanes];
  int count = 0;

 private:
  bool sweep(const Sample& sample);
  bool open(const Vector3d& point, const Vector3d& normal) const;
  Vector3d slide(const Vector3d& to) const;
  void approach(const Sample& sample, const ColliderPoint& nearest);
  void get_out(const Sample& sample, const ColliderPoint& nearest);
  Vector3d direction(const Vector3d& x, const ColliderPoint& nearest, double& distance) const;
  void add(const ColliderPoint& at, const Vector3d& normal) {
    if (count < kMostPlanes && !normal.isZero(0)) planes[count++] = {at, normal};
  }
  void add_way_out(const ColliderPoint& at, const Vector3d& normal, double depth = kInfinity) {
    if (!normal.isZero(0)) planes[count++] = {at, normal, depth, margin_};
  }

  const Collider& collider_;
  const ColliderPose &begin_, &end_;
  double deforms_, near_, margin_, size_, nudge_;
  Vector3d drift_;
};

/// Where x gets out of the collider along the normal of the plane that held it; x if it is not behind it.
Vector3d ContactFinder::Search::let_out(const Vector3d& x, const Vector3d& point, const Vector3d& normal) const {
  const double depth = normal.dot(point - x);
  if (depth < -nudge_) return x;
  const Vector3d behind = x - 2 * nudge_ * normal, beyond = x + (2 * std::max(depth, 0.0) + kHollow * margin_) * normal;
  const ColliderPoint out = collider_.first_crossing(begin_, begin_, behind, beyond, Collider::Crossing::either);
  if (!out || (out.front && !collider_.sheet(out.triangle))) return x;  // it came free past an edge
  return out.point + nudge_ * normal;
}

/// Where the way ends that leads to a point but stays outside of the planes.
Vector3d ContactFinder::Search::slide(const Vector3d& to) const {
  const auto outside = [&](const Vector3d& x, const Plane& p) -> Vector3d {
    return x + std::max(0.0, nudge_ - p.normal.dot(x - p.at.point)) * p.normal;
  };
  const Plane& last = planes[count - 1];
  if (count == kMostPlanes) return last.at.point;
  const Vector3d end = outside(to, last);
  if (count == 1 || planes[0].normal.dot(end - planes[0].at.point) >= 0) return end;
  const Vector3d along = planes[0].normal.cross(last.normal);
  return last.at.point + along * along.dot(to - last.at.point) / std::max(along.squaredNorm(), 1e-12);
}

/// From the nearest point to x, unit. On the surface itself: its normal.
Vector3d ContactFinder::Search::direction(const Vector3d& x, const ColliderPoint& nearest, double& distance) const {
  const Vector3d away = x - nearest.point;
  distance = away.norm();
  return distance > 2 * nudge_ ? Vector3d(away / distance) : collider_.pseudonormal(end_, nearest);
}

/// Follows a sample that begins outside.
void ContactFinder::Search::run(const Sample& sample) {
  const double way = (sample.to - sample.from).norm() + deforms_ + 2 * nudge_;
  ColliderPoint nearest;
  const double margin = std::min(margin_, near_ + way);
  if (way <= margin) nearest = collider_.nearest(end_, sample.to, margin);
  bool lost = !sample.held.isZero(0);
  if (way > margin || (nearest && (nearest.point - sample.to).norm() <= way)) lost |= !sweep(sample);
  if (count == 0) {
    if (!nearest) nearest = collider_.nearest(end_, sample.to, lost ? kInfinity : margin);
    if (nearest && collider_.contains(end_, sample.to, nearest))
      get_out(sample, nearest);
    else if (nearest && (nearest.point - sample.to).norm() < margin)
      approach(sample, nearest);
  } else if (count == 1) {
    Plane& plane = planes[0];
    const Vector3d x = slide(sample.to);
    nearest = collider_.nearest(end_, x, (x - plane.at.point).norm() + nudge_);
    double off;
    Vector3d normal = direction(x, nearest, off);
    if (off <= 2 * nudge_) normal = plane.normal;
    if (normal.dot(plane.normal) > 0 && !collider_.contains(end_, x, nearest)) plane = {nearest, normal};
  }
}

/// Finds the planes of what it runs into, one after the other. Returns false if something swallows it from within the
/// body.
bool ContactFinder::Search::sweep(const Sample& sample) {
  Vector3d from = sample.from, to = sample.to;
  for (int hits = 0; hits < kMostHits && count < kMostPlanes; ++hits) {
    const ColliderPoint hit =
        collider_.first_crossing(hits ? end_ : begin_, end_, from, to, Collider::Crossing::entering);
    if (!hit) return true;
    const Vector3d normal = (hit.front ? 1 : -1) * collider_.normal(end_, hit.triangle);
    if (normal.dot(sample.normal) > sample.limit) return false;
    if (count > 0 && normal.dot(planes[count - 1].normal) > kSmooth) --count;  // the next facet of a hollow
    add(hit, normal);
    from = hit.point + nudge_ * normal;
    to = slide(sample.to);
  }
  return true;
}

/// A sample that may be inside already: nothing is known but where it gets.
void ContactFinder::Search::appear(const Sample& sample) {
  const bool within = collider_.solid() && end_.bvh.nodes[0].box.contains(sample.to);
  const double reach = std::max(margin_, kFadeEnds * sample.thickness);
  const ColliderPoint nearest = collider_.nearest(end_, sample.to, within ? kInfinity : reach);
  if (!nearest) return;
  double distance;
  const Vector3d normal = direction(sample.to, nearest, distance);
  const double outward = normal.dot(sample.normal);
  if (collider_.contains(end_, sample.to, nearest))
    get_out(sample, nearest);
  else if (collider_.sheet(nearest.triangle) && !collider_.on_border(nearest) && outward > -kIntoSkin &&
           distance < reach)
    add_way_out(nearest, -normal);
  else if (distance < margin_)
    approach(sample, nearest);
}

void ContactFinder::Search::approach(const Sample& sample, const ColliderPoint& nearest) {
  double distance;
  Vector3d normal = direction(sample.to, nearest, distance);
  if (collider_.sheet(nearest.triangle) && distance <= 2 * nudge_ && normal.dot(sample.from - nearest.point) < 0)
    normal = -normal;
  if (normal.dot(sample.normal) <= sample.limit) add(nearest, normal);
}

/// A sample that is inside.
void ContactFinder::Search::get_out(const Sample& sample, const ColliderPoint& nearest) {
  double distance;
  Vector3d normal = direction(sample.to, nearest, distance);
  if (distance > 2 * nudge_) normal = -normal;
  const double outward = normal.dot(sample.normal);
  if ((outward < kIntoSkin || normal.dot(sample.held) > -kIntoSkin) && open(nearest.point, normal))
    return add_way_out(nearest, normal);
  const Vector3d beyond = sample.to - 2 * size_ * sample.normal;
  ColliderPoint out;
  Vector3d from = sample.to;
  for (int piece = 0; piece < kMostPieces; ++piece) {
    out = collider_.first_crossing(end_, end_, from, beyond, Collider::Crossing::leaving);
    if (!out || open(out.point, -sample.normal)) break;
    from = out.point - nudge_ * sample.normal;
  }
  // Out of something broad, as a floor, the nearest way is the better one where the skin is beside it.
  const bool far = out && (out.point - sample.to).norm() > kFadeEnds * sample.thickness;
  if (!out || (far && outward < -kIntoSkin)) return add_way_out(nearest, normal);
  add_way_out(out, -sample.normal, far ? distance : kInfinity);
}

/// Whether a point of the surface leads outside along the normal, not into another piece.
bool ContactFinder::Search::open(const Vector3d& point, const Vector3d& normal) const {
  const Vector3d x = point + 2 * nudge_ * normal;
  return !collider_.contains(end_, x, collider_.nearest(end_, x));
}

/// How deep the collider reaches below where bones and targets alone put a sample: under a small one that has gone
/// past, that is deeper than under its plane. Skin that stands on a floor does not press there with its sides. What
/// begins only beyond the middle of the body, one thickness below the skin, presses on its other side, as a belt does,
/// or the thumb of a hand that grips.
ContactFinder::Below ContactFinder::Search::last_below(const Vector3d& unmoved, const Sample& sample) const {
  const auto below = [&](double thicknesses) -> Vector3d {
    return unmoved - thicknesses * sample.thickness * sample.normal;
  };
  const auto first = [&](const Vector3d& from, const Vector3d& to) {
    return collider_.first_crossing(end_, end_, from, to, Collider::Crossing::entering);
  };
  Vector3d from = below(kSeen);
  if (const ColliderPoint other = first(below(1), from)) from = other.point + nudge_ * sample.normal;
  const ColliderPoint last = first(from, below(kFadeBegins));
  if (!last) return {};
  const Vector3d normal = (last.front ? 1 : -1) * collider_.normal(end_, last.triangle);
  if (normal.dot(sample.normal) > kIntoSkin) return {};
  return {sample.normal.dot(unmoved - last.point), normal.dot(last.point - unmoved)};
}

// --- All -------------------------------------------------------------------------------------------------------------

namespace {

/// Where a collider is at the beginning or the end of a step.
Bvh::Box corners_box(const Bvh::Box& own, const Matrix3d& turn, const Vector3d& shift) {
  Bvh::Box box;
  for (int corner = 0; corner < 8; ++corner)
    box.extend(Vector3d(turn * own.corner(Bvh::Box::CornerType(corner)) + shift));
  return box;
}

/// Around all samples of a step and what may touch them.
Bvh::Box samples_box(const SampleStep& samples, double margin) {
  Bvh::Box box;
  if (samples.before.rows() == 0) return box;
  for (const Points* points : {&samples.before, &samples.predicted}) {
    box.extend(Vector3d(points->colwise().minCoeff().transpose()));
    box.extend(Vector3d(points->colwise().maxCoeff().transpose()));
  }
  const Vector3d reach = Vector3d::Constant(std::max(margin, kFadeEnds * samples.thickness.maxCoeff()));
  return {box.min() - reach, box.max() + reach};
}

void check(const std::vector<ColliderStep>& colliders, const SampleStep& samples) {
  const Eigen::Index count = Eigen::Index(samples.samples.size());
  check_size("before", samples.before.rows(), count);
  check_size("predicted", samples.predicted.rows(), count);
  check_size("unmoved", samples.unmoved.rows(), count);
  check_size("normal", samples.normal.rows(), count);
  check_size("thickness", samples.thickness.size(), count);
  for (const ColliderStep& step : colliders) {
    const Eigen::Index rows = step.rigid() ? 3 : step.collider.rest().points.rows();
    check_size("collider, after", step.after.rows(), rows);
    check_size("collider, before", step.before.rows(), rows);
    if (step.before.cols() != step.after.cols() || (!step.rigid() && step.after.cols() != 3))
      throw std::invalid_argument("collider: expected transforms (3, 4) or points (V, 3)");
  }
}

}  // namespace

void ContactFinder::find(const std::vector<ColliderStep>& colliders, const SampleStep& samples, double near,
                         double margin, ContactMemory& memory, std::vector<Contact>& contacts) {
  check(colliders, samples);
  contacts.clear();
  unusable_.clear();
  posed_.resize(colliders.size());
  const Bvh::Box around = samples_box(samples, margin);
  memory.active.resize(colliders.size(), false);
  for (int c = 0; c < int(colliders.size()); ++c) {
    const ColliderStep& step = colliders[c];
    const bool usable = step.active && pose(step, around, posed_[c]);
    if (step.active && !usable) unusable_.push_back(c);
    const bool known = std::exchange(memory.active[c], usable) && usable && posed_[c].came;
    if (usable && !posed_[c].away)
      touch(step.collider, c, posed_[c], known, samples, around, near, margin, memory.planes, contacts);
  }
  memory.planes.clear();
  for (const Contact& contact : contacts)
    memory.planes.push_back({contact.sample, contact.collider, contact.point, contact.normal});
}

/// Adds the contacts of all samples with one collider. known: whether it was there in the last step.
void ContactFinder::touch(const Collider& collider, int number, const Posed& posed, bool known,
                          const SampleStep& samples, const Bvh::Box& around, double near, double margin,
                          const std::vector<ContactMemory::Plane>& held, std::vector<Contact>& contacts) {
  const Bvh::Box region =
      corners_box(posed.begin->bvh.nodes[0].box, posed.from_begin.turn, posed.from_begin.shift)
          .merged(corners_box(posed.end->bvh.nodes[0].box, posed.from_end.turn, posed.from_end.shift));
  if (!region.intersects(around)) return;
  auto plane = std::lower_bound(held.begin(), held.end(), number,
                                [](const ContactMemory::Plane& plane, int c) { return plane.collider < c; });
  Search search(collider, posed, near, margin);
  for (Eigen::Index row = 0; row < samples.before.rows(); ++row) {
    const int p = samples.samples[std::size_t(row)];
    const Vector3d before = samples.before.row(row), predicted = samples.predicted.row(row);
    const double thickness = samples.thickness[row], reach = known ? margin : std::max(margin, kFadeEnds * thickness);
    const Bvh::Box way(before.cwiseMin(predicted), before.cwiseMax(predicted));
    if (region.squaredExteriorDistance(way) > reach * reach) continue;

    Sample sample{posed.from_begin.to_own(before), posed.from_end.to_own(predicted),
                  posed.from_end.turn.transpose() * Vector3d(samples.normal.row(row)), thickness};
    search.count = 0;
    const bool jumps = search.jumps(sample);
    if (known && !jumps) {
      while (plane != held.end() && plane->collider == number && plane->sample < p) ++plane;
      for (; plane != held.end() && plane->collider == number && plane->sample == p; ++plane) {
        if (plane->normal.dot(before - plane->point) < near) sample.limit = kTurnsOver;
        sample.held = posed.from_begin.turn.transpose() * plane->normal;
        sample.from = search.let_out(sample.from, posed.from_begin.to_own(plane->point), sample.held);
      }
      search.run(sample);
    } else {
      search.appear(sample);
    }

    const Vector3d unmoved = posed.from_end.to_own(samples.unmoved.row(row)), was = posed.from_end.to_own(before);
    for (int i = 0; i < search.count; ++i) {
      const Plane& found = search.planes[i];
      const double depth = found.normal.dot(found.at.point - unmoved);
      const Below below = collider.solid() ? search.last_below(unmoved, sample) : Below();
      const double fade = (std::max(depth, below.along) / thickness - kFadeBegins) / (kFadeEnds - kFadeBegins);
      const double at_first = found.normal.dot(was - found.at.point);
      const double at_last = found.normal.dot(sample.to - found.at.point);
      const Vector3d point = found.at.point - std::max(0.0, -std::max(at_first, at_last) - found.most) * found.normal;
      const bool still = posed.begin == posed.end;
      const Vector3d came = posed.from_begin.to_world(still ? found.at.point : collider.at(*posed.begin, found.at));
      const Vector3d gets = posed.from_end.to_world(still ? found.at.point : collider.at(*posed.end, found.at));
      contacts.push_back(
          {p, number, posed.from_end.to_world(point), (posed.from_end.turn * found.normal).normalized(), before,
           jumps || !posed.came ? Vector3d(Vector3d::Zero()) : Vector3d(gets - came), 1 - smooth_step(fade),
           std::min(std::max(depth, below.under), found.depth) - kFadeBegins * thickness, std::min(at_first, at_last)});
    }
  }
}

}  // namespace dynamorph
