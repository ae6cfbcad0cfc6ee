// SPDX-License-Identifier: GPL-3.0-or-later
// The arithmetic of modal_inertia: how the tensors of pairs of bones (bone_pairs.hpp) are contracted.
// Lanes are eight pairs in single precision; tests use one pair in double.
#pragma once

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::bone_pairs {

constexpr int kMoments = 4, kPoses = 5;  ///< as in InertialTarget
constexpr int kRigid = 12, kSymmetric = 6, kSkew = 3;

/// Number of entries of a pair's tensor.
constexpr Index entries(Index r) { return (kRigid + kSymmetric) * r + (kSymmetric + kSkew) * (r * (r - 1) / 2); }

/// The coefficients that the tensor of each lane's pair is contracted with.
template <class Lanes>
struct Coefficients {
  Lanes rigid[kRigid];                              ///< of the rest positions, and of the weights alone
  Lanes differences[kMoments][kSymmetric + kSkew];  ///< of the modes, for each backward difference
  Lanes mass[kSymmetric];
};

/// Splits G into the symmetric and skew parts that the tensors are stored by: xx yy zz, xy yz zx; xy yz zx.
template <class Lanes>
DYNAMORPH_INLINE void split(const Lanes G[3][4], Lanes* parts) {
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    parts[i] = G[i][i];
    parts[3 + i] = G[i][j] + G[j][i];
    parts[6 + i] = G[i][j] - G[j][i];
  }
}

/// G = R^T D in the first columns.
template <class Lanes>
DYNAMORPH_INLINE void to_bind(const Lanes R[3][3], const Lanes* D, int columns, Lanes G[3][4]) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < columns; ++j) G[i][j] = mul_add(mul_add(R[0][i] * D[j], R[1][i], D[4 + j]), R[2][i], D[8 + j]);
}

/// The coefficients of the rest positions alone. motion: the bones, and what moves the rest positions.
template <class Lanes>
DYNAMORPH_INLINE void contract_rigid_bones(const Lanes (*motion)[12], const Lanes& sign, Coefficients<Lanes>& out) {
  Lanes R[3][3], G[3][4];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R[i][j] = sign * motion[0][4 * i + j];
  to_bind(R, motion[1], 4, G);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 4; ++j) out.rigid[4 * i + j] = G[i][j];
}

/// Computes the coefficients from the motions of eight pairs, entry after entry. sign: 1 for one bone, with a mass
/// counted by how far the bone is from rigid; -1 for two.
template <class Lanes>
DYNAMORPH_INLINE void contract_bones(const Lanes (*motion)[12], const Lanes& sign, Coefficients<Lanes>& out) {
  Lanes R[3][3], G[3][4];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R[i][j] = sign * motion[0][4 * i + j];
  for (int m = 0; m <= kMoments; ++m) {
    to_bind(R, motion[m], m == 1 ? 4 : 3, G);
    if (m == 0)
      for (int i = 0; i < 3; ++i) {
        out.mass[i] = G[i][i] - (0.5F + 0.5F * sign);
        out.mass[3 + i] = 2 * G[i][(i + 1) % 3];
      }
    else
      split(G, out.differences[m - 1]);
    if (m == 1)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) out.rigid[4 * i + j] = G[i][j];
  }
}

/// Computes the 9 coefficients of each mode. y: each mode's backward differences.
template <class Lanes, class Number>
DYNAMORPH_INLINE void take_slopes(const Coefficients<Lanes>& c, const Number* y, Index r, Lanes* slopes) {
  for (int e = 0; e < kSymmetric + kSkew; ++e) {
    const Lanes c0 = c.differences[0][e], c1 = c.differences[1][e], c2 = c.differences[2][e], c3 = c.differences[3][e];
    for (Index l = 0; l < r; ++l) {
      const Number* difference = y + kMoments * l;
      slopes[9 * l + e] =
          mul_add(difference[0] * c0, difference[1], c1) + mul_add(difference[2] * c2, difference[3], c3);
    }
  }
}

