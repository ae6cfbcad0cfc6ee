// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modal_inertia.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "dynamorph/reduced/modal_terms.hpp"

namespace dynamorph {

namespace {

using namespace terms;

// Parts of the force at which pairs of bones are simplified. All together they change Herbert's dive (sample_blends) by
// 1e-4 of its motion; skin weights below 1 %, which count as zero, change it more.
constexpr double kNegligible = 1e-5;  ///< left out, whatever the pose
constexpr double kUnnoticed = 1e-7;   ///< left out in a pose that turns the bones so little against each other
constexpr double kSlight = 1e-4;      ///< acts on the flesh as if it did not move in the modes
using BoneMotion = ModalInertia::BoneMotion;
using EightInertialTarget = ModalInertia::EightInertialTarget;
using EightInertia = ModalInertia::EightInertia;

/// How much the mass's coefficients can change it.
DYNAMORPH_INLINE float largest(const Coefficients<Floats>& c) {
  Floats most = c.mass[0] * c.mass[0];
  for (int e = 1; e < kSymmetric; ++e) most += c.mass[e] * c.mass[e];
  float out = 0;
  for (int lane = 0; lane < kLanes; ++lane) out = std::max(out, most[lane]);
  return std::sqrt(out);
}

/// The part of a force that does not depend on the coordinates.
template <class Table>
DYNAMORPH_INLINE void add_rigid(Table table, Index r, const Coefficients<Floats>& c, Floats* __restrict force) {
  for (Index k = 0; k < r; ++k) {
    Floats sums[3] = {};
    for (int e = 0; e < kRigid; ++e) sums[e % 3] += table[e] * c.rigid[e];
    force[k] += (sums[0] + sums[1]) + sums[2];
    table += kRigid + kSymmetric + (kSymmetric + kSkew) * (r - k - 1);
  }
}

/// Lane by lane, to force (r) and packed mass. y: each mode's backward differences, numbers or lanes. influence: the
/// largest part of the force that a term can have, where all are pairs.
template <class Table, class Y>
DYNAMORPH_INLINE void add_contribution(const Floats (*motion)[12], const Floats& sign, double influence, const Y* y,
                                       Index r, Table table, Floats* slopes, Floats* force, Floats* mass) {
  Coefficients<Floats> c;
  contract_bones(motion, sign, c);
  const float change = largest(c);
  const bool pairs = influence < HUGE_VAL;
  if (pairs && change * influence < kUnnoticed) return;
  if (pairs && change * influence < kSlight) return add_rigid(table, r, c, force);
  take_slopes(c, y, r, slopes);
  if (change > 1e-6F)  // bones are rigid to Blender's single precision
    add_terms<true>(table, r, slopes, c, force, mass);
  else
    add_terms<false>(table, r, slopes, c, force, mass);
}

DYNAMORPH_MULTIVERSION
void add_eight_terms(const Floats (*motion)[12], const Floats& sign, double influence, const float* y, Index r,
                     const Floats* table, Floats* slopes, Floats* force, Floats* mass) {
  add_contribution(motion, sign, influence, y, r, table, slopes, force, mass);
}

/// One term of eight characters; second: null of a single bone.
DYNAMORPH_MULTIVERSION
void add_term_of_eight(const Floats (*first)[12], const Floats (*second)[12], double influence, const Floats* y,
                       Index r, const float* table, Floats* slopes, Floats* force, Floats* mass) {
  Floats motion[1 + InertialTarget::kMoments][12], sign = {};
  for (int m = 0; m <= InertialTarget::kMoments; ++m)
    for (int e = 0; e < 12; ++e) motion[m][e] = second ? first[m][e] - second[m][e] : first[m][e];
  sign += second ? -1.0F : 1.0F;
  add_contribution(motion, sign, second ? influence : HUGE_VAL, y, r, table, slopes, force, mass);
}

using Order = std::int32_t __attribute__((vector_size(32)));

/// Each of two vectors' halves of neighbours, or of neighbouring pairs, added up.
DYNAMORPH_INLINE Floats folded(const Floats& a, const Floats& b, const Order& one, const Order& other) {
  return __builtin_shuffle(a, b, one) + __builtin_shuffle(a, b, other);
}

/// totals[8 i + j] = the sum of the lanes of sums[8 i + j].
DYNAMORPH_MULTIVERSION
void add_lanes(const Floats* sums, Index count, float* totals) {
  const Order even = {0, 8, 2, 10, 4, 12, 6, 14}, odd = {1, 9, 3, 11, 5, 13, 7, 15};
  const Order low = {0, 1, 8, 9, 4, 5, 12, 13}, high = {2, 3, 10, 11, 6, 7, 14, 15};
  const Order left = {0, 1, 2, 3, 8, 9, 10, 11}, right = {4, 5, 6, 7, 12, 13, 14, 15};
  for (Index i = 0; i < count; ++i, sums += kLanes) {
    Floats four[2];
    for (int half = 0; half < 2; ++half) {
      const Floats* v = sums + 4 * half;
      four[half] = folded(folded(v[0], v[1], even, odd), folded(v[2], v[3], even, odd), low, high);
    }
    const Floats all = folded(four[0], four[1], left, right);
    for (int lane = 0; lane < kLanes; ++lane) totals[kLanes * i + lane] = all[lane];
  }
}

DYNAMORPH_MULTIVERSION
void combine_one(const double* const* bones, const double* shares, const Vector3d& centre,
                 const Vector3d& gravity_offset, float (*out)[12]) {
  combine(bones, shares, centre, gravity_offset, out);
}

DYNAMORPH_MULTIVERSION
void combine_eight(const Doubles* const* bones, const double* shares, const Vector3d& centre,
                   const Vector3d& gravity_offset, Floats (*out)[12]) {
  combine(bones, shares, centre, gravity_offset, out);
}

/// A set's part, by its densities: force (r), and mass and damped mass, packed.
DYNAMORPH_MULTIVERSION
void add_set_of_eight(const Doubles& density, const Doubles& damping, const double* constant, Index r,
                      const Floats* force_sums, const Floats* mass_sums, EightInertia& out) {
  for (Index k = 0; k < r; ++k) out.force[k] += density * to_double(force_sums[k]);
  for (Index p = 0; p < r * (r + 1) / 2; ++p) {
    const Doubles mass = constant[p] + to_double(mass_sums[p]);
    out.mass[p] += density * mass;
    out.damped[p] += damping * mass;
  }
}

DYNAMORPH_MULTIVERSION
void differences_of_eight(const EightInertialTarget& inertial, Index r, Floats* y) {
  for (Index k = 0; k < r; ++k, y += InertialTarget::kMoments) {
    const Doubles q0 = inertial.q[0][k], q1 = inertial.q[1][k], q2 = inertial.q[2][k], q3 = inertial.q[3][k];
    to_single(q0, y[0]);
    to_single(q0 - q1, y[1]);
    to_single(q0 - 2 * q1 + q2, y[2]);
    to_single(q0 - 3 * q1 + 3 * q2 - q3, y[3]);
  }
}

/// lanes[m][e][t] = entry e of matrix m of term t: its bone's, less that of the second bone of a pair.
void gather(const std::vector<BoneMotion>& bones, const std::vector<std::pair<int, int>>& terms,
            const std::array<float, kLanes>& signs, Floats lanes[][12]) {
  for (size_t t = 0; t < terms.size(); ++t) {
    const auto &a = bones[terms[t].first].values, &b = bones[terms[t].second].values;
    const float less = signs[t] < 0;
    for (int m = 0; m <= InertialTarget::kMoments; ++m)
      for (int e = 0; e < 12; ++e) lanes[m][e][t] = a[m][e] - less * b[m][e];
  }
}

}  // namespace

ModalInertia::ModalInertia(const SoftBody& body, const MatrixXd& U) : r_(U.cols()), centre_(body.centre) {
  const Index nodes = body.skin.rows();
  VectorXd motion(nodes);  // of each node in the modes
  for (Index i = 0; i < nodes; ++i) motion(i) = U.middleRows<3>(3 * i).squaredNorm();
  const double all_motion = body.volumes.rowwise().sum().dot(motion);
  for (int s = 0; s < body.sets(); ++s) {
    std::map<Bones, double> volumes, motions;
    for_each_term(body, s, [&](Index i, const Bones& bones, double part) {
      volumes[bones] += part / body.volume;
      motions[bones] += part * motion(i) / all_motion;
    });
    std::vector<std::pair<double, Bones>> terms,
        pairs;  // with a bound, by Cauchy and Schwarz, of their part of the force
    for (const auto& [bones, share] : volumes) {
      const double influence = std::sqrt(share * motions[bones]);
      if (influence > kNegligible) (bones.first == bones.second ? terms : pairs).push_back({influence, bones});
    }
    Tensors& set = sets_.emplace_back();
    std::sort(pairs.rbegin(), pairs.rend());
    const size_t bones = terms.size();
    terms.insert(terms.end(), pairs.begin(), pairs.end());
    for (size_t t = 0; t < terms.size(); ++t) {
      if (t % kLanes == 0) {
        set.groups.push_back({{}, {}, t < bones ? HUGE_VAL : terms[t].first});
        set.groups.back().signs.fill(-1);  // a lane without a term looks like two bones that move together
      }
      set.groups.back().bones.push_back(terms[t].second);
      set.groups.back().signs[t % kLanes] = t < bones ? 1 : -1;
    }
    tabulate(body, U, s, set);
  }
  for (Tensors& set : sets_)
    for (Group& group : set.groups)
      for (Bones& bones : group.bones) bones = {used(bones.first), used(bones.second)};
  in_terms_ = used_.size();
  for (Index b = 0; b < body.skin.cols(); ++b)
    if (body.moments[b](3, 3) > 0) used(int(b));
}

int ModalInertia::used(int bone) {
  const auto found = std::find(used_.begin(), used_.end(), bone);
  if (found != used_.end()) return int(found - used_.begin());
  used_.push_back(bone);
  return int(used_.size()) - 1;
}

void ModalInertia::tabulate(const SoftBody& body, const MatrixXd& U, int s, Tensors& set) const {
  set.mass.setZero(r_ * (r_ + 1) / 2);
  std::map<Bones, Index> column;
  for (const Group& group : set.groups)
    for (const Bones& bones : group.bones) column.emplace(bones, Index(column.size()));
  MatrixXd sums = MatrixXd::Zero(entries(r_), Index(column.size()));
  VectorXd entry(entries(r_));
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
  set.table.assign(set.groups.size() * entries(r_), Floats{});
  set.terms.resize(column.size() * entries(r_));
  Index next = 0;
  for (size_t g = 0; g < set.groups.size(); ++g)
    for (size_t lane = 0; lane < set.groups[g].bones.size(); ++lane, ++next)
      for (Index e = 0; e < entries(r_); ++e)
        set.table[g * entries(r_) + e][lane] = set.terms[next * entries(r_) + e] = float(sums(e, next));
}

void ModalInertia::evaluate(const InertialTarget& inertial, const SetDensities& densities, Result& out) const {
  const Index pairs = r_ * (r_ + 1) / 2;
  take_differences(inertial, out.differences);
  out.bones.resize(in_terms_);
  const Shares shares = shares_of_differences(inertial.coefficients);
  for (size_t b = 0; b < in_terms_; ++b) {
    const double* poses[InertialTarget::kPoses];
    for (int n = 0; n < InertialTarget::kPoses; ++n) poses[n] = inertial.bones[n]->data() + 12 * used_[b];
    combine_one(poses, shares.data(), centre_, inertial.gravity_offset, out.bones[b].values);
  }

  out.slopes.resize(9 * r_);
  out.sums.resize((r_ + pairs + kLanes - 1) / kLanes * kLanes);
  out.totals.resize(out.sums.size());
  out.mass.setZero(r_, r_);
  out.damped.setZero(r_, r_);
  out.force.setZero(r_);
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Tensors& set = sets_[s];
    std::fill(out.sums.begin(), out.sums.end(), Floats{});
    for (size_t g = 0; g < set.groups.size(); ++g) {
      alignas(64) Floats lanes[1 + InertialTarget::kMoments][12] = {};
      gather(out.bones, set.groups[g].bones, set.groups[g].signs, lanes);
      alignas(64) Floats sign;
      std::copy_n(set.groups[g].signs.data(), kLanes, reinterpret_cast<float*>(&sign));
      add_eight_terms(lanes, sign, set.groups[g].influence, out.differences.data(), r_,
                      set.table.data() + g * entries(r_), out.slopes.data(), out.sums.data(), out.sums.data() + r_);
    }
    add_lanes(out.sums.data(), Index(out.sums.size()) / kLanes, out.totals.data());
    const double density = densities.density(s), damped = densities.damped(s);
    for (Index k = 0; k < r_; ++k) out.force(k) += density * out.totals[k];
    const float* change = out.totals.data() + r_;
    for (Index k = 0, p = 0; k < r_; ++k)
      for (Index l = k; l < r_; ++l, ++p) {
        const double mass = set.mass(p) + change[p];
        out.mass(l, k) += density * mass;
        out.damped(l, k) += damped * mass;
      }
  }
  out.mass.triangularView<Eigen::StrictlyUpper>() = out.mass.transpose();
  out.damped.triangularView<Eigen::StrictlyUpper>() = out.damped.transpose();
}

