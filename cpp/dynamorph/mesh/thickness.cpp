// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/thickness.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/refine.hpp"
#include "dynamorph/mesh/symmetry.hpp"

namespace dynamorph {

namespace {

constexpr int kBalls = 6144;         // samples of the skin; the fingers of a body get dozens
constexpr int kBlock = 256;          // balls at a time
constexpr double kCovered = 1.1;     // distance from its center, in radii, within which a ball counts fully,
constexpr double kUncovered = 1.35;  // and beyond which it does not count, so that a fin on a body is thin
constexpr double kThinnest = 5e-3;   // relative to the size; a sheet has no thickness, but divisors must not be 0
constexpr double kFacet = 0.04;      // relative to the size; longer triangles are split, as half may be inside the body
constexpr double kOff = 1e-4;        // relative to the size; how far off a face to test what lies there

/// Splits triangles until no edge is longer than `longest`.
void refine_all(Points& vertices, Triangles& triangles, double longest) {
  std::vector<Vector3d> points;
  for (Eigen::Index i = 0; i < vertices.rows(); ++i) points.emplace_back(vertices.row(i));
  std::vector<Triangle> pieces;
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    pieces.push_back({triangles(t, 0), triangles(t, 1), triangles(t, 2)});
  refine(points, pieces, longest);
  vertices.resize(Eigen::Index(points.size()), 3);
  for (size_t i = 0; i < points.size(); ++i) vertices.row(Eigen::Index(i)) = points[i];
  triangles.resize(Eigen::Index(pieces.size()), 3);
  for (size_t t = 0; t < pieces.size(); ++t) triangles.row(Eigen::Index(t)) << pieces[t][0], pieces[t][1], pieces[t][2];
}

/// Points spread evenly over triangles by area, and the same every time. Within a triangle they follow the additive
/// recurrence with the plastic number (Roberts 2018).
struct Samples {
  std::vector<Vector3d> points, normals;

  Samples(const Points& vertices, const Triangles& triangles, int count) {
    VectorXd area(triangles.rows());
    for (Eigen::Index t = 0; t < area.size(); ++t) area(t) = area_vector(vertices, triangles, t).norm();
    const double each = area.sum() / count;
    double due = 0.5 * each;
    for (Eigen::Index t = 0; t < area.size(); ++t) {
      for (due -= area(t); due < 0; due += each) {
        const double number = double(points.size() + 1);
        double u = std::fmod(number * 0.7548776662466927, 1.0), v = std::fmod(number * 0.5698402909980532, 1.0);
        if (u + v > 1) u = 1 - u, v = 1 - v;
        points.push_back((1 - u - v) * vertices.row(triangles(t, 0)) + u * vertices.row(triangles(t, 1)) +
                         v * vertices.row(triangles(t, 2)));
        normals.push_back(area_vector(vertices, triangles, t) / area(t));
      }
    }
  }
};

}  // namespace

Thickness::Thickness(const Points& vertices, const Triangles& triangles, const ProgressFn& progress)
    : body_(Points(0, 3), Triangles(0, 3)), skin_(body_), tree_({}) {
  ClosedSurface closed = close_surface(vertices, triangles);
  body_ = Surface(closed.vertices, closed.triangles);
  size_ = body_.box().diagonal().norm();
  refine_all(closed.vertices, closed.triangles, kFacet * size_);
  const double off = kOff * size_;
  std::vector<char> kept(closed.triangles.rows());
  parallel_parts(closed.triangles.rows(), [&](Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index t = first; t < end; ++t) {
      const Vector3d vector = area_vector(closed.vertices, closed.triangles, t);
      if (!(vector.norm() > 0)) continue;
      Vector3d center = Vector3d::Zero();
      for (int k = 0; k < 3; ++k) center += closed.vertices.row(closed.triangles(t, k)) / 3;
      kept[size_t(t)] = !body_.contains(center + off * vector.normalized());
    }
  });
  Triangles outside(std::count(kept.begin(), kept.end(), 1), 3);
  for (Eigen::Index t = 0, next = 0; t < Eigen::Index(kept.size()); ++t)
    if (kept[t]) outside.row(next++) = closed.triangles.row(t);
  if (outside.rows() == 0) outside = closed.triangles;
  skin_ = Surface(closed.vertices, outside);
  find_balls(closed.vertices, outside, progress);
  const std::optional<MirrorPlane> plane = mirror_plane(vertices, triangles);
  // Samples are not symmetric, and small differences of the thickness decide what is held.
  for (size_t i = 0, found = balls_.size(); plane && i < found; ++i)
    balls_.push_back({plane->image(balls_[i].center), balls_[i].radius});
  std::stable_sort(balls_.begin(), balls_.end(), [](const Ball& a, const Ball& b) { return a.radius > b.radius; });
  std::vector<Bvh::Box> boxes;
  for (const Ball& ball : balls_) {
    const Vector3d reach = Vector3d::Constant(kUncovered * ball.radius);
    boxes.emplace_back(ball.center - reach, ball.center + reach);
  }
  tree_ = Bvh(boxes);
  for (const Bvh::Node& node : tree_.nodes) {  // largest first: so is the least number
    const auto first = tree_.order.begin();
    largest_.push_back(balls_[*std::min_element(first + node.begin, first + node.end)].radius);
  }
}

