// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/nodal_kernels.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

using terms::kPoses;

DYNAMORPH_INLINE Doubles dot(const Doubles* a, const Doubles* b) {
  return mul_add(mul_add(a[0] * b[0], a[1], b[1]), a[2], b[2]);
}

/// y = sum_n A_n (sums_n X + U d_n) + sums_n a_n - gravity_offset. table: U (r, 3), then X; d (r, kPoses) row-major.
DYNAMORPH_INLINE void add_up(const EightNodes& nodes, const Doubles* table, Index r, const double* d,
                             const double* sums, const double* gravity_offset, Doubles* y) {
  Doubles bind[kPoses][3];
  for (int n = 0; n < kPoses; ++n)
    for (int c = 0; c < 3; ++c) bind[n][c] = table[3 * r + c] * sums[n];
  for (Index k = 0; k < r; ++k)
    for (int n = 0; n < kPoses; ++n)
      for (int c = 0; c < 3; ++c) bind[n][c] = mul_add(bind[n][c], d[kPoses * k + n], table[3 * k + c]);
  for (int i = 0; i < 3; ++i) {
    y[i] = Doubles{} - gravity_offset[i];
    for (int n = 0; n < kPoses; ++n) {
      const Doubles* row = nodes.poses[n] + 4 * i;
      y[i] += mul_add(dot(row, bind[n]), sums[n], row[3]);
    }
  }
}

}  // namespace

void add_eight_nodes(const EightNodes& nodes, const Doubles* table, Index r, const double* d, const double* sums,
                     const double* gravity_offset, Doubles* __restrict modes, Doubles* __restrict force,
                     Doubles* __restrict mass, Doubles* __restrict damped) {
  Doubles y[3];
  add_up(nodes, table, r, d, sums, gravity_offset, y);
  const Doubles* A = nodes.poses[0];
  for (Index k = 0; k < r; ++k) {
    const Doubles* u = table + 3 * k;
    for (int i = 0; i < 3; ++i) modes[3 * k + i] = dot(A + 4 * i, u);
  }
  for (Index k = 0; k < r; ++k) {
    const Doubles own[3] = {modes[3 * k], modes[3 * k + 1], modes[3 * k + 2]};
    const Doubles heavy[3] = {nodes.mass * own[0], nodes.mass * own[1], nodes.mass * own[2]};
    force[k] += dot(heavy, y);
    for (Index l = k; l < r; ++l) {
      const Doubles* other = modes + 3 * l;
      *mass++ += dot(heavy, other);
    }
    if (!damped) continue;
    const Doubles braked[3] = {nodes.damped * own[0], nodes.damped * own[1], nodes.damped * own[2]};
    for (Index l = k; l < r; ++l) {
      const Doubles* other = modes + 3 * l;
      *damped++ += dot(braked, other);
    }
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
