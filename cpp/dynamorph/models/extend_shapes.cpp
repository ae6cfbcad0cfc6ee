// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/extend_shapes.hpp"

#include <algorithm>
#include <memory>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

namespace {

constexpr double kPull = 1e4;              // of the mean nodal stiffness, per vertex
constexpr int kRounds = 300, kWiden = 10;  // of smoothing; after so many it reaches one tet farther

/// Where a shape would crush tets or turn them inside out, nodes go as those around them do, in an area that grows
/// until no tet is crushed. The surface is not met there.
VectorXd uncrushed(const SoftBody& body, VectorXd shape) {
  const Tets& tets = body.mesh.tets;
  const Eigen::Index n = body.mesh.nodes.rows();
  for (int round = 0; round < kRounds; ++round) {
    std::vector<bool> chosen = usable(body.mesh, shape);  // tets
    chosen.flip();
    if (std::find(chosen.begin(), chosen.end(), true) == chosen.end()) break;
    std::vector<bool> moves;
    for (int ring = 0; ring <= round / kWiden; ++ring) {
      moves.assign(std::size_t(n), false);
      for (Eigen::Index t = 0; t < tets.rows(); ++t)
        for (const int node : tets.row(t))
          moves[std::size_t(node)] = moves[std::size_t(node)] || chosen[std::size_t(t)];
      for (Eigen::Index t = 0; t < tets.rows(); ++t)
        for (const int node : tets.row(t)) chosen[std::size_t(t)] = chosen[std::size_t(t)] || moves[std::size_t(node)];
    }
    Points sum = Points::Zero(n, 3);  // of the displacements around each node
    VectorXd count = VectorXd::Zero(n);
    for (Eigen::Index t = 0; t < tets.rows(); ++t)
      for (const int a : tets.row(t)) {
        for (const int b : tets.row(t)) sum.row(a) += shape.segment<3>(3 * b).transpose();
        count(a) += 4;
      }
    for (const int node : body.free_nodes)
      if (moves[std::size_t(node)]) shape.segment<3>(3 * node) = sum.row(node).transpose() / count(node);
  }
  return shape;
}

}  // namespace

MatrixXd extend_shapes(const SoftBody& body, const Embedding& embedding, const MatrixXd& surfaces) {
  // A unit material will do, because the shape of the fill-in does not depend on the stiffness. The pull is so strong
  // that the surface is met to about 1e-4 where the cage can represent it.
  MorphTarget neutral;
  neutral.displacement = VectorXd::Zero(3 * body.mesh.nodes.rows());
  neutral.lame = {1, 1};
  auto whole = std::make_shared<SoftBody>(body);
  whole->region_weights.setOnes(body.mesh.tets.rows(), 1);
  whole->hold_stiffness.resize(0, 0);  // the hold acts about the target's shape, which is not known yet
  const FullModel model(whole, {neutral}, MaterialModel::linear, Blending::forces);
  SparseMatrix A = model.rest_stiffness(0);
  const double pull = kPull * A.diagonal().mean();

  check_size("surfaces", surfaces.rows(), 3 * embedding.nodes.rows());
  if (!surfaces.allFinite()) throw Error("A target's shape is not finite. Repair that shape.");
  const SparseMatrix E = embedding.matrix(body.mesh.nodes.rows());
  std::vector<Eigen::Triplet<double>> entries;
  for (int node = 0; node < E.outerSize(); ++node)
    for (SparseMatrix::InnerIterator it(E, node); it; ++it)
      if (body.free_of_node[node] >= 0)
        for (int c = 0; c < 3; ++c)
          entries.emplace_back(3 * int(it.row()) + c, 3 * body.free_of_node[node] + c, it.value());
  SparseMatrix B(surfaces.rows(), model.dofs());
  B.setFromTriplets(entries.begin(), entries.end());
  A += pull * SparseMatrix(B.transpose() * B);
  BlockCholesky<double> solver;
  if (!solver.factorize(A)) throw Error("A target's shape could not be extended into the cage. Rebuild the cage.");
  MatrixXd solution = pull * (B.transpose() * surfaces);
  solver.solve_in_place(solution);
  MatrixXd out(3 * body.mesh.nodes.rows(), surfaces.cols());
  for (Eigen::Index j = 0; j < out.cols(); ++j) out.col(j) = uncrushed(body, body.expand(solution.col(j)));
  return out;
}

}  // namespace dynamorph
