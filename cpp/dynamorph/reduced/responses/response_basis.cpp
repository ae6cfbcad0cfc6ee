// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/response_basis.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/models/free_motion.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/reduced/modes/gram_accumulator.hpp"
#include "dynamorph/reduced/modes/mass_pca.hpp"
#include "dynamorph/reduced/modes/static_solver.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

/// Of the motion's size. It decides which derivatives are among the responses; 0.03 and 0.3 do nearly as well.
constexpr double kBending = 0.1;
/// Of a block of answers in the modes, relative to the one before: only where there are few bones they take part.
constexpr double kLater = 0.1;
/// Radius, relative to the body, at which rotation and stretch of a bone accelerate tissue as much as its translation.
constexpr double kRadius = 0.1;

/// Three directions at right angles (columns) that turn, and are mirrored, with the body: toward its farthest nodes.
/// Without them, random combinations of loads would depend on the axes of its bind pose.
Matrix3d own_axes(const SoftBody& body) {
  constexpr double kAlike = 1 - 1e-6;  // of nodes that are as far, the first counts
  MatrixXd left = body.rest.reshaped(3, body.rest.size() / 3).colwise() - body.center;
  Matrix3d axes = Matrix3d::Identity();
  for (int k = 0; k < 3; ++k) {
    const Eigen::RowVectorXd squares = left.colwise().squaredNorm();
    const double farthest = squares.maxCoeff();
    if (!(farthest > 1e-12 * body.size * body.size)) break;
    const auto first = std::find_if(squares.begin(), squares.end(), [&](double d) { return d >= kAlike * farthest; });
    axes.col(k) = left.col(first - squares.begin()).normalized();
    left -= axes.col(k) * (axes.col(k).transpose() * left);
  }
  return axes;
}

/// The loads (3 free, at most `most`) that accelerated bones put on the tissue for unit density, M w_b (X - c_b, 1) e:
/// twelve of each bone, as M^-1/2 times their strongest combinations.
RowMajor affine_bone_loads(const SoftBody& body, Index most) {
  const Index nodes = body.skin.rows(), bones = body.own_transforms ? 1 : body.skin.cols();
  const VectorXd volumes = body.volumes.rowwise().sum();
  MatrixXd weights = MatrixXd::Zero(nodes, bones);  // nodes with their own transforms are loaded as if by one bone
  for (Index i = 0; i < nodes; ++i)
    for (SkinWeights::InnerIterator it(body.skin, i); it; ++it) weights(i, bones > 1 ? it.col() : 0) += it.value();
  const Matrix3d axes = own_axes(body);
  const MatrixXd X = body.rest.reshaped<Eigen::RowMajor>(nodes, 3) * axes / (kRadius * width(body));
  std::vector<Eigen::Triplet<double>> entries;
  Index columns = 0;  // many bones of a rig move nothing of this body
  for (Index b = 0; b < bones; ++b) {
    const VectorXd part = weights.col(b).cwiseProduct(volumes);
    const double volume = part.sum();
    if (!(volume > 0)) continue;
    const Eigen::RowVector3d center = part.transpose() * X / volume;
    for (Index i = 0; i < nodes; ++i) {
      if (weights(i, b) == 0) continue;
      const double root = std::sqrt(volumes(i)) * weights(i, b);
      for (int axis = 0; axis < 3; ++axis)
        for (int c = 0; c < 4; ++c)
          for (int to = 0; to < 3; ++to)
            entries.emplace_back(int(3 * i + to), int(columns + 4 * axis + c),
                                 root * axes(to, axis) * (c < 3 ? X(i, c) - center(c) : 1));
    }
    columns += 12;
  }
  SparseMatrix loads(3 * nodes, columns);
  loads.setFromTriplets(entries.begin(), entries.end());
  if (loads.cols() > kManyColumns) return loads * strongest_combinations(loads, most);
  return strongest(RowMajor(loads), most);
}

/// What one target answers to loads. Columns are y = M^1/2 u.
struct Answers {
  std::unique_ptr<StaticSolver> solver;
  /// To the bones' loads, then K^-1 M times the block before, which answers loads that change. Two blocks do for a body
  /// of many bones; few bones need more.
  std::vector<RowMajor> blocks;
  RowMajor bending;  ///< to the second derivatives of the force in the modes; empty for the linear law
};

std::vector<RowMajor> answers_to(const RowMajor& loads, const StaticSolver& solver, const VectorXd& root, Index most) {
  constexpr int kBlocks = 8;
  std::vector<RowMajor> blocks;
  Index columns = 0;
  for (RowMajor block = loads; int(blocks.size()) < kBlocks && columns < 2 * most; columns += block.cols()) {
    block = root.asDiagonal() * solver.solve_all(root.asDiagonal() * block);
    block = strongest(block, most);
    const double size = block.norm();
    if (!(size > 0)) break;
    if (!blocks.empty()) block *= blocks[0].norm() / size;
    blocks.push_back(block);
  }
  return blocks;
}

