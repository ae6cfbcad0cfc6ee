// SPDX-License-Identifier: GPL-3.0-or-later
// Simulations for Python: what their calls take, one at a time, and what they report.
#pragma once

#include <algorithm>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <tuple>
#include <vector>

#include "collider_motion.hpp"
#include "dynamorph/step/simulation.hpp"
#include "either.hpp"
#include "model_interface.hpp"

namespace dynamorph {

/// A body for Python, and the simulation of it alone. The engine works without the GIL, so threads take turns, each for
/// a whole call.
template <class Model>
struct InTurn {
  InTurn(std::shared_ptr<const Model> model, StepOptions options, Parts<Model> parts)
      : body(std::move(model), std::move(options), std::move(parts)) {}
  MovingBody<Model> body;
  Simulation<Model> alone{body};
  mutable std::recursive_mutex turn;  ///< recursive, because keep_going may read the simulation that calls it
  bool changes = false;               ///< whether a call that changes it is under way
};

template <class Model, class Function>
auto in_turn(const InTurn<Model>& simulation, const Function& function) {
  py::gil_scoped_release release;
  const std::lock_guard<std::recursive_mutex> lock(simulation.turn);
  return function();
}

/// The same for a call that changes some of them, which take turns in one order everywhere. Throws
/// std::invalid_argument when keep_going makes such a call in another one.
template <class Model, class Function>
auto changing(std::vector<InTurn<Model>*> simulations, const Function& function) {
  struct Change {
    std::unique_lock<std::recursive_mutex> lock;
    bool& flag;
    explicit Change(InTurn<Model>& simulation) : lock(simulation.turn), flag(simulation.changes) {
      if (flag) throw std::invalid_argument("keep_going: must not change the simulation that calls it");
      flag = true;
    }
    ~Change() { flag = false; }
  };
  py::gil_scoped_release release;
  std::sort(simulations.begin(), simulations.end(), std::less<>());
  std::list<Change> changes;
  for (InTurn<Model>* simulation : simulations) changes.emplace_back(*simulation);
  return function();
}

template <class Model, class Function>
auto changing(InTurn<Model>& simulation, const Function& function) {
  return changing(std::vector<InTurn<Model>*>{&simulation}, function);
}

/// What Python is told of some steps: the worst of each, or the last.
struct Report : StepReport {
  int steps = 0;
  double seconds = 0;

  /// Of a solution without a step.
  Report() = default;
  explicit Report(const StepReport& only) : StepReport(only) {}

  void add(const StepReport& step) {
    ++steps;
    iterations += step.iterations;
    converged &= step.converged;
    residual = std::max(residual, step.residual);
    energy = step.energy;
    teleported |= step.teleported;
    farthest = std::max(farthest, step.farthest);
    pulled += step.pulled;
    if (step.excess_bone >= 0 && step.excess >= excess) {
      excess = step.excess;
      excess_bone = step.excess_bone;
    }
    body_force = step.body_force;
    contacts = std::max(contacts, step.contacts);
    penetration = std::max(penetration, step.penetration);
    if (step.too_deep > too_deep) {
      too_deep = step.too_deep;
      too_deep_sample = step.too_deep_sample;
      too_deep_collider = step.too_deep_collider;
    }
    contact_forces = step.contact_forces;
    const std::set<int> other(step.unusable_colliders.begin(), step.unusable_colliders.end());
    std::set<int> all(unusable_colliders.begin(), unusable_colliders.end());
    all.insert(other.begin(), other.end());
    unusable_colliders.assign(all.begin(), all.end());
  }
};

/// Springs between points of a skin and goals (S, K, 3), one row of goals for each step.
struct Springs {
  Either<SkinMap> skin;
  FloatArray stiffness;  ///< (K), or (S, K)
  std::vector<int> points;
  FloatArray goals;

  void at(py::ssize_t step, std::vector<Grab>& out) const {
    out.clear();
    const double* goal = goals.data() + step * goals.shape(1) * 3;
    const double* firm = stiffness.data() + (stiffness.ndim() == 2 ? step * stiffness.shape(1) : 0);
    for (size_t k = 0; k < points.size(); ++k, goal += 3)
      out.push_back({points[k], Vector3d(goal[0], goal[1], goal[2]), firm[k]});
  }
};

/// What such springs pull: nothing where there are none. Throws std::invalid_argument for a skin of another model.
template <class Model>
Grabs<Model> pulled(const Model&, const std::optional<Springs>& springs) {
  if (!springs) return {};
  return {springs->skin.template of<Model>("grabs: the skin"), {}};
}

/// Forces on the nodes (n, 3), the same at all steps, or (S, n, 3), newtons in world space; empty for none.
class External {
 public:
  External(const SoftBody& body, const std::optional<FloatArray>& forces, py::ssize_t steps) : body_(body) {
    if (!forces) return;
    const py::ssize_t nodes = body.mesh.nodes.rows();
    if (forces->ndim() == 2)
      check_shape("external", *forces, {nodes, 3});
    else
      check_shape("external", *forces, {steps, nodes, 3});
    check_finite("external", Eigen::Map<const VectorXd>(forces->data(), forces->size()));
    forces_ = *forces;
    every_step_ = forces->ndim() == 3;
  }