void ModalInertia::evaluate(const EightInertialTarget& inertial, const Doubles* density, const Doubles* damping,
                            EightInertia& out) const {
  const Index pairs = r_ * (r_ + 1) / 2;
  out.differences.resize(InertialTarget::kMoments * r_);
  differences_of_eight(inertial, r_, out.differences.data());
  out.bones.resize((1 + InertialTarget::kMoments) * 12 * in_terms_);
  const auto bone = [&](int b) {
    return reinterpret_cast<Floats(*)[12]>(&out.bones[(1 + InertialTarget::kMoments) * 12 * b]);
  };
  const Shares shares = shares_of_differences(inertial.coefficients);
  for (size_t b = 0; b < in_terms_; ++b) {
    const Doubles* poses[InertialTarget::kPoses];
    for (int n = 0; n < InertialTarget::kPoses; ++n) poses[n] = inertial.bones[n] + 12 * b;
    combine_eight(poses, shares.data(), centre_, inertial.gravity_offset, bone(int(b)));
  }
  out.slopes.resize(9 * r_);
  out.sums.resize(r_ + pairs);
  out.mass.assign(pairs, Doubles{});
  out.damped.assign(pairs, Doubles{});
  out.force.assign(r_, Doubles{});
  for (size_t s = 0; s < sets_.size(); ++s) {
    const Tensors& set = sets_[s];
    std::fill(out.sums.begin(), out.sums.end(), Floats{});
    for (size_t g = 0; g < set.groups.size(); ++g)
      for (size_t t = 0; t < set.groups[g].bones.size(); ++t) {
        const Bones& bones = set.groups[g].bones[t];
        const float* table = set.terms.data() + (g * kLanes + t) * entries(r_);
        add_term_of_eight(bone(bones.first), set.groups[g].signs[t] < 0 ? bone(bones.second) : nullptr,
                          set.groups[g].influence, out.differences.data(), r_, table, out.slopes.data(),
                          out.sums.data(), out.sums.data() + r_);
      }
    add_set_of_eight(density[s], damping[s], set.mass.data(), r_, out.sums.data(), out.sums.data() + r_, out);
  }
}

int ModalInertia::terms() const {
  size_t count = 0;
  for (const Tensors& set : sets_)
    for (const Group& group : set.groups) count += group.bones.size();
  return int(count);
}

}  // namespace dynamorph
