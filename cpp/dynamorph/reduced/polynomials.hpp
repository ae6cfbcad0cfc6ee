// SPDX-License-Identifier: GPL-3.0-or-later
// Every law's energy is a polynomial of degree <= 4 in the modal coordinates (thesis eq. 5.7). About a target's own
// coordinates z_j, with v = z - z_j, its tangent is, as packed pairs (k <= l),
//
//   H(v) = K0 + K1 v + K2 (v v),
//   f = (K0 + 1/2 K1 v + 1/3 K2 (v v)) v,
//   E = v . (1/2 K0 + 1/6 K1 v + 1/12 K2 (v v)) v
//
// so one table [K0 | K1 | K2] gives energy, force and tangent from one product.
#pragma once

#include "dynamorph/models/full_model.hpp"

namespace dynamorph {

/// Index of the pair (k, l) of r modes in the packed upper triangle, rows first.
inline Eigen::Index pair_index(Eigen::Index r, Eigen::Index k, Eigen::Index l) {
  if (k > l) std::swap(k, l);
  return k * r - k * (k - 1) / 2 + (l - k);
}

/// Where the parts of one table lie in its vector: K0 (pairs), K1 (pairs, r), then the lower triangle of the symmetric
/// K2 (pairs, pairs), column after column; K0 alone for the linear law. Pairs of modes are the packed upper triangle,
/// rows first; in a product with K2 a pair k < l stands for both its orders.
struct TableLayout {
  Eigen::Index r;
  bool nonlinear;
  Eigen::Index pairs() const { return r * (r + 1) / 2; }
  Eigen::Index linear() const { return pairs(); }                 ///< start of K1
  Eigen::Index quadratic() const { return pairs() * (1 + r); }    ///< start of K2
  Eigen::Index quadratic(Eigen::Index p, Eigen::Index q) const {  ///< of K2's entry (p, q), or (q, p)
    if (p < q) std::swap(p, q);
    return quadratic() + q * pairs() - q * (q - 1) / 2 + (p - q);
  }
  Eigen::Index size() const { return nonlinear ? quadratic() + pairs() * (pairs() + 1) / 2 : pairs(); }
  /// Coefficients that differ: K0, K1 and K2 are the same for any order of their modes.
  Eigen::Index distinct() const {
    const Eigen::Index triples = pairs() * (r + 2) / 3;
    return nonlinear ? pairs() + triples + triples * (r + 3) / 4 : pairs();
  }
};

/// A table laid out as `layout` from the distinct coefficients, which are K0(k, l), then K1(k, l, m), then
/// K2(k, l, m, n), each for k <= l <= m <= n with the last index fastest.
VectorXd unfolded(const VectorXd& distinct, const TableLayout& layout);

/// What a built reduced model stores: geometry only. Each target's table for lambda = 1 Pa and mu = 1 Pa, so that
/// changing a target's stiffness is a linear recombination and never a new precompute.
struct ReducedTables {
  Law law = Law::linear;
  MatrixXd basis;                ///< U (3 free, r)
  std::vector<VectorXd> lambda;  ///< per target, the distinct coefficients as `unfolded` takes them
  std::vector<VectorXd> mu;

  TableLayout layout() const { return {basis.cols(), law != Law::linear}; }
};

/// G (9, r): column k is dF/dz_k of tet e for the modes (3 free, r), column-major 3 x 3. False if all its nodes are
/// held.
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
bool mode_gradients(const SoftBody& body, const Element& element, Eigen::Index e, const RowMajor& modes, RowMajor& G);

/// Tables of every target of `model` in the basis U (3 free, r), orthonormal in unit-density mass.
ReducedTables reduce(const FullModel& model, const MatrixXd& U, const ProgressFn& progress = {});

}  // namespace dynamorph