/// Calls work, and reports each solve of `solver` in it as a part of the `expected` number.
template <class Work>
void count_solves(StaticSolver& solver, Index expected, const ProgressFn& progress, const Work& work) {
  Index solves = 0;
  solver.tick = [&] { report(progress, std::min(1.0, double(solves++) / double(expected))); };
  work();
  solver.tick = nullptr;
}

/// The answers of all targets that differ, without bending.
std::vector<Answers> all_answers(const FullModel& model, const VectorXd& root, Index most, const ProgressFn& progress) {
  const RowMajor loads = affine_bone_loads(model.body(), 2 * most);
  const std::vector<int> targets = distinct_targets(model.targets());
  std::vector<Answers> out(targets.size());
  run_tasks(int(targets.size()), progress, [&](int i, const ProgressFn& done) {
    out[i].solver = std::make_unique<StaticSolver>(model, targets[i]);
    count_solves(*out[i].solver, loads.cols() + 2 * most, done,
                 [&] { out[i].blocks = answers_to(loads, *out[i].solver, root, most); });
  });
  return out;
}

/// Adds the answers to the second derivatives of the force in the given motions (3 free, k).
void add_bending(const FullModel& model, const VectorXd& root, const MatrixXd& motions, Index most,
                 const ProgressFn& progress, std::vector<Answers>& answers) {
  const std::vector<int> targets = distinct_targets(model.targets());
  run_tasks(int(targets.size()), progress, [&](int i, const ProgressFn& done) {
    MatrixXd loads = force_curvatures(model, targets[i], motions);
    for (Index k = 0; k < motions.cols(); ++k) loads.col(pair_index(motions.cols(), k, k)) /= std::sqrt(2.0);
    count_solves(*answers[i].solver, loads.cols(), done, [&] {
      answers[i].bending = strongest(root.asDiagonal() * answers[i].solver->solve_all(std::move(loads)), most);
    });
  });
}

using Weighted = std::pair<double, const RowMajor*>;

RowMajor side_by_side(Index rows, const std::vector<Weighted>& blocks) {
  Index columns = 0;
  for (const auto& [weight, block] : blocks) columns += block->cols();
  RowMajor all(rows, columns);
  Index at = 0;
  for (const auto& [weight, block] : blocks) {
    all.middleCols(at, block->cols()) = weight * *block;
    at += block->cols();
  }
  return all;
}

/// What modes are made of: all blocks of answers, the first more than the later ones. Stiff targets answer less and
/// count less.
RowMajor for_modes(const std::vector<Answers>& answers, Index rows) {
  std::vector<Weighted> blocks;
  for (const Answers& each : answers)
    for (size_t k = 0; k < each.blocks.size(); ++k) blocks.emplace_back(std::pow(kLater, double(k)), &each.blocks[k]);
  return side_by_side(rows, blocks);
}

/// What responses are made of: all blocks of answers alike, and bending.
RowMajor for_responses(const std::vector<Answers>& answers, Index rows) {
  std::vector<Weighted> blocks;
  for (const Answers& each : answers)
    for (const RowMajor& block : each.blocks) blocks.emplace_back(1, &block);
  for (const Answers& each : answers)
    if (const double size = each.bending.norm(); size > 0 && !each.blocks.empty())
      blocks.emplace_back(kBending * each.blocks[0].norm() / size, &each.bending);
  return side_by_side(rows, blocks);
}

/// Progress of a part of a call, from one fraction of it to another.
ProgressFn part_of(const ProgressFn& progress, double from, double to) {
  if (!progress) return {};
  return [=](double done) { return progress(from + (to - from) * done); };
}

void remove_span(const RowMajor& orthonormal, RowMajor& columns) {
  for (int twice = 0; twice < 2; ++twice)  // the second time for round-off
    columns -= product(orthonormal, inner_products(orthonormal, columns));
}

MatrixXd orthonormalized(const MatrixXd& columns) {
  const Eigen::HouseholderQR<MatrixXd> qr(columns);
  return qr.householderQ() * MatrixXd::Identity(columns.rows(), columns.cols());
}

/// Turns W (3 free, h) into its K-orthogonal part to U, with W^T M W = I and W^T K W diagonal.
MatrixXd decoupled(const SparseMatrix& K, const VectorXd& mass, const MatrixXd& U, const MatrixXd& W) {
  const MatrixXd KU = K * U;
  const RowMajor free = W - U * (U.transpose() * KU).ldlt().solve(KU.transpose() * W);
  const MatrixXd stiffness = inner_products(free, K * free), inertia = gram(mass.cwiseSqrt().asDiagonal() * free);
  return free * Eigen::GeneralizedSelfAdjointEigenSolver<MatrixXd>(stiffness, inertia).eigenvectors();
}

