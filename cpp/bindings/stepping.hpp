// SPDX-License-Identifier: GPL-3.0-or-later
// Simulations for Python: what their calls take, one at a time, and what they report.
#pragma once

#include <algorithm>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <vector>

#include "collider_motion.hpp"
#include "dynamorph/step/simulation.hpp"
#include "model_interface.hpp"

namespace dynamorph {

/// A Simulation for Python. The engine works without the GIL, so threads take turns, each for a whole call.
template <class Stepper>
struct InTurn : Stepper {
  explicit InTurn(Stepper&& stepper) : Stepper(std::move(stepper)) {}
  mutable std::recursive_mutex turn;  ///< recursive, because keep_going may read the simulation that calls it
  bool changes = false;               ///< whether a call that changes it is under way
};

template <class Stepper, class Function>
auto in_turn(const InTurn<Stepper>& stepper, const Function& function) {
  py::gil_scoped_release release;
  const std::lock_guard<std::recursive_mutex> lock(stepper.turn);
  return function();
}

/// The same for a call that changes some of them, which take turns in one order everywhere. Throws
/// std::invalid_argument when keep_going makes such a call in another one.
template <class Stepper, class Function>
auto changing(std::vector<InTurn<Stepper>*> steppers, const Function& function) {
  struct Change {
    std::unique_lock<std::recursive_mutex> lock;
    bool& flag;
    Change(InTurn<Stepper>& stepper) : lock(stepper.turn), flag(stepper.changes) {
      if (flag) throw std::invalid_argument("keep_going: must not change the simulation that calls it");
      flag = true;
    }
    ~Change() { flag = false; }
  };
  py::gil_scoped_release release;
  std::sort(steppers.begin(), steppers.end(), std::less<>());
  std::list<Change> changes;
  for (InTurn<Stepper>* stepper : steppers) changes.emplace_back(*stepper);
  return function();
}

template <class Stepper, class Function>
auto changing(InTurn<Stepper>& stepper, const Function& function) {
  return changing(std::vector<InTurn<Stepper>*>{&stepper}, function);
}

/// Adds the report of a step to that of those before it.
inline void add(const StepReport& step, StepReport& all) {
  all.iterations += step.iterations;
  all.converged &= step.converged;
  all.residual = std::max(all.residual, step.residual);
  all.energy = step.energy;
  all.teleported |= step.teleported;
  all.farthest = std::max(all.farthest, step.farthest);
  all.pulled += step.pulled;
  if (step.excess_bone >= 0 && step.excess >= all.excess) {
    all.excess = step.excess;
    all.excess_bone = step.excess_bone;
  }
  all.body_force = step.body_force;
  all.contacts = std::max(all.contacts, step.contacts);
  all.penetration = std::max(all.penetration, step.penetration);
  if (step.too_deep > all.too_deep) {
    all.too_deep = step.too_deep;
    all.too_deep_sample = step.too_deep_sample;
    all.too_deep_collider = step.too_deep_collider;
  }
  all.contact_forces = step.contact_forces;
  all.unusable_colliders.insert(all.unusable_colliders.end(), step.unusable_colliders.begin(),
                                step.unusable_colliders.end());
}

inline py::dict summary(const StepReport& worst, int steps, double seconds) {
  Points forces(Eigen::Index(worst.contact_forces.size()), 3);
  for (Eigen::Index c = 0; c < forces.rows(); ++c) forces.row(c) = worst.contact_forces[std::size_t(c)];
  const std::set<int> unusable(worst.unusable_colliders.begin(), worst.unusable_colliders.end());
  return py::dict("steps"_a = steps, "iterations"_a = worst.iterations, "converged"_a = worst.converged,
                  "residual"_a = worst.residual, "energy"_a = worst.energy, "teleported"_a = worst.teleported,
                  "seconds"_a = seconds, "excess"_a = worst.excess, "excess_bone"_a = worst.excess_bone,
                  "farthest"_a = worst.farthest, "pulled"_a = worst.pulled, "contacts"_a = worst.contacts,
                  "penetration"_a = worst.penetration, "too_deep"_a = worst.too_deep,
                  "too_deep_sample"_a = worst.too_deep_sample, "too_deep_collider"_a = worst.too_deep_collider,
                  "contact_forces"_a = forces, "body_force"_a = worst.body_force,
                  "unusable_colliders"_a = std::vector<int>(unusable.begin(), unusable.end()));
}

/// Springs between points of the skin and goals (S, K, 3), one row of goals for each step.
struct Grabs {
  VectorXd stiffness;  ///< (K)
  std::vector<int> points;
  FloatArray goals;

  void at(py::ssize_t step, std::vector<Grab>& out) const {
    out.clear();
    const double* goal = goals.data() + step * goals.shape(1) * 3;
    for (size_t k = 0; k < points.size(); ++k, goal += 3)
      out.push_back({points[k], Vector3d(goal[0], goal[1], goal[2]), stiffness(Eigen::Index(k))});
  }
};

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

/// What acts on a soft skin in some steps, as `advance` takes it.
class Moving {
 public:
  /// bones (S, B, 3, 4), weights (S, J), external (S, n, 3) or (n, 3). Throws std::invalid_argument unless all fit the
  /// body and each other.
  Moving(const SoftBody& body, std::size_t targets, const FloatArray& bones, const FloatArray& weights,
         const std::optional<FloatArray>& external, const std::optional<Grabs>& grabs,
         const std::optional<std::vector<ColliderMotion>>& colliders)
      : bones_((check_shape("bones", bones, {-1, -1, 3, 4}), bones)),
        weights_(weights),
        grabs_(grabs),
        colliders_(colliders.value_or(std::vector<ColliderMotion>())),
        external_(body, external, steps()) {
    check_shape("weights", weights, {steps(), py::ssize_t(targets)});
    if (grabs) check_shape("grabs: goals", grabs->goals, {steps(), -1, 3});
    for (const ColliderMotion& collider : colliders_)
      if (collider.steps() != steps())
        throw std::invalid_argument("colliders: expected the motion of " + std::to_string(steps()) + " steps, got " +
                                    std::to_string(collider.steps()));
  }

  py::ssize_t steps() const { return bones_.shape(0); }

  /// At one of the steps; the next call changes it.
  StepInput at(py::ssize_t step) {
    const py::ssize_t count = bones_.shape(1), targets = weights_.shape(1);
    frame_ = Eigen::Map<const Transforms>(bones_.data() + step * count * 12, count, 12);
    w_ = Eigen::Map<const VectorXd>(weights_.data() + step * targets, targets);
    if (grabs_) grabs_->at(step, grabbed_);
    met_.clear();
    for (const ColliderMotion& collider : colliders_) met_.push_back(collider.at(step));
    return {frame_, w_, external_.at(step), &grabbed_, &met_};
  }

 private:
  FloatArray bones_, weights_;
  std::optional<Grabs> grabs_;
  std::vector<ColliderMotion> colliders_;
  External external_;
  Transforms frame_;
  VectorXd w_;
  std::vector<Grab> grabbed_;
  std::vector<ColliderStep> met_;
};

}  // namespace dynamorph
