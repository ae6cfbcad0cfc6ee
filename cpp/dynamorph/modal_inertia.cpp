// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/modal_inertia.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace dynamorph {

namespace {

using Eigen::Index;

constexpr double kNegligible = 1e-7;  // part of the force, at most, that is left out with a term
constexpr int kRotation = 9, kRigid = 12, kSymmetric = 6, kSkew = 3;
constexpr int kCombined = std::tuple_size_v<ModalInertia::BoneMotion>;
using BoneMotion = ModalInertia::BoneMotion;

/// Of eight terms: coefficients that their tensors are contracted with.
struct Coefficients {
  Floats rigid[kRigid];                                      ///< of the rest positions, and of the weights alone
  Floats differences[Motion::kMoments][kSymmetric + kSkew];  ///< of the modes, for each backward difference
  Floats mass[kSymmetric];
};

/// Shares of the backward differences q_0, q_0 - q_1, q_0 - 2 q_1 + q_2, ... instead of the coordinates themselves.
/// Each has the size of what it adds to the force, which therefore keeps its digits in single precision.
Eigen::Matrix<double, Motion::kMoments, Motion::kPoses> shares_of_differences(const Motion& motion) {
  Eigen::Matrix4d binomials;
  binomials << 1, 1, 1, 1, 0, -1, -2, -3, 0, 0, 1, 3, 0, 0, 0, -1;
  return binomials * motion.share;
}

void take_differences(const Motion& motion, std::array<VectorXd, Motion::kMoments>& out) {
  out[0] = *motion.q[0];
  out[1] = *motion.q[0] - *motion.q[1];
  out[2] = *motion.q[0] - 2 * *motion.q[1] + *motion.q[2];
  out[3] = *motion.q[0] - 3 * *motion.q[1] + 3 * *motion.q[2] - *motion.q[3];
}

/// Symmetric and skew parts that the tensors are stored by: xx yy zz, xy yz zx; xy yz zx.
DYNAMORPH_INLINE void split(const Doubles* G, Floats* parts) {
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    to_single(G[4 * i], parts[i]);
    to_single(G[3 * i + j] + G[3 * j + i], parts[3 + i]);
    to_single(G[3 * i + j] - G[3 * j + i], parts[6 + i]);
  }
}

/// From eight terms' own motions, entry after entry.
DYNAMORPH_INLINE void contract_bones(const Doubles* motion, bool pairs, Coefficients& out) {
  const double sign = pairs ? -1 : 1;
  Doubles R[kRotation], G[kRotation];
  for (int e = 0; e < kRotation; ++e) R[e] = sign * motion[e];
  for (int m = -1; m < Motion::kMoments; ++m) {
    const Doubles* D = motion + kRotation * (m + 1);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) G[3 * i + j] = R[i] * D[j] + R[3 + i] * D[3 + j] + R[6 + i] * D[6 + j];
    if (m >= 0) {
      split(G, out.differences[m]);
    } else {
      for (int i = 0; i < 3; ++i) {
        to_single(G[4 * i] - (pairs ? 0.0 : 1.0), out.mass[i]);
        to_single(2 * G[3 * i + (i + 1) % 3], out.mass[3 + i]);
      }
    }
    if (m == 0)
      for (int e = 0; e < kRotation; ++e) to_single(G[e], out.rigid[e]);
  }
  const Doubles* d = motion + kRotation * (1 + Motion::kMoments);
  for (int i = 0; i < 3; ++i) to_single(R[i] * d[0] + R[3 + i] * d[1] + R[6 + i] * d[2], out.rigid[kRotation + i]);
}

/// How much the mass's coefficients can change it.
DYNAMORPH_INLINE float largest(const Coefficients& c) {
  Floats most = c.mass[0] * c.mass[0];
  for (int e = 1; e < kSymmetric; ++e) most += c.mass[e] * c.mass[e];
  float out = 0;
  for (int lane = 0; lane < kLanes; ++lane) out = std::max(out, most[lane]);
  return std::sqrt(out);
}

/// force += tensors : coefficients, and with kHeavy the mass, packed. slopes: scratch, 9 for each mode.
template <bool kHeavy>
DYNAMORPH_INLINE void add_terms(const Floats* __restrict table, Index r, const Floats* __restrict slopes,
                                const Coefficients& c, Floats* __restrict force, Floats* __restrict mass) {
  for (Index k = 0; k < r; ++k) {
    const Floats* own = slopes + 9 * k;
    Floats sums[3] = {};  // independent, or each addition would wait for the one before
    for (int e = 0; e < kRigid; ++e) sums[e % 3] += table[e] * c.rigid[e];
    table += kRigid;
    Floats heavy = {};
    for (int e = 0; e < kSymmetric; ++e) {
      sums[e % 3] += table[e] * own[e];
      if (kHeavy) heavy += table[e] * c.mass[e];
    }
    table += kSymmetric;
    if (kHeavy) *mass++ += heavy;
    for (Index l = k + 1; l < r; ++l, table += kSymmetric + kSkew) {
      const Floats* other = slopes + 9 * l;
      Floats theirs[3] = {};
      heavy = Floats{};
      for (int e = 0; e < kSymmetric; ++e) {
        sums[e % 3] += table[e] * other[e];
        theirs[e % 3] += table[e] * own[e];
        if (kHeavy) heavy += table[e] * c.mass[e];
      }
      for (int e = kSymmetric; e < kSymmetric + kSkew; ++e) {
        sums[e % 3] += table[e] * other[e];
        theirs[e % 3] -= table[e] * own[e];
      }
      force[l] += (theirs[0] + theirs[1]) + theirs[2];
      if (kHeavy) *mass++ += heavy;
    }
    force[k] += (sums[0] + sums[1]) + sums[2];
  }
}

