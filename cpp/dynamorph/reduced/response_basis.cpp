// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/response_basis.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/basis.hpp"
#include "dynamorph/reduced/mass_pca.hpp"
#include "dynamorph/reduced/static_solver.hpp"
#include "dynamorph/reduced/table_layout.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

/// Of the motion's size. It decides which derivatives are among the responses; 0.03 and 0.3 do nearly as well.
constexpr double kBending = 0.1;
/// Of a block of answers in the modes, relative to the one before: only where there are few bones they take part.
constexpr double kLater = 0.1;
/// Radius, relative to the body, at which rotation and stretch of a bone accelerate tissue as much as its translation.
constexpr double kRadius = 0.1;

/// The loads (3 free, at most `most`) that accelerated bones put on the tissue for unit density, M w_b (X - c_b, 1) e:
/// twelve of each bone, as M^-1/2 times their strongest combinations.
RowMajor bone_loads(const SoftBody& body, Index most) {
  const Index nodes = body.skin.rows(), bones = body.own_transforms ? 1 : body.skin.cols();
  const VectorXd volumes = body.volumes.rowwise().sum();
  MatrixXd weights = MatrixXd::Zero(nodes, bones);  // nodes with their own transforms are loaded as if by one bone
  for (Index i = 0; i < nodes; ++i)
    for (SkinWeights::InnerIterator it(body.skin, i); it; ++it) weights(i, bones > 1 ? it.col() : 0) += it.value();
  const MatrixXd X = body.rest.reshaped<Eigen::RowMajor>(nodes, 3);
  RowMajor loads = RowMajor::Zero(3 * nodes, 12 * bones);
  for (Index b = 0; b < bones; ++b) {
    const VectorXd part = weights.col(b).cwiseProduct(volumes);
    const double volume = part.sum();
    if (!(volume > 0)) continue;
    const Eigen::RowVector3d centre = part.transpose() * X / volume;
    for (Index i = 0; i < nodes; ++i)
      for (int axis = 0; axis < 3; ++axis)
        for (int c = 0; c < 4; ++c)
          loads(3 * i + axis, 12 * b + 4 * axis + c) =
              std::sqrt(volumes(i)) * weights(i, b) * (c < 3 ? (X(i, c) - centre(c)) / (kRadius * body.size) : 1);
  }
  return strongest(loads, most);
}

/// M^1/2 times static answers at one target, block after block: to the bones' loads, then K^-1 M times the block
/// before, which answers loads that change. Two blocks do for a body of many bones; few bones need more.
std::vector<RowMajor> answers(const StaticSolver& solver, const VectorXd& root, const RowMajor& loads, Index most) {
  constexpr int kBlocks = 8;
  std::vector<RowMajor> out;
  Index columns = 0;
  for (RowMajor block = loads; int(out.size()) < kBlocks && columns < 2 * most; columns += block.cols()) {
    block = root.asDiagonal() * solver.solve_all(root.asDiagonal() * block);
    block = strongest(block, most);
    if (!out.empty()) block *= out[0].norm() / block.norm();
    out.push_back(block);
  }
  return out;
}

/// M^1/2 times the static answers to the second derivatives of the force in the given motions (3 free, k).
RowMajor bending(const FullModel& model, int target, const StaticSolver& solver, const VectorXd& root,
                 const MatrixXd& motions) {
  MatrixXd loads = force_curvatures(model, target, motions);
  for (Index i = 0; i < motions.cols(); ++i) loads.col(pair_index(motions.cols(), i, i)) /= 2;
  return root.asDiagonal() * solver.solve_all(std::move(loads));
}

RowMajor side_by_side(const std::vector<RowMajor>& blocks, const std::vector<double>& scales) {
  Index columns = 0;
  for (const RowMajor& block : blocks) columns += block.cols();
  RowMajor all(blocks[0].rows(), columns);
  for (size_t i = 0, at = 0; i < blocks.size(); at += blocks[i].cols(), ++i)
    all.middleCols(at, blocks[i].cols()) = scales[i] * blocks[i];
  return all;
}

/// Progress of a part of a call, from one fraction of it to another.
ProgressFn part_of(const ProgressFn& progress, double from, double to) {
  if (!progress) return {};
  return [=](double done) { return progress(from + (to - from) * done); };
}

void remove_span(const MatrixXd& orthonormal, RowMajor& columns) {
  for (int twice = 0; twice < 2; ++twice)  // the second time for round-off
    columns.noalias() -= orthonormal * (orthonormal.transpose() * columns);
}

MatrixXd orthonormalized(const MatrixXd& columns) {
  const Eigen::HouseholderQR<MatrixXd> qr(columns);
  return qr.householderQ() * MatrixXd::Identity(columns.rows(), columns.cols());
}

