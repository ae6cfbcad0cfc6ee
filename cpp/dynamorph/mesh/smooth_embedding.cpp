// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/smooth_embedding.hpp"

#include <map>
#include <vector>

namespace dynamorph {

Eigen::SparseMatrix<double, Eigen::RowMajor> smooth_embedding(const TetMesh& mesh, const Embedding& embedding) {
  const Eigen::Index nodes = mesh.nodes.rows(), points = embedding.nodes.rows();
  const VectorXd volume = volumes(mesh);
  // F_k = sum_j x_j gradient_kj^T.
  std::vector<std::map<int, Vector3d>> gradients(nodes);
  VectorXd around = VectorXd::Zero(nodes);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) {
    const Gradients g = gradients_of(mesh, t);
    for (int a = 0; a < 4; ++a) {
      around(mesh.tets(t, a)) += volume(t);
      for (int b = 0; b < 4; ++b)
        gradients[mesh.tets(t, a)].try_emplace(mesh.tets(t, b), Vector3d::Zero()).first->second += volume(t) * g.col(b);
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index p = 0; p < points; ++p) {
    Vector3d place = Vector3d::Zero();
    for (int k = 0; k < 4; ++k) place += embedding.weights(p, k) * mesh.nodes.row(embedding.nodes(p, k)).transpose();
    for (int k = 0; k < 4; ++k) {
      const int node = embedding.nodes(p, k);
      const double weight = embedding.weights(p, k);
      entries.emplace_back(int(p), node, weight);
      const Vector3d half = 0.5 * weight / around(node) * (place - mesh.nodes.row(node).transpose());
      for (const auto& [other, gradient] : gradients[node]) entries.emplace_back(int(p), other, half.dot(gradient));
    }
  }
  Eigen::SparseMatrix<double, Eigen::RowMajor> S(points, nodes);
  S.setFromTriplets(entries.begin(), entries.end());
  return S;
}

}  // namespace dynamorph