/// force += tensors : coefficients, and with kHeavy the same for the packed mass. slopes: 9 coefficients of each mode.
template <bool kHeavy, class Lanes>
DYNAMORPH_INLINE void add_tensors(const Lanes* table, Index r, const Lanes* __restrict slopes,
                                  const Coefficients<Lanes>& c, Lanes* __restrict force, Lanes* __restrict mass) {
  constexpr int kEntries = kSymmetric + kSkew;
  for (Index k = 0; k < r; ++k) {
    const Lanes* slope = slopes + kEntries * k;
    Lanes sums[3] = {};  // independent, so that no addition waits for the one before
    for (int e = 0; e < kRigid; ++e) sums[e % 3] = mul_add(sums[e % 3], table[e], c.rigid[e]);
    table += kRigid;
    for (int e = 0; e < kSymmetric; ++e) sums[e % 3] = mul_add(sums[e % 3], table[e], slope[e]);
    // Two loops, so that each keeps its coefficients in registers.
    if (kHeavy) {
      const Lanes* row = table;
      for (Index l = k; l < r; row += l == k ? kSymmetric : kEntries, ++l) {
        Lanes heavy[2] = {};
        for (int e = 0; e < kSymmetric; ++e) heavy[e % 2] = mul_add(heavy[e % 2], row[e], c.mass[e]);
        *mass++ += heavy[0] + heavy[1];
      }
    }
    table += kSymmetric;
    for (Index l = k + 1; l < r; ++l, table += kEntries) {
      const Lanes* other_slope = slopes + kEntries * l;
      Lanes other_sums[2] = {};
      for (int e = 0; e < kSymmetric; ++e) {
        sums[e % 3] = mul_add(sums[e % 3], table[e], other_slope[e]);
        other_sums[e % 2] = mul_add(other_sums[e % 2], table[e], slope[e]);
      }
      for (int e = kSymmetric; e < kEntries; ++e) {
        sums[e % 3] = mul_add(sums[e % 3], table[e], other_slope[e]);
        other_sums[e % 2] = mul_sub(other_sums[e % 2], table[e], slope[e]);
      }
      force[l] += other_sums[0] + other_sums[1];
    }
    force[k] += (sums[0] + sums[1]) + sums[2];
  }
}

DYNAMORPH_INLINE double weigh(const double* coefficients, double b0, double b1, double b2, double b3, double b4) {
  return mul_add(
      mul_add(mul_add(mul_add(coefficients[0] * b0, coefficients[1], b1), coefficients[2], b2), coefficients[3], b3),
      coefficients[4], b4);
}

/// What one bone contributes to its pairs (BoneMotion). bones: its twelve entries in each pose. coefficients (kMoments,
/// kPoses), row-major. Only the sums are rounded, because each is as large as what it adds to the force.
template <class Single>
DYNAMORPH_INLINE void combine(const double* const* bones, const double* coefficients, const double* center,
                              const double* gravity_offset, Single (*out)[12]) {
  for (int i = 0; i < 3; ++i) {
    double first[4];  // the row of the first difference, with its translation moved to the center
    for (int j = 0; j < 4; ++j) {
      const int e = 4 * i + j;
      const double b0 = bones[0][e], b1 = bones[1][e], b2 = bones[2][e], b3 = bones[3][e], b4 = bones[4][e];
      out[0][e] = Single(b0);
      first[j] = weigh(coefficients, b0, b1, b2, b3, b4);
      for (int m = 1; m < kMoments; ++m) out[m + 1][e] = Single(weigh(coefficients + m * kPoses, b0, b1, b2, b3, b4));
    }
    first[3] += first[0] * center[0] + first[1] * center[1] + first[2] * center[2] - gravity_offset[i];
    for (int j = 0; j < 4; ++j) out[1][4 * i + j] = Single(first[j]);
  }
}

}  // namespace dynamorph::bone_pairs