/// Adds eight terms' part of force (r) and mass, packed, lane by lane. `influence`: the largest part of the force that
/// one of them can have.
DYNAMORPH_MULTIVERSION
void add_group(const Doubles* motion, bool pairs, double influence, const double* const* differences, Index r,
               const Floats* table, Floats* slopes, Floats* force, Floats* mass) {
  Coefficients c;
  contract_bones(motion, pairs, c);
  const float change = largest(c);
  if (pairs && change * influence < 1e-9) return;  // the bones hardly turned against each other: below round-off
  for (Index l = 0; l < r; ++l) {
    float y[Motion::kMoments];
    for (int m = 0; m < Motion::kMoments; ++m) y[m] = float(differences[m][l]);
    for (int e = 0; e < kSymmetric + kSkew; ++e)
      slopes[9 * l + e] = (y[0] * c.differences[0][e] + y[1] * c.differences[1][e]) +
                          (y[2] * c.differences[2][e] + y[3] * c.differences[3][e]);
  }
  if (pairs || change > 1e-6f)  // a bone is rigid, to Blender's single precision
    add_terms<true>(table, r, slopes, c, force, mass);
  else
    add_terms<false>(table, r, slopes, c, force, mass);
}

void combine(const Motion& motion, const Eigen::Matrix<double, Motion::kMoments, Motion::kPoses>& shares, int bone,
             const Vector3d& centre, BoneMotion& out) {
  using Rotation = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  Eigen::Map<Eigen::Matrix<double, 3 * (1 + Motion::kMoments), 3, Eigen::RowMajor>> parts(out.data());
  Eigen::Map<Vector3d> offset(out.data() + parts.size());
  parts.setZero();
  offset = -motion.lift;
  parts.topRows<3>() = transform(*motion.bones[0], bone).leftCols<3>();
  for (int n = 0; n < Motion::kPoses; ++n) {
    const TransformMap T = transform(*motion.bones[n], bone);
    const Rotation R = T.leftCols<3>();
    for (int m = 0; m < Motion::kMoments; ++m)
      if (shares(m, n) != 0) parts.middleRows<3>(3 * (m + 1)) += shares(m, n) * R;
    offset += shares(0, n) * (R * centre + T.col(3));
  }
}

/// lanes[e][t] = entry e of term t: its bone's, less that of the second bone of a pair.
void gather(const std::vector<BoneMotion>& bones, const std::vector<std::pair<int, int>>& terms, Doubles* lanes) {
  for (size_t t = 0; t < terms.size(); ++t) {
    const BoneMotion &a = bones[terms[t].first], &b = bones[terms[t].second];
    const double less = terms[t].first == terms[t].second ? 0 : 1;
    for (size_t e = 0; e < a.size(); ++e) lanes[e][t] = a[e] - less * b[e];
  }
}

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
void node_tensor(const Eigen::Ref<const Eigen::Matrix3Xd>& U, const Vector3d& X, VectorXd& out) {
  double* entry = out.data();
  for (Index k = 0; k < U.cols(); ++k) {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) *entry++ = U(i, k) * X(j);
    for (int i = 0; i < 3; ++i) *entry++ = U(i, k);
    for (Index l = k; l < U.cols(); ++l) {
      for (int i = 0; i < 3; ++i) *entry++ = U(i, k) * U(i, l);
      for (double sign : {1.0, -1.0})
        for (int i = 0, j = 1; i < 3 && (sign > 0 || l > k); ++i, j = (i + 1) % 3)
          *entry++ = 0.5 * (U(i, k) * U(j, l) + sign * U(j, k) * U(i, l));
    }
  }
}

}  // namespace

