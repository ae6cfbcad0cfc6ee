// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/polynomials.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/modes/gram_accumulator.hpp"
#include "dynamorph/reduced/modes/gram_kernels.hpp"

namespace dynamorph {

namespace {

using Eigen::Index;

constexpr double kOrthonormal = 1e-8;    // norm of U^T M U - I; a computed basis has 1e-13
constexpr double kLost = 1e-6;           // relative to a target's shape
constexpr double kLostOfLargest = 1e-8;  // relative to the largest shape, for a near multiple of another

/// The sums over the tetrahedra that one target's tables are made of. Green's strain is quadratic in v,
///
///   E = sum_k v_k sym(G_k) + sum_kl v_k v_l 1/2 sym(G_k^T G_l).
///
/// With the monomials m = (v_k, v_k v_l), each tet adds B^T B to a Gram matrix, where B has the rows of its strain: the
/// trace, and the deviator, because E:E = dev:dev + 1/3 tr^2.
class TargetSums {
 public:
  TargetSums(MaterialModel material_model, Index r)
      : material_model_(material_model),
        layout_{r, material_model != MaterialModel::linear},
        r_(r),
        pairs_(layout_.pairs()),
        deviator_cols_(material_model == MaterialModel::stvk ? r + pairs_ : r),
        trace_(layout_.nonlinear ? r + pairs_ : r),
        deviator_(deviator_cols_),
        determinant_(stable() ? r : 0, pairs_, [r](Index k) { return pair_index(r, k, k); }),
        row_(std::max(5 * deviator_cols_, r + pairs_)),
        crosses_(stable() ? 9 : 0, pairs_) {}

  /// G (9, r): column k is dF/dz_k, column-major 3 x 3.
  void add(double volume, const RowMajor& G) {
    trace_row(G.data(), r_, layout_.nonlinear, std::sqrt(volume / 2), row_.data());
    trace_.add(row_.data());
    deviator_rows(G.data(), r_, material_model_ == MaterialModel::stvk, std::sqrt(volume), row_.data(), deviator_cols_);
    for (int c = 0; c < 5; ++c) deviator_.add(row_.data() + c * deviator_cols_);
    if (!stable()) return;
    crosses_of_pairs(G.data(), r_, crosses_.data());
    for (int c = 0; c < 9; ++c) {
      row_.head(r_) = volume * G.row(c);
      determinant_.add(row_.data(), crosses_.row(c).data());
    }
  }

  void tables(VectorXd& lambda, VectorXd& mu) {
    trace_.finish();
    deviator_.finish();
    determinant_.finish();
    lambda = table(trace_, layout_);
    // 1/2 mu tr(E)^2 + mu (tr E - det F + 1), which to second order is mu E:E.
    mu = stable() ? lambda : VectorXd(2.0 / 3 * lambda);
    const TableLayout summed{r_, material_model_ == MaterialModel::stvk};
    mu.head(summed.distinct()) = table(deviator_, summed) + 2.0 / 3 * lambda.head(summed.distinct());
    Index at = pairs_;
    if (stable())
      for_triples(r_, [&](Index k, Index l, Index m) { mu(at++) -= determinant_(k, pair_index(r_, l, m)); });
  }

 private:
  bool stable() const { return material_model_ == MaterialModel::stable_stvk; }

  /// Differentiates E = m^T gram m twice, symmetrized over all indices.
  VectorXd table(const GramAccumulator& gram, const TableLayout& layout) const {
    VectorXd out(layout.distinct());
    const auto pair = [&](Index k, Index l) { return r_ + pair_index(r_, k, l); };
    const auto quartic = [&](Index p, Index q) { return gram(std::min(p, q), std::max(p, q)); };
    Index at = 0;
    for_pairs(r_, [&](Index k, Index l) { out(at++) = 2 * gram(k, l); });
    if (!layout.nonlinear) return out;
    for_triples(r_, [&](Index k, Index l, Index m) {
      out(at++) = 4 * (gram(k, pair(l, m)) + gram(l, pair(k, m)) + gram(m, pair(k, l)));
    });
    for_quadruples(r_, [&](Index k, Index l, Index m, Index n) {
      out(at++) =
          4 * (quartic(pair(k, l), pair(m, n)) + quartic(pair(k, m), pair(l, n)) + quartic(pair(k, n), pair(l, m)));
    });
    return out;
  }

