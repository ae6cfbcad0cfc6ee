// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/moving_body.hpp"

#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/progress.hpp"
#include "dynamorph/step/choices.hpp"
#include "dynamorph/step/teleport.hpp"

namespace dynamorph {

namespace {

constexpr int kStaticIterations = 200;  // needed only once, and gravity moves a soft body far
constexpr int kLieDown = 20;  // static solutions until contacts stay: 2 in a bed, 4 to 10 with a ball in a belly

/// Gravity (m/s^2, world) on the soft tissue at the bones, without a past.
InertialTarget at_rest(const VectorXd& q, const Transforms& bones, const Vector3d& gravity) {
  InertialTarget inertial;
  inertial.q.fill(&q);
  inertial.bones.fill(&bones);
  inertial.gravity_offset = gravity;
  return inertial;
}

/// Throws Error unless a state's contacts are of samples that there are (0: without contact).
void check_contacts(const State& state, Eigen::Index samples) {
  const auto good = [&](int sample, int collider, const Vector3d& normal) {
    return sample >= 0 && sample < samples && collider >= kOtherSkin && normal.allFinite();
  };
  for (const ContactMemory::Plane& plane : state.contact.planes)
    if (!good(plane.sample, plane.collider, plane.normal) || plane.collider < 0 || !plane.point.allFinite())
      throw Error("The state has a contact that does not fit");
  for (const Pressure& pressure : state.pressures)
    if (!good(pressure.sample, pressure.collider, pressure.normal) || !(pressure.force >= 0) ||
        !std::isfinite(pressure.force) || !pressure.slip.allFinite())
      throw Error("The state has a contact that does not fit");
}

/// Of a limit that has not acted; `bones`: 0 without a limit.
DrivenLoad not_driven(Eigen::Index bones, Eigen::Index dofs) {
  const VectorXd none = VectorXd::Zero(bones);
  return {MatrixX2d::Zero(bones > 0 ? dofs : 0, 2), none, none, {none, none, none}};
}

/// Throws std::invalid_argument unless the load is empty or fits, and Error for what is not finite.
void check_driven(const DrivenLoad& driven, Eigen::Index bones, Eigen::Index dofs) {
  if (driven.swing.size() == 0) return;
  bool fits = driven.swing.rows() == dofs, finite = driven.swing.allFinite();
  for (const VectorXd* x : {&driven.reach, &driven.held, &driven.excess[0], &driven.excess[1], &driven.excess[2]}) {
    fits = fits && x->size() == bones;
    finite = finite && x->allFinite() && (x->array() >= 0).all();
  }
  if (!fits)
    throw std::invalid_argument("state: expected the limit of " + std::to_string(bones) + " bones, got " +
                                std::to_string(driven.reach.size()));
  if (!finite) throw Error("The state has an excess that is not a finite number");
}

/// Throws std::invalid_argument unless the parts are those of such a model.
template <class Model>
void check(const Parts<Model>& parts, const Model& model) {
  const auto is_own = [&](const auto& part) { return !part || &part->model() == &model; };
  if (!is_own(parts.limit)) throw std::invalid_argument("limit: it belongs to another model");
  if (!is_own(parts.contact)) throw std::invalid_argument("contact: its samples belong to another model");
  if (parts.self_contact && &parts.self_contact->samples() != parts.contact.get())
    throw std::invalid_argument("self_contact: its samples are not those of the contact");
  check_not_negative("distance", parts.distance);
  check_not_negative("friction", parts.self_friction);
}

}  // namespace

void check_weights(const std::vector<MorphTarget>& targets, int sets, const Eigen::Ref<const VectorXd>& weights) {
  if (weights.size() != Eigen::Index(targets.size()))
    throw std::invalid_argument("weights: expected " + std::to_string(targets.size()) + ", got " +
                                std::to_string(weights.size()));
  for (int set = 0; set < sets; ++set) {
    double sum = 0;
    for (Eigen::Index j = 0; j < weights.size(); ++j)
      if (targets[j].set == set) sum += weights(j);
    if (!((weights.array() >= 0).all() && std::abs(sum - 1) < 1e-6))
      throw std::invalid_argument("weights: those of every target set must be >= 0 and sum to one");
  }
}

template <class Model>
MovingBody<Model>::MovingBody(std::shared_ptr<const Model> model, StepOptions options, Parts<Model> parts)
    : model_(std::move(model)),
      options_(std::move(options)),
      parts_(std::move(parts)),
      load_(model_, parts_.limit),
      search_(parts_.contact, parts_.distance, parts_.self_contact, parts_.self_friction) {
  check(options_);
  check(parts_, *model_);
  damped_ = quadratic_.H = newton_.hessian.base = model_->zero();
  state_.driven = not_driven(parts_.limit ? parts_.limit->bones() : 0, model_->dofs());
  state_.dents = VectorXd::Zero(patches());
  const SoftBody& body = model_->body();
  shares_ = body.volumes.colwise().sum().transpose() / body.volumes.sum();
}

template <class Model>
Eigen::Index MovingBody<Model>::patches() const {
  return parts_.contact && parts_.contact->local() ? parts_.contact->local()->size() : 0;
}

template <class Model>
void MovingBody<Model>::pose(const Transforms& bones, const VectorXd& weights, const VectorXd* stiffness) {
  if (bones.rows() != model_->body().skin.cols())
    throw std::invalid_argument("bones: expected " + std::to_string(model_->body().skin.cols()) + " transforms, got " +
                                std::to_string(bones.rows()));
  if (!bones.allFinite() || !weights.allFinite())
    throw Error("The rig has a transform that is not a number. Check what poses it at this step.");
  stiffer_ = 1;
  if (!stiffness) return model_->blend(weights, blend_);
  check_size("stiffness", stiffness->size(), weights.size());
  if (!stiffness->allFinite() || !(stiffness->array() > 0).all())
    throw std::invalid_argument("stiffness: must be finite and above zero");
  const VectorXd elastic = weights.cwiseProduct(*stiffness);
  stiffer_ = 0;
  for (std::size_t j = 0; j < model_->targets().size(); ++j)
    stiffer_ += shares_(model_->targets()[j].set) * elastic(Eigen::Index(j));
  model_->blend(weights, elastic, blend_);
}

template <class Model>
void MovingBody<Model>::balance_targets(const std::vector<Transforms>& bones) {
  const auto& targets = model_->targets();
  if (bones.size() != targets.size())
    throw std::invalid_argument("bones: expected one skin frame for each of " + std::to_string(targets.size()) +
                                " targets, got " + std::to_string(bones.size()));
  MatrixXd loads(model_->dofs(), targets.size());
  MatrixXd directions(3 * model_->body().skin.cols(), targets.size());
  const VectorXd rest = VectorXd::Zero(model_->dofs());
  for (size_t j = 0; j < targets.size(); ++j) {
    // The target alone, without targets of other sets: f_g^(j) = rho_j (A^(j))^T M1 g.
    const VectorXd alone = VectorXd::Unit(targets.size(), j);
    pose(bones[j], alone, nullptr);
    load_.unbalanced({at_rest(rest, bones[j], options_.gravity), 1, blend_, nullptr}, quadratic_.g);
    loads.col(j) = -quadratic_.g;
    for (Eigen::Index t = 0; t < bones[j].rows(); ++t)
      directions.block<3, 1>(3 * t, j) = transform(bones[j], t).leftCols<3>().transpose() * options_.gravity;
  }
  load_.balance(std::move(loads), std::move(directions));
}

template <class Model>
void MovingBody<Model>::begin_terms(const StepInput<Model>& input, const VectorXd& predicted, double watched) {
  grabs_.begin(*model_, input);
  pulls_.begin(parts_.limit.get(), input.weights, stiffer_, predicted, watched);
}

template <class Model>
void MovingBody<Model>::find_contacts(const StepInput<Model>& input) {
  search_.find(input, state_, next_);
  contacts_.clear();
  if (search_.found().empty()) return;
  contacts_.begin({*parts_.contact, input.bones, input.weights, blend_.elastic}, search_.found(), contact_step(),
                  state_.pressures, state_.dents);
}

template <class Model>
void MovingBody<Model>::report_contacts(const StepInput<Model>& input, StepReport& report) {
  if (search_.found().empty() && (!input.colliders || input.colliders->empty())) return;
  report.contacts = contacts_.count();
  if (report.converged) report.penetration = contacts_.penetration();
  for (std::size_t k = 0; k < search_.found().size(); ++k) {
    const Contact& contact = search_.found()[k];
    const double too_deep = std::min(contact.too_deep, contacts_.inside(k));
    if (!(too_deep > report.too_deep)) continue;
    report.too_deep = too_deep;
    report.too_deep_sample = contact.sample;
    report.too_deep_collider = contact.collider;
  }
  report.contact_forces.assign(input.colliders ? input.colliders->size() : 0, Vector3d::Zero());
  contacts_.forces(report.contact_forces);
  report.unusable_colliders = search_.unusable();
}

template <class Model>
StepReport MovingBody<Model>::solve_static(const StepInput<Model>& input, VectorXd& q) {
  const VectorXd& weights = input.weights;
  check_weights(model_->targets(), model_->body().sets(), weights);
  pose(input.bones, weights, input.stiffness);
  if (q.size() != model_->dofs()) {
    // The blended targets are close to the answer, and often they are the answer.
    blended_shape(*model_, weights, q);
  }
  if (!q.allFinite()) throw std::invalid_argument("q: coordinates must be finite");
  const InertialTarget gravity = at_rest(q, input.bones, options_.gravity);
  load_.lasting({gravity, 1, blend_, input.external}, quadratic_.g);
  begin_terms(input, q, 0);
  contacts_.clear();
  forget();
  values(quadratic_.H).setZero();
  quadratic_.origin = VectorXd::Zero(model_->dofs());
  quadratic_.round_off_of_g = 1e-15 * quadratic_.g.norm();
  next_ = q;
  const StepReport report = minimize(kStaticIterations);
  q = next_;
  return report;
}

template <class Model>
StepReport MovingBody<Model>::start(const StepInput<Model>& now, const Transforms& next) {
  if (next.rows() != now.bones.rows() || !next.allFinite())
    throw std::invalid_argument("next: expected " + std::to_string(now.bones.rows()) + " finite transforms, got " +
                                std::to_string(next.rows()));
  VectorXd q;
  StepReport report = solve_static(now, q);
  state_.dents.setZero();
  weights_ = now.weights;
  elastic_weights_ = blend_.elastic;
  state_.driven = load_.driven();
  state_.q.fill(q);
  for (int k = 0; k < InertialTarget::kMoments; ++k) state_.bones[k] = extrapolate_back(now.bones, next, k);
  state_.contact.clear();
  state_.pressures.clear();
  lie_down(now, report);
  return report;
}

// Each static solution has the planes that are found where the last one ended. Friction has no pressure yet, so it does
// not act.
template <class Model>
void MovingBody<Model>::lie_down(const StepInput<Model>& input, StepReport& report) {
  const double negligible = limits().step;
  for (int round = 0; round < kLieDown; ++round) {
    next_ = state_.q[0];
    find_contacts(input);
    if (contacts_.empty()) break;
    const int iterations = report.iterations;
    report = minimize(options_.max_iterations);
    report.iterations += iterations;
    const bool lies = (next_ - state_.q[0]).norm() <= negligible;
    state_.q.fill(next_);
    state_.contact = search_.memory();
    contacts_.dents(state_.dents);
    if (lies) break;
  }
  report_contacts(input, report);
  contacts_.dents(state_.dents);
  contacts_.pressures(state_.pressures);
}

template <class Model>
void MovingBody<Model>::set_state(const State& state) {
  for (const VectorXd& q : state.q) {
    if (q.size() != model_->dofs()) throw std::invalid_argument("state: it belongs to another model");
    if (!q.allFinite()) throw Error("The state has a coordinate that is not a finite number");
  }
  for (const Transforms& bones : state.bones) {
    if (bones.rows() != model_->body().skin.cols()) throw std::invalid_argument("state: it belongs to another model");
    if (!bones.allFinite()) throw Error("The state has a bone transform that is not a finite number");
  }
  const Eigen::Index limited = parts_.limit ? parts_.limit->bones() : 0;
  if (parts_.limit) check_driven(state.driven, limited, model_->dofs());
  if (parts_.contact) check_contacts(state, parts_.contact->size());
  if (state.dents.size() > 0 && state.dents.size() != patches())
    throw std::invalid_argument("state: expected the dents of " + std::to_string(patches()) + " patches, got " +
                                std::to_string(state.dents.size()));
  if (!state.dents.allFinite()) throw Error("The state has a dent that is not a finite number");
  state_ = state;
  if (state.dents.size() == 0) state_.dents = VectorXd::Zero(patches());
  if (!parts_.contact) {
    state_.contact.clear();
    state_.pressures.clear();
  }
  if (!parts_.limit || state_.driven.swing.size() == 0) state_.driven = not_driven(limited, model_->dofs());
}

template <class Model>
double MovingBody<Model>::farthest(const Transforms& bones) const {
  return bones.rightCols<1>().cwiseAbs().maxCoeff() + bones.col(3).cwiseAbs().maxCoeff() +
         bones.col(7).cwiseAbs().maxCoeff() + model_->body().center.norm() + model_->body().size;
}

template <class Model>
void MovingBody<Model>::begin_step(const StepInput<Model>& input) {
  if (state_.q[0].size() == 0) throw std::invalid_argument("step: start() comes first");
  check_weights(model_->targets(), model_->body().sets(), input.weights);
  pose(input.bones, input.weights, input.stiffness);
  teleported_ = jumps(model_->body(), options_.teleport, input.bones, state_.bones);
  if (teleported_) {
    before_ = state_;
    carry_past(model_->body(), input.bones, state_.bones);
    state_.contact.clear();
    state_.pressures.clear();
    state_.dents.setZero();
  }
  try {
    prepare(input);
  } catch (...) {
    give_up();
    throw;
  }
}

template <class Model>
StepReport MovingBody<Model>::solve_alone() {
  guess(unknowns_);
  begin_newton();
  const auto next_round = [&] {
    begin_newton();
    return contacts_.next_round();
  };
  const NewtonReport found = minimize_in_rounds(potential_, newton_, unknowns_, limits(), [&] { ask(); }, next_round);
  return accept(found, unknowns_);
}

template <class Model>
void MovingBody<Model>::give_up() {
  if (teleported_) state_ = before_;
  teleported_ = false;
}

template <class Model>
void MovingBody<Model>::prepare(const StepInput<Model>& input) {
  const Transforms& bones = input.bones;
  const StepRule rule(options_);
  const double h = options_.h;
  next_ = 2 * state_.q[0] - state_.q[1];
  InertialTarget inertial;
  inertial.bones[0] = &bones;
  for (int m = 0; m < InertialTarget::kMoments; ++m) {
    inertial.q[m] = &state_.q[m];
    inertial.bones[m + 1] = &state_.bones[m];
  }
  inertial.coefficients = rule.coefficients();
  inertial.gravity_offset = rule.square * options_.gravity;
  load_.step({inertial, rule.square, blend_, input.external}, h, stiffer_, state_.driven, quadratic_.g);
  begin_terms(input, next_, kWatched);
  find_contacts(input);

  // Damping: C u' with u' = (v0 q + v1 q(n) + v2 q(n-1)) / h and a constant, symmetric, positive C.
  values(damped_) = values(load_.inertia().damped) + values(blend_.damping);
  values(quadratic_.H) = values(load_.inertia().mass) / rule.square + (rule.velocity[0] / h) * values(damped_);
  velocity_ = (rule.velocity[0] * next_ + rule.velocity[1] * state_.q[0] + rule.velocity[2] * state_.q[1]) / h;
  multiply(damped_, velocity_, resistance_);
  quadratic_.g += resistance_;
  quadratic_.origin = next_;
  // Far from the world's origin, posed positions lose digits, and inertia multiplies the loss.
  quadratic_.round_off_of_g = 1e-14 / rule.square * farthest(bones) *
                              std::sqrt(model_->body().volume * blend_.mass.density.maxCoeff() *
                                        values(load_.inertia().mass).cwiseAbs().maxCoeff());
}

template <class Model>
void MovingBody<Model>::end_step(const StepInput<Model>& input, StepReport& report) {
  report.teleported = teleported_;
  report_contacts(input, report);
  contacts_.dents(state_.dents);
  std::rotate(state_.q.rbegin(), state_.q.rbegin() + 1, state_.q.rend());
  std::rotate(state_.bones.rbegin(), state_.bones.rbegin() + 1, state_.bones.rend());
  state_.q[0] = next_;
  state_.bones[0] = input.bones;
  state_.driven = load_.driven();
  state_.contact = search_.memory();
  contacts_.pressures(state_.pressures);
  weights_ = input.weights;
  elastic_weights_ = blend_.elastic;
}

template <class Model>
void MovingBody<Model>::require_pose() const {
  if (state_.q[0].size() == 0 || weights_.size() == 0)
    throw std::invalid_argument("energy: start() comes first, or after setting a state a step");
}

template <class Model>
void MovingBody<Model>::guess(VectorXd& unknowns) const {
  const VectorXd& patches = contacts_.unknowns();
  unknowns.resize(next_.size() + patches.size());
  unknowns << next_, patches;
}

template <class Model>
void MovingBody<Model>::begin_newton() {
  elastic_.begin(*model_, blend_, quadratic_.origin.norm(), options_.tolerance);
}

template <class Model>
StepReport MovingBody<Model>::minimize(int max_iterations) {
  guess(unknowns_);
  begin_newton();
  NewtonLimits until = limits();
  until.iterations = max_iterations;
  const NewtonReport found = dynamorph::minimize(potential_, newton_, unknowns_, until, [&] { ask(); });
  return accept(found, unknowns_);
}

template <class Model>
StepReport MovingBody<Model>::accept(const NewtonReport& found, const VectorXd& unknowns) {
  if (found.broken)
    throw Error("A step failed because a force is not finite. Check the rig and the materials at this frame.");
  next_ = unknowns.head(next_.size());
  StepReport report;
  report.iterations = found.iterations;
  report.converged = found.converged;
  report.residual = found.residual;
  report.energy = found.unseen ? elastic_.energy_after(newton_.direction) : elastic_.energy();
  report.farthest = pulls_.farthest();
  report.pulled = pulls_.acts();
  if (parts_.limit) report.excess = load_.driven().excess[0].maxCoeff(&report.excess_bone);
  return report;
}

template <class Model>
void MovingBody<Model>::remember(const std::vector<Pressure>& pressures) {
  state_.pressures.insert(state_.pressures.begin(), pressures.begin(), pressures.end());
}

template <class Model>
NewtonLimits MovingBody<Model>::limits() const {
  const double negligible = options_.tolerance * model_->body().size * model_->meter();
  return {options_.tolerance, negligible, options_.max_iterations, contacts_.empty()};
}

template <class Model>
void MovingBody<Model>::ask() const {
  if (options_.keep_going && !options_.keep_going()) throw Cancelled();
}

template <class Model>
double MovingBody<Model>::elastic_energy() const {
  require_pose();
  typename Model::Blend blend;  // blend_ may be of another pose
  model_->blend(weights_, elastic_weights_, blend);
  return model_->energy(blend, state_.q[0]);
}

template <class Model>
double MovingBody<Model>::kinetic_energy() const {
  require_pose();
  const SoftBody& body = model_->body();
  VectorXd velocity = VectorXd::Zero(body.rest.size()), u, x;
  const std::array<double, 3> past = StepRule(options_).velocity;
  for (int m = 0; m < 3; ++m) {
    SkinFrame frame{state_.bones[m], {}};
    pose_nodes(body.skin, frame);
    model_->displacement(state_.q[m], u);
    to_world(frame, 1, body.rest + u, x);
    velocity += past[m] / options_.h * x;
  }
  SetDensities densities;
  densities.blend(model_->targets(), body.sets(), weights_);
  const VectorXd mass = body.volumes * densities.density;
  double energy = 0;
  for (Eigen::Index i = 0; i < mass.size(); ++i) energy += 0.5 * mass(i) * velocity.segment<3>(3 * i).squaredNorm();
  return energy;
}

template class MovingBody<FullModel>;
template class MovingBody<ReducedModel>;

}  // namespace dynamorph
