// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/collider.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <numeric>
#include <set>
#include <stdexcept>

#include "dynamorph/core/disjoint_sets.hpp"

namespace dynamorph {

namespace {

constexpr double kFlat = 1e-4;    // relative volume (of a sphere: 1) below which a closed piece has no inside
constexpr double kOnEdge = 1e-9;  // weight of a corner below which a point lies on the edge across
constexpr double kGap = 1e-6;     // how far outside a triangle, in weights, a way still crosses it

struct HalfEdge {
  std::uint64_t edge;
  int corner;  ///< 3 triangle + k: where it begins
};

/// Vertices at the same place get the same number. Exporters split vertices along seams, which would leave borders.
std::vector<int> number_places(const Points& points) {
  std::vector<int> order(points.rows()), number(points.rows());
  std::iota(order.begin(), order.end(), 0);
  const auto before = [&](int a, int b) {
    for (int k = 0; k < 3; ++k)
      if (points(a, k) != points(b, k)) return points(a, k) < points(b, k);
    return false;
  };
  std::sort(order.begin(), order.end(), [&](int a, int b) { return before(a, b) || (!before(b, a) && a < b); });
  int last = -1;
  for (size_t i = 0; i < order.size(); ++i) number[order[i]] = i && !before(order[i - 1], order[i]) ? last : ++last;
  return number;
}

/// All half edges, those of an edge one after another.
std::vector<HalfEdge> sorted_edges(const Triangles& triangles, const std::vector<int>& place) {
  std::vector<HalfEdge> edges(triangles.size());
  for (int corner = 0; corner < int(edges.size()); ++corner) {
    const int t = corner / 3, k = corner % 3;
    const auto [a, b] = undirected(place[triangles(t, k)], place[triangles(t, (k + 1) % 3)]);
    edges[corner] = {std::uint64_t(a) << 32 | std::uint64_t(b), corner};
  }
  std::sort(edges.begin(), edges.end(), [](const HalfEdge& a, const HalfEdge& b) {
    return a.edge != b.edge ? a.edge < b.edge : a.corner < b.corner;
  });
  return edges;
}

/// Calls visit(first, last) for the half edges of each edge.
template <class Visit>
void for_each_edge(const std::vector<HalfEdge>& edges, const Visit& visit) {
  for (auto first = edges.begin(), last = first; first != edges.end(); first = last) {
    while (last != edges.end() && last->edge == first->edge) ++last;
    visit(first, last);
  }
}

/// Of the corners at the foot of x on the triangle.
Vector3d foot_weights(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& x) {
  const Vector3d u = b - a, v = c - a, d = x - a, n = u.cross(v);
  const double to_b = d.cross(v).dot(n) / n.squaredNorm(), to_c = u.cross(d).dot(n) / n.squaredNorm();
  return {1 - to_b - to_c, to_b, to_c};
}

/// A cubic over 0 .. 1, c0 + c1 t + c2 t^2 + c3 t^3.
struct Cubic {
  double c0, c1, c2, c3;
  double operator()(double t) const { return c0 + t * (c1 + t * (c2 + t * c3)); }
  /// Whether it has no root, because its Bernstein coefficients have one sign.
  bool one_sign() const {
    const double b1 = c0 + c1 / 3, b2 = c0 + (2 * c1 + c2) / 3, b3 = c0 + c1 + c2 + c3;
    return (c0 > 0 && b1 > 0 && b2 > 0 && b3 > 0) || (c0 < 0 && b1 < 0 && b2 < 0 && b3 < 0);
  }
};

/// Calls visit(t, falls) where the cubic changes its sign, in order, until that returns true.
template <class Visit>
void roots(const Cubic& cubic, const Visit& visit) {
  double knots[4] = {0, 1, 1, 1};  // between them it is monotonic
  int count = 1;
  const double square = cubic.c2 * cubic.c2 - 3 * cubic.c3 * cubic.c1;
  if (square > 0) {
    const double q = -(cubic.c2 + std::copysign(std::sqrt(square), cubic.c2));
    double turns[2] = {q / (3 * cubic.c3), cubic.c1 / q};
    if (turns[0] > turns[1]) std::swap(turns[0], turns[1]);
    for (double t : turns)
      if (t > 0 && t < 1) knots[count++] = t;
  }
  for (int i = 0; i < count; ++i) {
    double low = knots[i], high = knots[i + 1];
    const bool falls = cubic(low) >= 0;
    if (falls == (cubic(high) >= 0)) continue;
    for (int step = 0; step < 60; ++step) {
      const double middle = (low + high) / 2;
      ((cubic(middle) >= 0) == falls ? low : high) = middle;
    }
    if (visit(high, falls)) return;
  }
}

/// Weights of the corners at a point of the triangle.
Vector3d weights_at(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& point) {
  Vector3d weights = foot_weights(a, b, c, point);
  const Vector3d corners[] = {a, b, c};
  const double area = (b - a).cross(c - a).norm();
  int longest = 0;
  const auto length2 = [&](int k) { return (corners[(k + 1) % 3] - corners[k]).squaredNorm(); };
  for (int k : {1, 2})
    if (length2(k) > length2(longest)) longest = k;
  if (!(area > 1e-12 * length2(longest))) {  // without area: along its longest edge
    const Vector3d from = corners[longest], along = corners[(longest + 1) % 3] - from;
    const double part = length2(longest) > 0 ? along.dot(point - from) / length2(longest) : 0;
    weights.setZero();
    weights[longest] = 1 - part;
    weights[(longest + 1) % 3] = part;
  }
  for (double& weight : weights)
    if (weight < kOnEdge) weight = 0;
  return weights / weights.sum();
}

void check(const Points& points, const Triangles& triangles) {
  if (triangles.rows() == 0) throw std::invalid_argument("triangles: a collider needs at least one");
  check_triangles(points, triangles);
  if (!points.allFinite()) throw std::invalid_argument("points: must be finite");
}

}  // namespace

// --- Built once ------------------------------------------------------------------------------------------------------

Collider::Collider(Points points, Triangles triangles, bool one_sided)
    : triangles_(std::move(triangles)), one_sided_(one_sided) {
  static std::atomic<std::uint64_t> count{0};
  id_ = ++count;
  check(points, triangles_);
  place_ = number_places(points);
  drop_needless();
  find_neighbors();
  find_kinds(points);
  find_corners();
  std::vector<Bvh::Box> boxes(triangles_.rows());
  for (int t = 0; t < int(boxes.size()); ++t) boxes[t] = box(points, t);
  rest_.bvh = Bvh(boxes);
  rest_.points = std::move(points);
  volume_ = volume(rest_);
  if (needs_winding()) find_dipoles(rest_.points, winding_triangles(), rest_.bvh, rest_.dipoles);
}

/// Keeps the triangles with three different corners, each once. Others would make more than two faces of an edge. Where
/// both sides of a face are there, as in a mesh with modeled backfaces, normals do not tell which side is meant.
void Collider::drop_needless() {
  std::set<std::array<int, 3>> kept;  // places of their corners in turn, from the first one on
  Eigen::Index count = 0;
  for (Eigen::Index t = 0; t < triangles_.rows(); ++t) {
    std::array<int, 3> face{place_[triangles_(t, 0)], place_[triangles_(t, 1)], place_[triangles_(t, 2)]};
    if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0]) continue;
    std::rotate(face.begin(), std::min_element(face.begin(), face.end()), face.end());
    const bool turned = kept.count({face[0], face[2], face[1]}) > 0;
    if (turned) one_sided_ = false;
    if (!turned && kept.insert(face).second) triangles_.row(count++) = triangles_.row(t).eval();
  }
  if (count == 0) throw std::invalid_argument("triangles: none of them has three different corners");
  triangles_.conservativeResize(count, 3);
}