  MaterialModel material_model_;
  TableLayout layout_;
  Index r_, pairs_, deviator_cols_;
  GramAccumulator trace_, deviator_;
  GramAccumulator determinant_;  ///< the cubic part of det F: (k, (l, m)), k <= l <= m
  VectorXd row_;
  RowMajor crosses_;  ///< (9, pairs)
};

/// Adds the hold's U^T H U, which is quadratic about the target's shape, as K0 is.
void add_hold(const SoftBody& body, int set, const RowMajor& U, VectorXd& table) {
  MatrixXd hold = MatrixXd::Zero(U.cols(), U.cols());
  for (Index i = 0; i < body.hold_stiffness.rows(); ++i) {
    const auto rows = U.middleRows<3>(3 * i);
    hold.noalias() += body.hold_stiffness(i, set) * rows.transpose() * rows;
  }
  Index at = 0;
  for_pairs(U.cols(), [&](Index k, Index l) { table(at++) += hold(k, l); });
}

}  // namespace

bool mode_gradients(const SoftBody& body, const Element& element, Index e, const RowMajor& modes, RowMajor& G) {
  G.setZero(9, modes.cols());
  bool moves = false;
  for (int a = 0; a < 4; ++a) {
    const int i = body.free_of_node[body.mesh.tets(e, a)];
    if (i < 0) continue;
    moves = true;
    for (int c = 0; c < 3; ++c) G.middleRows<3>(3 * c) += element.gradients(c, a) * modes.middleRows<3>(3 * i);
  }
  return moves;
}

std::vector<VectorXd> target_coordinates(const SoftBody& body, const std::vector<MorphTarget>& targets,
                                         const MatrixXd& U) {
  check_size("basis", U.rows(), body.rest.size());
  if (U.cols() == 0) throw std::invalid_argument("basis: expected at least one mode");
  if (U.cols() > U.rows()) throw std::invalid_argument("basis: more modes than degrees of freedom");
  if (!U.allFinite()) throw std::invalid_argument("basis: must be finite");
  const VectorXd mass = body.unit_mass();
  const auto norm = [&](const VectorXd& u) { return std::sqrt(u.cwiseAbs2().dot(mass)); };
  const MatrixXd products = U.transpose() * mass.asDiagonal() * U;
  if (!((products - MatrixXd::Identity(U.cols(), U.cols())).norm() <= kOrthonormal))
    throw std::invalid_argument("basis: is not orthonormal in the mass for unit density");
  std::vector<VectorXd> shapes, coordinates;
  double largest = 0;
  for (const MorphTarget& target : targets) {
    shapes.push_back(body.restrict_to_free(target.displacement));
    largest = std::max(largest, norm(shapes.back()));
  }
  for (size_t j = 0; j < targets.size(); ++j) {
    coordinates.push_back(U.transpose() * mass.cwiseProduct(shapes[j]));
    const double lost = norm(U * coordinates[j] - shapes[j]);
    if (!(lost <= std::max(kLost * norm(shapes[j]), kLostOfLargest * largest)))
      throw std::invalid_argument("basis: cannot hold the shape of '" + targets[j].name + "'");
  }
  return coordinates;
}

ReducedTables reduce(const FullModel& model, const MatrixXd& U, const ProgressFn& progress,
                     const std::vector<MatrixXd>& relaxed) {
  const SoftBody& body = model.body();
  target_coordinates(body, model.targets(), U);
  ReducedTables tables;
  tables.material_model = model.material_model();
  tables.basis = U;
  const int targets = int(model.targets().size());
  const Index tets = body.mesh.tets.rows();
  tables.lambda.resize(targets);
  tables.mu.resize(targets);
  run_tasks(targets, progress, [&](int j, const ProgressFn& done) {
    const RowMajor modes = relaxed.empty() ? U : relaxed[j];  // row-major, so that a node's rows are contiguous
    TargetSums sums(model.material_model(), U.cols());
    RowMajor G;
    for (Index e = 0; e < tets; ++e) {
      if (e % 512 == 0) report(done, double(e) / tets);
      const Element& element = model.shape(j).elements[e];
      if (element.weight == 0) continue;  // a tet outside this target's region
      if (mode_gradients(body, element, e, modes, G)) sums.add(element.weight, G);
    }
    sums.tables(tables.lambda[j], tables.mu[j]);
    if (body.hold_stiffness.size() > 0) add_hold(body, model.targets()[j].set, modes, tables.mu[j]);
  });
  report(progress, 1);
  return tables;
}

}  // namespace dynamorph
