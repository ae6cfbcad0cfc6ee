// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/coupled_simulation.hpp"

#include <algorithm>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/step/teleport.hpp"

namespace dynamorph {

namespace {

/// Of things that are numbered one body after the other: the body that one belongs to, and its number there. first: the
/// first number of each body.
std::pair<std::size_t, int> find_owner(const std::vector<int>& first, int number) {
  const auto body = std::upper_bound(first.begin(), first.end(), number) - first.begin() - 1;
  return {std::size_t(body), number - first[std::size_t(body)]};
}

}  // namespace

/// `PosedSamples` of several bodies: their samples, and the vertices of their skins, follow each other in their
/// numbers.
template <class Model>
class JointSamples {
 public:
  using Matrix = typename Model::Matrix;
  using Rows = typename Model::SkinPoints::Rows;

  /// first_sample: of each body.
  JointSamples(std::vector<PosedSamples<Model>> bodies, const std::vector<int>& first_sample,
               const JointLayout<Matrix>& layout)
      : bodies_(std::move(bodies)), first_sample_(first_sample), layout_(layout) {
    first_vertex_.push_back(0);
    for (const auto& body : bodies_) first_vertex_.push_back(first_vertex_.back() + int(body.of.map().size()));
  }

  double stiffness(int sample, double square) const {
    const auto [body, own] = find_owner(first_sample_, sample);
    return bodies_[body].stiffness(own, square);
  }
  Vector3d unmoved(int sample) const {
    const auto [body, own] = find_owner(first_sample_, sample);
    return bodies_[body].unmoved(own);
  }
  void add(int sample, const Vector3d& direction, PointRows& numbers) const {
    const auto [body, own] = find_owner(first_sample_, sample);
    const int first = first_vertex_[body];
    bodies_[body].of.points().each_corner(own,
                                          [&](int v, double weight) { numbers.add(first + v, weight * direction); });
  }
  void rows(const PointRows& numbers, PointRows& scratch, Rows& out) const {
    std::vector<Rows> own(bodies_.size());
    std::vector<const Rows*> all;
    for (std::size_t body = 0; body < bodies_.size(); ++body) {
      const int first = first_vertex_[body], end = first_vertex_[body + 1];
      PointRows part;
      for (int row = 0; row < numbers.size(); ++row) {
        part.add_row();
        for (int k = numbers.first(row); k < numbers.first(row + 1); ++k)
          if (numbers.point(k) >= first && numbers.point(k) < end)
            part.add(numbers.point(k) - first, numbers.direction(k));
      }
      bodies_[body].rows(part, scratch, own[body]);
      all.push_back(&own[body]);
    }
    layout_.join(all, out);
  }

 private:
  std::vector<PosedSamples<Model>> bodies_;
  const std::vector<int>& first_sample_;
  std::vector<int> first_vertex_;  ///< of each body, and how many there are
  const JointLayout<Matrix>& layout_;
};

/// The potentials of all bodies and their contacts, for Newton's method: a `Potential` over the coordinates of all.
template <class Model>
class CoupledSimulation<Model>::Sum {
 public:
  using Rows = typename Model::SkinPoints::Rows;

  explicit Sum(CoupledSimulation& of) : of_(of) {
    for (const auto& body : of.bodies_) sums_.push_back(body.simulation->sum());
  }

  double value(const VectorXd& all) {
    of_.contacts_.at(all);
    double out = of_.contacts_.value();
    for (std::size_t body = 0; body < sums_.size(); ++body) {
      of_.take(all, body, own_);
      out += sums_[body].value(own_);
    }
    return out;
  }

  void linearize(const VectorXd& all, Linearization& out) {
    of_.contacts_.at(all);
    out.gradient = of_.contacts_.gradient();
    out.value = out.magnitude = of_.contacts_.value();
    out.round_off = of_.contacts_.round_off();
    VectorXd gradient = VectorXd::Zero(all.size());
    for (std::size_t body = 0; body < sums_.size(); ++body) {
      of_.take(all, body, own_);
      sums_[body].linearize(own_, part_);
      of_.put(part_.gradient, body, gradient);
      out.value += part_.value;
      out.magnitude += part_.magnitude;
      out.round_off = out.round_off + part_.round_off;
    }
    out.gradient += gradient;
  }

  void hessian(Hessian<Matrix>& out) {
    points_.clear();
    for (std::size_t body = 0; body < sums_.size(); ++body) {
      Hessian<Matrix>& own = of_.bodies_[body].simulation->newton_.hessian;
      sums_[body].hessian(own);
      of_.layout_.put(own.base, body, out.base);
      std::vector<const Rows*> rows(sums_.size());
      for (const auto* each : own.points) {
        rows[body] = &each->rows;
        points_.push_back(*each);  // with the unknowns that they have of their own
        of_.layout_.join(rows, points_.back().rows);
      }
    }
    out.points.clear();
    for (const auto& each : points_) out.points.push_back(&each);
    if (const auto& contacts = of_.contacts_.hessian(); contacts.stiffness.size() > 0) out.points.push_back(&contacts);
  }

