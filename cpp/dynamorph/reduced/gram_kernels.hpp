// SPDX-License-Identifier: GPL-3.0-or-later
// The sums that the reduced polynomials' tables are made of. Compiled for several instruction sets, as kernels.hpp.
#pragma once

#include <functional>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// C = sum a^T b over rows a (m) and b (n), collected in batches so that it is summed at the speed of a matrix product.
class GramAccumulator {
 public:
  /// Of one kind of row, a = b (n): of C, which is symmetric, the upper triangle.
  explicit GramAccumulator(Eigen::Index n);
  /// Of row i of C, the columns from `first(i)` on, which must not decrease with i.
  GramAccumulator(Eigen::Index m, Eigen::Index n, const std::function<Eigen::Index(Eigen::Index)>& first);

  void add(const double* row);
  void add(const double* a, const double* b);
  /// To be called before C is read.
  void finish();
  double operator()(Eigen::Index i, Eigen::Index j) const;

 private:
  std::vector<Eigen::Index> first_;  ///< column of tiles that each row of tiles starts with
  std::vector<Eigen::Index> start_;  ///< of each row of tiles in tiles_, in tiles
  Eigen::Index m_, n_, filled_ = 0;
  std::vector<double> a_, b_;  ///< the batch in panels: tiles' columns of each row, row after row; a_ is empty if a = b
  std::vector<double> tiles_;  ///< row after row of those kept, each row-major
};

/// Rows of Green's strain of a tetrahedron with the deformation gradient I + sum_k v_k G_k, over the monomials v_k and,
/// if `pairs`, v_k v_l (k <= l, packed), the coefficient of the full double sum. G (9, r) row-major, entry 3 j + i of a
/// column is G_k(i, j).
void trace_row(const double* G, Eigen::Index r, bool pairs, double scale, double* row);

/// Likewise the deviator in an orthonormal basis, five rows `stride` apart: the dot product of two columns is A:B.
void deviator_rows(const double* G, Eigen::Index r, bool pairs, double scale, double* rows, Eigen::Index stride);

/// The bilinear part of the cofactor: columns of cross (9, pairs) are G_k x G_l, tensor cross product.
void crosses_of_pairs(const double* G, Eigen::Index r, double* cross);

/// Second derivatives of StVK's force on a tetrahedron's nodes at rest: rows of out (12, pairs), node by node, are
/// d2f[G_k, G_l] for a unit volume. stresses (6, r): xx, yy, zz, xy, yz, zx of Hooke's law for each sym(G_k); gradients
/// (3, 4) column-major, of the nodes.
void curvatures_of_pairs(const double* G, const double* stresses, Eigen::Index r, double lambda, double mu,
                         const double* gradients, double* out);

}  // namespace dynamorph
