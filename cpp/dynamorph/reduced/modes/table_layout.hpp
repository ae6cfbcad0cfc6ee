// SPDX-License-Identifier: GPL-3.0-or-later
// How the numbers of an energy polynomial's table lie in memory: the order in which they are summed and folded
// (TableLayout), and the order in which a step reads K2 in single precision (panels).
#pragma once

#include <utility>

#include "dynamorph/core/types.hpp"
#include "dynamorph/reduced/modes/polynomial_kernels.hpp"

namespace dynamorph {

/// Index of the pair (k, l) of r modes in the packed upper triangle, rows first.
inline Eigen::Index pair_index(Eigen::Index r, Eigen::Index k, Eigen::Index l) {
  if (k > l) std::swap(k, l);
  return k * r - k * (k - 1) / 2 + (l - k);
}

/// A symmetric matrix (r, r) from its packed upper triangle, rows first; entry(p): the p-th number of that.
template <class Entry>
void unpack(const Entry& entry, Eigen::Ref<MatrixXd> symmetric) {
  for (Eigen::Index k = 0, p = 0; k < symmetric.rows(); ++k)
    for (Eigen::Index l = k; l < symmetric.rows(); ++l, ++p) symmetric(k, l) = symmetric(l, k) = entry(p);
}

/// Where the parts of one table lie in its vector: K0 (pairs), K1 (pairs, r), then the lower triangle of the symmetric
/// K2 (pairs, pairs), column after column. The linear law has K0 alone. Pairs of modes are the packed upper triangle,
/// rows first. In a product with K2, a pair k < l stands for both its orders.
struct TableLayout {
  Eigen::Index r;
  bool nonlinear;
  Eigen::Index pairs() const { return r * (r + 1) / 2; }
  Eigen::Index linear() const { return pairs(); }                 ///< start of K1
  Eigen::Index quadratic() const { return pairs() * (1 + r); }    ///< start of K2
  Eigen::Index quadratic(Eigen::Index p, Eigen::Index q) const {  ///< place of K2's entry (p, q), or (q, p)
    if (p < q) std::swap(p, q);
    return quadratic() + q * pairs() - q * (q - 1) / 2 + (p - q);
  }
  Eigen::Index size() const { return nonlinear ? quadratic() + pairs() * (pairs() + 1) / 2 : pairs(); }
  /// Number of coefficients that differ, because K0, K1 and K2 are the same for any order of their modes.
  Eigen::Index distinct() const {
    const Eigen::Index triples = pairs() * (r + 2) / 3;
    return nonlinear ? pairs() + triples + triples * (r + 3) / 4 : pairs();
  }
};

/// Calls visit(k, l) for each k <= l < r, with the last index fastest. The functions below do the same.
template <class Visit>
void for_pairs(Eigen::Index r, const Visit& visit) {
  for (Eigen::Index k = 0; k < r; ++k)
    for (Eigen::Index l = k; l < r; ++l) visit(k, l);
}

template <class Visit>
void for_triples(Eigen::Index r, const Visit& visit) {
  for_pairs(r, [&](Eigen::Index k, Eigen::Index l) {
    for (Eigen::Index m = l; m < r; ++m) visit(k, l, m);
  });
}

template <class Visit>
void for_quadruples(Eigen::Index r, const Visit& visit) {
  for_triples(r, [&](Eigen::Index k, Eigen::Index l, Eigen::Index m) {
    for (Eigen::Index n = m; n < r; ++n) visit(k, l, m, n);
  });
}

/// A table laid out as `layout` says, from its distinct coefficients: K0(k, l), then K1(k, l, m), then K2(k, l, m, n).
/// Each has k <= l <= m <= n, with the last index fastest.
VectorXd unfolded(const VectorXd& distinct, const TableLayout& layout);

inline Eigen::Index whole_chunks(Eigen::Index size) { return (size + kChunk - 1) / kChunk * kChunk; }

/// How many numbers add_symmetric_product reads of a symmetric matrix (size, size). size is a whole number of chunks.
inline Eigen::Index symmetric_size(Eigen::Index size) { return size * (size + kChunk) / 2; }

/// The place of entry (row, column) among them; row must not be in an earlier chunk than column. The numbers are in
/// panels of four columns. Each panel runs down from the chunk of rows that holds the diagonal, chunk after chunk and,
/// in a chunk, column after column. Diagonal chunks are stored in full.
inline Eigen::Index symmetric_index(Eigen::Index size, Eigen::Index row, Eigen::Index column) {
  const Eigen::Index c = column / kChunk, below = size - kChunk * c;
  const Eigen::Index panels = kChunk * c * size - kChunk * kChunk * c * (c - 1) / 2 + 4 * below * (column % kChunk / 4);
  return panels + 4 * kChunk * (row / kChunk - c) + kChunk * (column % 4) + row % kChunk;
}

}  // namespace dynamorph
