// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/interior_graph.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/refine.hpp"
#include "dynamorph/mesh/weld.hpp"

namespace dynamorph {

namespace {

constexpr size_t kMostAdded = 4'000'000;  // triangles; a cage of a million tets needs fewer
constexpr double kSlack = 1e-9;           // so that no line slips through between two triangles

/// Distance along the line from p to triangle abc, infinite if the line misses it (Moller and Trumbore 1997).
double along_line(const Vector3d& p, const Vector3d& direction, const Vector3d& a, const Vector3d& b,
                  const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, normal = direction.cross(ac), from = p - a, q = from.cross(ab);
  const double determinant = ab.dot(normal);
  const double u = from.dot(normal) / determinant, v = direction.dot(q) / determinant, t = ac.dot(q) / determinant;
  return u >= -kSlack && v >= -kSlack && u + v <= 1 + kSlack && t >= 0
             ? t
             : kInfinity;  // NaN fails too: the triangle is along the line
}

/// The vertices that are the same point as others at their place: those at open edges, and those of duplicate triangles
/// that face alike. Elsewhere, vertices at the same place belong to parts that touch. places: of each vertex.
std::vector<bool> seams(const Triangles& triangles, const std::vector<int>& places) {
  std::map<Edge, int> edges;
  std::map<Triangle, int> faces;
  const auto face = [&](Eigen::Index t) {
    Triangle corners{places[triangles(t, 0)], places[triangles(t, 1)], places[triangles(t, 2)]};
    std::rotate(corners.begin(), std::min_element(corners.begin(), corners.end()), corners.end());
    return corners;
  };
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    ++faces[face(t)];
    for (int k = 0; k < 3; ++k) ++edges[undirected(triangles(t, k), triangles(t, (k + 1) % 3))];
  }
  std::vector<bool> seam(places.size(), false);
  for (const auto& [ends, count] : edges)
    if (count == 1) seam[ends.first] = seam[ends.second] = true;
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    if (faces[face(t)] > 1)
      for (int vertex : triangles.row(t)) seam[vertex] = true;
  return seam;
}

}  // namespace

InteriorGraph::InteriorGraph(const Points& vertices, const Triangles& triangles, double spacing) {
  check_triangles(vertices, triangles);
  if (!(spacing > 0)) throw std::invalid_argument("spacing: expected more than 0, got " + std::to_string(spacing));
  of_vertex_.assign(vertices.rows(), -1);
  if (triangles.rows() == 0) return;
  join_seams(vertices, triangles);
  face_outward(vertices, triangles);
  if (!refine(points_, triangles_, spacing, triangles_.size() + kMostAdded))
    throw std::invalid_argument("triangles: far larger than the tets, of size " + std::to_string(spacing) +
                                ": give both in the same unit");
  connect();
  find_parts();
  find_normals();
  find_buried(1e-3 * spacing);
  look_through();
}

void InteriorGraph::join_seams(const Points& vertices, const Triangles& triangles) {
  const Welded welded = weld(vertices, triangles, unit_box(vertices, triangles));
  const std::vector<bool> seam = seams(triangles, welded.of_vertex);
  std::vector<int> joined(welded.points.size(), -1);  // the point of the seams' vertices at each place
  for (int vertex : triangles.reshaped<Eigen::RowMajor>()) {
    int& point = of_vertex_[vertex];
    if (point >= 0) continue;
    int& there = joined[welded.of_vertex[vertex]];
    point = seam[vertex] && there >= 0 ? there : size();
    if (seam[vertex]) there = point;
    if (point == size()) points_.push_back(vertices.row(vertex));
  }
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    triangles_.push_back({of_vertex_[triangles(t, 0)], of_vertex_[triangles(t, 1)], of_vertex_[triangles(t, 2)]});
}

/// Turns the triangles outward, like those of the closed body.
void InteriorGraph::face_outward(const Points& vertices, const Triangles& triangles) {
  const ClosedSurface closed = close_surface(vertices, triangles);
  body_ = Surface(closed.vertices, closed.triangles);
  for (size_t t = 0; t < triangles_.size(); ++t)
    if (closed.flipped[t]) std::swap(triangles_[t][1], triangles_[t][2]);
}

void InteriorGraph::connect() {
  steps_.resize(size());
  const auto connected = [&](int a, int b) {
    return std::any_of(steps_[a].begin(), steps_[a].end(), [&](const Step& step) { return step.to == b; });
  };
  for (const Triangle& corners : triangles_)
    for (int k = 0; k < 3; ++k) {
      const int a = corners[k], b = corners[(k + 1) % 3];
      if (a == b || connected(a, b)) continue;
      const double length = (points_[a] - points_[b]).norm();
      steps_[a].push_back({b, length});
      steps_[b].push_back({a, length});
    }
}

void InteriorGraph::find_parts() {
  part_.assign(size(), -1);
  int parts = 0;
  for (int seed = 0; seed < size(); ++seed) {
    if (part_[seed] >= 0) continue;
    std::vector<int> open{seed};
    part_[seed] = parts;
    while (!open.empty()) {
      const int i = open.back();
      open.pop_back();
      for (const Step& step : steps_[i])
        if (part_[step.to] < 0) {
          part_[step.to] = parts;
          open.push_back(step.to);
        }
    }
    ++parts;
  }
}