void Collider::find_neighbors() {
  neighbors_.setConstant(triangles_.rows(), 3, kNone);
  DisjointSets sets(triangles_.rows());
  for_each_edge(sorted_edges(triangles_, place_), [&](auto first, auto last) {
    const auto neighbor = [&](const HalfEdge& e) -> int& { return neighbors_(e.corner / 3, e.corner % 3); };
    if (last - first == 2) {
      neighbor(first[0]) = first[1].corner / 3;
      neighbor(first[1]) = first[0].corner / 3;
    }
    for (auto e = first; e != last; ++e) {
      sets.join(e->corner / 3, first->corner / 3);
      if (last - first > 2) neighbor(*e) = kSeveral;
    }
  });
  int count = 0;
  std::vector<int> number(triangles_.rows(), -1);
  for (int t = 0; t < int(triangles_.rows()); ++t) {
    int& piece = number[sets.root(t)];
    if (piece < 0) piece = count++;
    pieces_.push_back(piece);
  }
  kinds_.resize(count);
}

void Collider::turn(int t) {
  std::swap(triangles_(t, 1), triangles_(t, 2));
  std::swap(neighbors_(t, 0), neighbors_(t, 2));
}

/// Turns triangles to face as their neighbors do. Returns the pieces in which that is not possible.
std::vector<bool> Collider::orient() {
  std::vector<bool> seen(triangles_.rows(), false), impossible(kinds_.size(), false);
  std::vector<int> found;
  const auto edge = [&](int t, int k) { return Edge(place_[triangles_(t, k)], place_[triangles_(t, (k + 1) % 3)]); };
  for (int start = 0; start < int(triangles_.rows()); ++start) {
    if (!seen[start]) found = {start};
    for (; !found.empty();) {
      const int t = found.back();
      found.pop_back();
      seen[t] = true;
      for (int k = 0; k < 3; ++k) {
        const int other = neighbors_(t, k);
        if (other < 0) continue;
        bool alike = true;
        for (int l = 0; l < 3; ++l) alike &= edge(other, l) != edge(t, k);
        if (seen[other]) {
          if (!alike) impossible[pieces_[t]] = true;
          continue;
        }
        if (!alike) turn(other);
        seen[other] = true;
        found.push_back(other);
      }
    }
  }
  return impossible;
}

