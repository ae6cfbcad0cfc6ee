// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/closed_surface.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <queue>
#include <tuple>
#include <unordered_map>
#include <vector>

#include "dynamorph/core/disjoint_sets.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "dynamorph/mesh/weld.hpp"

namespace dynamorph {

namespace {

/// Numbers of faces, in a row.
struct Faces {
  const int *first, *last;
  const int* begin() const { return first; }
  const int* end() const { return last; }
  std::size_t size() const { return std::size_t(last - first); }
};

constexpr double kNegligible = 1e-4;  // relative to a sphere of the same area; a thinner patch has no outside

class Closing {
 public:
  Closing(const Points& vertices, const Triangles& triangles, const UnitBox& box) {
    weld_faces(vertices, triangles, box);
    find_edges();
    orient_patches();
    authored_ = faces_.size();
    cap_loops();
  }

  ClosedSurface result(const UnitBox& box) const {
    ClosedSurface s{Points(points_.size(), 3), Triangles(faces_.size(), 3), int(authored_), defects_, {}};
    for (size_t i = 0; i < points_.size(); ++i) s.vertices.row(i) = box.origin + box.size * points_[i];
    for (size_t f = 0; f < faces_.size(); ++f) s.triangles.row(f) << faces_[f][0], faces_[f][1], faces_[f][2];
    for (const auto& [f, edge] : soup_) s.flipped.push_back(f >= 0 && !runs_along(f, edge.first, edge.second));
    return s;
  }

 private:
  void weld_faces(const Points& vertices, const Triangles& triangles, const UnitBox& box);
  void find_edges();
  void orient_patches();
  double outwardness(const std::vector<int>& patch) const;
  void cap_loops();
  void cap(const std::vector<int>& loop);

  /// The faces at an edge, in their order.
  Faces at(int edge) const { return {beside_.data() + first_[edge], beside_.data() + first_[edge + 1]}; }
  /// Whether face f runs along a -> b.
  bool runs_along(int f, int a, int b) const {
    const Triangle& t = faces_[f];
    return (t[0] == a && t[1] == b) || (t[1] == a && t[2] == b) || (t[2] == a && t[0] == b);
  }
  void flip(int f) {
    std::swap(faces_[f][1], faces_[f][2]);
    std::swap(edges_of_[f][0], edges_of_[f][2]);
  }

