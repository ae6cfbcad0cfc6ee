// SPDX-License-Identifier: GPL-3.0-or-later
// The arithmetic of modal_inertia: tensors of bones and of pairs of bones, and what they are contracted with. Lanes are
// eight terms, or eight characters, in single precision; tests take one term in double.
#pragma once

#include <vector>

#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::terms {

using Eigen::Index;
constexpr int kRigid = 12, kSymmetric = 6, kSkew = 3;

/// Entries of a term's tensor.
constexpr Index entries(Index r) { return (kRigid + kSymmetric) * r + (kSymmetric + kSkew) * (r * (r - 1) / 2); }

/// visit(node, bones, volume) for the bones (b, b) of every node and the pairs (b, c), b < c, that share it.
template <class Visit>
void for_each_term(const SoftBody& body, int set, const Visit& visit) {
  for (Index i = 0; i < body.skin.rows(); ++i)
    for (SkinWeights::InnerIterator b(body.skin, i); b; ++b)
      for (SkinWeights::InnerIterator c(body.skin, i); c; ++c)
        if (b.col() <= c.col())
          visit(i, std::pair(int(b.col()), int(c.col())),
                body.volumes(i, set) * b.value() * (b.col() == c.col() ? 1 : c.value()));
}

/// One node's tensor in the order of add_terms: U (3, r) of the node, X its rest position.
inline void node_tensor(const Eigen::Ref<const Eigen::Matrix3Xd>& U, const Vector3d& X, VectorXd& out) {
  double* entry = out.data();
  for (Index k = 0; k < U.cols(); ++k) {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 4; ++j) *entry++ = U(i, k) * (j < 3 ? X(j) : 1);
    for (Index l = k; l < U.cols(); ++l) {
      for (int i = 0; i < 3; ++i) *entry++ = U(i, k) * U(i, l);
      for (double sign : {1.0, -1.0})
        for (int i = 0, j = 1; i < 3 && (sign > 0 || l > k); ++i, j = (i + 1) % 3)
          *entry++ = 0.5 * (U(i, k) * U(j, l) + sign * U(j, k) * U(i, l));
    }
  }
}

/// Of each lane's term: coefficients that their tensors are contracted with.
template <class Lanes>
struct Coefficients {
  Lanes rigid[kRigid];                                              ///< of the rest positions, and of the weights alone
  Lanes differences[InertialTarget::kMoments][kSymmetric + kSkew];  ///< of the modes, for each backward difference
  Lanes mass[kSymmetric];
};

/// Shares of the backward differences q_0, q_0 - q_1, q_0 - 2 q_1 + q_2, ... instead of the coordinates themselves.
/// Each has the size of what it adds to the force, which therefore keeps its digits in single precision.
using Shares = Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses, Eigen::RowMajor>;
inline Shares shares_of_differences(
    const Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses>& coefficients) {
  Eigen::Matrix4d binomials;
  binomials << 1, 1, 1, 1, 0, -1, -2, -3, 0, 0, 1, 3, 0, 0, 0, -1;
  return binomials * coefficients;
}

/// Backward differences of each mode, one after another.
template <class Number>
void take_differences(const InertialTarget& inertial, std::vector<Number>& y) {
  const VectorXd &q0 = *inertial.q[0], &q1 = *inertial.q[1], &q2 = *inertial.q[2], &q3 = *inertial.q[3];
  y.clear();
  for (Index k = 0; k < q0.size(); ++k)
    for (double difference : {q0(k), q0(k) - q1(k), q0(k) - 2 * q1(k) + q2(k), q0(k) - 3 * q1(k) + 3 * q2(k) - q3(k)})
      y.push_back(Number(difference));
}

/// Symmetric and skew parts that the tensors are stored by: xx yy zz, xy yz zx; xy yz zx.
template <class Lanes>
DYNAMORPH_INLINE void split(const Lanes G[3][4], Lanes* parts) {
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    parts[i] = G[i][i];
    parts[3 + i] = G[i][j] + G[j][i];
    parts[6 + i] = G[i][j] - G[j][i];
  }
}

