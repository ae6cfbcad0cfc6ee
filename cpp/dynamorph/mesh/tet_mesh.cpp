// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/tet_mesh.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <string>

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
    const double turned = determinant(mesh, t);
    if (!(turned > 0))
      throw std::invalid_argument("tets: tet " + std::to_string(t) +
                                  (turned < 0 ? " is inside out: swap two of its indices" : " is flat"));
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

Gradients gradients_of(const Matrix3d& edges) {
  Gradients out;
  out.rightCols<3>() = edges.inverse().transpose();
  out.col(0) = -out.rightCols<3>().rowwise().sum();
  return out;
}

Gradients gradients_of(const TetMesh& mesh, Eigen::Index tet) {
  Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = mesh.nodes.row(mesh.tets(tet, k + 1)) - mesh.nodes.row(mesh.tets(tet, 0));
  return gradients_of(edges);
}

std::vector<std::pair<int, int>> face_neighbors(const Tets& tets) {
  struct Face {
    std::array<int, 3> nodes;
    int tet;
    bool operator<(const Face& other) const { return nodes < other.nodes; }
  };
  std::vector<Face> faces;
  for (int t = 0; t < tets.rows(); ++t)
    for (int k = 0; k < 4; ++k) {
      Face face{{tets(t, (k + 1) % 4), tets(t, (k + 2) % 4), tets(t, (k + 3) % 4)}, t};
      std::sort(face.nodes.begin(), face.nodes.end());
      faces.push_back(face);
    }
  std::stable_sort(faces.begin(), faces.end());
  std::vector<std::pair<int, int>> pairs;
  for (size_t i = 1; i < faces.size(); ++i)
    if (faces[i - 1].nodes == faces[i].nodes) pairs.emplace_back(faces[i - 1].tet, faces[i].tet);
  return pairs;
}

}  // namespace dynamorph