  /// On the free nodes at a step; null for none.
  const VectorXd* at(py::ssize_t step) {
    if (forces_.size() == 0) return nullptr;
    if (every_step_ || free_.size() == 0) {
      const Eigen::Index size = 3 * body_.mesh.nodes.rows();
      free_ =
          body_.restrict_to_free(Eigen::Map<const VectorXd>(forces_.data() + (every_step_ ? step * size : 0), size));
    }
    return &free_;
  }

 private:
  const SoftBody& body_;
  FloatArray forces_;
  bool every_step_ = false;
  VectorXd free_;
};

/// bones (S, B, 3, 4), weights (S, J), external (S, n, 3) or (n, 3), grabs, colliders, stiffness (S, J), distance (S),
/// self_friction (S).
using Motion = std::tuple<FloatArray, FloatArray, std::optional<FloatArray>, std::optional<Springs>,
                          std::optional<std::vector<ColliderMotion>>, std::optional<FloatArray>,
                          std::optional<FloatArray>, std::optional<FloatArray>>;

/// Throws std::invalid_argument unless they are one for each step, finite and not negative.
inline void check_each_step(const char* name, const std::optional<FloatArray>& values, py::ssize_t steps) {
  if (!values) return;
  check_shape(name, *values, {steps});
  for (py::ssize_t i = 0; i < steps; ++i) check_not_negative(name, values->data()[i]);
}

/// What acts on a soft skin in some steps, as `advance` takes it.
template <class Model>
class Moving {
 public:
  /// Throws std::invalid_argument unless all fit the body and each other.
  Moving(const Model& model, const Motion& motion)
      : bones_((check_shape("bones", std::get<0>(motion), {-1, -1, 3, 4}), std::get<0>(motion))),
        weights_(std::get<1>(motion)),
        springs_(std::get<3>(motion)),
        colliders_(std::get<4>(motion).value_or(std::vector<ColliderMotion>())),
        external_(model.body(), std::get<2>(motion), steps()),
        stiffness_(std::get<5>(motion)),
        distance_(std::get<6>(motion)),
        self_friction_(std::get<7>(motion)) {
    check_shape("weights", weights_, {steps(), py::ssize_t(model.targets().size())});
    if (stiffness_) check_shape("stiffness", *stiffness_, {steps(), weights_.shape(1)});
    check_each_step("distance", distance_, steps());
    check_each_step("self_friction", self_friction_, steps());
    if (springs_) check_shape("grabs: goals", springs_->goals, {steps(), -1, 3});
    grabs_ = pulled(model, springs_);
    for (const ColliderMotion& collider : colliders_)
      if (collider.steps() != steps())
        throw std::invalid_argument("colliders: expected the motion of " + std::to_string(steps()) + " steps, got " +
                                    std::to_string(collider.steps()));
  }

  py::ssize_t steps() const { return bones_.shape(0); }

  /// At one of the steps; the next call changes it.
  StepInput<Model> at(py::ssize_t step) {
    const py::ssize_t count = bones_.shape(1), targets = weights_.shape(1);
    frame_ = Eigen::Map<const Transforms>(bones_.data() + step * count * 12, count, 12);
    w_ = Eigen::Map<const VectorXd>(weights_.data() + step * targets, targets);
    if (springs_) springs_->at(step, grabs_.springs);
    met_.clear();
    for (const ColliderMotion& collider : colliders_) met_.push_back(collider.at(step));
    if (stiffness_) s_ = Eigen::Map<const VectorXd>(stiffness_->data() + step * targets, targets);
    const auto of_step = [&](const std::optional<FloatArray>& values) {
      return values ? values->data() + step : nullptr;
    };
    return {frame_,
            w_,
            external_.at(step),
            &grabs_,
            &met_,
            stiffness_ ? &s_ : nullptr,
            of_step(distance_),
            of_step(self_friction_)};
  }

 private:
  FloatArray bones_, weights_;
  std::optional<Springs> springs_;
  std::vector<ColliderMotion> colliders_;
  External external_;
  std::optional<FloatArray> stiffness_, distance_, self_friction_;
  Transforms frame_;
  VectorXd w_, s_;
  Grabs<Model> grabs_;
  std::vector<ColliderStep> met_;
};

}  // namespace dynamorph