/// M^1/2 times the targets' shapes, orthonormal.
MatrixXd shapes_of_targets(const FullModel& model, const VectorXd& root) {
  MatrixXd shapes(model.dofs(), Index(model.targets().size()));
  for (int j = 0; j < shapes.cols(); ++j) shapes.col(j) = root.cwiseProduct(model.target(j));
  return orthonormal(shapes);
}

/// Throws Error unless r modes hold the targets' shapes and some motion, and all fit in the cage. It speaks of modes as
/// the settings do: all of them are modes, r of them in full detail.
void check_counts(int r, int h, Index shapes, Index dofs) {
  const auto number = [](Index n) { return std::to_string(n); };
  if (r <= shapes)
    throw Error(number(r) + " modes in full detail are too few: the shapes of the targets alone take " +
                number(shapes) + ". Ask for " + number(shapes + 1) + " or more.");
  if (Index(r) + h >= dofs / 2)
    throw Error(number(Index(r) + h) + " modes and responses are too many for this cage, whose nodes can move in " +
                number(dofs) + " ways. Ask for fewer than " + number(dofs / 2) + ", or use more nodes.");
}

/// M^1/2 times the modes (3 free, r), orthonormal: the shapes, then the strongest of the candidates' motions beyond
/// them. amplitudes: of the candidates in each.
MatrixXd modes(RowMajor candidates, const MatrixXd& shapes, Index r, VectorXd& amplitudes) {
  const Index motions = r - shapes.cols();
  const VectorXd along_shapes = (shapes.transpose() * candidates).rowwise().norm();
  remove_span(shapes, candidates);
  const MatrixXd strong = strongest(candidates, motions);
  if (strong.cols() < motions)
    throw Error("The bones move this cage in only " + std::to_string(shapes.cols() + strong.cols()) + " of " +
                std::to_string(r) + " modes in full detail. Ask for fewer, or use make_basis.");
  const VectorXd sizes = strong.colwise().norm();
  amplitudes.resize(r);
  amplitudes << along_shapes, sizes;
  MatrixXd Y(shapes.rows(), r);
  Y << shapes, strong * sizes.cwiseInverse().asDiagonal();
  return orthonormalized(Y);
}

}  // namespace

ResponseBasis make_response_basis(const FullModel& model, int r, int h, const ProgressFn& progress) {
  if (h < 1) throw std::invalid_argument("h: expected at least one response, got " + std::to_string(h));
  check_no_free_motion(model.body());
  const VectorXd mass = model.body().unit_mass(), root = mass.cwiseSqrt(), inverse = root.cwiseInverse();
  const Index most = Index(r) + h;
  const MatrixXd shapes = shapes_of_targets(model, root);
  const Index motions = r - shapes.cols();
  check_counts(r, h, shapes.cols(), model.dofs());

  report(progress, 0);
  std::vector<Answers> answers = all_answers(model, root, most, part_of(progress, 0, 0.5));
  ResponseBasis basis;
  const MatrixXd Y = modes(for_modes(answers, model.dofs()), shapes, r, basis.amplitudes);
  basis.U = inverse.asDiagonal() * Y;
  if (model.material_model() != MaterialModel::linear) {
    const MatrixXd moved = basis.U.rightCols(motions) * basis.amplitudes.tail(motions).asDiagonal();
    add_bending(model, root, moved, most, part_of(progress, 0.5, 0.85), answers);
  }
  report(progress, 0.85);

  RowMajor rest = for_responses(answers, model.dofs());
  remove_span(Y, rest);
  const MatrixXd high = orthonormalized(strongest(rest, h).colwise().normalized());
  basis.W = decoupled(answers[0].solver->stiffness, mass, basis.U, inverse.asDiagonal() * high);
  if (!basis.U.allFinite() || !basis.W.allFinite())
    throw Error(
        "The modes of this soft skin are not finite numbers. Check the stiffness of its targets and build again.");
  report(progress, 1);
  return basis;
}

ResponseBasis adapt_response_basis(const FullModel& model, const MatrixXd& U, const MatrixXd& W) {
  if (U.rows() != model.dofs() || W.rows() != model.dofs())
    throw std::invalid_argument("U, W: expected " + std::to_string(model.dofs()) + " rows each, got " +
                                std::to_string(U.rows()) + " and " + std::to_string(W.rows()));
  if (W.cols() < 1 || !U.allFinite() || !W.allFinite())
    throw std::invalid_argument("U, W: expected finite numbers, and at least one response");
  SparseMatrix K = model.zero();
  for (int j : summed_at(model.targets(), 0)) values(K) += values(model.rest_stiffness(j));
  ResponseBasis basis{U, {}, decoupled(K, model.body().unit_mass(), U, W)};
  if (!basis.W.allFinite()) throw Error("The modes do not fit this soft skin. Build it again.");
  return basis;
}

}  // namespace dynamorph
