// SPDX-License-Identifier: GPL-3.0-or-later
#include <chrono>
#include <cmath>
#include <memory>
#include <mutex>
#include <set>
#include <tuple>

#include "collider_motion.hpp"
#include "dynamorph/step/simulation.hpp"
#include "model_interface.hpp"

using namespace dynamorph;

namespace {

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

/// The same for a call that changes it. Throws std::invalid_argument when keep_going makes such a call in another one.
template <class Stepper, class Function>
auto changing(InTurn<Stepper>& stepper, const Function& function) {
  struct Reset {
    bool& flag;
    ~Reset() { flag = false; }
  };
  return in_turn(stepper, [&] {
    if (stepper.changes) throw std::invalid_argument("keep_going: must not change the simulation that calls it");
    const Reset at_the_end{stepper.changes = true};
    return function();
  });
}

/// bones (J, B, 3, 4).
template <class Stepper>
void balance_targets_in(InTurn<Stepper>& stepper, const FloatArray& bones) {
  const auto& model = stepper.model();
  check_shape("bones", bones, {py::ssize_t(model.targets().size()), py::ssize_t(model.body().skin.cols()), 3, 4});
  std::vector<Transforms> frames;
  const py::ssize_t count = bones.shape(1);
  for (py::ssize_t j = 0; j < bones.shape(0); ++j) frames.push_back(transforms(bones.data() + 12 * count * j, count));
  changing(stepper, [&] { stepper.balance_targets(frames); });
}

/// Adds the report of a step to that of those before it.
void add(const StepReport& step, StepReport& all) {
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

py::dict summary(const StepReport& worst, int steps, double seconds) {
  Points forces(Eigen::Index(worst.contact_forces.size()), 3);
  for (Eigen::Index c = 0; c < forces.rows(); ++c) forces.row(c) = worst.contact_forces[std::size_t(c)];
  const std::set<int> unusable(worst.unusable_colliders.begin(), worst.unusable_colliders.end());
  return py::dict("steps"_a = steps, "iterations"_a = worst.iterations, "converged"_a = worst.converged,
                  "residual"_a = worst.residual, "energy"_a = worst.energy, "teleported"_a = worst.teleported,
                  "seconds"_a = seconds, "excess"_a = worst.excess, "excess_bone"_a = worst.excess_bone,
                  "farthest"_a = worst.farthest, "pulled"_a = worst.pulled, "contacts"_a = worst.contacts,
                  "penetration"_a = worst.penetration, "too_deep"_a = worst.too_deep,
                  "too_deep_sample"_a = worst.too_deep_sample, "too_deep_collider"_a = worst.too_deep_collider,
                  "contact_forces"_a = forces,
                  "unusable_colliders"_a = std::vector<int>(unusable.begin(), unusable.end()));
}

/// What a state remembers of contact, as numbers: how many planes and colliders there are, then the planes (sample,
/// collider, point, normal), whether each collider acted, and the pressures (sample, collider, normal, force). Empty
/// when there is nothing.
VectorXd contact_numbers(const State& state) {
  std::vector<double> out;
  const auto add = [&](const Vector3d& v) { out.insert(out.end(), v.data(), v.data() + 3); };
  if (state.contact.planes.empty() && state.contact.active.empty() && state.pressures.empty()) return {};
  out = {double(state.contact.planes.size()), double(state.contact.active.size())};
  for (const ContactMemory::Plane& plane : state.contact.planes) {
    out.insert(out.end(), {double(plane.sample), double(plane.collider)});
    add(plane.point);
    add(plane.normal);
  }
  out.insert(out.end(), state.contact.active.begin(), state.contact.active.end());
  for (const Pressure& pressure : state.pressures) {
    out.insert(out.end(), {double(pressure.sample), double(pressure.collider)});
    add(pressure.normal);
    out.push_back(pressure.force);
  }
  return Eigen::Map<const VectorXd>(out.data(), Eigen::Index(out.size()));
}

/// Throws std::invalid_argument for what `contact_numbers` would not give.
void read_contact(const VectorXd& numbers, State& state) {
  if (numbers.size() == 0) return;
  Eigen::Index at = 0;
  const auto fits = [](bool good) {
    if (!good) throw std::invalid_argument("state: its contact is not one that a simulation had");
  };
  const auto whole = [&](int least = 0) {
    fits(at < numbers.size());
    const double number = numbers(at++);
    fits(number >= least && number < 1 << 30 && number == std::floor(number));
    return int(number);
  };
  const auto vector = [&] {
    fits(at + 3 <= numbers.size());
    at += 3;
    return Vector3d(numbers.segment<3>(at - 3));
  };
  const int planes = whole(), colliders = whole();
  fits(8.0 * planes + colliders <= double(numbers.size()));
  for (int k = 0; k < planes; ++k) {
    const int sample = whole(), collider = whole();
    const Vector3d point = vector();
    state.contact.planes.push_back({sample, collider, point, vector()});
  }
  for (int k = 0; k < colliders; ++k) state.contact.active.push_back(whole() != 0);
  while (at < numbers.size()) {
    const int sample = whole(), collider = whole(kOwnSkin);
    const Vector3d normal = vector();
    fits(at < numbers.size());
    state.pressures.push_back({sample, collider, normal, numbers(at++)});
  }
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

void bind_grabs(py::module_& m) {
  py::class_<Grabs>(m, "Grabs", "Springs that pull points of the skin to places in the world.")
      .def(py::init([](const IndexArray& points, const FloatArray& goals, const VectorXd& stiffness) {
             using Column = Eigen::Matrix<std::int32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
             const Column column = to_indices<Column>(IndexArray(points.attr("reshape")(-1, 1)), "points");
             check_shape("goals", goals, {-1, column.size(), 3});
             check_size("stiffness", stiffness.size(), column.size());
             check_finite("goals", Eigen::Map<const VectorXd>(goals.data(), goals.size()));
             if (!stiffness.allFinite() || (stiffness.array() < 0).any())
               throw std::invalid_argument("stiffness: must be finite and not negative");
             return Grabs{stiffness, {column.data(), column.data() + column.size()}, goals};
           }),
           "points"_a, "goals"_a, "stiffness"_a,
           "points (K): of the simulation's skin. goals (S, K, 3): meters, world space, at the end of each step. "
           "stiffness (K): N/m.");
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

template <class Model>
void bind_limit(py::module_& m, const char* name) {
  using Limit = MotionLimit<Model>;
  py::class_<Limit, std::shared_ptr<Limit>>(
      m, name, "How far a moving rig may drive the skin of a model. Simulations may share it.")
      .def(py::init([](std::shared_ptr<Model> model, const FloatArray& rest, const Embedding& embedding,
                       const IndexArray& triangles, const MatrixXd& weights, const VectorXd& distances,
                       const std::optional<MatrixXd>& groups, const std::optional<VectorXd>& painted, double slack,
                       double stretch, double pulled_stretch, int edges_between) {
             SkinLimits limits{as_points(flat_points("rest", rest, -1)),
                               embedding,
                               to_indices<Triangles>(triangles, "triangles"),
                               weights,
                               distances,
                               groups.value_or(MatrixXd()),
                               painted.value_or(VectorXd()),
                               {slack, stretch, pulled_stretch, edges_between}};
             check_finite("rest", limits.rest);
             check_finite("weights", weights);
             check_finite("groups", limits.groups);
             py::gil_scoped_release release;
             return std::make_shared<Limit>(model, limits);
           }),
           "model"_a.none(false), "rest"_a, "embedding"_a, "triangles"_a, "weights"_a, "distances"_a,
           "groups"_a = py::none(), "painted"_a = py::none(), py::kw_only(), "slack"_a = LimitConstants().slack,
           "stretch"_a = LimitConstants().stretch, "pulled_stretch"_a = LimitConstants().pulled_stretch,
           "edges_between"_a = LimitConstants().edges_between,
           "rest (P, 3): meters, bind space. embedding: of the P points in the body's mesh. triangles (T, 3): of the "
           "soft skin. weights (P, G): skin weights of the bones. distances (P): the largest from the targets' shape, "
           "meters. groups (free nodes, G): the bones' parts in nodes with transforms of their own, otherwise None. "
           "painted (P) in (0, 1]: factors on the distances from which points are pulled back, or None for ones. "
           "The others are LimitConstants, which docs/limit.md tables: slack, how many limits of a static answer count "
           "as "
           "one; stretch, of an edge's length, by which a static answer may change it; pulled_stretch, of its length: "
           "at "
           "0.6 of that change an edge begins to be pulled back; edges_between, how many more edges are. Raises "
           "ValueError for those below zero, and Error if the tissue has no stiffness at rest.")
      .def_property_readonly("frequency", &Limit::frequency, "Of the neutral tissue, 1/s (angular).")
      .def_property_readonly("numbers", &Limit::numbers, "How many numbers of a static answer are looked at.");
}

template <class Model>
void bind_simulation_of(py::module_& m, const char* name) {
  using Sim = InTurn<Simulation<Model>>;
  py::class_<Sim>(m, name, "Steps a model through time, in world space and SI units.")
      .def(py::init([](std::shared_ptr<Model> model, double h, Integrator integrator, const Vector3d& gravity,
                       double tolerance, int max_iterations, double teleport, const py::object& keep_going) {
             std::function<bool()> asked;
             if (!keep_going.is_none())
               asked = [callable = shared(keep_going)] {
                 py::gil_scoped_acquire gil;
                 return answer("keep_going", (*callable)());
               };
             return std::make_unique<Sim>(
                 Simulation<Model>(model, {h, integrator, gravity, tolerance, max_iterations, teleport, asked}));
           }),
           "model"_a.none(false), "h"_a, py::kw_only(), "integrator"_a = Integrator::bdf2,
           "gravity"_a = Vector3d(0, 0, 0), "tolerance"_a = 1e-6, "max_iterations"_a = 30, "teleport"_a = 0.0,
           "keep_going"_a = py::none(),
           "h: seconds per step. gravity (3,): m/s^2. teleport: the jump of the skin off its course in one step, "
           "meters, above which the past is carried along (0: never). keep_going() -> bool is called before every "
           "Newton iteration; returning False raises Cancelled.")
      .def("balance_targets", &balance_targets_in<Simulation<Model>>, "bones"_a,
           "Lets only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) act, "
           "so that targets do not sag.")
      .def(
          "start",
          [](Sim& s, const FloatArray& now, const FloatArray& next, const VectorXd& weights) {
            const Transforms a = transforms("now", now), b = transforms("next", next);
            return summary(changing(s, [&] { return s.start(a, b, weights); }), 0, 0);
          },
          "now"_a, "next"_a, "weights"_a,
          "Starts from the static solution at the bones `now` (B, 3, 4). The past continues the motion from `now` to "
          "`next` backward.")
      .def(
          "advance",
          [](Sim& s, const FloatArray& bones, const FloatArray& weights, const std::optional<FloatArray>& external,
             const std::optional<Grabs>& grabs, const std::optional<std::vector<ColliderMotion>>& colliders) {
            check_shape("bones", bones, {-1, -1, 3, 4});
            check_shape("weights", weights, {bones.shape(0), py::ssize_t(s.model().targets().size())});
            const py::ssize_t steps = bones.shape(0), count = bones.shape(1);
            if (grabs) check_shape("grabs: goals", grabs->goals, {steps, -1, 3});
            const std::vector<ColliderMotion> moving = colliders.value_or(std::vector<ColliderMotion>());
            for (const ColliderMotion& collider : moving)
              if (collider.steps() != steps)
                throw std::invalid_argument("colliders: expected the motion of " + std::to_string(steps) +
                                            " steps, got " + std::to_string(collider.steps()));
            External forces(s.model().body(), external, steps);
            StepReport worst;
            const auto begin = std::chrono::steady_clock::now();
            changing(s, [&] {
              Transforms frame;
              VectorXd w;
              std::vector<Grab> grabbed;
              std::vector<ColliderStep> met;
              s.forget();  // so that a state resumes bit for bit, between any two calls
              for (py::ssize_t i = 0; i < steps; ++i) {
                frame = Eigen::Map<const Transforms>(bones.data() + i * count * 12, count, 12);
                w = Eigen::Map<const VectorXd>(weights.data() + i * weights.shape(1), weights.shape(1));
                if (grabs) grabs->at(i, grabbed);
                met.clear();
                for (const ColliderMotion& collider : moving) met.push_back(collider.at(i));
                add(s.step({frame, w, forces.at(i), &grabbed, &met}), worst);
              }
            });
            const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
            return summary(worst, int(steps), elapsed.count());
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "grabs"_a = py::none(), "colliders"_a = py::none(),
          "Takes one step to each of the bones (S, B, 3, 4) and target weights (S, J). external: newtons on the nodes, "
          "world space, (S, n, 3) or the same at all steps (n, 3). grabs: of points of the skin. colliders: what "
          "pushes "
          "the points of `set_contact`. Returns a report on the steps: total iterations, converged, worst residual, "
          "elastic energy at the end, teleported, seconds. With a motion limit: the largest excess of a bone's load, "
          "which was held back if that is above 1/2, and which bone's; farthest, the largest distance of a point from "
          "its targets' shape, relative to its limit; pulled, in how many steps anything was pulled back. With "
          "colliders: the largest number of contacts in a step; "
          "penetration, the largest depth of a point under a surface; too_deep, how much deeper the bones take a point "
          "into a collider, or into the body itself, than it can give way, so that contact does (0: nowhere), and the "
          "sample "
          "(-1: none) and collider (-1: the body) where that is; contact_forces, newtons on each collider (C, 3) at "
          "the last step; "
          "unusable_colliders, the "
          "numbers of those that were active but not finite or without extent.")
      .def(
          "solve_static",
          [](Sim& s, const FloatArray& bones, const VectorXd& weights, const std::optional<FloatArray>& external,
             const std::optional<VectorXd>& guess) {
            VectorXd q = guess.value_or(VectorXd());
            if (guess) check_coordinates(s.model(), q);
            External forces(s.model().body(), external, 1);
            const Transforms frame = transforms("bones", bones);
            const StepReport report = changing(s, [&] { return s.solve_static({frame, weights, forces.at(0)}, q); });
            return py::make_tuple(q, summary(report, 0, 0));
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "guess"_a = py::none(),
          "Returns (coordinates, report) of the static solution. The search starts from `guess`, or from the blended "
          "targets.")
      .def(
          "set_skin",
          [](Sim& s, std::shared_ptr<SkinMap<Model>> skin) { changing(s, [&] { s.set_skin(std::move(skin)); }); },
          "skin"_a, "The skin whose points `advance` grabs; None for none.")
      .def(
          "set_limit",
          [](Sim& s, std::shared_ptr<MotionLimit<Model>> limit) {
            changing(s, [&] { s.set_limit(std::move(limit)); });
          },
          "limit"_a, "Limits the motion from now on; None for no limit.")
      .def(
          "set_contact",
          [](Sim& s, std::shared_ptr<ContactSamples<Model>> contact, double distance) {
            changing(s, [&] { s.set_contact(std::move(contact), distance); });
          },
          "contact"_a, "distance"_a = 0.0,
          "The points that the colliders of `advance` push, from a distance in meters on; None for none.")
      .def(
          "set_self_contact",
          [](Sim& s, std::shared_ptr<SelfContact<Model>> self, double friction) {
            changing(s, [&] { s.set_self_contact(std::move(self), friction); });
          },
          "self_contact"_a, "friction"_a = 0.5,
          "Where the skin touches itself, from the distance of `set_contact` on, which comes first and drops it; None: "
          "nowhere. friction: of skin on skin.")
      .def_property_readonly("model", &Sim::shared_model)
      .def_property_readonly(
          "coordinates", [](const Sim& s) { return in_turn(s, [&] { return VectorXd(s.coordinates()); }); },
          "A copy of the coordinates after the last step. The unit is meters times the square root of cubic meters for "
          "a reduced model, and meters for a full one.")
      .def_property_readonly(
          "dents", [](const Sim& s) { return in_turn(s, [&] { return VectorXd(s.dents()); }); },
          "A copy of the amplitudes of its contact's local responses after the last step, none without. Setting a "
          "state "
          "sets them to zero.")
      .def_property_readonly(
          "kinetic_energy", [](const Sim& s) { return in_turn(s, [&] { return s.kinetic_energy(); }); },
          "Kinetic energy of the posed nodes, J, from the integrator's own velocity.")
      .def_property_readonly(
          "elastic_energy", [](const Sim& s) { return in_turn(s, [&] { return s.elastic_energy(); }); },
          "Elastic energy, J, at the target weights of the last step.")
      .def_property(
          "state",
          [](const Sim& s) {
            const State state = in_turn(s, [&] { return State(s.state()); });
            return py::make_tuple(state.q, state.bones, state.excess, contact_numbers(state));
          },
          [](Sim& s,
             const std::tuple<std::array<VectorXd, 4>, std::array<Transforms, 4>, VectorXd, VectorXd>& numbers) {
            const auto& [q, bones, excess, contact] = numbers;
            State state{q, bones, excess, {}, {}};
            read_contact(contact, state);
            changing(s, [&] { s.set_state(state); });
          },
          "(coordinates, bones' transforms (B, 12), excess (G), contact (any)): the first two now and at the last "
          "three "
          "steps, the third of each bone's load, empty without a motion limit, the last what was touched, empty "
          "without "
          "colliders. Set it to resume a simulation; raises Error for what is not finite.");
}

}  // namespace

void bind_step(py::module_& m) {
  py::enum_<Integrator>(m, "Integrator").value("EULER", Integrator::implicit_euler).value("BDF2", Integrator::bdf2);
  bind_grabs(m);
  bind_limit<FullModel>(m, "FullMotionLimit");
  bind_limit<ReducedModel>(m, "ReducedMotionLimit");
  bind_simulation_of<FullModel>(m, "FullSimulation");
  bind_simulation_of<ReducedModel>(m, "ReducedSimulation");
}
