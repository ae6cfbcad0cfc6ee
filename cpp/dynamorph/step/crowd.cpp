// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/crowd.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/progress.hpp"
#include "dynamorph/reduced/eight_kernels.hpp"

namespace dynamorph {

namespace {

using Eigen::Index;

constexpr int kMost = 1000000;  ///< characters

}  // namespace

Crowd::Crowd(std::shared_ptr<const ReducedModel> model, StepOptions options, int size)
    : size_(size), alone_(std::move(model), std::move(options)) {
  alone_.model().modal_inertia();  // throws if there is none
  if (size < 1 || size > kMost)
    throw std::invalid_argument("size: expected 1 to " + std::to_string(kMost) + " characters, got " +
                                std::to_string(size));
}

void Crowd::balance_targets(const std::vector<Transforms>& bones) { alone_.balance_targets(bones); }

CrowdReport Crowd::start(const double* now, const double* next, const double* weights) {
  const Index bones = model().body().skin.cols(), targets = Index(model().targets().size());
  const Index r = model().dofs(), used = Index(model().modal_inertia().used_bones().size());
  Eight empty;
  for (int m = 0; m < InertialTarget::kMoments; ++m) {
    empty.q[m].assign(r, DoubleW{});
    empty.bones[m].assign(12 * used, DoubleW{});
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
    state.bones[m].setZero(model().body().skin.cols(), 12);  // bones that carry no soft tissue do not count
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
    eights_.clear();  // some characters have moved on
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
                  ": The rig has a transform that is not a number. Check its drivers and constraints.");
  }
}

void Crowd::step_eight(int index, const double* bones, const double* weights, CrowdReport& report) {
  Eight& eight = eights_[index];
  gather(index, bones, weights);
  model().blend(scratch_.blend);
  load(eight);
  const int count = std::min(kLanes, size_ - index * kLanes);
  const Lanes present = (1U << count) - 1, cut = jumps(eight) & present;
  const Lanes need = cut | minimize(present & ~cut, report);
  std::array<State, kLanes> before;
  for (int i = 0; i < count; ++i)
    if (need >> i & 1) before[i] = lane(eight, i);

  std::rotate(eight.q.rbegin(), eight.q.rbegin() + 1, eight.q.rend());
  std::rotate(eight.bones.rbegin(), eight.bones.rbegin() + 1, eight.bones.rend());
  eight.q[0].swap(scratch_.q);
  eight.bones[0].swap(scratch_.bones);

  const Index targets = Index(model().targets().size());
  for (int i = 0; i < count; ++i) {
    if (!(need >> i & 1)) continue;
    const int character = index * kLanes + i;
    alone_.set_state(before[i]);
    add(report, character, [&] {
      return alone_.step(lane(eight, i).bones[0],  // without the bones that do not count
                         Eigen::Map<const VectorXd>(weights + character * targets, targets));
    });
    ++report.alone;
    set_lane(eight, i, alone_.state());
  }
  for (int i = count; i < kLanes; ++i)
    for (DoubleW& q : eight.q[0]) q[i] = q[count - 1];
}

void Crowd::gather(int index, const double* bones, const double* weights) {
  const std::vector<int>& used = model().modal_inertia().used_bones();
  const Index count = model().body().skin.cols(), targets = Index(model().targets().size());
  Scratch& s = scratch_;
  s.blend.weights.resize(targets);
  s.bones.resize(12 * used.size());
  for (int lane = 0; lane < kLanes; ++lane) {
    const Index character = std::min(index * kLanes + lane, size_ - 1);
    for (Index j = 0; j < targets; ++j) s.blend.weights[j][lane] = weights[character * targets + j];
    for (size_t b = 0; b < used.size(); ++b)
      for (int e = 0; e < 12; ++e) s.bones[12 * b + e][lane] = bones[(character * count + used[b]) * 12 + e];
  }
}

