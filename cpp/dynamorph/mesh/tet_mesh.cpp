// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/tet_mesh.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace dynamorph {

namespace {

/// Six times the signed volume.
double determinant(const TetMesh& mesh, Eigen::Index tet) {
  const Eigen::Vector4i t = mesh.tets.row(tet);
  const Vector3d a = mesh.nodes.row(t[0]), b = mesh.nodes.row(t[1]), c = mesh.nodes.row(t[2]), d = mesh.nodes.row(t[3]);
  return (b - a).cross(c - a).dot(d - a);
}

}  // namespace

TetMesh make_tet_mesh(Points nodes, Tets tets) {
  TetMesh mesh{std::move(nodes), std::move(tets)};
  if (!(mesh.nodes.array().abs() <= kFarthest).all())
    throw std::invalid_argument("nodes: expected finite coordinates within 1e100 m");
  if (mesh.tets.size() && (mesh.tets.minCoeff() < 0 || mesh.tets.maxCoeff() >= mesh.nodes.rows()))
    throw std::invalid_argument("tets: expected node indices from 0 to " + std::to_string(mesh.nodes.rows() - 1));
  std::vector<bool> used(mesh.nodes.rows(), false);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) {
    if (!(determinant(mesh, t) > 0))
      throw std::invalid_argument("tets: tet " + std::to_string(t) + " is flat or inside out");
    for (int node : mesh.tets.row(t)) used[node] = true;
  }
  const auto unused = std::find(used.begin(), used.end(), false);
  if (unused != used.end())
    throw std::invalid_argument("nodes: node " + std::to_string(unused - used.begin()) + " belongs to no tet");
  return mesh;
}

VectorXd volumes(const TetMesh& mesh) {
  VectorXd v(mesh.tets.rows());
  for (Eigen::Index t = 0; t < v.size(); ++t) v[t] = determinant(mesh, t) / 6;
  return v;
}

}  // namespace dynamorph