  std::vector<Vector3d> points_;  ///< in the unit box
  std::vector<Triangle> faces_;
  std::vector<std::pair<int, Edge>> soup_;  ///< of each of its triangles: the face, -1 if collapsed; the first edge
  size_t authored_ = 0;
  std::vector<Edge> edges_;         ///< sorted
  std::vector<int> first_;          ///< of the faces at each edge, in beside_
  std::vector<int> beside_;         ///< the faces at all edges
  std::vector<Triangle> edges_of_;  ///< the edges of each face: from each corner to the next
  Defects defects_;
};

void Closing::weld_faces(const Points& vertices, const Triangles& triangles, const UnitBox& box) {
  Welded welded = weld(vertices, triangles, box);
  const std::vector<int>& number = welded.of_vertex;
  points_ = std::move(welded.points);
  defects_.stray_vertices = int(std::count(number.begin(), number.end(), -1));
  DisjointSets pieces(points_.size());
  std::unordered_map<Triangle, int, HashNumbers> seen;
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    const Triangle f{number[triangles(t, 0)], number[triangles(t, 1)], number[triangles(t, 2)]};
    pieces.join(f[0], f[1]);
    pieces.join(f[0], f[2]);
    const bool collapsed = f[0] == f[1] || f[1] == f[2] || f[2] == f[0];
    const Vector3d u = points_[f[1]] - points_[f[0]], v = points_[f[2]] - points_[f[0]];
    // A triangle without area still joins its neighbors, so it stays.
    defects_.degenerate_faces += u.cross(v).norm() <= 1e-12 * std::max(u.squaredNorm(), v.squaredNorm());
    soup_.push_back({-1, {f[0], f[1]}});
    if (collapsed) continue;
    Triangle corners = f;
    std::sort(corners.begin(), corners.end());
    const auto [same, is_new] = seen.emplace(corners, int(faces_.size()));
    soup_.back().first = same->second;
    if (is_new)
      faces_.push_back(f);
    else
      ++defects_.duplicate_faces;
  }
  for (size_t i = 0; i < points_.size(); ++i) defects_.components += pieces.root(i) == int(i);
}

void Closing::find_edges() {
  struct Side {
    Edge edge;
    int face, corner;
    bool operator<(const Side& other) const {
      return std::tie(edge, face, corner) < std::tie(other.edge, other.face, other.corner);
    }
  };
  std::vector<Side> sides;
  for (size_t f = 0; f < faces_.size(); ++f)
    for (int k = 0; k < 3; ++k) sides.push_back({undirected(faces_[f][k], faces_[f][(k + 1) % 3]), int(f), k});
  std::sort(sides.begin(), sides.end());
  edges_of_.resize(faces_.size());
  for (const Side& side : sides) {
    if (edges_.empty() || edges_.back() != side.edge) {
      edges_.push_back(side.edge);
      first_.push_back(int(beside_.size()));
    }
    edges_of_[side.face][side.corner] = int(edges_.size()) - 1;
    beside_.push_back(side.face);
  }
  first_.push_back(int(beside_.size()));
  for (int e = 0; e < int(edges_.size()); ++e) {
    defects_.open_edges += at(e).size() == 1;
    defects_.nonmanifold_edges += at(e).size() > 2;
  }
}

/// Turns faces to agree with their neighbors across edges of exactly two faces, then turns each patch of such faces
/// outward.
void Closing::orient_patches() {
  std::vector<bool> visited(faces_.size(), false), flipped(faces_.size(), false);
  for (size_t start = 0; start < faces_.size(); ++start) {
    if (visited[start]) continue;
    visited[start] = true;
    std::vector<int> patch{int(start)};
    for (size_t next = 0; next < patch.size(); ++next)
      for (int k = 0; k < 3; ++k) {
        const int f = patch[next], a = faces_[f][k], b = faces_[f][(k + 1) % 3];
        const Faces both = at(edges_of_[f][k]);
        if (both.size() != 2) continue;
        const int other = *both.first == f ? both.first[1] : *both.first;
        if (visited[other]) continue;
        visited[other] = true;
        if (runs_along(other, a, b)) {
          flip(other);
          flipped[other] = true;
        }
        patch.push_back(other);
      }
    const double outward = outwardness(patch);
    const auto turned = std::count_if(patch.begin(), patch.end(), [&](int f) { return flipped[f]; });
    const bool inside_out = std::abs(outward) > kNegligible ? outward < 0 : 2 * turned > std::ptrdiff_t(patch.size());
    if (!inside_out) continue;
    for (int f : patch) {
      flip(f);
      flipped[f] = !flipped[f];
    }
  }
  defects_.flipped_faces = int(std::count(flipped.begin(), flipped.end(), true));
}

/// The volume of a patch, closed toward the middle of its border, relative to that of a sphere with the same area: 1
/// for a sphere, -1 for a sphere inside out.
double Closing::outwardness(const std::vector<int>& patch) const {
  Vector3d middle = Vector3d::Zero();
  double border = 0;
  for (int f : patch)
    for (int k = 0; k < 3; ++k) {
      const int a = faces_[f][k], b = faces_[f][(k + 1) % 3];
      if (at(edges_of_[f][k]).size() == 2) continue;
      const double length = (points_[b] - points_[a]).norm();
      middle += length * (points_[a] + points_[b]) / 2;
      border += length;
    }
  middle = border > 0 ? Vector3d(middle / border) : points_[faces_[patch[0]][0]];
  double volume = 0, area = 0;
  for (int f : patch) {
    const Vector3d a = points_[faces_[f][0]] - middle, b = points_[faces_[f][1]] - middle,
                   c = points_[faces_[f][2]] - middle;
    volume += a.dot(b.cross(c)) / 6;
    area += (b - a).cross(c - a).norm() / 2;
  }
  return area > 0 ? volume * std::sqrt(36 * EIGEN_PI) / std::pow(area, 1.5) : 0;
}

/// Splits the flow of open edges into loops that pass no vertex twice, and caps them.
void Closing::cap_loops() {
  std::map<int, std::vector<int>> open;  // for each vertex, where the caps go next: against the faces
  for (int e = 0; e < int(edges_.size()); ++e) {
    const auto [a, b] = edges_[e];
    int net = 0;
    for (int f : at(e)) net += runs_along(f, a, b) ? 1 : -1;
    for (int i = 0; i < std::abs(net); ++i) net > 0 ? open[b].push_back(a) : open[a].push_back(b);
  }
  for (auto& [start, ends] : open)
    while (!ends.empty()) {
      std::vector<int> path{start};
      std::unordered_map<int, size_t> place{{start, 0}};
      while (!path.empty()) {
        std::vector<int>& onward = open.at(path.back());
        if (onward.empty()) break;  // happens only at `start`, when nothing is left
        const int next = onward.back();
        onward.pop_back();
        const auto seen = place.find(next);
        if (seen == place.end()) {
          place.emplace(next, path.size());
          path.push_back(next);
          continue;
        }
        const std::vector<int> loop(path.begin() + seen->second, path.end());
        cap(loop);
        for (size_t i = seen->second + 1; i < path.size(); ++i) place.erase(path[i]);
        path.resize(seen->second + 1);
      }
    }
}

/// Fills a loop by repeatedly cutting off the corner with the shortest cut. This goes straight across a hole, and back
/// and forth between the sides of a strip. The triangles run along the loop.
void Closing::cap(const std::vector<int>& loop) {
  ++defects_.boundary_loops;
  const int count = int(loop.size());
  std::vector<int> before(count), after(count), version(count, 0);
  for (int i = 0; i < count; ++i) before[i] = (i + count - 1) % count, after[i] = (i + 1) % count;
  struct Corner {
    double cut;
    int place, version;
    bool operator<(const Corner& other) const { return std::tie(other.cut, other.place) < std::tie(cut, place); }
  };
  std::priority_queue<Corner> corners;
  const auto push = [&](int i) {
    corners.push({(points_[loop[before[i]]] - points_[loop[after[i]]]).norm(), i, ++version[i]});
  };
  for (int i = 0; i < count; ++i) push(i);
  for (int left = count; left > 2;) {
    const Corner corner = corners.top();
    corners.pop();
    const int i = corner.place;
    if (corner.version != version[i]) continue;
    faces_.push_back({loop[before[i]], loop[i], loop[after[i]]});
    version[i] = -1;
    after[before[i]] = after[i];
    before[after[i]] = before[i];
    if (--left > 2) {
      push(before[i]);
      push(after[i]);
    }
  }
}

}  // namespace

ClosedSurface close_surface(const Points& vertices, const Triangles& triangles) {
  const UnitBox box = unit_box(vertices, triangles);
  return Closing(vertices, triangles, box).result(box);
}

}  // namespace dynamorph
