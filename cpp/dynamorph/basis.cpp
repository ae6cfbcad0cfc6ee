// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/basis.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <Eigen/SparseCholesky>
#include <Spectra/SymEigsShiftSolver.h>

namespace dynamorph {

namespace {

using Cholesky = Eigen::SimplicialLLT<SparseMatrix>;

/// Lumped mass of every degree of freedom for unit density, all sets together (3 free).
VectorXd unit_mass(const SoftBody& body) {
  const VectorXd nodes = body.volumes.rowwise().sum();
  VectorXd mass(3 * nodes.size());
  for (Eigen::Index i = 0; i < nodes.size(); ++i) mass.segment<3>(3 * i).setConstant(nodes(i));
  return mass;
}

/// K_j + epsilon M, factored. A body without pins has rigid modes; the shift keeps K positive definite and is far
/// below the first elastic frequency.
struct Factored {
  Factored(const FullModel& model, int target)
      : mass(unit_mass(model.body()) * model.targets()[target].density) {
    SparseMatrix K = model.rest_stiffness(target);
    shift = 1e-9 * (K.diagonal().array() / mass.array()).maxCoeff();
    K.diagonal() += shift * mass;
    solver.compute(K);
    if (solver.info() != Eigen::Success)
      throw Error("target '" + model.targets()[target].name +
                  "' has a shape with degenerate elements: smooth its sculpt or raise the cage resolution");
  }
  VectorXd mass;  ///< (3 free), kg
  double shift;   ///< 1/s^2
  Cholesky solver;
};

/// (M^-1/2 (K + shift M) M^-1/2)^-1, the operator that Spectra iterates with.
class InverseOperator {
 public:
  using Scalar = double;
  explicit InverseOperator(const Factored& factored)
      : factored_(factored), root_(factored.mass.cwiseSqrt()) {}
  Eigen::Index rows() const { return root_.size(); }
  Eigen::Index cols() const { return root_.size(); }
  void set_shift(double) {}  // the factorisation is already shifted
  void perform_op(const double* x, double* y) const {
    const Eigen::Map<const VectorXd> in(x, rows());
    Eigen::Map<VectorXd>(y, rows()) = root_.cwiseProduct(factored_.solver.solve(root_.cwiseProduct(in)));
  }

