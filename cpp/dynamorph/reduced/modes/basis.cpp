// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/basis.hpp"

#include <Spectra/SymEigsShiftSolver.h>

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/models/free_motion.hpp"
#include "dynamorph/reduced/modes/gram_accumulator.hpp"
#include "dynamorph/reduced/modes/gram_kernels.hpp"
#include "dynamorph/reduced/modes/mass_pca.hpp"
#include "dynamorph/reduced/modes/polynomials.hpp"
#include "dynamorph/reduced/modes/static_solver.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph {

namespace {

/// (M^-1/2 (K + shift M) M^-1/2)^-1, the operator that Spectra iterates with.
class InverseOperator {
 public:
  using Scalar = double;
  explicit InverseOperator(const StaticSolver& factored) : factored_(factored), root_(factored.mass.cwiseSqrt()) {}
  Eigen::Index rows() const { return root_.size(); }
  Eigen::Index cols() const { return root_.size(); }
  void set_shift(double) {}  // the factorization is already shifted
  void perform_op(const double* x, double* y) const {
    const Eigen::Map<const VectorXd> in(x, rows());
    Eigen::Map<VectorXd>(y, rows()) = root_.cwiseProduct(factored_.solve(root_.cwiseProduct(in)));
  }

 private:
  const StaticSolver& factored_;
  VectorXd root_;
};

LinearModes solve_modes(const StaticSolver& factored, const std::string& name, int k) {
  InverseOperator op(factored);
  const int n = int(op.rows());
  const int search = std::min(n, std::max(2 * k + 1, 20));
  Spectra::SymEigsShiftSolver<InverseOperator> solver(op, k, search, -factored.shift);
  solver.init();
  const auto found = solver.compute(Spectra::SortRule::LargestMagn, 1000, 1e-10);
  if (solver.info() != Spectra::CompInfo::Successful || found < k)
    throw Error("The vibration modes of target '" + name + "' were not found (" + std::to_string(found) + " of " +
                std::to_string(k) + "). Ask for fewer modes, or rebuild the cage.");
  LinearModes modes;
  modes.omega = solver.eigenvalues().cwiseMax(0).cwiseSqrt().reverse();
  modes.shapes = factored.mass.cwiseSqrt().cwiseInverse().asDiagonal() * solver.eigenvectors().rowwise().reverse();
  return modes;
}

/// The largest distance that displacements (3 free, k) together move a node. It does not depend on the axes.
double largest(const MatrixXd& u) {
  VectorXd squares = u.rowwise().squaredNorm();
  return std::sqrt(squares.reshaped(3, u.rows() / 3).colwise().sum().maxCoeff());
}

/// The inertial loads (3 free, at most kLoads) that bones put on the soft tissue for unit density. Each bone
/// accelerates along and about each axis. The loads are the strongest combinations of all bones by SVD, scaled by their
/// strength.
MatrixXd rigid_bone_loads(const SoftBody& body) {
  constexpr Eigen::Index kLoads = 24;
  const VectorXd mass = body.unit_mass();
  // Nodes with their own transforms are loaded as if one bone moved them.
  const Eigen::Index nodes = body.skin.rows(), bones = body.own_transforms ? 1 : body.skin.cols();
  const auto X = [&](Eigen::Index i) { return Vector3d(body.rest.segment<3>(3 * i)); };
  MatrixXd centers = MatrixXd::Zero(3, bones);
  VectorXd weight = VectorXd::Zero(bones), spread = weight;
  const auto for_each = [&](const auto& visit) {
    for (Eigen::Index i = 0; i < nodes; ++i)
      for (SkinWeights::InnerIterator it(body.skin, i); it; ++it)
        visit(i, bones > 1 ? it.col() : 0, it.value() * mass(3 * i));
  };
  for_each([&](Eigen::Index i, Eigen::Index b, double m) {
    weight(b) += m;
    centers.col(b) += m * X(i);
  });
  centers.array().rowwise() /= weight.transpose().array().max(1e-300);
  for_each([&](Eigen::Index i, Eigen::Index b, double m) { spread(b) += m * (X(i) - centers.col(b)).squaredNorm(); });
  spread = (spread.array() / weight.array().max(1e-300)).sqrt().max(1e-9 * body.size);

  std::vector<Eigen::Triplet<double>> entries;
  for_each([&](Eigen::Index i, Eigen::Index b, double m) {
    for (int axis = 0; axis < 3; ++axis) {
      entries.emplace_back(3 * i + axis, 6 * b + axis, m);
      // Rotation, as fast at the bone's radius as the translation.
      const Vector3d turn = m / spread(b) * Vector3d::Unit(axis).cross(X(i) - centers.col(b));
      for (int c = 0; c < 3; ++c) entries.emplace_back(3 * i + c, 6 * b + 3 + axis, turn(c));
    }
  });
  SparseMatrix loads(3 * nodes, 6 * bones);
  loads.setFromTriplets(entries.begin(), entries.end());
  const SparseMatrix scaled = mass.cwiseSqrt().cwiseInverse().asDiagonal() * loads;
  if (loads.cols() > kManyColumns) return loads * strongest_combinations(scaled, kLoads);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(MatrixXd(scaled.transpose() * scaled));
  return loads * eigen.eigenvectors().rightCols(std::min(kLoads, loads.cols()));
}

/// Adds what tets from `first` on add to target j's part of `force_curvatures`, with the given Lame parameters.
void add_curvatures(const FullModel& model, int j, Lame lame, const RowMajor& modes, Eigen::Index first,
                    Eigen::Index end, RowMajor& sum) {
  const SoftBody& body = model.body();
  // Stable StVK is StVK with (lambda + mu, 0) minus mu det F. The second derivative of det F is the cross product.
  const double mu = model.material_model() == MaterialModel::stable_stvk ? lame.mu : 0;
  lame = {lame.lambda + mu, lame.mu - mu};
  const Eigen::Index r = modes.cols(), pairs = r * (r + 1) / 2;
  RowMajor G, stresses(6, r), forces(12, pairs), crosses(mu != 0 ? 9 : 0, pairs);
  for (Eigen::Index e = first; e < end; ++e) {
    const Element& element = model.shape(j).elements[e];
    if (element.weight == 0 || !mode_gradients(body, element, e, modes, G)) continue;
    for (int a = 0; a < 3; ++a) {
      const int b = (a + 1) % 3;
      stresses.row(a) = lame.lambda * (G.row(0) + G.row(4) + G.row(8)) + 2 * lame.mu * G.row(4 * a);
      stresses.row(3 + a) = lame.mu * (G.row(3 * a + b) + G.row(3 * b + a));
    }
    curvatures_of_pairs(G.data(), stresses.data(), r, lame.lambda, lame.mu, element.gradients.data(), forces.data());
    if (mu != 0) {
      crosses_of_pairs(G.data(), r, crosses.data());
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i)
          forces.middleRows<3>(3 * a) -= mu * element.gradients(i, a) * crosses.middleRows<3>(3 * i);
    }
    for (int a = 0; a < 4; ++a) {
      const int i = body.free_of_node[body.mesh.tets(e, a)];
      if (i >= 0) sum.middleRows<3>(3 * i) += element.weight * forces.middleRows<3>(3 * a);
    }
  }
}