void Thickness::find_balls(const Points& vertices, const Triangles& triangles, const ProgressFn& progress) {
  const Samples samples(vertices, triangles, kBalls);
  const int count = int(samples.points.size());
  balls_.resize(count);
  run_tasks((count + kBlock - 1) / kBlock, progress, [&](int block, const ProgressFn& done) {
    for (int i = block * kBlock; i < std::min(count, (block + 1) * kBlock); ++i) {
      const Vector3d &p = samples.points[i], &normal = samples.normals[i];
      double radius = 0.5 * size_;
      for (int round = 0; round < 60; ++round) {
        const Vector3d center = p - radius * normal, touched = skin_.nearest(center);
        if ((touched - center).norm() >= (1 - 1e-4) * radius) break;
        const double along = normal.dot(p - touched);  // above zero when the touched point lies inside the ball
        const double smaller = along > 0 ? (p - touched).squaredNorm() / (2 * along) : 0;
        if (!(smaller < (1 - 1e-6) * radius)) break;
        radius = smaller;
      }
      const Vector3d center = p - radius * normal;
      balls_[i] = {center, body_.contains(center) ? radius : 0};  // the ball of a sheet lies outside
    }
    report(done, 1);
  });
}

double Thickness::thickness(const Vector3d& p) const {
  double best = kThinnest * size_;
  if (!tree_.nodes.empty()) raise(0, p, best);
  return best;
}

void Thickness::raise(int index, const Vector3d& p, double& best) const {
  const Bvh::Node& node = tree_.nodes[index];
  if (largest_[index] <= best || !node.box.contains(p)) return;
  if (!node.leaf()) {
    const bool right_first = largest_[node.right] > largest_[index + 1];
    raise(right_first ? node.right : index + 1, p, best);
    raise(right_first ? index + 1 : node.right, p, best);
    return;
  }
  for (int i = node.begin; i < node.end; ++i) {
    const Ball& ball = balls_[tree_.order[i]];
    const double distance = (p - ball.center).norm();
    if (distance < kUncovered * ball.radius)
      best = std::max(best, ball.radius * smooth_step((kUncovered - distance / ball.radius) / (kUncovered - kCovered)));
  }
}

Thickness::Measures Thickness::at(const Points& points) const {
  Measures out{VectorXd(points.rows()), VectorXd(points.rows())};
  parallel_parts(points.rows(), [&](Eigen::Index first, Eigen::Index end) {
    Vector3d nearest = skin_.nearest(points.row(first));
    for (Eigen::Index i = first; i < end; ++i) {
      const Vector3d p = points.row(i);
      nearest = skin_.nearest(p, nearest);  // points follow each other closely
      const bool inside = body_.contains(p);
      out.depth(i) = inside ? (p - nearest).norm() : 0;
      out.thickness(i) = std::max(thickness(inside ? p : nearest), out.depth(i));
    }
  });
  return out;
}

std::vector<Thickness::Ball> Thickness::covering(const Points& points, double tolerance) const {
  const auto gap = [&](const Ball& ball, Eigen::Index p) {
    return std::abs((points.row(p).transpose() - ball.center).norm() - ball.radius);
  };
  VectorXd most = tolerance * at(points).thickness;
  parallel_parts(points.rows(), [&](Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index p = first; p < end; ++p) {
      double nearest = kInfinity;
      for (const Ball& ball : balls_)
        if (ball.radius > 0) nearest = std::min(nearest, gap(ball, p));
      most(p) = std::max(most(p), nearest);
    }
  });
  std::vector<char> covered(std::size_t(points.rows()), false);
  std::vector<Ball> out;
  for (const Ball& ball : balls_) {
    bool needed = false;
    for (Eigen::Index p = 0; ball.radius > 0 && p < points.rows(); ++p)
      if (!covered[std::size_t(p)] && gap(ball, p) <= most(p)) covered[std::size_t(p)] = needed = true;
    if (needed) out.push_back(ball);
  }
  return out;
}

}  // namespace dynamorph
