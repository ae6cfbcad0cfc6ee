// SPDX-License-Identifier: GPL-3.0-or-later
#include <chrono>
#include <cmath>
#include <memory>
#include <tuple>

#include "dynamorph/step/coupled_simulation.hpp"
#include "stepping.hpp"

using namespace dynamorph;

namespace {

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

/// What a state remembers of contact, as numbers: how many planes and colliders there are, then the planes (sample,
/// collider, point, normal), whether each collider acted, and the pressures (sample, collider, normal, force, slip).
/// Empty when there is nothing.
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
    add(pressure.slip);
  }
  return Eigen::Map<const VectorXd>(out.data(), Eigen::Index(out.size()));
}

VectorXd driven_numbers(const DrivenLoad& driven) {
  const Eigen::Index G = driven.reach.size();
  VectorXd out(5 * G + driven.mean.size());
  if (out.size() > 0)
    out << driven.excess[0], driven.excess[1], driven.excess[2], driven.reach, driven.held, driven.mean;
  return out;
}

/// The other way. dofs: of the mean. Throws std::invalid_argument for what that would not give.
DrivenLoad read_driven(const VectorXd& numbers, Eigen::Index dofs) {
  if (numbers.size() == 0) return {};
  if (numbers.size() < dofs || (numbers.size() - dofs) % 5 != 0)
    throw std::invalid_argument("state: its limit is not one that a simulation had");
  const Eigen::Index G = (numbers.size() - dofs) / 5;
  const auto part = [&](Eigen::Index k) { return VectorXd(numbers.segment(k * G, G)); };
  return {numbers.tail(dofs), part(3), part(4), {part(0), part(1), part(2)}};
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
    const int sample = whole(), collider = whole(kOtherSkin);
    const Vector3d normal = vector();
    fits(at < numbers.size());
    const double force = numbers(at++);
    state.pressures.push_back({sample, collider, normal, force, vector()});
  }
}

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

template <class Model>
void bind_limit(py::module_& m, const char* name) {
  using Limit = MotionLimit<Model>;
  py::class_<Limit, std::shared_ptr<Limit>>(
      m, name, "How far a moving rig may drive the skin of a model. Simulations may share it.")
      .def(py::init([](std::shared_ptr<Model> model, const FloatArray& rest, const Embedding& embedding,
                       const IndexArray& triangles, const MatrixXd& weights, const VectorXd& distances,
                       const std::optional<MatrixXd>& groups, const std::optional<VectorXd>& painted, double stretch,
                       int edges_between) {
             SkinLimits limits{as_points(flat_points("rest", rest, -1)),
                               embedding,
                               to_indices<Triangles>(triangles, "triangles"),
                               weights,
                               distances,
                               groups.value_or(MatrixXd()),
                               painted.value_or(VectorXd()),
                               {stretch, edges_between}};
             check_finite("rest", limits.rest);
             check_finite("weights", weights);
             check_finite("groups", limits.groups);
             py::gil_scoped_release release;
             return std::make_shared<Limit>(model, limits);
           }),
           "model"_a.none(false), "rest"_a, "embedding"_a, "triangles"_a, "weights"_a, "distances"_a,
           "groups"_a = py::none(), "painted"_a = py::none(), py::kw_only(), "stretch"_a = LimitConstants().stretch,
           "edges_between"_a = LimitConstants().edges_between,
           "rest (P, 3): meters, bind space. embedding: of the P points in the body's mesh. triangles (T, 3): of the "
           "soft skin. weights (P, G): skin weights of the bones. distances (P): the largest from the targets' "
           "shape, meters. groups (free nodes, G): the bones' parts in nodes with transforms of their own, otherwise "
           "None. painted (P) in (0, 1]: factors on the distances from which points are pulled back, or None for "
           "ones. The others are LimitConstants, which docs/limit.md tables: stretch, of an edge's length, by which "
           "it may change; edges_between, how many more than the most stretched are pulled back. Raises "
           "ValueError for those below zero, and Error if the tissue has no stiffness at rest.")
      .def_property_readonly("frequency", &Limit::frequency, "Of the neutral tissue, 1/s (angular).")
      .def_property_readonly("numbers", &Limit::numbers, "How many numbers of a static answer are looked at.");
}

