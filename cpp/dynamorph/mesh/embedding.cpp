// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/embedding.hpp"

#include <Eigen/SparseCholesky>
#include <cassert>
#include <cmath>
#include <vector>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/bvh.hpp"
#include "dynamorph/mesh/tet.hpp"

namespace dynamorph {

namespace {

std::vector<Tet> prepare(const TetMesh& mesh) {
  std::vector<Tet> tets;
  tets.reserve(mesh.tets.rows());
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) tets.emplace_back(mesh, t);
  return tets;
}

Bvh tree_of(const std::vector<Tet>& tets) {
  std::vector<Bvh::Box> boxes(tets.size());
  for (size_t t = 0; t < tets.size(); ++t)
    for (const Vector3d& corner : tets[t].corners) boxes[t].extend(corner);
  return Bvh(boxes);
}

/// Laplacian of the graph of tet edges, where each edge counts once for every tet that has it. Unlike the finite
/// element Laplacian, it has positive weights on slivers too, so interpolated values stay in the range of the data.
SparseMatrix graph_laplacian(const TetMesh& mesh) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(mesh.tets.rows() * 24);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t)
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b)
        if (a != b) {
          entries.emplace_back(mesh.tets(t, a), mesh.tets(t, a), 1);
          entries.emplace_back(mesh.tets(t, a), mesh.tets(t, b), -1);
        }
  SparseMatrix laplacian(mesh.nodes.rows(), mesh.nodes.rows());
  laplacian.setFromTriplets(entries.begin(), entries.end());
  return laplacian;
}

}  // namespace

Embedding embed(const TetMesh& mesh, const Points& points, const MayCarry& may_carry) {
  if (!points.allFinite()) throw Error("The surface has a NaN or infinite coordinate. Fix or delete that vertex.");
  if (points.size() > 0 && points.cwiseAbs().maxCoeff() > kFarthest)
    throw Error("The surface has a vertex too far away to compute with. Fix or delete that vertex.");
  if (mesh.tets.rows() == 0) throw std::invalid_argument("mesh: expected at least one tet");
  const std::vector<Tet> tets = prepare(mesh);
  const Bvh tree = tree_of(tets);
  struct Found {
    int tet = -1;
    Vector3d closest;
    double squared = kInfinity;  ///< distance
  };
  std::vector<Found> found(points.rows());
  const auto search = [&](Eigen::Index i, const auto& may) {
    const Vector3d p = points.row(i);
    Found nearest;
    tree.nearest(p, nearest.squared, [&](int t) {
      const Vector3d q = tets[t].closest(p);
      const double squared = (q - p).squaredNorm();
      if (squared < nearest.squared && may(t)) nearest = {t, q, squared};
    });
    return nearest;
  };
  parallel_parts(points.rows(), [&](Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index i = first; i < end; ++i) found[i] = search(i, [](int) { return true; });
  });
  for (Eigen::Index i = 0; may_carry && i < points.rows(); ++i) {
    if (may_carry(i, found[i].tet)) continue;
    const Found other = search(i, [&](int t) { return may_carry(i, t); });
    if (other.tet >= 0) found[i] = other;
  }
  Embedding e{Tets(points.rows(), 4), {points.rows(), 4}, VectorXd(points.rows())};
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    assert(found[i].tet >= 0);
    e.nodes.row(i) = mesh.tets.row(found[i].tet);
    e.weights.row(i) = tets[found[i].tet].bounded_weights(points.row(i), found[i].closest);
    e.distances[i] = std::sqrt(found[i].squared);
  }
  return e;
}

SparseMatrix Embedding::matrix(Eigen::Index node_count) const {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(weights.size());
  for (Eigen::Index i = 0; i < nodes.rows(); ++i)
    for (int k = 0; k < 4; ++k) entries.emplace_back(i, nodes(i, k), weights(i, k));
  SparseMatrix matrix(nodes.rows(), node_count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

RowMajor Embedding::interpolate(const RowMajor& values) const {
  RowMajor out(nodes.rows(), values.cols());
  for (Eigen::Index i = 0; i < nodes.rows(); ++i)
    out.row(i) = weights(i, 0) * values.row(nodes(i, 0)) + weights(i, 1) * values.row(nodes(i, 1)) +
                 weights(i, 2) * values.row(nodes(i, 2)) + weights(i, 3) * values.row(nodes(i, 3));
  return out;
}

MatrixXd extend_to_nodes(const TetMesh& mesh, const Embedding& embedding, const MatrixXd& values) {
  const SparseMatrix e = embedding.matrix(mesh.nodes.rows());
  const SparseMatrix fit = e.transpose() * e, smooth = graph_laplacian(mesh);
  const double scale = fit.diagonal().sum() / smooth.diagonal().sum();
  SparseMatrix unit(mesh.nodes.rows(), mesh.nodes.rows());
  unit.setIdentity();
  // The last term matters only on a piece of mesh without surface points, where it gives zero.
  const SparseMatrix system = fit + 1e-2 * scale * smooth + 1e-12 * unit;
  const Eigen::SimplicialLDLT<SparseMatrix> solver(system);
  if (solver.info() != Eigen::Success)
    throw Error("Surface values could not be extended into the cage. Change the cage resolution a little.");
  const MatrixXd sums = e.transpose() * values;
  MatrixXd at_nodes = MatrixXd::Zero(sums.rows(), sums.cols());
  run_tasks(int(sums.cols()), {}, [&](int c, const ProgressFn&) {  // many bones move nothing of this body
    if (!sums.col(c).isZero(0)) at_nodes.col(c) = solver.solve(sums.col(c));
  });
  return at_nodes;
}

}  // namespace dynamorph