/// Tells what has an inside, and turns it outward.
void Collider::find_kinds(const Points& points) {
  if (one_sided_) return;
  const std::vector<bool> impossible = orient();
  struct Piece {
    double area = 0, border = 0, volume = 0;
    Vector3d middle = Vector3d::Zero();
    bool irregular = false;
    Bvh::Box box;
  };
  std::vector<Piece> pieces(kinds_.size());
  for (int t = 0; t < int(triangles_.rows()); ++t) {
    Piece& piece = pieces[pieces_[t]];
    const double area = area_vector(points, t).norm();
    piece.box.extend(box(points, t));
    piece.area += area;
    for (int k = 0; k < 3; ++k) {
      const Vector3d a = points.row(triangles_(t, k)), b = points.row(triangles_(t, (k + 1) % 3));
      piece.middle += area * a / 3;
      if (neighbors_(t, k) == kNone) piece.border += (b - a).norm();
      if (neighbors_(t, k) == kSeveral) piece.irregular = true;
    }
  }
  for (Piece& piece : pieces) piece.middle = piece.area > 0 ? Vector3d(piece.middle / piece.area) : piece.box.center();
  for (int t = 0; t < int(triangles_.rows()); ++t)
    pieces[pieces_[t]].volume += signed_volume(points, t, pieces[pieces_[t]].middle);

  for (size_t i = 0; i < pieces.size(); ++i) {
    const Piece& piece = pieces[i];
    const double full = std::abs(piece.volume) * std::sqrt(36 * kPi) / std::pow(piece.area, 1.5);  // 1: a sphere
    if (piece.border * piece.border >= piece.area || !(full > kFlat))
      kinds_[i] = Kind::sheet;
    else
      kinds_[i] = piece.border > 0 || piece.irregular || impossible[i] ? Kind::holed : Kind::closed;
    solids_ += kinds_[i] != Kind::sheet;
  }
  by_normals_ = kinds_.size() == 1 && kinds_[0] == Kind::closed;

  // What faces inward is inside out, unless it is the wall of a cavity in another piece.
  std::vector<bool> inward(pieces.size(), false);
  for (size_t i = 0; i < pieces.size(); ++i) {
    inward[i] = kinds_[i] != Kind::sheet && pieces[i].volume < 0;
    for (size_t j = 0; inward[i] && j < pieces.size(); ++j)
      if (j != i && kinds_[j] != Kind::sheet && pieces[j].box.contains(pieces[i].box)) inward[i] = false;
  }
  for (int t = 0; t < int(triangles_.rows()); ++t)
    if (inward[pieces_[t]]) turn(t);

  if (solids_ == 0 || solids_ == int(kinds_.size())) return;
  winding_ = triangles_;
  for (int t = 0; t < int(triangles_.rows()); ++t)
    if (sheet(t)) winding_.row(t).setConstant(triangles_(t, 0));
}

