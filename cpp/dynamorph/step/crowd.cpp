// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/crowd.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/progress.hpp"
#include "dynamorph/step/crowd_kernels.hpp"

namespace dynamorph {

namespace {

using Eigen::Index;

DYNAMORPH_INLINE bool all_zero(const Doubles& v) {
  for (int lane = 0; lane < kLanes; ++lane)
    if (v[lane] != 0) return false;
  return true;
}

DYNAMORPH_INLINE Doubles root_of(const Doubles& v) {
  Doubles out;
  for (int lane = 0; lane < kLanes; ++lane) out[lane] = std::sqrt(v[lane]);
  return out;
}

DYNAMORPH_INLINE Doubles norm(const LaneVector<Doubles>& v) {
  Doubles square;
  dot(v.data(), v.data(), Index(v.size()), square);
  return root_of(square);
}

DYNAMORPH_INLINE unsigned lanes_below(const Doubles& v, double limit) {
  unsigned out = 0;
  for (int lane = 0; lane < kLanes; ++lane)
    if (v[lane] <= limit) out |= 1U << lane;
  return out;
}

DYNAMORPH_INLINE void widen(Doubles& most, const Doubles& v) {
  for (int lane = 0; lane < kLanes; ++lane) most[lane] = std::max(most[lane], std::abs(v[lane]));
}

DYNAMORPH_INLINE Doubles largest(const LaneVector<Doubles>& values) {
  Doubles most = {};
  for (const Doubles& v : values) widen(most, v);
  return most;
}

}  // namespace

Crowd::Crowd(std::shared_ptr<const ReducedModel> model, StepOptions options, int size)
    : size_(size), alone_(std::move(model), std::move(options)) {
  alone_.model().modal_inertia();  // there must be one
  if (size < 1) throw std::invalid_argument("size: expected at least one character, got " + std::to_string(size));
}

void Crowd::hold_targets(const std::vector<Transforms>& bones) { alone_.hold_targets(bones); }

CrowdReport Crowd::start(const double* now, const double* next, const double* weights) {
  const Index bones = model().body().skin.cols(), targets = Index(model().targets().size());
  const Index r = model().dofs(), used = Index(model().modal_inertia().used_bones().size());
  Eight empty;
  for (int m = 0; m < InertialTarget::kMoments; ++m) {
    empty.q[m].assign(r, Doubles{});
    empty.bones[m].assign(12 * used, Doubles{});
  }
  CrowdReport report;
  std::vector<Eight> eights((size_ + kLanes - 1) / kLanes, empty);
  for (int i = 0; i < int(eights.size()) * kLanes; ++i) {
    if (i < size_) {
      add(report, i, [&] {
        return alone_.start(Eigen::Map<const Transforms>(now + i * bones * 12, bones, 12),
                            Eigen::Map<const Transforms>(next + i * bones * 12, bones, 12),
                            Eigen::Map<const VectorXd>(weights + i * targets, targets));
      });
    }
    set_lane(eights[i / kLanes], i % kLanes, alone_.state());  // lanes without a character repeat the last one
  }
  eights_.swap(eights);
  return report;
}

template <class Step>
void Crowd::add(CrowdReport& report, int character, const Step& step) {
  try {
    const StepReport own = step();
    report.iterations += own.iterations;
    report.converged &= own.converged;
  } catch (const Error& error) {
    throw Error("character " + std::to_string(character) + ": " + error.what());
  } catch (const std::invalid_argument& error) {
    throw std::invalid_argument("character " + std::to_string(character) + ": " + error.what());
  }
}

State Crowd::lane(const Eight& eight, int lane) const {
  const std::vector<int>& used = model().modal_inertia().used_bones();
  State state;
  for (int m = 0; m < InertialTarget::kMoments; ++m) {
    state.q[m].resize(model().dofs());
    for (Index k = 0; k < state.q[m].size(); ++k) state.q[m](k) = eight.q[m][k][lane];
    state.bones[m].setZero(model().body().skin.cols(), 12);  // those that carry no flesh do not count
    for (size_t b = 0; b < used.size(); ++b)
      for (int e = 0; e < 12; ++e) state.bones[m](used[b], e) = eight.bones[m][12 * b + e][lane];
  }
  return state;
}

void Crowd::set_lane(Eight& eight, int lane, const State& state) const {
  const std::vector<int>& used = model().modal_inertia().used_bones();
  for (int m = 0; m < InertialTarget::kMoments; ++m) {
    for (Index k = 0; k < state.q[m].size(); ++k) eight.q[m][k][lane] = state.q[m](k);
    for (size_t b = 0; b < used.size(); ++b)
      for (int e = 0; e < 12; ++e) eight.bones[m][12 * b + e][lane] = state.bones[m](used[b], e);
  }
}

VectorXd Crowd::coordinates(int character) const {
  if (eights_.empty()) throw std::invalid_argument("coordinates: start() comes first");
  if (character < 0 || character >= size_)
    throw std::invalid_argument("character: expected 0 to " + std::to_string(size_ - 1) + ", got " +
                                std::to_string(character));
  return lane(eights_[character / kLanes], character % kLanes).q[0];
}

CrowdReport Crowd::step(const double* bones, const double* weights) {
  if (eights_.empty()) throw std::invalid_argument("step: start() comes first");
  if (options().keep_going && !options().keep_going()) throw Cancelled();
  check(bones, weights);
  CrowdReport report;
  try {
    for (int eight = 0; eight < int(eights_.size()); ++eight) step_eight(eight, bones, weights, report);
  } catch (...) {
    eights_.clear();  // half of them have moved on
    throw;
  }
  return report;
}

void Crowd::check(const double* bones, const double* weights) const {
  const Index count = model().body().skin.cols(), targets = Index(model().targets().size());
  const std::vector<int>& used = model().modal_inertia().used_bones();
  for (int i = 0; i < size_; ++i) {
    check_weights(model().targets(), model().body().sets(), Eigen::Map<const VectorXd>(weights + i * targets, targets));
    if (!all_finite(bones + i * count * 12, used.data(), Index(used.size())))
      throw Error("character " + std::to_string(i) +
                  ": the rig has a transform that is not a number: check its drivers and constraints");
  }
}

void Crowd::step_eight(int index, const double* bones, const double* weights, CrowdReport& report) {
  Eight& eight = eights_[index];
  gather(index, bones, weights);
  blend();
  pull(eight);
  const int count = std::min(kLanes, size_ - index * kLanes);
  const unsigned present = (1U << count) - 1, cut = jumps(eight) & present;
  const unsigned need = cut | minimize(present & ~cut, report);
  std::array<State, kLanes> before;
  for (int i = 0; i < count; ++i)
    if (need >> i & 1) before[i] = lane(eight, i);

  std::rotate(eight.q.rbegin(), eight.q.rbegin() + 1, eight.q.rend());
  std::rotate(eight.bones.rbegin(), eight.bones.rbegin() + 1, eight.bones.rend());
  eight.q[0].swap(scratch_.q);
  eight.bones[0].swap(scratch_.bones);

  const Index transforms = model().body().skin.cols(), targets = Index(model().targets().size());
  for (int i = 0; i < count; ++i) {
    if (!(need >> i & 1)) continue;
    const int character = index * kLanes + i;
    alone_.set_state(before[i]);
    add(report, character, [&] {
      return alone_.step(Eigen::Map<const Transforms>(bones + character * transforms * 12, transforms, 12),
                         Eigen::Map<const VectorXd>(weights + character * targets, targets));
    });
    ++report.alone;
    set_lane(eight, i, alone_.state());
  }
  for (int i = count; i < kLanes; ++i)
    for (Doubles& q : eight.q[0]) q[i] = q[count - 1];
}

void Crowd::gather(int index, const double* bones, const double* weights) {
  const std::vector<int>& used = model().modal_inertia().used_bones();
  const Index count = model().body().skin.cols(), targets = Index(model().targets().size());
  Scratch& s = scratch_;
  s.weights.resize(targets);
  s.bones.resize(12 * used.size());
  for (int lane = 0; lane < kLanes; ++lane) {
    const Index character = std::min(index * kLanes + lane, size_ - 1);
    for (Index j = 0; j < targets; ++j) s.weights[j][lane] = weights[character * targets + j];
    for (size_t b = 0; b < used.size(); ++b)
      for (int e = 0; e < 12; ++e) s.bones[12 * b + e][lane] = bones[(character * count + used[b]) * 12 + e];
  }
}

unsigned Crowd::jumps(const Eight& eight) const {
  if (options().teleport <= 0) return 0;
  const SoftBody& body = model().body();
  const std::vector<int>& used = model().modal_inertia().used_bones();
  Doubles jump = {};
  for (size_t b = 0; b < used.size(); ++b) {
    const Eigen::Matrix4d& moments = body.moments[used[b]];
    add_jump(&scratch_.bones[12 * b], &eight.bones[0][12 * b], &eight.bones[1][12 * b], moments.data(), body.centre,
             jump);
  }
  unsigned out = 0;
  for (int lane = 0; lane < kLanes; ++lane)
    if (!(jump[lane] < options().teleport * options().teleport * body.volume)) out |= 1U << lane;
  return out;
}

void Crowd::blend() {
  const ReducedModel& m = model();
  const Index r = m.dofs(), pairs = r * (r + 1) / 2;
  Scratch& s = scratch_;
  s.density.assign(m.body().sets(), Doubles{});
  s.density_damping.assign(m.body().sets(), Doubles{});
  s.centre.assign(r, Doubles{});
  s.rest_force.assign(r, Doubles{});
  s.stiffness.assign(pairs, Doubles{});
  s.damping.assign(pairs, Doubles{});
  s.rest_energy = Doubles{};
  for (size_t j = 0; j < m.targets().size(); ++j) {
    const Doubles w = s.weights[j];
    if (all_zero(w)) continue;
    const MorphTarget& target = m.targets()[j];
    s.density[target.set] += w * target.density;
    s.density_damping[target.set] += w * target.density * target.mass_damping;
    add_scaled(w, m.stiffness_[j].data(), pairs, s.stiffness.data());
    add_scaled(w * target.stiffness_damping, m.rest_stiffness_[j].data(), pairs, s.damping.data());
    if (m.blending_ == Blending::even) {
      add_scaled(w, m.coordinates_[j].data(), r, s.centre.data());
    } else {
      add_scaled(w, m.forces_[j].data(), r, s.rest_force.data());
      s.rest_energy += w * m.energies_[j];
    }
  }
}

void Crowd::pull(const Eight& eight) {
  const Index r = model().dofs(), pairs = r * (r + 1) / 2;
  Scratch& s = scratch_;
  const StepRule rule(options());
  ModalInertia::EightInertialTarget inertial;
  for (int m = 0; m < InertialTarget::kMoments; ++m) inertial.q[m] = eight.q[m].data();
  inertial.bones[0] = s.bones.data();
  for (int m = 0; m < InertialTarget::kMoments; ++m) inertial.bones[m + 1] = eight.bones[m].data();
  inertial.coefficients = rule.coefficients();
  inertial.gravity_offset = rule.square * options().gravity;
  model().modal_inertia().evaluate(inertial, s.density.data(), s.density_damping.data(), s.inertia);

  s.H.resize(pairs);
  for (LaneVector<Doubles>* v : {&s.g, &s.q, &s.origin, &s.velocity, &s.force, &s.gradient, &s.trial, &s.image})
    v->resize(r);
  add_up(s.inertia.mass.data(), s.inertia.damped.data(), 1 / rule.square, rule.velocity[0] / options().h, pairs,
         s.damping.data(), s.H.data());
  for (Index k = 0; k < r; ++k) {
    const Doubles &q0 = eight.q[0][k], &q1 = eight.q[1][k];
    s.q[k] = s.origin[k] = 2 * q0 - q1;
    s.velocity[k] = (rule.velocity[0] * s.q[k] + rule.velocity[1] * q0 + rule.velocity[2] * q1) / options().h;
  }
  packed_product(s.damping.data(), s.velocity.data(), r, s.g.data());
  for (Index k = 0; k < r; ++k) s.g[k] += s.inertia.force[k] / rule.square;
  for (Index j = 0; j < alone_.held().cols(); ++j) add_scaled(s.weights[j], alone_.held().col(j).data(), r, s.g.data());

  Doubles farthest = {}, density = {};
  for (size_t e = 3; e < s.bones.size(); e += 4) widen(farthest, s.bones[e]);
  for (const Doubles& d : s.density) widen(density, d);
  const SoftBody& body = model().body();
  s.round_off = 1e-14 / rule.square * (farthest + (body.centre.norm() + body.size)) *
                root_of(body.volume * density * largest(s.inertia.mass));
}

void Crowd::linearize() {
  const ReducedModel& m = model();
  const Index r = m.dofs(), rows = m.padded_pairs_;
  Scratch& s = scratch_;
  s.v.resize(r);
  s.pairs.assign(rows, Floats{});
  s.linear.assign(rows, Floats{});
  s.quadratic.assign(rows, Floats{});
  s.product.resize(rows);
  s.tangent.resize(r * (r + 1) / 2);
  expand(s.q.data(), s.centre.data(), r, s.v.data(), s.pairs.data());
  for (size_t j = 0; j < m.targets().size() && m.layout_.nonlinear; ++j) {
    if (all_zero(s.weights[j])) continue;
    alignas(64) Floats w;
    to_single(s.weights[j], w);
    add_orders(m.tables_[j].data(), rows, r, w, s.v.data(), s.pairs.data(), s.product.data(), s.linear.data(),
               s.quadratic.data());
  }
  contract(s.stiffness.data(), s.linear.data(), s.quadratic.data(), s.q.data(), s.centre.data(), s.rest_force.data(), r,
           s.force.data(), s.tangent.data(), s.energy);
  s.energy += s.rest_energy;
  for (Index k = 0; k < r; ++k) s.trial[k] = s.q[k] - s.origin[k];
  packed_product(s.H.data(), s.trial.data(), r, s.image.data());
  Doubles half, linear;
  dot(s.trial.data(), s.image.data(), r, half);
  dot(s.trial.data(), s.g.data(), r, linear);
  s.potential = 0.5 * half + linear + s.energy;
  for (Index k = 0; k < r; ++k) s.gradient[k] = s.image[k] + s.g[k] + s.force[k];
}

void Crowd::residual(Doubles& out) {
  Scratch& s = scratch_;
  const Doubles scale = norm(s.image) + norm(s.g) + norm(s.force);
  const Doubles displacement = norm(s.q) + norm(s.origin) + 0.1 * model().body().size;
  const Doubles round_off = s.round_off + 1e-14 * largest(s.tangent) * displacement;
  out = norm(s.gradient) / (scale + round_off / options().tolerance + 1e-300);
}

void Crowd::descend(unsigned moving) {
  Scratch& s = scratch_;
  const Index r = model().dofs();
  const Doubles unit = 1e-4 * (largest(s.tangent) + largest(s.H));
  Doubles shift = {};
  s.inverse.resize(r);
  for (int attempt = 0; attempt < 20; ++attempt) {
    s.factor = s.tangent;
    for (size_t p = 0; p < s.factor.size(); ++p) s.factor[p] += s.H[p];
    for (Index k = 0, p = 0; k < r; p += r - k, ++k) s.factor[p] += shift;
    factorize(s.factor.data(), r, s.inverse.data());
    unsigned indefinite = 0;
    for (const Doubles& d : s.inverse)
      for (int lane = 0; lane < kLanes; ++lane)
        if (!(d[lane] > 0)) indefinite |= 1U << lane;
    if (!(indefinite & moving)) break;
    for (int lane = 0; lane < kLanes; ++lane)
      if (indefinite >> lane & 1) shift[lane] = shift[lane] == 0 ? unit[lane] : 4 * shift[lane];
  }
  s.direction = s.gradient;
  substitute(s.factor.data(), s.inverse.data(), r, s.direction.data());
}

unsigned Crowd::minimize(unsigned moving, CrowdReport& report) {
  Scratch& s = scratch_;
  const double tolerance = options().tolerance;
  linearize();
  unsigned alone = 0;
  for (int iteration = 0; moving; ++iteration) {
    Doubles reached;
    residual(reached);
    const unsigned close = lanes_below(reached, 100 * tolerance);  // as Simulation counts convergence
    moving &= ~lanes_below(reached, tolerance);
    if (iteration == options().max_iterations) return alone | (moving & ~close);
    descend(moving);
    // Displacements in single precision have no more digits.
    for (size_t k = 0; k < s.q.size(); ++k) s.trial[k] = s.q[k] - s.centre[k];
    moving &= ~(close & lanes_below(norm(s.direction) - 1e-6 * norm(s.trial), 0));
    if (!moving) break;
    for (int i = 0; i < kLanes; ++i) report.iterations += moving >> i & 1;
    const unsigned stuck = search(moving);
    alone |= stuck & ~close;
    moving &= ~stuck;
  }
  return alone;
}

unsigned Crowd::search(unsigned moving) {
  Scratch& s = scratch_;
  const Index r = model().dofs();
  Doubles slope, length = {};
  dot(s.gradient.data(), s.direction.data(), r, slope);
  const Doubles start = s.potential, elastic = s.energy;
  s.from = s.q;
  for (int lane = 0; lane < kLanes; ++lane) length[lane] = moving >> lane & 1;
  // The whole step is nearly always taken; who would not descend by it halves it, and stays in the end.
  constexpr int kHalvings = 4;
  unsigned rising = moving, stuck = 0;
  for (int halving = 0; rising; ++halving) {
    for (Index k = 0; k < r; ++k) s.q[k] = s.from[k] - length * s.direction[k];
    linearize();
    rising &= ~stuck;
    for (int lane = 0; lane < kLanes; ++lane) {
      const double noise = 1e-6 * (std::abs(elastic[lane]) + std::abs(start[lane] - elastic[lane]));
      if (s.potential[lane] <= start[lane] - 1e-4 * length[lane] * slope[lane] + noise) rising &= ~(1U << lane);
    }
    if (halving == kHalvings) stuck = rising;
    for (int lane = 0; lane < kLanes; ++lane)
      if (rising >> lane & 1) length[lane] = stuck ? 0 : 0.5 * length[lane];
  }
  return stuck;
}

}  // namespace dynamorph
