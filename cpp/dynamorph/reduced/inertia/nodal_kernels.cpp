// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/inertia/nodal_kernels.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

using bone_pairs::kPoses;

DYNAMORPH_INLINE DoubleW dot(const DoubleW* a, const DoubleW* b) {
  return mul_add(mul_add(a[0] * b[0], a[1], b[1]), a[2], b[2]);
}

/// y = sum_n A_n (sums_n X + U d_n) + sums_n a_n - gravity_offset. table: U (r, 3), then X; d (r, kPoses) row-major.
DYNAMORPH_INLINE void add_up(const EightNodes& nodes, const DoubleW* table, Index r, const double* d,
                             const double* sums, const double* gravity_offset, DoubleW* y) {
  DoubleW bind[kPoses][3];
  for (int n = 0; n < kPoses; ++n)
    for (int c = 0; c < 3; ++c) bind[n][c] = table[3 * r + c] * sums[n];
  for (Index k = 0; k < r; ++k)
    for (int n = 0; n < kPoses; ++n)
      for (int c = 0; c < 3; ++c) bind[n][c] = mul_add(bind[n][c], d[kPoses * k + n], table[3 * k + c]);
  for (int i = 0; i < 3; ++i) {
    y[i] = DoubleW{} - gravity_offset[i];
    for (int n = 0; n < kPoses; ++n) {
      const DoubleW* row = nodes.poses[n] + 4 * i;
      y[i] += mul_add(dot(row, bind[n]), sums[n], row[3]);
    }
  }
}

}  // namespace

void add_eight_nodes(const EightNodes& nodes, const DoubleW* table, Index r, const double* d, const double* sums,
                     const double* gravity_offset, DoubleW* __restrict modes, DoubleW* __restrict force,
                     DoubleW* __restrict mass, DoubleW* __restrict damped) {
  DoubleW y[3];
  add_up(nodes, table, r, d, sums, gravity_offset, y);
  const DoubleW* A = nodes.poses[0];
  for (Index k = 0; k < r; ++k) {
    const DoubleW* u = table + 3 * k;
    for (int i = 0; i < 3; ++i) modes[3 * k + i] = dot(A + 4 * i, u);
  }
  for (Index k = 0; k < r; ++k) {
    const DoubleW mode[3] = {modes[3 * k], modes[3 * k + 1], modes[3 * k + 2]};
    const DoubleW heavy[3] = {nodes.mass * mode[0], nodes.mass * mode[1], nodes.mass * mode[2]};
    force[k] += dot(heavy, y);
    for (Index l = k; l < r; ++l) {
      const DoubleW* other = modes + 3 * l;
      *mass++ += dot(heavy, other);
    }
    if (!damped) continue;
    const DoubleW braked[3] = {nodes.damped * mode[0], nodes.damped * mode[1], nodes.damped * mode[2]};
    for (Index l = k; l < r; ++l) {
      const DoubleW* other = modes + 3 * l;
      *damped++ += dot(braked, other);
    }
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