void Collider::find_corners() {
  first_.assign(*std::max_element(place_.begin(), place_.end()) + 2, 0);
  for (int vertex : triangles_.reshaped()) ++first_[place_[vertex] + 1];
  std::partial_sum(first_.begin(), first_.end(), first_.begin());
  corners_.resize(triangles_.size());
  std::vector<int> next(first_.begin(), first_.end() - 1);
  for (int c = 0; c < int(corners_.size()); ++c) corners_[next[place_[triangles_(c / 3, c % 3)]]++] = c;
}

// --- Posed -----------------------------------------------------------------------------------------------------------

void Collider::refit(const Eigen::Ref<const Points>& points, ColliderPose& pose) const {
  pose.points = points;
  if (pose.bvh.order != rest_.bvh.order) pose.bvh = rest_.bvh;
  pose.bvh.refit([&](int t) { return box(pose.points, t); });
  pose.turned = volume(pose) * volume_ < 0 ? -1 : 1;
  if (needs_winding()) find_dipoles(pose.points, winding_triangles(), pose.bvh, pose.dipoles);
}

Bvh::Box Collider::box(const Points& points, int t) const {
  Bvh::Box box;
  for (int k = 0; k < 3; ++k) box.extend(Vector3d(points.row(triangles_(t, k))));
  return box;
}

Vector3d Collider::area_vector(const Points& points, int t) const {
  const Vector3d a = points.row(triangles_(t, 0)), b = points.row(triangles_(t, 1)), c = points.row(triangles_(t, 2));
  return (b - a).cross(c - a) / 2;
}

double Collider::signed_volume(const Points& points, int t, const Vector3d& from) const {
  const Vector3d a = points.row(triangles_(t, 0)), b = points.row(triangles_(t, 1)), c = points.row(triangles_(t, 2));
  return (a - from).dot((b - from).cross(c - from)) / 6;
}

double Collider::volume(const ColliderPose& pose) const {
  if (solids_ == 0) return 0;
  double sum = 0;
  for (int t = 0; t < int(triangles_.rows()); ++t)
    if (!sheet(t)) sum += signed_volume(pose.points, t, pose.bvh.nodes[0].box.center());
  return sum;
}

Vector3d Collider::normal(const ColliderPose& pose, int t) const {
  return pose.turned * area_vector(pose.points, t).normalized();
}

ColliderPoint Collider::nearest(const ColliderPose& pose, const Vector3d& x, double cutoff) const {
  ColliderPoint found;
  double best = cutoff * cutoff;
  pose.bvh.nearest(x, best, [&](int t) {
    const Vector3d closest = closest_on_triangle(x, corner(pose, t, 0), corner(pose, t, 1), corner(pose, t, 2));
    const double square = (closest - x).squaredNorm();
    if (!(square < best)) return;
    best = square;
    found.triangle = t;
    found.point = closest;
  });
  if (const int t = found.triangle; found)
    found.weights = weights_at(corner(pose, t, 0), corner(pose, t, 1), corner(pose, t, 2), found.point);
  return found;
}

Vector3d Collider::pseudonormal(const ColliderPose& pose, const ColliderPoint& at) const {
  const int t = at.triangle;
  Vector3d sum = Vector3d::Zero();
  if (const int k = vertex_of(at); k >= 0) {
    const int place = place_[triangles_(t, k)];
    for (int i = first_[place]; i < first_[place + 1]; ++i) {
      const int other = corners_[i] / 3, l = corners_[i] % 3;
      const Vector3d from = corner(pose, other, l), u = corner(pose, other, (l + 1) % 3) - from,
                     v = corner(pose, other, (l + 2) % 3) - from;
      sum += std::atan2(u.cross(v).norm(), u.dot(v)) * normal(pose, other);
    }
  } else {
    sum = normal(pose, t);
    const int edge = edge_of(at);
    if (edge >= 0 && neighbors_(t, edge) >= 0) sum += normal(pose, neighbors_(t, edge));
  }
  return sum.norm() > 1e-9 ? Vector3d(sum.normalized()) : Vector3d(Vector3d::Zero());
}

