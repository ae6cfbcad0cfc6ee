// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/simulation.hpp"

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
class Simulation<Model>::Sum {
 public:
  using Rows = typename Model::SkinPoints::Rows;

  explicit Sum(Simulation& of) : of_(of) {}

  double value(const VectorXd& all) {
    double out = of_.contacts_.value(all);
    for (std::size_t body = 0; body < of_.bodies_.size(); ++body) {
      of_.take(all, body, own_);
      out += potential(body).value(own_);
    }
    return out;
  }

  void linearize(const VectorXd& all, Linearization& out) {
    const auto contacts = of_.contacts_.linearize(all);
    out.value = out.magnitude = contacts.value;
    out.round_off = contacts.round_off;
    out.gradient.setZero(all.size());
    for (std::size_t body = 0; body < of_.bodies_.size(); ++body) {
      of_.take(all, body, own_);
      potential(body).linearize(own_, part_);
      of_.put(part_.gradient, body, out.gradient);
      out.value += part_.value;
      out.magnitude += part_.magnitude;
      out.round_off = out.round_off + part_.round_off;
    }
    out.gradient += contacts.gradient;
  }

  void hessian(Hessian<Matrix>& out) {
    points_.clear();
    for (std::size_t body = 0; body < of_.bodies_.size(); ++body) {
      Hessian<Matrix>& own = of_.hessians_[body];
      potential(body).hessian(own);
      of_.layout_.put(own.base, body, out.base);
      std::vector<const Rows*> rows(of_.bodies_.size());
      for (const auto* each : own.points) {
        rows[body] = &each->rows;
        points_.push_back(*each);  // with the unknowns that they have of their own
        of_.layout_.join(rows, points_.back().rows);
      }
    }
    out.points.clear();
    for (const auto& each : points_) out.points.push_back(&each);
    if (const auto& contacts = of_.contacts_.points(); contacts.stiffness.size() > 0) out.points.push_back(&contacts);
  }

 private:
  typename MovingBody<Model>::Sum& potential(std::size_t body) { return of_.bodies_[body].body->potential(); }

  Simulation& of_;
  VectorXd own_;
  Linearization part_;
  std::vector<PointStiffness<Matrix>> points_;  ///< that bodies have of their own
};

template <class Model>
std::vector<typename Model::Matrix> patterns(const std::vector<TouchingBody<Model>>& bodies) {
  std::vector<typename Model::Matrix> out;
  for (const auto& each : bodies) out.push_back(each.body->model().zero());
  return out;
}

template <class Model>
Simulation<Model>::Simulation(MovingBody<Model>& body)
    : bodies_{{&body, nullptr}}, reports_(1), layout_(std::vector<Matrix>()) {}