/// Turns W (3 free, h) into its K-orthogonal part to U, with W^T M W = I and W^T K W diagonal.
MatrixXd decoupled(const SparseMatrix& K, const VectorXd& mass, const MatrixXd& U, const MatrixXd& W) {
  const MatrixXd KU = K * U;
  const MatrixXd free = W - U * (U.transpose() * KU).ldlt().solve(KU.transpose() * W);
  const MatrixXd stiffness = free.transpose() * (K * free), inertia = free.transpose() * mass.asDiagonal() * free;
  return free * Eigen::GeneralizedSelfAdjointEigenSolver<MatrixXd>(stiffness, inertia).eigenvectors();
}

}  // namespace

ResponseBasis make_response_basis(const FullModel& model, int r, int h, const ProgressFn& progress) {
  if (h < 1) throw std::invalid_argument("h: expected at least one response, got " + std::to_string(h));
  const VectorXd mass = unit_mass(model.body()), root = mass.cwiseSqrt();
  const int targets = int(model.targets().size()), most = r + h;
  MatrixXd sculpted(model.dofs(), targets);
  for (int j = 0; j < targets; ++j) sculpted.col(j) = root.cwiseProduct(model.target(j));
  const MatrixXd shapes = orthonormal(sculpted);
  const Index motions = r - shapes.cols();
  if (motions < 1 || most >= model.dofs() / 2)
    throw Error("A detail of " + std::to_string(most) + " (" + std::to_string(r) +
                " tabulated): this model needs more tabulated modes than " + std::to_string(shapes.cols()) +
                " (its targets' shapes) and fewer in all than " + std::to_string(model.dofs() / 2) +
                " (half its degrees of freedom).");

  report(progress, 0);
  const RowMajor loads = bone_loads(model.body(), 2 * most);
  const std::vector<int> distinct = distinct_targets(model.targets());
  std::vector<std::unique_ptr<StaticSolver>> solvers(distinct.size());
  std::vector<std::vector<RowMajor>> found(distinct.size());
  run_tasks(int(distinct.size()), part_of(progress, 0, 0.5), [&](int i, const ProgressFn& done) {
    double solves = 0;
    const double expected = double(loads.cols() + 2 * most);
    solvers[i] =
        std::make_unique<StaticSolver>(model, distinct[i], [&] { report(done, std::min(1.0, solves++ / expected)); });
    found[i] = answers(*solvers[i], root, loads, most);
    solvers[i]->tick = nullptr;
  });
  std::vector<RowMajor> blocks;
  std::vector<double> of_modes, scales;  // of the blocks
  for (const auto& those : found)
    for (size_t k = 0; k < those.size(); ++k) {
      blocks.push_back(those[k]);
      of_modes.push_back(std::pow(kLater, double(k)));
      scales.push_back(1);
    }

  // Stiff targets answer less and count less.
  ResponseBasis basis;
  RowMajor all = side_by_side(blocks, of_modes);
  const VectorXd along_shapes = (shapes.transpose() * all).rowwise().norm();
  remove_span(shapes, all);
  MatrixXd low = strongest(all, motions);
  if (low.cols() < motions)
    throw Error(std::to_string(r) + " modes are more than this cage can move in. Ask for fewer.");
  const VectorXd sizes = low.colwise().norm();
  basis.amplitudes.resize(r);
  basis.amplitudes << along_shapes, sizes;
  MatrixXd Y(model.dofs(), r);
  Y << shapes, low * sizes.cwiseInverse().asDiagonal();
  Y = orthonormalized(Y);
  basis.U = root.cwiseInverse().asDiagonal() * Y;

  if (model.law() != Law::linear) {
    const MatrixXd moved = root.cwiseInverse().asDiagonal() * low;
    std::vector<RowMajor> bent(distinct.size());
    run_tasks(int(distinct.size()), part_of(progress, 0.5, 0.8), [&](int i, const ProgressFn&) {
      bent[i] = strongest(bending(model, distinct[i], *solvers[i], root, moved), most);
    });
    for (size_t i = 0; i < bent.size(); ++i) {
      scales.push_back(kBending * found[i][0].norm() / bent[i].norm());
      blocks.push_back(std::move(bent[i]));
    }
  }
  all = side_by_side(blocks, scales);
  remove_span(Y, all);
  report(progress, 0.85);
  const MatrixXd high = orthonormalized(strongest(all, h).colwise().normalized());
  basis.W = decoupled(solvers[0]->stiffness, mass, basis.U, root.cwiseInverse().asDiagonal() * high);
  if (!basis.U.allFinite() || !basis.W.allFinite())
    throw Error("The modes of this setup are not finite. Check its stiffness and rebuild.");
  report(progress, 1);
  return basis;
}

}  // namespace dynamorph