 private:
  const Factored& factored_;
  VectorXd root_;
};

LinearModes solve_modes(const Factored& factored, const std::string& name, int k) {
  InverseOperator op(factored);
  const int n = int(op.rows());
  const int search = std::min(n, std::max(2 * k + 1, 20));
  Spectra::SymEigsShiftSolver<InverseOperator> solver(op, k, search, -factored.shift);
  solver.init();
  const auto found = solver.compute(Spectra::SortRule::LargestMagn, 1000, 1e-10);
  if (solver.info() != Spectra::CompInfo::Successful || found < k)
    throw Error("the vibration modes of target '" + name + "' were not found (" + std::to_string(found) + " of " +
                std::to_string(k) + "): ask for fewer modes or rebuild the cage");
  LinearModes modes;
  modes.frequencies = solver.eigenvalues().cwiseMax(0).cwiseSqrt().reverse();
  modes.shapes = factored.mass.cwiseSqrt().cwiseInverse().asDiagonal() * solver.eigenvectors().rowwise().reverse();
  return modes;
}

double largest(const Eigen::Ref<const VectorXd>& x) { return x.cwiseAbs().maxCoeff(); }

/// Candidate displacements about one target, each scaled to the amplitude it is expected to have when the lowest mode
/// moves by `amplitude` metres: modes by omega_1 / omega_i, derivatives by the product of their modes' amplitudes.
MatrixXd candidates(const FullModel& model, int target, int k, double amplitude, VectorXd& frequencies) {
  const Factored factored(model, target);
  const LinearModes modes = solve_modes(factored, model.targets()[target].name, k);
  frequencies = modes.frequencies;
  const double floor = 1e-3 * frequencies(k - 1);  // rigid modes of an unpinned body would swamp all others
  MatrixXd scaled(modes.shapes.rows(), k);
  const double reference = amplitude / largest(modes.shapes.col(0)) * std::max(frequencies(0), floor);
  for (int i = 0; i < k; ++i) scaled.col(i) = reference / std::max(frequencies(i), floor) * modes.shapes.col(i);

  std::vector<VectorXd> columns;
  const int bending = std::min(k, 10);  // derivatives of stiffer modes are too small to be kept
  for (int i = 0; model.law() != Law::linear && i < bending; ++i)
    for (int j = 0; j <= i; ++j)
      columns.push_back((i == j ? -0.5 : -1.0) *
                        factored.solver.solve(model.force_curvature(target, scaled.col(i), scaled.col(j))));

  // Static response to each bone accelerating along each axis: what gravity and sudden stops excite first.
  const SkinWeights& skin = model.body().skin;
  const VectorXd bone_share = skin.transpose() * VectorXd::Ones(skin.rows());
  VectorXd uniform = VectorXd::Zero(factored.mass.size());
  for (Eigen::Index i = 2; i < uniform.size(); i += 3) uniform(i) = factored.mass(i);
  const double pull = amplitude / largest(factored.solver.solve(uniform));
  const Eigen::SparseMatrix<double> by_bone = skin;
  for (Eigen::Index b = 0; b < by_bone.outerSize(); ++b) {
    if (bone_share(b) < 0.002 * double(skin.rows())) continue;
    for (int axis = 0; axis < 3; ++axis) {
      VectorXd load = VectorXd::Zero(factored.mass.size());
      for (Eigen::SparseMatrix<double>::InnerIterator it(by_bone, b); it; ++it)
        load(3 * it.row() + axis) = it.value() * factored.mass(3 * it.row());
      columns.push_back(pull * factored.solver.solve(load));
    }
  }

  MatrixXd out(scaled.rows(), k + Eigen::Index(columns.size()));
  out.leftCols(k) = scaled;
  for (size_t c = 0; c < columns.size(); ++c) out.col(k + c) = columns[c];
  return out;
}

/// Orthonormal basis of the columns' span, relative rank tolerance 1e-9.
MatrixXd orthonormal(const MatrixXd& columns) {
  MatrixXd unit = columns;
  for (Eigen::Index c = 0; c < unit.cols(); ++c)
    if (unit.col(c).norm() > 0) unit.col(c).normalize();
  const Eigen::JacobiSVD<MatrixXd, Eigen::HouseholderQRPreconditioner> svd(
      unit, Eigen::ComputeThinU);
  const Eigen::Index rank = (svd.singularValues().array() > 1e-9).count();
  return svd.matrixU().leftCols(rank);
}

}  // namespace

LinearModes linear_modes(const FullModel& model, int target, int k) {
  if (k < 1 || k >= model.dofs())
    throw std::invalid_argument("k: expected 1 to " + std::to_string(model.dofs() - 1) + " modes, got " +
                                std::to_string(k));
  return solve_modes(Factored(model, target), model.targets()[target].name, k);
}

Basis make_basis(const FullModel& model, int r, const ProgressFn& progress) {
  const int targets = int(model.targets().size());
  const VectorXd root = unit_mass(model.body()).cwiseSqrt();  // all algebra below is in y = M^1/2 u

  MatrixXd sculpted(model.dofs(), targets);
  for (int j = 0; j < targets; ++j) sculpted.col(j) = root.cwiseProduct(model.target(j));
  const MatrixXd shapes = orthonormal(sculpted);
  if (r <= shapes.cols() || r >= model.dofs() / 2)
    throw Error(std::to_string(r) + " modes: this model needs more than " + std::to_string(shapes.cols()) +
                " (its targets' shapes) and fewer than " + std::to_string(model.dofs() / 2) +
                " (half its degrees of freedom)");

  Basis basis;
  basis.frequencies.resize(targets);
  const int k = std::min(std::max(r, 8), model.dofs() / 3);
  MatrixXd all(model.dofs(), 0);
  for (int j = 0; j < targets; ++j) {
    report(progress, double(j) / (targets + 1));
    const MatrixXd some = root.asDiagonal() * candidates(model, j, k, 0.1 * model.body().size, basis.frequencies[j]);
    all.conservativeResize(Eigen::NoChange, all.cols() + some.cols());
    all.rightCols(some.cols()) = some;
  }
  report(progress, double(targets) / (targets + 1));

  // Mass-PCA by the method of snapshots on what the targets' shapes do not already span.
  const double total = all.squaredNorm();
  all -= shapes * (shapes.transpose() * all);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(all.transpose() * all);
  const int motions = r - int(shapes.cols());
  if (eigen.eigenvalues()(all.cols() - motions) <= 1e-14 * total)
    throw Error(std::to_string(r) + " modes are more than this cage can move in: ask for fewer");
  MatrixXd Y(model.dofs(), r);
  Y.leftCols(shapes.cols()) = shapes;
  Y.rightCols(motions) = all * eigen.eigenvectors().rightCols(motions).rowwise().reverse();
  for (Eigen::Index c = shapes.cols(); c < r; ++c) Y.col(c).normalize();
  // Householder QR leaves the span and makes the columns orthonormal to round-off.
  const Eigen::HouseholderQR<MatrixXd> qr(Y);
  Y = qr.householderQ() * MatrixXd::Identity(Y.rows(), r);
  basis.captured = 1 - std::max(0.0, eigen.eigenvalues().head(all.cols() - motions).sum()) / total;
  basis.U = root.cwiseInverse().asDiagonal() * Y;
  report(progress, 1);
  return basis;
}

}  // namespace dynamorph