template <class Model>
void bind_simulation_of(py::module_& m, const char* name) {
  using Sim = InTurn<Simulation<Model>>;
  py::class_<Sim, std::shared_ptr<Sim>>(m, name, "Steps a model through time, in world space and SI units.")
      .def(py::init([](std::shared_ptr<Model> model, double h, Integrator integrator, const Vector3d& gravity,
                       double tolerance, int max_iterations, double teleport, const py::object& keep_going) {
             std::function<bool()> asked;
             if (!keep_going.is_none())
               asked = [callable = shared(keep_going)] {
                 py::gil_scoped_acquire gil;
                 return answer("keep_going", (*callable)());
               };
             return std::make_shared<Sim>(
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
          [](Sim& s, const FloatArray& now, const FloatArray& next, const VectorXd& weights,
             const std::optional<std::vector<ColliderMotion>>& colliders) {
            const Transforms a = transforms("now", now), b = transforms("next", next);
            std::vector<ColliderStep> met;
            const auto at_rest = colliders.value_or(std::vector<ColliderMotion>());
            for (const ColliderMotion& collider : at_rest) {
              check_size("colliders: steps", collider.steps(), 1);
              met.push_back(collider.at(0));
            }
            return summary(changing(s, [&] { return s.start(a, b, weights, &met); }), 0, 0);
          },
          "now"_a, "next"_a, "weights"_a, "colliders"_a = py::none(),
          "Starts from the static solution at the bones `now` (B, 3, 4). The past continues the motion from `now` to "
          "`next` backward. colliders: what the skin lies on then, each with the motion of one step in which it stays "
          "where it is.")
      .def(
          "advance",
          [](Sim& s, const FloatArray& bones, const FloatArray& weights, const std::optional<FloatArray>& external,
             const std::optional<Grabs>& grabs, const std::optional<std::vector<ColliderMotion>>& colliders) {
            Moving moving(s.model().body(), s.model().targets().size(), bones, weights, external, grabs, colliders);
            StepReport worst;
            const auto begin = std::chrono::steady_clock::now();
            changing(s, [&] {
              s.forget();  // so that a state resumes bit for bit, between any two calls
              for (py::ssize_t i = 0; i < moving.steps(); ++i) add(s.step(moving.at(i)), worst);
            });
            const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
            return summary(worst, int(moving.steps()), elapsed.count());
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "grabs"_a = py::none(), "colliders"_a = py::none(),
          "Takes one step to each of the bones (S, B, 3, 4) and target weights (S, J). external: newtons on the "
          "nodes, world space, (S, n, 3) or the same at all steps (n, 3). grabs: of points of the skin. colliders: "
          "what pushes the points of `set_contact`. Returns a report on the steps: total iterations, converged, "
          "worst residual, elastic energy at the end, teleported, seconds. With a motion limit: the largest excess "
          "of a bone's load, which was held back if that is above 1/2, and which bone's; farthest, the largest "
          "distance of a point from its targets' shape, relative to its limit; pulled, in how many steps anything "
          "was pulled back. With colliders: the largest number of contacts in a step; penetration, the largest depth "
          "of a point under a surface; too_deep, how much deeper the bones take a point into a collider, or into the "
          "body itself, than it can give way, so that contact does (0: nowhere), and the sample (-1: none) and "
          "collider (-1: the body; below that, of a coupling, -2 less the number of another body) where that is; "
          "body_force (3), newtons that the others of a coupling push it with at the end; contact_forces, newtons on "
          "each collider (C, 3) at the last step; unusable_colliders, the "
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
      .def_property_readonly("model", &Sim::shared_model, "The model that it steps.")
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
            return py::make_tuple(state.q, state.bones, driven_numbers(state.driven), contact_numbers(state));
          },
          [](Sim& s,
             const std::tuple<std::array<VectorXd, 4>, std::array<Transforms, 4>, VectorXd, VectorXd>& numbers) {
            const auto& [q, bones, limit, contact] = numbers;
            State state{q, bones, read_driven(limit, s.model().dofs()), {}, {}};
            read_contact(contact, state);
            changing(s, [&] { s.set_state(state); });
          },
          "(coordinates, bones' transforms (B, 12), limit (any), contact (any)): the first two now and at the last "
          "three steps, the third what the motion limit remembers of the load, empty without one, the last what was "
          "touched, empty without colliders. Set it to resume a simulation; raises Error for what is not finite.")
      .def_property_readonly(
          "excess", [](const Sim& s) { return in_turn(s, [&] { return VectorXd(s.state().driven.excess[0]); }); },
          "By how much each bone's load (G) exceeded its limit in the last step: above 1/2 it was held back. Empty "
          "without a motion limit.");
}

/// Simulations for Python that take their steps together.
template <class Model>
struct Coupling {
  using Sim = InTurn<Simulation<Model>>;
  using Body = std::pair<std::shared_ptr<Sim>, std::shared_ptr<SelfContact<Model>>>;

  Coupling(std::vector<Body> bodies, double friction, const std::vector<Garment>& garments)
      : bodies(std::move(bodies)), coupled(own(), friction, garments) {}

  /// Throws std::invalid_argument where one is missing or there twice.
  std::vector<Sim*> steppers() const {
    std::vector<Sim*> out;
    for (const auto& [simulation, skin] : bodies) {
      if (!simulation || std::count(out.begin(), out.end(), simulation.get()) > 0)
        throw std::invalid_argument("coupling: each body must be there once");
      out.push_back(simulation.get());
    }
    return out;
  }
  std::vector<CoupledBody<Model>> own() const {
    std::vector<CoupledBody<Model>> out;
    for (Sim* stepper : steppers()) out.push_back({stepper, bodies[out.size()].second});
    return out;
  }

  std::vector<Body> bodies;
  CoupledSimulation<Model> coupled;
};

template <class Model>
void bind_coupling_of(py::module_& m, const char* name) {
  using Body = typename Coupling<Model>::Body;
  using Motion = std::tuple<FloatArray, FloatArray, std::optional<FloatArray>, std::optional<Grabs>,
                            std::optional<std::vector<ColliderMotion>>>;
  py::class_<Coupling<Model>>(
      m, name, "Soft bodies that press on each other and take their steps together: both sides give way.")
      .def(py::init([](std::vector<Body> bodies, double friction,
                       const std::vector<std::tuple<int, int, PointTransform>>& worn) {
             std::vector<Garment> garments;
             for (const auto& [clothes, body, to_body] : worn) garments.push_back({clothes, body, to_body});
             return std::make_unique<Coupling<Model>>(std::move(bodies), friction, garments);
           }),
           "bodies"_a, "friction"_a = 0.0, "garments"_a = std::vector<std::tuple<int, int, PointTransform>>(),
           "bodies: two simulations at least, each with its skin, that of its contact. friction: of skin on skin. "
           "garments: (clothes, body, to_body), numbers of clothes that lie on a body at rest and of that, and the "
           "transform (3, 4) of the bind space of the first to that of the second. "
           "Raises ValueError for others, or if their time steps or integrators differ.")
      .def(
          "advance",
          [](Coupling<Model>& c, const std::vector<Motion>& motions) {
            if (motions.size() != c.bodies.size())
              throw std::invalid_argument("motions: expected those of " + std::to_string(c.bodies.size()) +
                                          " bodies, got " + std::to_string(motions.size()));
            std::vector<Moving> moving;
            for (std::size_t body = 0; body < motions.size(); ++body) {
              const auto& [bones, weights, external, grabs, colliders] = motions[body];
              const Model& model = c.bodies[body].first->model();
              moving.emplace_back(model.body(), model.targets().size(), bones, weights, external, grabs, colliders);
              if (moving.back().steps() != moving.front().steps())
                throw std::invalid_argument("motions: expected as many steps of each body");
            }
            std::vector<StepReport> worst(motions.size());
            const auto begin = std::chrono::steady_clock::now();
            changing(c.steppers(), [&] {
              c.coupled.forget();
              for (py::ssize_t i = 0; i < moving.front().steps(); ++i) {
                std::vector<StepInput> inputs;
                for (Moving& each : moving) inputs.push_back(each.at(i));
                const std::vector<StepReport> reports = c.coupled.step(inputs);
                for (std::size_t body = 0; body < reports.size(); ++body) add(reports[body], worst[body]);
              }
            });
            const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
            std::vector<py::dict> out;
            for (const StepReport& each : worst)
              out.push_back(summary(each, int(moving.front().steps()), elapsed.count() / double(worst.size())));
            return out;
          },
          "motions"_a,
          "As `advance` of one simulation, for all bodies: motions has, for each, (bones, weights, external, grabs, "
          "colliders). Returns a report for each; iterations are those of all, seconds an equal share.");
}

}  // namespace

void bind_step(py::module_& m) {
  py::enum_<Integrator>(m, "Integrator", "How a step goes on in time. Both are implicit.")
      .value("EULER", Integrator::implicit_euler,
             "first order: it damps motion of itself, the more the longer the step")
      .value("BDF2", Integrator::bdf2, "second order: it damps motion much less");
  bind_grabs(m);
  bind_limit<FullModel>(m, "FullMotionLimit");
  bind_limit<ReducedModel>(m, "ReducedMotionLimit");
  bind_simulation_of<FullModel>(m, "FullSimulation");
  bind_simulation_of<ReducedModel>(m, "ReducedSimulation");
  bind_coupling_of<FullModel>(m, "FullCoupling");
  bind_coupling_of<ReducedModel>(m, "ReducedCoupling");
}
