// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/extend_shapes.hpp"

#include <algorithm>
#include <memory>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

namespace {

constexpr double kPull = 1e4;     // of the mean nodal stiffness, per vertex
constexpr double kFirmer = 10;    // times, in each round, around what would be crushed
constexpr double kFirmest = 1e6;  // times: as good as rigid
constexpr int kRounds = 20;

SparseMatrix stiffness_of(const std::shared_ptr<SoftBody>& body) {
  MorphTarget neutral;
  neutral.displacement = VectorXd::Zero(3 * body->mesh.nodes.rows());
  neutral.lame = {1, 1};
  return FullModel(body, {neutral}, MaterialModel::linear, Blending::forces).rest_stiffness(0);
}

/// Nodes (3n, k) that are pulled to surfaces (3V, k). B: embedding of the surface in the free nodes.
void extend(const std::shared_ptr<SoftBody>& body, const SparseMatrix& B, double pull, const MatrixXd& surfaces,
            MatrixXd& out) {
  BlockCholesky<double> solver;
  if (!solver.factorize(stiffness_of(body) + pull * SparseMatrix(B.transpose() * B)))
    throw Error("A target's shape could not be extended into the cage. Rebuild the cage.");
  MatrixXd solution = pull * (B.transpose() * surfaces);
  solver.solve_in_place(solution);
  for (Eigen::Index j = 0; j < out.cols(); ++j) out.col(j) = body->expand(solution.col(j));
}

/// Where a shape would crush tets or turn them inside out, they and those beside them are made firmer until it does
/// not; the surface is not met there.
VectorXd uncrushed(const SoftBody& body, const SparseMatrix& B, double pull, const VectorXd& surface, MatrixXd nodes) {
  const Tets& tets = body.mesh.tets;
  auto firm = std::make_shared<SoftBody>(body);
  for (int round = 0; round < kRounds; ++round) {
    const std::vector<bool> good = usable(body.mesh, nodes.col(0));
    if (std::find(good.begin(), good.end(), false) == good.end()) break;
    std::vector<bool> at_bad(std::size_t(body.mesh.nodes.rows()));
    for (std::size_t t = 0; t < good.size(); ++t)
      if (!good[t])
        for (const int node : tets.row(Eigen::Index(t))) at_bad[std::size_t(node)] = true;
    for (Eigen::Index t = 0; t < tets.rows(); ++t)
      if (std::any_of(tets.row(t).begin(), tets.row(t).end(), [&](int node) { return at_bad[std::size_t(node)]; }))
        firm->stiffness_scale(t) = std::min(kFirmer * firm->stiffness_scale(t), kFirmest * body.stiffness_scale(t));
    extend(firm, B, pull, surface, nodes);
  }
  return nodes.col(0);
}

}  // namespace

MatrixXd extend_shapes(const SoftBody& body, const Embedding& embedding, const MatrixXd& surfaces) {
  // A unit material will do, because the shape of the fill-in does not depend on the stiffness. The pull is so strong
  // that the surface is met to about 1e-4 where the cage can represent it.
  auto whole = std::make_shared<SoftBody>(body);
  whole->region_weights.setOnes(body.mesh.tets.rows(), 1);
  whole->hold_stiffness.resize(0, 0);  // the hold acts about the target's shape, which is not known yet
  check_size("surfaces", surfaces.rows(), 3 * embedding.nodes.rows());
  if (!surfaces.allFinite()) throw Error("A target's shape is not finite. Repair that shape.");
  const SparseMatrix E = embedding.matrix(body.mesh.nodes.rows());
  std::vector<Eigen::Triplet<double>> entries;
  for (int node = 0; node < E.outerSize(); ++node)
    for (SparseMatrix::InnerIterator it(E, node); it; ++it)
      if (body.free_of_node[node] >= 0)
        for (int c = 0; c < 3; ++c)
          entries.emplace_back(3 * int(it.row()) + c, 3 * body.free_of_node[node] + c, it.value());
  SparseMatrix B(surfaces.rows(), Eigen::Index(3 * body.free_nodes.size()));
  B.setFromTriplets(entries.begin(), entries.end());
  const double pull = kPull * stiffness_of(whole).diagonal().mean();
  MatrixXd out(3 * body.mesh.nodes.rows(), surfaces.cols());
  extend(whole, B, pull, surfaces, out);
  for (Eigen::Index j = 0; j < out.cols(); ++j) out.col(j) = uncrushed(*whole, B, pull, surfaces.col(j), out.col(j));
  return out;
}

}  // namespace dynamorph
