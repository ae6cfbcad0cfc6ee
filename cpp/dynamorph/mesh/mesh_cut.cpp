// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/mesh_cut.hpp"

#include <algorithm>
#include <map>
#include <numeric>

#include "dynamorph/core/parallel.hpp"

namespace dynamorph {

namespace {

constexpr double kDetour = 3;  // a path longer than this many times the straight distance,
constexpr double kEdges = 4;   // and than this many times the longest edge, joins nothing
constexpr int kRounds = 5;     // of reassigning tets that a crack would cut off

/// Longest edge of every tet.
std::vector<double> sizes_of(const TetMesh& mesh) {
  std::vector<double> sizes(mesh.tets.rows(), 0.0);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t)
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < a; ++b)
        sizes[t] = std::max(sizes[t], (mesh.nodes.row(mesh.tets(t, a)) - mesh.nodes.row(mesh.tets(t, b))).norm());
  return sizes;
}

/// The mean size of the tets, to which the skin is refined.
double spacing_of(const std::vector<double>& sizes) {
  if (sizes.empty()) throw std::invalid_argument("mesh: expected at least one tet");
  return std::accumulate(sizes.begin(), sizes.end(), 0.0) / double(sizes.size());
}

bool has(const Tets& tets, int tet, int node) { return (tets.row(tet).array() == node).any(); }

}  // namespace

MeshCut::MeshCut(const TetMesh& mesh, const Points& vertices, const Triangles& triangles)
    : mesh_(mesh),
      vertices_(vertices),
      sizes_(sizes_of(mesh)),
      graph_(vertices, triangles, spacing_of(sizes_)),
      pairs_(face_neighbors(mesh.tets)) {
  owner_.resize(mesh.tets.rows());
  parallel_parts(mesh.tets.rows(), [&](Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index t = first; t < end; ++t) {
      Vector3d center = Vector3d::Zero();
      for (int node : mesh.tets.row(t)) center += mesh.nodes.row(node) / 4;
      owner_[t] = graph_.nearest(center);
    }
  });
  find_glued();
  for (int round = 0; round < kRounds && adopt_loose(); ++round) find_glued();
}

void MeshCut::find_glued() {
  std::stable_sort(pairs_.begin(), pairs_.end(), [&](auto& p, auto& q) { return owner_[p.first] < owner_[q.first]; });
  ShortestPaths paths(graph_);
  glued_.clear();
  beside_.assign(mesh_.tets.rows(), {});
  for (const auto& [a, b] : pairs_)
    if (far_apart(paths, owner_[a], owner_[b], std::max(sizes_[a], sizes_[b])))
      glued_.push_back({a, b});
    else {
      beside_[a].push_back(b);
      beside_[b].push_back(a);
    }
}

/// A crack must not cut anything off, because there is a path through the body. If it would, a few tets in the middle
/// of the body belong to the wrong skin, and they go to the skin of a neighbor. Returns whether there were any.
bool MeshCut::adopt_loose() {
  std::vector<int> group(mesh_.tets.rows(), -1), count;
  for (int seed = 0; seed < mesh_.tets.rows(); ++seed) {
    if (group[seed] >= 0) continue;
    std::vector<int> members{seed};
    group[seed] = int(count.size());
    for (size_t i = 0; i < members.size(); ++i)
      for (int other : beside_[members[i]])
        if (group[other] < 0) {
          group[other] = group[seed];
          members.push_back(other);
        }
    count.push_back(int(members.size()));
  }
  std::map<int, int> adopted;  // group -> its new owner
  for (auto [a, b] : glued_) {
    if (group[a] == group[b]) continue;
    if (count[group[a]] > count[group[b]]) std::swap(a, b);
    adopted.emplace(group[a], owner_[b]);
  }
  for (size_t t = 0; t < owner_.size(); ++t)
    if (const auto found = adopted.find(group[t]); found != adopted.end()) owner_[t] = found->second;
  return !adopted.empty();
}

bool MeshCut::far_apart(ShortestPaths& paths, int a, int b, double size) const {
  if (a < 0 || b < 0 || graph_.part(a) != graph_.part(b)) return false;
  if (paths.from() != a) paths.start(a);
  const double straight = (graph_.point(a) - graph_.point(b)).norm();
  const double bound = std::max(kDetour * straight, kEdges * size);
  return paths.to(b, bound) > bound;
}

std::vector<bool> MeshCut::glued() const {
  std::vector<bool> glued(mesh_.tets.rows(), false);
  for (const auto& [a, b] : glued_) glued[a] = glued[b] = true;
  return glued;
}

TetMesh MeshCut::cut() const {
  std::vector<std::vector<int>> around(mesh_.nodes.rows());  // the tets at each node of the crack
  std::vector<bool> on_crack(mesh_.nodes.rows(), false);
  for (const auto& [a, b] : glued_)
    for (int node : mesh_.tets.row(a))
      if (has(mesh_.tets, b, node)) on_crack[node] = true;
  for (int t = 0; t < mesh_.tets.rows(); ++t)
    for (int node : mesh_.tets.row(t))
      if (on_crack[node]) around[node].push_back(t);

  TetMesh out = mesh_;
  std::vector<int> doubled;
  for (int node = 0; node < mesh_.nodes.rows(); ++node)
    for (bool first = true; !around[node].empty(); first = false) {
      const int name = first ? node : int(mesh_.nodes.rows() + doubled.size());
      if (!first) doubled.push_back(node);
      for (int tet : take_connected(around[node]))
        for (int k = 0; k < 4; ++k)
          if (mesh_.tets(tet, k) == node) out.tets(tet, k) = name;
    }
  out.nodes.conservativeResize(mesh_.nodes.rows() + doubled.size(), 3);
  for (size_t i = 0; i < doubled.size(); ++i) out.nodes.row(mesh_.nodes.rows() + i) = mesh_.nodes.row(doubled[i]);
  return out;
}

/// Removes the first of `tets` and those connected to it, and returns them.
std::vector<int> MeshCut::take_connected(std::vector<int>& tets) const {
  std::vector<int> taken{tets.front()};
  tets.erase(tets.begin());
  for (size_t i = 0; i < taken.size(); ++i)
    for (int other : beside_[taken[i]]) {
      const auto found = std::find(tets.begin(), tets.end(), other);
      if (found == tets.end()) continue;
      taken.push_back(other);
      tets.erase(found);
    }
  return taken;
}

Embedding MeshCut::embed(const TetMesh& cut) const {
  if (cut.tets.rows() != mesh_.tets.rows()) throw std::invalid_argument("cut: it belongs to another mesh");
  ShortestPaths paths(graph_);
  return dynamorph::embed(cut, vertices_, [&](Eigen::Index vertex, int tet) {
    return !far_apart(paths, graph_.of_vertex(vertex), owner_[tet], sizes_[tet]);
  });
}

}  // namespace dynamorph
