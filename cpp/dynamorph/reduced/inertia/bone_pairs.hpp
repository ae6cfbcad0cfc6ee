// SPDX-License-Identifier: GPL-3.0-or-later
// The tensors of bones and of pairs of bones that modal_inertia contracts, and the coefficients to contract them with.
// One bone counts as a pair with itself.
#pragma once

#include <vector>

#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/inertia/modal_arithmetic.hpp"

namespace dynamorph::bone_pairs {

static_assert(kMoments == InertialTarget::kMoments && kPoses == InertialTarget::kPoses, "see modal_arithmetic.hpp");

using BonePair = std::pair<int, int>;  ///< (b, b) for one bone, (b, c), b < c, for two

/// Calls visit(node, pair, volume) for each bone (b, b) of every node, and for any two bones (b, c), b < c, that share
/// it.
template <class Visit>
void for_each_bone_pair(const SoftBody& body, int set, const Visit& visit) {
  for (Index i = 0; i < body.skin.rows(); ++i)
    for (SkinWeights::InnerIterator b(body.skin, i); b; ++b)
      for (SkinWeights::InnerIterator c(body.skin, i); c; ++c)
        if (b.col() <= c.col())
          visit(i, BonePair(int(b.col()), int(c.col())),
                body.volumes(i, set) * b.value() * (b.col() == c.col() ? 1 : c.value()));
}

/// One node's tensor in the order of add_tensors. U (3, r) is that of the node, X is its rest position.
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

/// The coefficients of the backward differences q_0, q_0 - q_1, q_0 - 2 q_1 + q_2, ... instead of those of the
/// coordinates themselves. Each difference is as large as what it adds to the force, so the force keeps its digits in
/// single precision.
using DifferenceCoefficients = Eigen::Matrix<double, InertialTarget::kMoments, InertialTarget::kPoses, Eigen::RowMajor>;
inline DifferenceCoefficients coefficients_of_differences(
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

}  // namespace dynamorph::bone_pairs