Lanes Crowd::jumps(const Eight& eight) const {
  if (options().teleport <= 0) return 0;
  const SoftBody& body = model().body();
  const std::vector<int>& used = model().modal_inertia().used_bones();
  DoubleW jump = {};
  for (size_t b = 0; b < used.size(); ++b) {
    const Eigen::Matrix4d& moments = body.moments[used[b]];
    add_jump(&scratch_.bones[12 * b], &eight.bones[0][12 * b], &eight.bones[1][12 * b], moments.data(),
             body.centre.data(), jump);
  }
  Lanes out = 0;
  for (int lane = 0; lane < kLanes; ++lane)
    if (!(jump[lane] < options().teleport * options().teleport * body.volume)) out |= 1U << lane;
  return out;
}

void Crowd::load(const Eight& eight) {
  const Index r = model().dofs(), pairs = r * (r + 1) / 2;
  Scratch& s = scratch_;
  ReducedModel::EightBlend& blend = s.blend;
  QuadraticTerm<EightLanes>& quadratic = s.quadratic;
  const StepRule rule(options());
  ModalInertia::EightInertialTarget inertial;
  for (int m = 0; m < InertialTarget::kMoments; ++m) inertial.q[m] = eight.q[m].data();
  inertial.bones[0] = s.bones.data();
  for (int m = 0; m < InertialTarget::kMoments; ++m) inertial.bones[m + 1] = eight.bones[m].data();
  inertial.coefficients = rule.coefficients();
  inertial.gravity_offset = rule.square * options().gravity;
  model().modal_inertia().evaluate(inertial, blend.density.data(), blend.density_damping.data(), s.inertia);

  quadratic.hessian.resize(pairs);
  for (LaneVector<DoubleW>* v : {&quadratic.g, &quadratic.origin, &s.velocity}) v->resize(r);
  add_up(s.inertia.mass.data(), s.inertia.damped.data(), 1 / rule.square, rule.velocity[0] / options().h, pairs,
         blend.damping.data(), quadratic.hessian.data());
  for (Index k = 0; k < r; ++k) {
    const DoubleW &q0 = eight.q[0][k], &q1 = eight.q[1][k];
    quadratic.origin[k] = 2 * q0 - q1;
    s.velocity[k] =
        (rule.velocity[0] * quadratic.origin[k] + rule.velocity[1] * q0 + rule.velocity[2] * q1) / options().h;
  }
  EightLanes::multiply(blend.damping, s.velocity, quadratic.g);
  for (Index k = 0; k < r; ++k) quadratic.g[k] += s.inertia.force[k] / rule.square;
  for (Index j = 0; j < alone_.rest_gravity().cols(); ++j)
    add_scaled(blend.weights[j], alone_.rest_gravity().col(j).data(), r, quadratic.g.data());

  DoubleW farthest = {}, density = {};
  for (size_t e = 3; e < s.bones.size(); e += 4) EightLanes::widen(farthest, s.bones[e]);
  for (const DoubleW& d : blend.density) EightLanes::widen(density, d);
  const SoftBody& body = model().body();
  quadratic.round_off = 1e-14 / rule.square * (farthest + (body.centre.norm() + body.size)) *
                        EightLanes::root(body.volume * density * EightLanes::largest(s.inertia.mass));
}

Lanes Crowd::minimize(Lanes moving, CrowdReport& report) {
  Scratch& s = scratch_;
  s.elastic.model = &model();
  s.elastic.blend = &s.blend;
  s.elastic.reference = EightLanes::norm(s.quadratic.origin);
  s.q = s.quadratic.origin;
  Potential<EightLanes, decltype(s.quadratic), decltype(s.elastic)> potential(s.quadratic, s.elastic);
  const double nothing = options().tolerance * model().body().size * model().metre();
  const NewtonLimits limits{options().tolerance, nothing, options().max_iterations};
  const auto found = dynamorph::minimize(potential, s.newton, s.q, moving, limits, [] {});
  report.iterations += found.iterations;
  return found.open | found.broken;
}

}  // namespace dynamorph