/// Adds target j's part of `force_curvatures`, with the given Lame parameters.
void add_curvatures(const FullModel& model, int j, Lame lame, const RowMajor& modes, RowMajor& sum) {
  constexpr Eigen::Index kNumbers = 1 << 25;  // each part has a sum of its own, and all together this many numbers
  const Eigen::Index tets = model.body().mesh.tets.rows();
  const Eigen::Index count = std::clamp<Eigen::Index>(kNumbers / std::max<Eigen::Index>(sum.size(), 1), 1, 4);
  std::vector<RowMajor> parts(std::size_t(count), RowMajor::Zero(sum.rows(), sum.cols()));
  run_tasks(int(count), {}, [&](int part, const ProgressFn&) {
    add_curvatures(model, j, lame, modes, part * tets / count, (part + 1) * tets / count, parts[part]);
  });
  for (const RowMajor& part : parts) sum += part;
}

/// Candidate displacements about one target.
struct Candidates {
  MatrixXd modes;      ///< scaled as they respond to a slow load: phi_i / omega_i^2 (with 1 / omega_i, high modes
                       ///< crowd out the derivatives and large motions lock: docs/decisions)
  MatrixXd bending;    ///< derivatives of pairs of those modes, quadratic in their scale
  MatrixXd responses;  ///< static, to the bones' loads
  double response;     ///< how far uniform accelerations move the body, in the scale of the responses
};