template <class Model>
Simulation<Model>::Simulation(std::vector<TouchingBody<Model>> bodies, double friction,
                              const std::vector<Garment>& garments)
    : bodies_(std::move(bodies)),
      reports_(bodies_.size()),
      friction_(friction),
      layout_(patterns(bodies_)),
      scratch_(bodies_.size()) {
  if (bodies_.size() < 2) throw std::invalid_argument("coupling: expected two bodies at least");
  check_not_negative("friction", friction);
  const StepOptions& first = bodies_[0].body->options();
  int samples = 0;
  for (const auto& [body, skin] : bodies_) {
    const StepOptions& options = body->options();
    if (options.h != first.h || options.integrator != first.integrator)
      throw std::invalid_argument("coupling: the bodies must have the same time step and integrator");
    if (!skin || &skin->samples() != body->parts().contact.get())
      throw std::invalid_argument("coupling: the skin of a body must be that of its simulation's contact");
    first_sample_.push_back(samples);
    samples += int(skin->samples().size());
    hessians_.push_back({body->model().zero(), {}});
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
void Simulation<Model>::forget() {
  newton_.solver.forget();
  for (const auto& each : bodies_) each.body->forget();
}

template <class Model>
const std::vector<StepReport>& Simulation<Model>::step(const std::vector<StepInput<Model>>& inputs) {
  if (inputs.size() != bodies_.size())
    throw std::invalid_argument("coupling: expected the input of " + std::to_string(bodies_.size()) + " bodies, got " +
                                std::to_string(inputs.size()));
  take_step(inputs.data());
  return reports_;
}

template <class Model>
const StepReport& Simulation<Model>::step(const StepInput<Model>& input) {
  if (bodies_.size() != 1) throw std::invalid_argument("step: expected the input of each body");
  take_step(&input);
  return reports_[0];
}

template <class Model>
void Simulation<Model>::take_step(const StepInput<Model>* inputs) {
  std::size_t begun = 0;
  try {
    for (; begun < bodies_.size(); ++begun) bodies_[begun].body->begin_step(inputs[begun]);
    if (bodies_.size() > 1) find_contacts(inputs);
    if (contacts_.empty())
      for (std::size_t body = 0; body < bodies_.size(); ++body) reports_[body] = bodies_[body].body->solve_alone();
    else
      solve_together();
  } catch (...) {
    for (std::size_t body = 0; body < begun; ++body) bodies_[body].body->give_up();
    throw;
  }
  for (std::size_t body = 0; body < bodies_.size(); ++body) bodies_[body].body->end_step(inputs[body], reports_[body]);
  if (bodies_.size() == 1) return;
  remember_pressures();
  report_contacts();
}

template <class Model>
void Simulation<Model>::take(const VectorXd& all, std::size_t body, VectorXd& own) const {
  layout_.take(all, body, own);
  const Eigen::Index first = first_patch_[body], patches = first_patch_[body + 1] - first;
  own.conservativeResize(own.size() + patches);
  own.tail(patches) = all.segment(first, patches);
}

template <class Model>
void Simulation<Model>::put(const VectorXd& own, std::size_t body, VectorXd& all) const {
  layout_.put(own, body, all);
  const Eigen::Index first = first_patch_[body], patches = first_patch_[body + 1] - first;
  all.segment(first, patches) = own.tail(patches);
}

template <class Model>
void Simulation<Model>::find_contacts(const StepInput<Model>* inputs) {
  std::vector<typename SelfContact<Model>::Body> skins;
  std::vector<PosedSamples<Model>> samples;
  std::vector<Pressure> pressures;
  ContactStep step = bodies_[0].body->contact_step();
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    const auto& [body, skin] = bodies_[b];
    const StepInput<Model>& input = inputs[b];
    const SoftBody& soft = body->model().body();
    const bool jumps = dynamorph::jumps(soft, soft.size, input.bones, body->state().bones);
    skins.push_back({*skin, body->posed_skin(input), scratch_[b], first_sample_[b], jumps});
    samples.push_back({skin->samples(), input.bones, input.weights, body->elastic()});
    for (const Pressure& last : body->state().pressures)
      if (last.collider == kOtherSkin)
        pressures.push_back({first_sample_[b] + last.sample, kSkin, last.normal, last.force, last.slip});
    const ContactStep own = body->contact_step();
    step.distance = std::max(step.distance, own.distance);
    step.width = std::min(step.width, own.width);
    step.sticks = std::min(step.sticks, own.sticks);
  }
  step.own_friction = friction_;
  SelfContact<Model>::find_between(skins, worn_, found_);
  contacts_.clear();
  if (!found_.empty()) contacts_.begin({std::move(samples), first_sample_, layout_}, found_, step, pressures, {});
}

template <class Model>
NewtonLimits Simulation<Model>::begin_together() {
  first_patch_.assign(1, layout_.dofs());
  for (const auto& each : bodies_)
    first_patch_.push_back(first_patch_.back() + each.body->contacts().unknowns().size());
  all_.resize(first_patch_.back());
  NewtonLimits until{kInfinity, kInfinity, 0, false};
  VectorXd own;
  for (std::size_t body = 0; body < bodies_.size(); ++body) {
    bodies_[body].body->guess(own);
    put(own, body, all_);
    const NewtonLimits limits = bodies_[body].body->limits();
    until.tolerance = std::min(until.tolerance, limits.tolerance);
    until.step = std::min(until.step, limits.step);
    until.iterations = std::max(until.iterations, limits.iterations);
  }
  return until;
}

template <class Model>
void Simulation<Model>::solve_together() {
  const NewtonLimits until = begin_together();
  const auto ask = [&] {
    for (const auto& each : bodies_) each.body->ask();
  };
  const auto begin_newton = [&] {
    for (const auto& each : bodies_) each.body->begin_newton();
  };
  const auto next_round = [&] {
    begin_newton();
    bool again = contacts_.next_round();
    for (const auto& each : bodies_) again |= each.body->contacts().next_round();
    return again;
  };
  Sum sum(*this);
  begin_newton();
  const NewtonReport found = minimize_in_rounds(sum, newton_, all_, until, ask, next_round);
  VectorXd own;
  for (std::size_t body = 0; body < bodies_.size(); ++body) {
    take(all_, body, own);
    reports_[body] = bodies_[body].body->accept(found, own);
  }
}

template <class Model>
void Simulation<Model>::remember_pressures() {
  std::vector<Pressure> all;
  contacts_.pressures(all);
  std::vector<std::vector<Pressure>> of_bodies(bodies_.size());
  for (const Pressure& last : all) {
    const auto [body, sample] = find_owner(first_sample_, last.sample);
    of_bodies[body].push_back({sample, kOtherSkin, last.normal, last.force, last.slip});
  }
  for (std::size_t body = 0; body < bodies_.size(); ++body) bodies_[body].body->remember(of_bodies[body]);
}

template <class Model>
void Simulation<Model>::report_contacts() {
  contacts_.each_push([&](const Contact& contact, const Vector3d& force) {
    const std::size_t body = find_owner(first_sample_, contact.sample).first;
    const std::size_t other = find_owner(first_sample_, contact.others.samples[0]).first;
    reports_[body].body_force += force;
    reports_[other].body_force -= force;
    ++reports_[body].contacts;
  });
  for (std::size_t k = 0; k < found_.size(); ++k) {
    const Contact& contact = found_[k];
    const auto [body, sample] = find_owner(first_sample_, contact.sample);
    StepReport& report = reports_[body];
    const double too_deep = std::min(contact.too_deep, contacts_.inside(k));
    if (!(too_deep > report.too_deep)) continue;
    report.too_deep = too_deep;
    report.too_deep_sample = sample;
    report.too_deep_collider = kSkin - 1 - int(find_owner(first_sample_, contact.others.samples[0]).first);
  }
}

template class Simulation<FullModel>;
template class Simulation<ReducedModel>;

}  // namespace dynamorph