 private:
  CoupledSimulation& of_;
  std::vector<typename Simulation<Model>::Sum> sums_;
  VectorXd own_;
  Linearization part_;
  std::vector<PointStiffness<Matrix>> points_;  ///< that bodies have of their own
};

template <class Model>
std::vector<typename Model::Matrix> patterns(const std::vector<CoupledBody<Model>>& bodies) {
  if (bodies.size() < 2) throw std::invalid_argument("coupling: expected two bodies at least");
  std::vector<typename Model::Matrix> out;
  for (const auto& body : bodies) out.push_back(body.simulation->model().zero());
  return out;
}

template <class Model>
CoupledSimulation<Model>::CoupledSimulation(std::vector<CoupledBody<Model>> bodies, double friction,
                                            const std::vector<Garment>& garments)
    : bodies_(std::move(bodies)), friction_(friction), layout_(patterns(bodies_)), scratch_(bodies_.size()) {
  if (!(friction >= 0) || !std::isfinite(friction))
    throw std::invalid_argument("friction: must be finite and not negative");
  const StepOptions& first = bodies_[0].simulation->options();
  for (const auto& [simulation, skin] : bodies_) {
    const StepOptions& options = simulation->options();
    if (options.h != first.h || options.integrator != first.integrator)
      throw std::invalid_argument("coupling: the bodies must have the same time step and integrator");
    if (!skin || &skin->samples() != simulation->samples_.get())
      throw std::invalid_argument("coupling: the skin of a body must be that of its simulation's contact");
  }
  int samples = 0;
  for (const auto& body : bodies_) {
    first_sample_.push_back(samples);
    samples += int(body.skin->samples().size());
  }
  const auto is_body = [&](int body) { return body >= 0 && std::size_t(body) < bodies_.size(); };
  for (const auto& [clothes, body, to_body] : garments) {
    if (!is_body(clothes) || !is_body(body) || clothes == body || !to_body.allFinite())
      throw std::invalid_argument("garments: must be numbers of two bodies, and a finite transform");
    const auto skin = [&](int number) -> const SelfContact<Model>& { return *bodies_[std::size_t(number)].skin; };
    worn_.push_back(skin(clothes).wear(clothes, body, skin(body), to_body));
  }
  newton_.hessian.base = layout_.zero();
}

template <class Model>
void CoupledSimulation<Model>::forget() {
  newton_.solver.forget();
  for (const auto& body : bodies_) body.simulation->forget();
}

template <class Model>
std::vector<StepReport> CoupledSimulation<Model>::step(const std::vector<StepInput>& inputs) {
  if (inputs.size() != bodies_.size())
    throw std::invalid_argument("coupling: expected the input of " + std::to_string(bodies_.size()) + " bodies, got " +
                                std::to_string(inputs.size()));
  std::vector<StepReport> reports;
  std::size_t begun = 0;
  try {
    for (; begun < bodies_.size(); ++begun) bodies_[begun].simulation->begin_step(inputs[begun]);
    find_contacts(inputs);
    reports = solve();
  } catch (...) {
    for (std::size_t body = 0; body < begun; ++body) bodies_[body].simulation->give_up();
    throw;
  }
  for (std::size_t body = 0; body < bodies_.size(); ++body)
    bodies_[body].simulation->end_step(inputs[body], reports[body]);
  remember_pressures();
  report_contacts(reports);
  return reports;
}

template <class Model>
void CoupledSimulation<Model>::take(const VectorXd& all, std::size_t body, VectorXd& own) const {
  layout_.take(all, body, own);
  const Eigen::Index first = first_patch_[body], patches = first_patch_[body + 1] - first;
  own.conservativeResize(own.size() + patches);
  own.tail(patches) = all.segment(first, patches);
}

template <class Model>
void CoupledSimulation<Model>::put(const VectorXd& own, std::size_t body, VectorXd& all) const {
  layout_.put(own, body, all);
  const Eigen::Index first = first_patch_[body], patches = first_patch_[body + 1] - first;
  all.segment(first, patches) = own.tail(patches);
}

template <class Model>
void CoupledSimulation<Model>::find_contacts(const std::vector<StepInput>& inputs) {
  std::vector<typename SelfContact<Model>::Body> skins;
  std::vector<PosedSamples<Model>> samples;
  std::vector<Pressure> pressures;
  ContactStep step = bodies_[0].simulation->contact_step();
  for (std::size_t body = 0; body < bodies_.size(); ++body) {
    const auto& [simulation, skin] = bodies_[body];
    const SoftBody& soft = simulation->model().body();
    const bool jumps = dynamorph::jumps(soft, soft.size, inputs[body].bones, simulation->state_.bones);
    skins.push_back({*skin, simulation->posed_skin(inputs[body]), scratch_[body], first_sample_[body], jumps});
    samples.push_back({skin->samples(), inputs[body].bones, inputs[body].weights});
    for (const Pressure& last : simulation->state_.pressures)
      if (last.collider == kOtherSkin)
        pressures.push_back({first_sample_[body] + last.sample, kSkin, last.normal, last.force, last.slip});
    const ContactStep own = simulation->contact_step();
    step.distance = std::max(step.distance, own.distance);
    step.width = std::min(step.width, own.width);
    step.sticks = std::min(step.sticks, own.sticks);
  }
  step.own_friction = friction_;
  SelfContact<Model>::find_between(skins, worn_, found_);
  contacts_.clear();
  if (!found_.empty()) contacts_.begin({std::move(samples), first_sample_, layout_}, found_, step, pressures);
}

template <class Model>
std::vector<StepReport> CoupledSimulation<Model>::solve() {
  std::vector<StepReport> reports;
  if (contacts_.empty()) {
    for (const auto& body : bodies_) reports.push_back(body.simulation->solve_step());
    return reports;
  }
  NewtonLimits limits{kInfinity, kInfinity, 0, false};
  first_patch_.assign(1, layout_.dofs());
  for (const auto& body : bodies_)
    first_patch_.push_back(first_patch_.back() + body.simulation->contacts_.unknowns().size());
  all_.resize(first_patch_.back());
  VectorXd own;
  for (std::size_t body = 0; body < bodies_.size(); ++body) {
    const Simulation<Model>& simulation = *bodies_[body].simulation;
    const StepOptions& options = simulation.options();
    const VectorXd& patches = simulation.contacts_.unknowns();
    own.resize(simulation.next_.size() + patches.size());
    own << simulation.next_, patches;
    put(own, body, all_);
    limits.tolerance = std::min(limits.tolerance, options.tolerance);
    limits.step =
        std::min(limits.step, options.tolerance * simulation.model().body().size * simulation.model().meter());
    limits.iterations = std::max(limits.iterations, options.max_iterations);
  }
  const auto ask = [&] {
    for (const auto& body : bodies_)
      if (const auto& keep_going = body.simulation->options().keep_going; keep_going && !keep_going())
        throw Cancelled();
  };
  const auto minimize = [&] {
    Sum sum(*this);
    return dynamorph::minimize(sum, newton_, all_, limits, ask);
  };
  NewtonReport found = minimize();
  bool again = contacts_.next_round();
  for (const auto& body : bodies_) again |= body.simulation->contacts_.next_round();
  if (again) {
    const int iterations = found.iterations;
    found = minimize();
    found.iterations += iterations;
  }
  for (std::size_t body = 0; body < bodies_.size(); ++body) {
    Simulation<Model>& simulation = *bodies_[body].simulation;
    reports.push_back(simulation.report(found));
    layout_.take(all_, body, simulation.next_);
  }
  return reports;
}

template <class Model>
void CoupledSimulation<Model>::remember_pressures() {
  std::vector<Pressure> all;
  contacts_.pressures(all);
  for (auto last = all.rbegin(); last != all.rend(); ++last) {  // each goes before those of the body's own contacts
    const auto [body, sample] = find_owner(first_sample_, last->sample);
    std::vector<Pressure>& own = bodies_[body].simulation->state_.pressures;
    own.insert(own.begin(), {sample, kOtherSkin, last->normal, last->force, last->slip});
  }
}

template <class Model>
void CoupledSimulation<Model>::report_contacts(std::vector<StepReport>& reports) const {
  contacts_.each_push([&](const Contact& contact, const Vector3d& force) {
    const std::size_t body = find_owner(first_sample_, contact.sample).first;
    const std::size_t other = find_owner(first_sample_, contact.others.samples[0]).first;
    reports[body].body_force += force;
    reports[other].body_force -= force;
    ++reports[body].contacts;
  });
  for (const Contact& contact : found_) {
    const auto [body, sample] = find_owner(first_sample_, contact.sample);
    StepReport& report = reports[body];
    if (!(contact.too_deep > report.too_deep)) continue;
    report.too_deep = contact.too_deep;
    report.too_deep_sample = sample;
    report.too_deep_collider = kSkin - 1 - int(find_owner(first_sample_, contact.others.samples[0]).first);
  }
}

template class CoupledSimulation<FullModel>;
template class CoupledSimulation<ReducedModel>;

}  // namespace dynamorph