/// From eight terms' own motions, entry after entry. sign: 1 of a bone, whose mass counts by how far it is from rigid;
/// -1 of a pair.
template <class Lanes>
DYNAMORPH_INLINE void contract_bones(const Lanes (*motion)[12], const Lanes& sign, Coefficients<Lanes>& out) {
  Lanes R[3][3], G[3][4];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R[i][j] = sign * motion[0][4 * i + j];
  for (int m = 0; m <= InertialTarget::kMoments; ++m) {
    const Lanes* D = motion[m];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < (m == 1 ? 4 : 3); ++j) G[i][j] = R[0][i] * D[j] + R[1][i] * D[4 + j] + R[2][i] * D[8 + j];
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

/// The 9 coefficients of each mode. y: its backward differences, numbers or lanes.
template <class Lanes, class Y>
DYNAMORPH_INLINE void take_slopes(const Coefficients<Lanes>& c, const Y* y, Index r, Lanes* slopes) {
  for (int e = 0; e < kSymmetric + kSkew; ++e) {
    const Lanes c0 = c.differences[0][e], c1 = c.differences[1][e], c2 = c.differences[2][e], c3 = c.differences[3][e];
    for (Index l = 0; l < r; ++l) {
      const Y* own = y + InertialTarget::kMoments * l;
      slopes[9 * l + e] = (own[0] * c0 + own[1] * c1) + (own[2] * c2 + own[3] * c3);
    }
  }
}

/// force += tensors : coefficients, and with kHeavy the mass, packed: of eight terms (Table: const Lanes*) or of one
/// term for eight characters (const float*). slopes: 9 coefficients of each mode.
template <bool kHeavy, class Table, class Lanes>
DYNAMORPH_INLINE void add_terms(Table table, Index r, const Lanes* __restrict slopes, const Coefficients<Lanes>& c,
                                Lanes* __restrict force, Lanes* __restrict mass) {
  constexpr int kEntries = kSymmetric + kSkew;
  for (Index k = 0; k < r; ++k) {
    const Lanes* own = slopes + kEntries * k;
    Lanes sums[3] = {};  // independent, or each addition would wait for the one before
    for (int e = 0; e < kRigid; ++e) sums[e % 3] += table[e] * c.rigid[e];
    table += kRigid;
    for (int e = 0; e < kSymmetric; ++e) sums[e % 3] += table[e] * own[e];
    // Two loops, each of which keeps its coefficients in registers.
    if (kHeavy) {
      Table row = table;
      for (Index l = k; l < r; row += l == k ? kSymmetric : kEntries, ++l) {
        Lanes heavy[2] = {};
        for (int e = 0; e < kSymmetric; ++e) heavy[e % 2] += row[e] * c.mass[e];
        *mass++ += heavy[0] + heavy[1];
      }
    }
    table += kSymmetric;
    for (Index l = k + 1; l < r; ++l, table += kEntries) {
      const Lanes* other = slopes + kEntries * l;
      Lanes theirs[2] = {};
      for (int e = 0; e < kSymmetric; ++e) {
        sums[e % 3] += table[e] * other[e];
        theirs[e % 2] += table[e] * own[e];
      }
      for (int e = kSymmetric; e < kEntries; ++e) {
        sums[e % 3] += table[e] * other[e];
        theirs[e % 2] -= table[e] * own[e];
      }
      force[l] += theirs[0] + theirs[1];
    }
    force[k] += (sums[0] + sums[1]) + sums[2];
  }
}

DYNAMORPH_INLINE void round_to(const double& from, double& to) { to = from; }
template <class Value, class Single>
DYNAMORPH_INLINE void round_to(const Value& from, Single& to) {
  to_single(from, to);
}

/// What one bone contributes to the terms (BoneMotion), of one character or of eight. bones: its twelve entries in each
/// pose; shares (kMoments, kPoses), row-major. Only the sums are rounded: each has the size of what it adds to the
/// force.
template <class Value, class Single>
DYNAMORPH_INLINE void combine(const Value* const* bones, const double* shares, const Vector3d& centre,
                              const Vector3d& gravity_offset, Single (*out)[12]) {
  for (int i = 0; i < 3; ++i) {
    Value first[4];  // the row of the first difference, whose translation is moved to the centre
    for (int j = 0; j < 4; ++j) {
      const int e = 4 * i + j;
      const Value b0 = bones[0][e], b1 = bones[1][e], b2 = bones[2][e], b3 = bones[3][e], b4 = bones[4][e];
      round_to(b0, out[0][e]);
      first[j] = shares[0] * b0 + shares[1] * b1 + shares[2] * b2 + shares[3] * b3 + shares[4] * b4;
      for (int m = 1; m < InertialTarget::kMoments; ++m) {
        const double* share = shares + m * InertialTarget::kPoses;
        round_to(share[0] * b0 + share[1] * b1 + share[2] * b2 + share[3] * b3 + share[4] * b4, out[m + 1][e]);
      }
    }
    first[3] += first[0] * centre[0] + first[1] * centre[1] + first[2] * centre[2] - gravity_offset[i];
    for (int j = 0; j < 4; ++j) round_to(first[j], out[1][4 * i + j]);
  }
}

}  // namespace dynamorph::terms