int Collider::vertex_of(const ColliderPoint& at) {
  for (int k = 0; k < 3; ++k)
    if (at.weights[(k + 1) % 3] == 0 && at.weights[(k + 2) % 3] == 0) return k;
  return -1;
}

int Collider::edge_of(const ColliderPoint& at) {
  for (int k = 0; k < 3; ++k)
    if (at.weights[(k + 2) % 3] == 0) return k;
  return -1;
}

bool Collider::on_border(const ColliderPoint& at) const {
  const int t = at.triangle;
  const auto open = [&](int triangle, int k) { return neighbors_(triangle, k) == kNone; };
  const int k = vertex_of(at);
  if (k < 0) return edge_of(at) >= 0 && open(t, edge_of(at));
  const int place = place_[triangles_(t, k)];
  return std::any_of(&corners_[first_[place]], &corners_[first_[place]] + (first_[place + 1] - first_[place]),
                     [&](int c) { return open(c / 3, c % 3) || open(c / 3, (c + 2) % 3); });
}

bool Collider::contains(const ColliderPose& pose, const Vector3d& x, const ColliderPoint& nearest) const {
  const auto behind = [&] { return (x - nearest.point).dot(pseudonormal(pose, nearest)) < 0; };
  if (one_sided_) return behind() && !on_border(nearest);
  if (by_normals_) return behind();
  return solids_ > 0 && std::abs(winding_number(pose.points, winding_triangles(), pose.bvh, pose.dipoles, x)) > 0.5;
}

double Collider::signed_distance(const ColliderPose& pose, const Vector3d& x) const {
  const ColliderPoint at = nearest(pose, x);
  return (contains(pose, x, at) ? -1 : 1) * (x - at.point).norm();
}

// With x, the corner a and the edges u and v all moving straight and evenly, the volume (x - a) . (u x v) that they
// span is a cubic of time; where it is zero, x is in the triangle's plane.
ColliderPoint Collider::first_crossing(const ColliderPose& before, const ColliderPose& after, const Vector3d& from,
                                       const Vector3d& to, Crossing kind) const {
  ColliderPoint found;
  double best = 1;
  const bool still = &before == &after;
  const auto visit = [&](int t) {
    const Vector3d a = corner(before, t, 0), u = corner(before, t, 1) - a, v = corner(before, t, 2) - a, d = from - a;
    const Vector3d n = u.cross(v);
    if (still && d.dot(n) * (to - a).dot(n) > 0) return;  // it stays on one side of the plane
    const Vector3d a_end = corner(after, t, 0), da = a_end - a, dd = to - a_end - d;
    const Vector3d du = corner(after, t, 1) - a_end - u, dv = corner(after, t, 2) - a_end - v;
    const Vector3d dn = u.cross(dv) + du.cross(v), ddn = du.cross(dv);
    const Cubic volume{d.dot(n), d.dot(dn) + dd.dot(n), d.dot(ddn) + dd.dot(dn), dd.dot(ddn)};
    if (volume.one_sign()) return;
    roots(volume, [&](double time, bool falls) {
      if (found && time >= best) return true;
      const bool front = falls == (before.turned > 0);
      if (!sheet(t) && kind != Crossing::either && front != (kind == Crossing::entering)) return false;
      const Vector3d at = a + time * da;
      const Vector3d weights = foot_weights(at, at + u + time * du, at + v + time * dv, from + time * (to - from));
      if (!(weights.minCoeff() >= -kGap)) return false;
      best = time;
      found.triangle = t;
      found.weights = weights;
      found.front = front;
      return true;
    });
  };
  if (still)
    before.bvh.along(from, to - from, best, visit);
  else
    before.bvh.along(from, to - from, best, after.bvh, visit);
  if (found) found.point = at(after, found);
  return found;
}

}  // namespace dynamorph