Candidates candidates(const FullModel& model, int target, int k, const MatrixXd& loads, const ProgressFn& progress) {
  const bool linear = model.material_model() == MaterialModel::linear;
  const int bent = linear ? 0 : std::min(k, 10);  // stiffer modes bend too little to count
  const Eigen::Index pairs = bent * (bent + 1) / 2;
  const double expected = double(k + pairs + loads.cols() + 3 + 4 * k);  // solves; the eigensolver takes a few per mode
  double solves = 0;
  const StaticSolver factored(model, target, [&] { report(progress, std::min(1.0, solves++ / expected)); });
  const LinearModes modes = solve_modes(factored, model.targets()[target].name, k);
  // Without a bound, a part that is hardly held would swamp all others.
  const VectorXd frequencies = modes.omega.cwiseMax(1e-3 * modes.omega(k - 1));
  Candidates out{modes.shapes * frequencies.cwiseAbs2().cwiseInverse().asDiagonal(), {}, {}, 0};
  MatrixXd curvatures = -force_curvatures(model, target, out.modes.leftCols(bent));
  for (int i = 0; i < bent; ++i) curvatures.col(pair_index(bent, i, i)) /= 2;
  out.bending = factored.solve_all(std::move(curvatures));
  out.responses = factored.solve_all(loads);
  MatrixXd uniform = MatrixXd::Zero(factored.mass.size(), 3);
  for (Eigen::Index i = 0; i < uniform.rows(); ++i)
    uniform(i, i % 3) = factored.mass(i) / model.targets()[target].density;
  out.response = largest(factored.solve_all(std::move(uniform))) / std::sqrt(3.0);
  return out;
}

/// All targets' candidates as columns in common units, with rows multiplied by `root`. The softest target's first mode
/// moves by `amplitude` meters, and the first modes of the others with about the same energy. A uniform acceleration
/// moves each target as far as its first mode. Stiff targets therefore move less and count less; under the same loads
/// they would hardly count at all.
RowMajor in_common_units(const std::vector<Candidates>& candidates, double amplitude, const VectorXd& root) {
  double softest = 0;
  Eigen::Index columns = 0;
  for (const Candidates& of_target : candidates) {
    softest = std::max(softest, largest(of_target.modes.col(0)));
    columns += of_target.modes.cols() + of_target.bending.cols() + of_target.responses.cols();
  }
  RowMajor all(root.size(), columns);
  Eigen::Index column = 0;
  const auto append = [&](const MatrixXd& displacements, double scale) {
    all.middleCols(column, displacements.cols()) = (scale * root).asDiagonal() * displacements;
    column += displacements.cols();
  };
  for (const Candidates& of_target : candidates) {
    const double sway = largest(of_target.modes.col(0));
    const double distance = amplitude * std::sqrt(sway / softest);
    append(of_target.modes, distance / sway);
    append(of_target.bending, distance / sway * distance / sway);
    append(of_target.responses, distance / of_target.response);
  }
  return all;
}

}  // namespace

