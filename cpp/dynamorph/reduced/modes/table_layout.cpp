// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph {

using Eigen::Index;

VectorXd unfolded(const VectorXd& distinct, const TableLayout& layout) {
  const Index r = layout.r, pairs = layout.pairs();
  VectorXd out(layout.size());
  out.head(pairs) = distinct.head(pairs);
  if (!layout.nonlinear) return out;
  const double* next = distinct.data() + pairs;
  const auto pair = [&](Index k, Index l) { return pair_index(r, k, l); };
  for_triples(r, [&](Index k, Index l, Index m) {
    double* K1 = out.data() + layout.linear();
    K1[k * pairs + pair(l, m)] = K1[l * pairs + pair(k, m)] = K1[m * pairs + pair(k, l)] = *next++;
  });
  for_quadruples(r, [&](Index k, Index l, Index m, Index n) {
    const auto K2 = [&](Index p, Index q) -> double& { return out(layout.quadratic(p, q)); };
    K2(pair(k, l), pair(m, n)) = K2(pair(k, m), pair(l, n)) = K2(pair(k, n), pair(l, m)) = *next++;
  });
  return out;
}

}  // namespace dynamorph
