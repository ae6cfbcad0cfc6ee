// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/symmetry.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/bvh.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

namespace {

constexpr double kTolerance = 0.002;  // of the skin's diagonal; a wrap of 2,000 nodes is .006 away from the skin
constexpr double kNear = 0.5;         // of an edge: an end nearer to the plane is moved onto it
constexpr double kNearOutside = 0.3;  // of the outside, where that could uncover the skin
constexpr double kKept = 0.3;         // of a tet's volume: what a move leaves at least
constexpr int kRounds = 3;            // of smoothing

std::vector<bool> used_by(const Triangles& triangles, Eigen::Index vertices) {
  std::vector<bool> used(vertices, false);
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    for (int v : triangles.row(t)) used[v] = true;
  return used;
}

/// The half of a mesh above a plane, in coordinates whose `axis` counts from the plane.
class Half {
 public:
  Half(const TetMesh& mesh, const MirrorPlane& plane) : plane_(plane) {
    for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
      points_.emplace_back(mesh.nodes.row(i));
      height(int(i)) -= plane.at;
    }
    for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) {
      const Eigen::Vector4i tet = mesh.tets.row(t);
      tets_.push_back({tet[0], tet[1], tet[2], tet[3]});
    }
    move_onto_plane();
    std::vector<Corners> whole = std::move(tets_);
    tets_.clear();
    for (const Corners& tet : whole) cut(tet);
    smooth();
  }

  TetMesh with_image() const;

 private:
  using Corners = std::array<int, 4>;

  double& height(int node) { return points_[node][plane_.axis]; }
  double height(int node) const { return points_[node][plane_.axis]; }
  bool crosses(int a, int b) const { return height(a) * height(b) < 0; }
  bool is_above(const Corners& tet) const {
    return std::any_of(tet.begin(), tet.end(), [&](int node) { return height(node) > 0; });
  }
  double volume(const Corners& tet) const {
    const Vector3d& a = points_[tet[0]];
    return (points_[tet[1]] - a).cross(points_[tet[2]] - a).dot(points_[tet[3]] - a);
  }
  double nearness(int node, const std::vector<int>& around) const;
  std::vector<bool> outside() const;
  void move_onto_plane();
  void cut(const Corners& tet);
  int middle(int a, int b);
  double quality(const Corners& tet) const;
  void smooth();

  MirrorPlane plane_;
  std::vector<Vector3d> points_;
  std::vector<Corners> tets_;
  std::map<Edge, int> middles_;  ///< the point on the plane of each edge that crosses it
};

/// How near a node is to the plane, relative to an edge that crosses it: the smallest such fraction, 1 without edges.
/// around: the tets at the node.
double Half::nearness(int node, const std::vector<int>& around) const {
  double nearest = 1;
  for (int t : around)
    for (int other : tets_[t])
      if (crosses(node, other)) nearest = std::min(nearest, height(node) / (height(node) - height(other)));
  return nearest;
}

/// Whether each node is on the outside of the mesh: on a face of one tet that is not in the plane.
std::vector<bool> Half::outside() const {
  std::map<std::array<int, 3>, int> tets_at;
  for (const Corners& tet : tets_)
    for (int k = 0; k < 4; ++k) {
      std::array<int, 3> face{tet[(k + 1) % 4], tet[(k + 2) % 4], tet[(k + 3) % 4]};
      std::sort(face.begin(), face.end());
      ++tets_at[face];
    }
  std::vector<bool> out(points_.size(), false);
  const auto in_plane = [&](int node) { return height(node) == 0; };
  for (const auto& [face, count] : tets_at)
    if (count == 1 && !std::all_of(face.begin(), face.end(), in_plane))
      for (int node : face) out[node] = true;
  return out;
}

void Half::move_onto_plane() {
  std::vector<std::vector<int>> around(points_.size());
  for (size_t t = 0; t < tets_.size(); ++t)
    for (int node : tets_[t]) around[node].push_back(int(t));
  std::vector<std::pair<double, int>> near;
  const std::vector<bool> outside = this->outside();
  const auto limit = [&](int node) { return outside[node] ? kNearOutside : kNear; };
  for (size_t i = 0; i < points_.size(); ++i)
    if (const double nearest = nearness(int(i), around[i]); nearest < limit(int(i))) near.emplace_back(nearest, int(i));
  std::sort(near.begin(), near.end());
  std::vector<double> volumes(tets_.size());
  for (size_t t = 0; t < tets_.size(); ++t) volumes[t] = volume(tets_[t]);
  for (const auto& [_, node] : near) {
    if (nearness(node, around[node]) >= limit(node)) continue;  // the other ends have moved
    const double before = std::exchange(height(node), 0.0);
    for (int t : around[node])
      if (is_above(tets_[t]) && volume(tets_[t]) < kKept * volumes[t]) height(node) = before;
  }
}

/// Keeps what is above the plane. Each tet is halved at its edges in an order that all tets share, so that the halves
/// of neighbors fit together.
void Half::cut(const Corners& tet) {
  if (!is_above(tet)) return;
  std::pair<Edge, std::pair<int, int>> first{{int(points_.size()), 0}, {}};  // edge, and its places in the tet
  for (int a = 0; a < 4; ++a)
    for (int b = 0; b < a; ++b)
      if (crosses(tet[a], tet[b])) first = std::min(first, {undirected(tet[a], tet[b]), {a, b}});
  const auto& [edge, places] = first;
  if (edge.first == int(points_.size())) {
    tets_.push_back(tet);
    return;
  }
  const int node = middle(edge.first, edge.second);
  for (int place : {places.first, places.second}) {
    Corners half = tet;
    half[place] = node;
    cut(half);
  }
}