void InteriorGraph::find_normals() {
  normals_.assign(size(), Vector3d::Zero());
  for (const auto& [a, b, c] : triangles_) {
    const Vector3d area = (points_[b] - points_[a]).cross(points_[c] - points_[a]);
    for (int corner : {a, b, c}) normals_[corner] += area;
  }
  for (Vector3d& normal : normals_) normal.normalize();
}

/// Uses the winding number of each part alone, because a body is not buried in its clothes.
void InteriorGraph::find_buried(double off) {
  std::vector<std::vector<Triangle>> parts(part_.empty() ? 0 : 1 + *std::max_element(part_.begin(), part_.end()));
  for (const Triangle& corners : triangles_) parts[part_[corners[0]]].push_back(corners);
  std::vector<int> number(size());  // each point's number within its part
  std::vector<std::vector<int>> members(parts.size());
  for (int i = 0; i < size(); ++i) {
    number[i] = int(members[part_[i]].size());
    members[part_[i]].push_back(i);
  }
  buried_.resize(size());
  for (size_t part = 0; part < parts.size(); ++part) {
    Points points(members[part].size(), 3);
    for (int i : members[part]) points.row(number[i]) = points_[i];
    Triangles triangles(parts[part].size(), 3);
    for (size_t t = 0; t < parts[part].size(); ++t)
      for (int k = 0; k < 3; ++k) triangles(t, k) = number[parts[part][t][k]];
    const Surface surface(points, triangles);
    parallel_parts(Eigen::Index(members[part].size()), [&](Eigen::Index first, Eigen::Index end) {
      for (Eigen::Index k = first; k < end; ++k) {
        const int i = members[part][k];
        buried_[i] = surface.winding_number(points_[i] + off * normals_[i]) > 0.5;
      }
    });
  }
}

/// Joins points that lie opposite each other through the body. It skips buried points, because the line from there
/// would leave another place instead.
void InteriorGraph::look_through() {
  std::vector<Bvh::Box> boxes(triangles_.size());
  for (size_t t = 0; t < triangles_.size(); ++t)
    for (int corner : triangles_[t]) boxes[t].extend(points_[corner]);
  bvh_ = Bvh(boxes);
  std::vector<int> opposites(size(), -1);
  parallel_parts(size(), [&](Eigen::Index first, Eigen::Index end) {
    for (int i = int(first); i < end; ++i)
      if (!buried_[i]) opposites[i] = opposite(i);
  });
  for (int i = 0; i < size(); ++i) {
    const int other = opposites[i];
    if (other < 0) continue;
    const double length = (points_[i] - points_[other]).norm();
    steps_[i].push_back({other, length});
    steps_[other].push_back({i, length});
  }
}

/// The point where the inward line from a point leaves the body, through skin that faces the other way; -1 if the line
/// first enters the body a second time.
int InteriorGraph::opposite(int from) const {
  const Vector3d inward = -normals_[from];
  double nearest = kInfinity;
  int crossed = -1;
  bool leaves = false;
  bvh_.along(points_[from], inward, nearest, [&](int t) {
    const auto& [a, b, c] = triangles_[t];
    if (part_[a] != part_[from] || a == from || b == from || c == from) return;
    const bool out = (points_[b] - points_[a]).cross(points_[c] - points_[a]).dot(inward) > 0;
    const double distance = along_line(points_[from], inward, points_[a], points_[b], points_[c]);
    const double first = out ? distance * (1 - 1e-6) : distance;  // where parts touch, the line leaves before it enters
    if (!(first < nearest)) return;
    nearest = first;
    crossed = t;
    leaves = out;
  });
  const int other = leaves ? nearest_corner(crossed, points_[from]) : -1;
  return other >= 0 && normals_[from].dot(normals_[other]) < -0.5 ? other : -1;
}

int InteriorGraph::nearest_corner(int triangle, const Vector3d& p) const {
  const Triangle& corners = triangles_[triangle];
  return *std::min_element(corners.begin(), corners.end(), [&](int a, int b) {
    return (points_[a] - p).squaredNorm() < (points_[b] - p).squaredNorm();
  });
}

int InteriorGraph::nearest(const Vector3d& p) const {
  const Place any = nearest_place(p, false);
  if (any.triangle < 0) return -1;
  // p lies inside another part that overlaps this one, so it does not belong to this one, although this one is near.
  const bool other = any.outside && body_.contains(p);
  const Place same_side = other ? nearest_place(p, true) : any;
  const Place& place = same_side.triangle < 0 ? any : same_side;
  return nearest_corner(place.triangle, place.at);
}

InteriorGraph::Place InteriorGraph::nearest_place(const Vector3d& p, bool only_around) const {
  double best = kInfinity;
  Place place;
  bvh_.nearest(p, best, [&](int t) {
    const auto& [a, b, c] = triangles_[t];
    if (buried_[a] || buried_[b] || buried_[c]) return;
    const Vector3d q = closest_on_triangle(p, points_[a], points_[b], points_[c]);
    if ((q - p).squaredNorm() >= best) return;
    const bool outside = (points_[b] - points_[a]).cross(points_[c] - points_[a]).dot(p - q) > 0;
    if (outside && only_around) return;
    best = (q - p).squaredNorm();
    place = {t, q, outside};
  });
  return place;
}

}  // namespace dynamorph