ModalInertia::ModalInertia(const SoftBody& body, const MatrixXd& U) : r_(U.cols()), centre_(body.centre) {
  const Index nodes = body.skin.rows();
  const double volume = body.volumes.sum();
  VectorXd motion(nodes);  // of each node in the modes
  for (Index i = 0; i < nodes; ++i) motion(i) = U.middleRows<3>(3 * i).squaredNorm();
  const double all_motion = body.volumes.rowwise().sum().dot(motion);
  for (int s = 0; s < body.sets(); ++s) {
    std::map<Bones, double> volumes, motions;
    for_each_term(body, s, [&](Index i, const Bones& bones, double part) {
      volumes[bones] += part / volume;
      motions[bones] += part * motion(i) / all_motion;
    });
    std::vector<std::pair<double, Bones>> single, paired;
    for (const auto& [bones, share] : volumes) {
      const double influence =
          std::sqrt(share * motions[bones]);  // Cauchy and Schwarz's bound of its part of the force
      if (influence > kNegligible) (bones.first == bones.second ? single : paired).push_back({influence, bones});
    }
    Tensors& set = sets_.emplace_back();
    for (auto* terms : {&single, &paired}) {
      std::sort(terms->rbegin(), terms->rend());
      for (size_t t = 0; t < terms->size(); ++t) {
        if (t % kLanes == 0) set.groups.push_back({terms == &paired, {}, (*terms)[t].first});
        set.groups.back().bones.push_back((*terms)[t].second);
      }
    }
    tabulate(body, U, s, set);
  }
  for (Index b = 0; b < body.skin.cols(); ++b)
    for (const Tensors& set : sets_)
      for (const Group& group : set.groups)
        for (const Bones& bones : group.bones)
          if (b == bones.first || b == bones.second) used_.push_back(int(b));
  used_.erase(std::unique(used_.begin(), used_.end()), used_.end());
}

void ModalInertia::tabulate(const SoftBody& body, const MatrixXd& U, int s, Tensors& set) const {
  set.mass.setZero(r_ * (r_ + 1) / 2);
  std::map<Bones, Index> column;
  for (const Group& group : set.groups)
    for (const Bones& bones : group.bones) column.emplace(bones, Index(column.size()));
  MatrixXd sums = MatrixXd::Zero(entries(), Index(column.size()));
  VectorXd entry(entries());
  Index seen = -1;
  for_each_term(body, s, [&](Index i, const Bones& bones, double part) {
    const auto found = column.find(bones);
    if (found == column.end()) return;
    if (i != seen) node_tensor(U.middleRows<3>(3 * i), body.rest.segment<3>(3 * i) - centre_, entry);
    seen = i;
    sums.col(found->second) += part * entry;
  });
  for (Index k = 0, p = 0; k < r_; ++k)
    for (Index l = k; l < r_; ++l, ++p)
      for (Index i = 0; i < body.volumes.rows(); ++i)
        set.mass(p) += body.volumes(i, s) * U.col(k).segment<3>(3 * i).dot(U.col(l).segment<3>(3 * i));
  set.table.assign(set.groups.size() * entries(), Floats{});
  Index next = 0;
  for (size_t g = 0; g < set.groups.size(); ++g)
    for (size_t lane = 0; lane < set.groups[g].bones.size(); ++lane, ++next)
      for (Index e = 0; e < entries(); ++e) set.table[g * entries() + e][lane] = float(sums(e, next));
}

void ModalInertia::evaluate(const Motion& motion, const SetDensities& densities, Result& out) const {
  const Index pairs = r_ * (r_ + 1) / 2;
  take_differences(motion, out.differences);
  const double* differences[Motion::kMoments];
  for (int m = 0; m < Motion::kMoments; ++m) differences[m] = out.differences[m].data();
  out.bones.resize(motion.bones[0]->rows());
  const auto shares = shares_of_differences(motion);
  for (int b : used_) combine(motion, shares, b, centre_, out.bones[b]);

  out.slopes.resize(9 * r_);
  out.sums.resize(r_ + pairs);
  out.mass.setZero(r_, r_);
  out.damped.setZero(r_, r_);
  out.force.setZero(r_);
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Tensors& set = sets_[s];
    std::fill(out.sums.begin(), out.sums.end(), Floats{});
    for (size_t g = 0; g < set.groups.size(); ++g) {
      alignas(64) Doubles lanes[kCombined] = {};
      gather(out.bones, set.groups[g].bones, lanes);
      add_group(lanes, set.groups[g].pairs, set.groups[g].influence, differences, r_, set.table.data() + g * entries(),
                out.slopes.data(), out.sums.data(), out.sums.data() + r_);
    }
    const double density = densities.density(s), damped = densities.damped(s);
    for (Index k = 0; k < r_; ++k) out.force(k) += density * sum_of(out.sums[k]);
    const Floats* change = out.sums.data() + r_;
    for (Index k = 0, p = 0; k < r_; ++k)
      for (Index l = k; l < r_; ++l, ++p) {
        const double mass = set.mass(p) + sum_of(change[p]);
        out.mass(l, k) += density * mass;
        out.damped(l, k) += damped * mass;
      }
  }
  out.mass.triangularView<Eigen::StrictlyUpper>() = out.mass.transpose();
  out.damped.triangularView<Eigen::StrictlyUpper>() = out.damped.transpose();
}

int ModalInertia::terms() const {
  size_t count = 0;
  for (const Tensors& set : sets_)
    for (const Group& group : set.groups) count += group.bones.size();
  return int(count);
}

}  // namespace dynamorph