MatrixXd force_curvatures(const FullModel& model, int target, const MatrixXd& modes) {
  const RowMajor by_node = modes;
  const Eigen::Index pairs = modes.cols() * (modes.cols() + 1) / 2;
  RowMajor sum = RowMajor::Zero(modes.rows(), pairs);
  if (model.material_model() == MaterialModel::linear) return sum;
  for (int j : summed_at(model.targets(), target)) add_curvatures(model, j, model.targets()[j].lame, by_node, sum);
  return sum;
}

RowMajor force_curvatures_alone(const FullModel& model, int target, Lame lame, const MatrixXd& modes) {
  const RowMajor by_node = modes;
  RowMajor sum = RowMajor::Zero(modes.rows(), modes.cols() * (modes.cols() + 1) / 2);
  if (model.material_model() != MaterialModel::linear) add_curvatures(model, target, lame, by_node, sum);
  return sum;
}

LinearModes linear_modes(const FullModel& model, int target, int k) {
  if (k < 1 || k >= model.dofs())
    throw std::invalid_argument("k: expected 1 to " + std::to_string(model.dofs() - 1) + " modes, got " +
                                std::to_string(k));
  check_no_free_motion(model.body());
  return solve_modes(StaticSolver(model, target), model.targets()[target].name, k);
}

Basis make_basis(const FullModel& model, int r, const ProgressFn& progress) {
  check_no_free_motion(model.body());
  const int targets = int(model.targets().size());
  const VectorXd root = model.body().unit_mass().cwiseSqrt();  // all algebra below is in y = M^1/2 u

  MatrixXd sculpted(model.dofs(), targets);
  for (int j = 0; j < targets; ++j) sculpted.col(j) = root.cwiseProduct(model.target(j));
  const MatrixXd shapes = orthonormal(sculpted);
  if (r <= shapes.cols() || r >= model.dofs() / 2)
    throw Error(std::to_string(r) + " modes: this model needs more than " + std::to_string(shapes.cols()) +
                " (its targets' shapes) and fewer than " + std::to_string(model.dofs() / 2) +
                " (half its degrees of freedom).");

  Basis basis;
  const int k = std::min(std::max(r, 8), model.dofs() / 3);
  report(progress, 0);
  const MatrixXd loads = rigid_bone_loads(model.body());
  const std::vector<int> distinct = distinct_targets(model.targets());
  std::vector<Candidates> all_candidates(distinct.size());
  run_tasks(int(all_candidates.size()), progress,
            [&](int i, const ProgressFn& done) { all_candidates[i] = candidates(model, distinct[i], k, loads, done); });
  RowMajor all = in_common_units(all_candidates, 0.1 * width(model.body()), root);

  // Mass-PCA by the method of snapshots, on what the targets' shapes do not already span.
  const double total = all.squaredNorm();
  all.noalias() -= shapes * (shapes.transpose() * all);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(gram(all));
  const int motions = r - int(shapes.cols());
  if (eigen.eigenvalues()(all.cols() - motions) <= 1e-14 * total)
    throw Error(std::to_string(r) + " modes are more than this cage can move in. Ask for fewer.");
  MatrixXd Y(model.dofs(), r);
  Y.leftCols(shapes.cols()) = shapes;
  Y.rightCols(motions) = all * eigen.eigenvectors().rightCols(motions).rowwise().reverse();
  for (Eigen::Index c = shapes.cols(); c < r; ++c) Y.col(c).normalize();
  // Householder QR keeps the span and makes the columns orthonormal to round-off.
  const Eigen::HouseholderQR<MatrixXd> qr(Y);
  Y = qr.householderQ() * MatrixXd::Identity(Y.rows(), r);
  basis.explained_variance = 1 - std::max(0.0, eigen.eigenvalues().head(all.cols() - motions).sum()) / total;
  basis.U = root.cwiseInverse().asDiagonal() * Y;
  if (!basis.U.allFinite()) throw Error("The modes of this setup are not finite. Check its stiffness and rebuild.");
  report(progress, 1);
  return basis;
}

}  // namespace dynamorph