int Half::middle(int a, int b) {
  const auto [found, is_new] = middles_.emplace(Edge{a, b}, int(points_.size()));
  if (is_new) {
    const double part = height(a) / (height(a) - height(b));
    points_.push_back(points_[a] + part * (points_[b] - points_[a]));
    height(found->second) = 0;
  }
  return found->second;
}

/// Above zero, and larger the rounder the tet is.
double Half::quality(const Corners& tet) const {
  double squares = 0;
  for (int a = 0; a < 4; ++a)
    for (int b = 0; b < a; ++b) squares += (points_[tet[a]] - points_[tet[b]]).squaredNorm();
  return volume(tet) / std::pow(squares, 1.5);
}

/// Moves nodes inside, on the plane and next to it, to the middle of their neighbors where that makes the worst tet at
/// them rounder.
void Half::smooth() {
  std::vector<std::vector<int>> around(points_.size());
  for (size_t t = 0; t < tets_.size(); ++t)
    for (int node : tets_[t]) around[node].push_back(int(t));
  const std::vector<bool> fixed = outside();
  for (int round = 0; round < kRounds; ++round)
    for (size_t i = 0; i < points_.size(); ++i) {
      Vector3d sum = Vector3d::Zero();
      double worst = HUGE_VAL;
      bool near = false;
      for (int t : around[i]) {
        worst = std::min(worst, quality(tets_[t]));
        for (int node : tets_[t]) {
          near = near || height(node) == 0;
          if (node != int(i)) sum += points_[node];
        }
      }
      if (fixed[i] || !near) continue;
      const Vector3d before = points_[i];
      points_[i] = sum / (3.0 * double(around[i].size()));
      if (before[plane_.axis] == 0) height(int(i)) = 0;
      for (int t : around[i])
        if (!(quality(tets_[t]) > worst)) points_[i] = before;
    }
}

TetMesh Half::with_image() const {
  std::vector<int> number(points_.size(), -1), image, kept;
  for (const Corners& tet : tets_)
    for (int node : tet) number[node] = 0;
  for (size_t i = 0; i < points_.size(); ++i)
    if (number[i] == 0) {
      number[i] = int(kept.size());
      kept.push_back(int(i));
    }
  int count = int(kept.size());
  for (int node : kept) image.push_back(height(node) > 0 ? count++ : number[node]);
  const Eigen::Index half = Eigen::Index(tets_.size());
  TetMesh mesh{Points(count, 3), Tets(2 * half, 4)};
  for (size_t i = 0; i < kept.size(); ++i)
    for (const auto& [row, side] : {std::pair(image[i], -1.0), std::pair(int(i), 1.0)}) {
      mesh.nodes.row(row) = points_[kept[i]];
      mesh.nodes(row, plane_.axis) = plane_.at + side * height(kept[i]);
    }
  for (Eigen::Index t = 0; t < half; ++t) {
    const auto [a, b, c, d] = tets_[t];
    mesh.tets.row(t) << number[a], number[b], number[c], number[d];
    mesh.tets.row(half + t) << image[number[a]], image[number[c]], image[number[b]], image[number[d]];
  }
  return mesh;
}

}  // namespace

std::optional<MirrorPlane> mirror_plane(const Points& vertices, const Triangles& triangles) {
  check_triangles(vertices, triangles);
  const Surface skin(vertices, triangles);
  const Eigen::AlignedBox3d box = skin.box();
  const std::vector<bool> used = used_by(triangles, vertices.rows());
  for (int axis = 0; axis < 3 && triangles.rows() > 0; ++axis) {
    const MirrorPlane plane{axis, box.center()[axis]};
    std::atomic<bool> same{true};
    parallel_parts(vertices.rows(), [&](Eigen::Index first, Eigen::Index end) {
      for (Eigen::Index v = first; same && v < end; ++v)
        if (used[v] && skin.distance(plane.image(vertices.row(v))) > kTolerance * box.diagonal().norm()) same = false;
    });
    if (same) return plane;
  }
  return std::nullopt;
}

std::vector<int> mirror_images(const Points& vertices, const Triangles& triangles) {
  std::vector<int> images(vertices.rows(), -1);
  const std::optional<MirrorPlane> plane = mirror_plane(vertices, triangles);
  if (!plane) return images;
  const std::vector<bool> used = used_by(triangles, vertices.rows());
  std::vector<Bvh::Box> boxes;
  std::vector<int> points;
  Bvh::Box whole;
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    if (!used[v]) continue;
    points.push_back(int(v));
    boxes.emplace_back(Vector3d(vertices.row(v)));
    whole.extend(boxes.back());
  }
  const Bvh tree(boxes);
  parallel_parts(Eigen::Index(points.size()), [&](Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index k = first; k < end; ++k) {
      const Vector3d place = plane->image(vertices.row(points[k]));
      double best = std::pow(kTolerance * whole.diagonal().norm(), 2);
      tree.nearest(place, best, [&](int item) {
        const double square = (boxes[item].min() - place).squaredNorm();
        if (square < best) best = square, images[points[k]] = points[item];
      });
    }
  });
  return images;
}

TetMesh symmetric_like(const TetMesh& mesh, const Points& vertices, const Triangles& triangles) {
  const std::optional<MirrorPlane> plane = mirror_plane(vertices, triangles);
  if (!plane) return mesh;
  TetMesh symmetric = Half(mesh, *plane).with_image();
  return make_tet_mesh(std::move(symmetric.nodes), std::move(symmetric.tets));
}

}  // namespace dynamorph
