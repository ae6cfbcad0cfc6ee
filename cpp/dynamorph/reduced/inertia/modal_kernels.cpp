// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/inertia/modal_kernels.hpp"

#include "dynamorph/reduced/inertia/modal_arithmetic.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

using namespace bone_pairs;

// Two bones with a smaller part of the force than this are simplified. Together with those that ModalInertia
// leaves out for good, they change Herbert's dive (sample_blends) by 1e-4 of its motion. Skin weights below 1 %, which
// count as zero, change it more.
constexpr double kUnnoticed = 1e-7;  ///< left out, because the pose turns the bones so little against each other
constexpr double kSlight = 1e-4;     ///< counted as if the soft tissue did not move in the modes

/// The most that the coefficients of the mass can change it.
DYNAMORPH_INLINE float largest(const Coefficients<FloatW>& c) {
  FloatW squares = c.mass[0] * c.mass[0];
  for (int e = 1; e < kSymmetric; ++e) squares = mul_add(squares, c.mass[e], c.mass[e]);
  float out = 0;
  for (int lane = 0; lane < kLanes; ++lane) out = out < squares[lane] ? squares[lane] : out;
  return __builtin_sqrtf(out);
}

/// Adds the part of a force that does not depend on the coordinates.
DYNAMORPH_INLINE void add_rigid(const FloatW* table, Index r, const Coefficients<FloatW>& c, FloatW* __restrict force) {
  for (Index k = 0; k < r; ++k) {
    FloatW sums[3] = {};
    for (int e = 0; e < kRigid; ++e) sums[e % 3] = mul_add(sums[e % 3], table[e], c.rigid[e]);
    force[k] += (sums[0] + sums[1]) + sums[2];
    table += kRigid + kSymmetric + (kSymmetric + kSkew) * (r - k - 1);
  }
}

/// Adds up the neighbors, the pairs of neighbors, or the halves of each of two vectors.
DYNAMORPH_INLINE Float8 added_neighbors(const Float8& a, const Float8& b) {
  return __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14) +
         __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
}
DYNAMORPH_INLINE Float8 added_pairs(const Float8& a, const Float8& b) {
  return __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13) +
         __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
}
DYNAMORPH_INLINE Float8 added_halves(const Float8& a, const Float8& b) {
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11) +
         __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
}

}  // namespace

void add_eight_pairs(const FloatW (*motion)[12], const FloatW& sign, double largest_force, const float* y, Index r,
                     const FloatW* table, FloatW* slopes, FloatW* force, FloatW* mass) {
  Coefficients<FloatW> c;
  contract_bones(motion, sign, c);
  const float change = largest(c);
  const bool of_two_bones = largest_force < __builtin_huge_val();
  if (of_two_bones && change * largest_force < kUnnoticed) return;
  if (of_two_bones && change * largest_force < kSlight) return add_rigid(table, r, c, force);
  take_slopes(c, y, r, slopes);
  if (change > 1e-6F)  // Blender's bones are rigid only to single precision
    add_tensors<true>(table, r, slopes, c, force, mass);
  else
    add_tensors<false>(table, r, slopes, c, force, mass);
}

void add_eight_rigid_pairs(const FloatW (*motion)[12], const FloatW& sign, Index r, const FloatW* table,
                           FloatW* force) {
  Coefficients<FloatW> c;
  contract_rigid_bones(motion, sign, c);
  add_rigid(table, r, c, force);
}

void add_lanes(const FloatW* sums, Index count, float* totals) {
  for (Index i = 0; i < count; ++i, sums += kLanes) {
    Float8 four[2];
    for (int half = 0; half < 2; ++half) {
      const FloatW* v = sums + 4 * half;
      four[half] = added_pairs(added_neighbors(v[0].all, v[1].all), added_neighbors(v[2].all, v[3].all));
    }
    store(added_halves(four[0], four[1]), totals + kLanes * i);
  }
}

void combine_poses(const double* const* bones, const double* coefficients, const double* center,
                   const double* gravity_offset, float (*out)[12]) {
  combine(bones, coefficients, center, gravity_offset, out);
}

}  // namespace dynamorph::DYNAMORPH_ISA
