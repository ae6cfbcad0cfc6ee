// SPDX-License-Identifier: GPL-3.0-or-later
#include <chrono>
#include <cmath>
#include <memory>
#include <tuple>

#include "stepping.hpp"

using namespace dynamorph;

namespace {

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
  VectorXd out(5 * G + driven.swing.size());
  if (out.size() > 0)
    out << driven.excess[0], driven.excess[1], driven.excess[2], driven.reach, driven.held, driven.swing.reshaped();
  return out;
}

/// The other way. dofs: of the load. Throws std::invalid_argument for what that would not give.
DrivenLoad read_driven(const VectorXd& numbers, Eigen::Index dofs) {
  if (numbers.size() == 0) return {};
  if (numbers.size() < 2 * dofs || (numbers.size() - 2 * dofs) % 5 != 0)
    throw std::invalid_argument("state: its limit is not one that a simulation had");
  const Eigen::Index G = (numbers.size() - 2 * dofs) / 5;
  const auto part = [&](Eigen::Index k) { return VectorXd(numbers.segment(k * G, G)); };
  return {numbers.tail(2 * dofs).reshaped(dofs, 2), part(3), part(4), {part(0), part(1), part(2)}};
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
  py::class_<Springs>(m, "Grabs", "Springs that pull points of a skin to places in the world.")
      .def(py::init([](const Either<SkinMap>& skin, const IndexArray& points, const FloatArray& goals,
                       const FloatArray& stiffness) {
             using Column = Eigen::Matrix<std::int32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
             const Column column = to_indices<Column>(IndexArray(points.attr("reshape")(-1, 1)), "points");
             check_shape("goals", goals, {-1, column.size(), 3});
             if (stiffness.ndim() == 2)
               check_shape("stiffness", stiffness, {goals.shape(0), column.size()});
             else
               check_shape("stiffness", stiffness, {column.size()});
             check_finite("goals", Eigen::Map<const VectorXd>(goals.data(), goals.size()));
             for (py::ssize_t i = 0; i < stiffness.size(); ++i) check_not_negative("stiffness", stiffness.data()[i]);
             return Springs{skin, stiffness, {column.data(), column.data() + column.size()}, goals};
           }),
           "skin"_a, "points"_a, "goals"_a, "stiffness"_a,
           "skin: of the simulation's model. points (K): of the skin. goals (S, K, 3): meters, world space, at the end "
           "of each step. stiffness (K), or (S, K) for each step: N/m.");
}

using EdgesArray = Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>;

EdgesArray edges_array(const std::vector<Edge>& edges) {
  EdgesArray out(Eigen::Index(edges.size()), 2);
  for (std::size_t e = 0; e < edges.size(); ++e) out.row(Eigen::Index(e)) << edges[e].first, edges[e].second;
  return out;
}

std::vector<Edge> edges_of(const EdgesArray& array) {
  std::vector<Edge> out;
  for (const auto& row : array.rowwise()) out.emplace_back(row(0), row(1));
  return out;
}

/// What limits look at, on its way to another process, and there.
py::tuple pickled(const LimitedTissue& tissue) {
  py::list edges;
  for (const BoneEdges& of_bone : tissue.edges)
    edges.append(py::make_tuple(edges_array(of_bone.critical), edges_array(of_bone.between), of_bone.stiffness));
  return py::make_tuple(tissue.square_frequency, tissue.chosen, tissue.area, tissue.pulled, tissue.pulled_mass, edges);
}

/// Throws std::invalid_argument for a state that `pickled` did not make. Whether it is of a skin, MotionLimit checks.
LimitedTissue unpickled(const py::tuple& state) {
  try {
    LimitedTissue tissue{state[0].cast<double>(),   state[1].cast<std::vector<int>>(),
                         state[2].cast<VectorXd>(), state[3].cast<std::vector<int>>(),
                         state[4].cast<VectorXd>(), {}};
    for (const auto& of_bone : state[5].cast<std::vector<std::tuple<EdgesArray, EdgesArray, double>>>())
      tissue.edges.push_back({edges_of(std::get<0>(of_bone)), edges_of(std::get<1>(of_bone)), std::get<2>(of_bone)});
    return tissue;
  } catch (const std::exception&) {  // those of pybind11 have no class in common
    throw std::invalid_argument("state: it is none of a limited tissue");
  }
}

void bind_limit(py::module_& m) {
  py::class_<LimitedTissue>(m, "LimitedTissue",
                            "Which points and edges of a skin the limits of its motion look at, and what moves there.")
      .def(py::pickle(&pickled, &unpickled));
  py::class_<Either<MotionLimit>>(m, "MotionLimit",
                                  "How far a moving rig may drive the skin of a model. Simulations may share it.")
      .def(py::init([](const EitherModel& model, const FloatArray& rest, const Embedding& embedding,
                       const IndexArray& triangles, const MatrixXd& weights, const VectorXd& distances,
                       const std::optional<MatrixXd>& groups, const std::optional<VectorXd>& painted, double stretch,
                       int edges_between, const std::optional<LimitedTissue>& tissue) {
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
             return without_gil([&] {
               return make_either<MotionLimit>(model, [&](const auto& own) {
                 return std::make_shared<MotionLimit<std::decay_t<decltype(*own)>>>(own, limits, tissue);
               });
             });
           }),
           "model"_a.none(false), "rest"_a, "embedding"_a, "triangles"_a, "weights"_a, "distances"_a,
           "groups"_a = py::none(), "painted"_a = py::none(), py::kw_only(), "stretch"_a = LimitConstants().stretch,
           "edges_between"_a = LimitConstants().edges_between, "tissue"_a = py::none(),
           "rest (P, 3): meters, bind space. embedding: of the P points in the body's mesh. triangles (T, 3): of the "
           "soft skin. weights (P, G): skin weights of the bones. distances (P): the largest from the targets' "
           "shape, meters. groups (free nodes, G): the bones' parts in nodes with transforms of their own, otherwise "
           "None. painted (P) in (0, 1]: factors on the distances from which points are pulled back, or None for "
           "ones. The others are LimitConstants, which docs/limit.md tables: stretch, of an edge's length, by which "
           "it may change; edges_between, how many more than the most stretched are pulled back. tissue: that of "
           "a limit that differs from this in its distances alone, or None to find it, which takes most of the time. "
           "Raises ValueError for constants below zero and a tissue of another skin, and Error if the tissue has no "
           "stiffness at rest.")
      .def_property_readonly(
          "frequency",
          [](const Either<MotionLimit>& limit) { return limit.visit([](const auto& own) { return own.frequency(); }); },
          "Of the neutral tissue, 1/s (angular).")
      .def_property_readonly(
          "tissue",
          [](const Either<MotionLimit>& limit) { return limit.visit([](const auto& own) { return own.tissue(); }); },
          "What was found of the skin. It can be pickled.")
      .def_property_readonly(
          "numbers",
          [](const Either<MotionLimit>& limit) { return limit.visit([](const auto& own) { return own.numbers(); }); },
          "How many numbers of a static answer are looked at.");
}

/// A state for Python: NumPy arrays.
struct PastArrays {
  std::array<VectorXd, InertialTarget::kMoments> coordinates;
  std::array<Transforms, InertialTarget::kMoments> bones;
  VectorXd limit, contact, dents;
};

void bind_state(py::module_& m) {
  py::class_<PastArrays>(m, "State",
                         "Where a soft skin is, and what its next steps depend on besides. Keep one to resume, undo or "
                         "fork a simulation.")
      .def(py::init<decltype(PastArrays::coordinates), decltype(PastArrays::bones), VectorXd, VectorXd, VectorXd>(),
           "coordinates"_a, "bones"_a, "limit"_a = VectorXd(), "contact"_a = VectorXd(), "dents"_a = VectorXd())
      .def_readonly("coordinates", &PastArrays::coordinates,
                    "Coordinates (dofs), now and at the last three steps. The unit is meters times the square root of "
                    "cubic meters for a reduced model, and meters for a full one.")
      .def_readonly("bones", &PastArrays::bones, "Transforms (B, 12) of the bones, bind to world space, likewise.")
      .def_readonly("limit", &PastArrays::limit,
                    "What the motion limit remembers of the load (any); empty without one, or where it has not acted.")
      .def_readonly("contact", &PastArrays::contact, "What is touched (any); empty where nothing is.")
      .def_readonly("dents", &PastArrays::dents, "Amplitudes of the contact's local responses (P); empty without.");
}

void bind_report(py::module_& m) {
  py::class_<Report>(m, "StepReport", "What steps, or a static solution, say of themselves.")
      .def(py::init<>(), "Of no steps.")
      .def_readonly("steps", &Report::steps, "How many there were.")
      .def_readonly("seconds", &Report::seconds, "How long they took; of a coupling, an equal share.")
      .def_readonly("iterations", &Report::iterations, "Of Newton's method, in all; of a coupling, those of all.")
      .def_readonly("converged", &Report::converged, "Whether each met its tolerance. The state is finite anyway.")
      .def_readonly("residual", &Report::residual, "The worst one: the gradient relative to the largest force.")
      .def_readonly("energy", &Report::energy, "Elastic energy at the end, J.")
      .def_readonly("teleported", &Report::teleported, "Whether the rig jumped, so that the past was carried along.")
      .def_readonly(
          "excess", &Report::excess,
          "With a motion limit: the largest excess of a bone's load, which was held back if that is above 1/2.")
      .def_readonly("excess_bone", &Report::excess_bone, "Which bone's; -1 without a limit.")
      .def_readonly("farthest", &Report::farthest,
                    "The largest distance of a point from its targets' shape, relative to its limit.")
      .def_readonly("pulled", &Report::pulled, "In how many steps a limit pulled anything back.")
      .def_readonly("contacts", &Report::contacts, "The largest number of points that were pushed in a step.")
      .def_readonly("penetration", &Report::penetration,
                    "The largest depth of a point under a surface, meters, where the bones leave it room.")
      .def_readonly(
          "too_deep", &Report::too_deep,
          "How deep a point stays in a collider, or in the body itself, where the bones take it deeper than it "
          "can give way; meters, 0: nowhere.")
      .def_readonly("too_deep_sample", &Report::too_deep_sample, "Which point of the contact; -1: none.")
      .def_readonly(
          "too_deep_collider", &Report::too_deep_collider,
          "In which collider; -1: in the body, below that: of a coupling, -2 less the number of another body.")
      .def_property_readonly(
          "contact_forces",
          [](const Report& report) {
            Points forces(Eigen::Index(report.contact_forces.size()), 3);
            for (Eigen::Index c = 0; c < forces.rows(); ++c) forces.row(c) = report.contact_forces[std::size_t(c)];
            return forces;
          },
          "Newtons on each collider (C, 3) in the last step.")
      .def_readonly("body_force", &Report::body_force,
                    "Newtons (3) that the others of a coupling pushed it with in the last step.")
      .def_readonly("unusable_colliders", &Report::unusable_colliders,
                    "Numbers of those that were active, but not finite or without extent.");
}

std::vector<ColliderStep> at_rest(const std::optional<std::vector<ColliderMotion>>& colliders) {
  std::vector<ColliderStep> out;
  if (!colliders) return out;
  for (const ColliderMotion& collider : *colliders) {
    check_size("colliders: steps", collider.steps(), 1);
    out.push_back(collider.at(0));
  }
  return out;
}

/// Steps bodies to each of their motions, and reports on each. forget: so that a state resumes bit for bit, between any
/// two calls.
template <class Model>
std::vector<Report> advance(const std::vector<InTurn<Model>*>& bodies, Simulation<Model>& simulation,
                            const std::vector<Motion>& motions) {
  if (motions.size() != bodies.size())
    throw std::invalid_argument("motions: expected those of " + std::to_string(bodies.size()) + " bodies, got " +
                                std::to_string(motions.size()));
  std::vector<Moving<Model>> moving;
  for (std::size_t k = 0; k < motions.size(); ++k) {
    moving.emplace_back(bodies[k]->body.model(), motions[k]);
    if (moving.back().steps() != moving.front().steps())
      throw std::invalid_argument("motions: expected as many steps of each body");
  }
  std::vector<Report> out(bodies.size());
  const auto begin = std::chrono::steady_clock::now();
  changing(bodies, [&] {
    simulation.forget();
    std::vector<StepInput<Model>> inputs;
    for (py::ssize_t i = 0; i < moving.front().steps(); ++i) {
      inputs.clear();
      for (Moving<Model>& each : moving) inputs.push_back(each.at(i));
      const auto& reports = simulation.step(inputs);
      for (std::size_t k = 0; k < out.size(); ++k) out[k].add(reports[k]);
    }
  });
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
  for (Report& each : out) each.seconds = elapsed.count() / double(out.size());
  return out;
}

using AnySimulation = Either<InTurn>;

AnySimulation make_simulation(const EitherModel& model, double h, const std::optional<Either<MotionLimit>>& limit,
                              const std::optional<Either<ContactSamples>>& contact, double distance,
                              const std::optional<Either<SelfContact>>& self_contact, double self_friction,
                              Integrator integrator, const Vector3d& gravity, double tolerance, int max_iterations,
                              double teleport, const py::object& keep_going) {
  std::function<bool()> asked;
  if (!keep_going.is_none())
    asked = [callable = shared(keep_going)] {
      py::gil_scoped_acquire gil;
      return answer("keep_going", (*callable)());
    };
  const StepOptions options{h, integrator, gravity, tolerance, max_iterations, teleport, asked};
  return make_either<InTurn>(model, [&](const auto& own) {
    using Model = std::decay_t<decltype(*own)>;
    const Parts<Model> parts{of_kind<Model>(limit, "limit"), of_kind<Model>(contact, "contact"), distance,
                             of_kind<Model>(self_contact, "self_contact"), self_friction};
    return std::make_shared<InTurn<Model>>(own, options, parts);
  });
}

void bind_simulation(py::module_& m) {
  py::class_<AnySimulation>(m, "Simulation", "Steps a model through time, in world space and SI units.")
      .def(py::init(&make_simulation), "model"_a.none(false), "h"_a, py::kw_only(), "limit"_a = py::none(),
           "contact"_a = py::none(), "distance"_a = 0.0, "self_contact"_a = py::none(), "self_friction"_a = 0.5,
           "integrator"_a = Integrator::bdf2, "gravity"_a = Vector3d(0, 0, 0), "tolerance"_a = 1e-6,
           "max_iterations"_a = 30, "teleport"_a = 0.0, "keep_going"_a = py::none(),
           "h: seconds per step. limit: of the motion. contact: the points that "
           "the colliders of `advance` push, from a distance in meters on. self_contact: of those points, where the "
           "skin touches itself, with self_friction. gravity (3,): m/s^2. teleport: the jump of the skin off its "
           "course in one step, meters, above which the past is carried along (0: never). keep_going() -> bool is "
           "called before every Newton iteration; returning False raises Cancelled. Raises ValueError for parts of "
           "another model.")
      .def(
          "balance_targets",
          [](AnySimulation& s, const FloatArray& bones) {
            s.visit([&](auto& own) {
              const auto& model = own.body.model();
              check_shape("bones", bones,
                          {py::ssize_t(model.targets().size()), py::ssize_t(model.body().skin.cols()), 3, 4});
              std::vector<Transforms> frames;
              const py::ssize_t count = bones.shape(1);
              for (py::ssize_t j = 0; j < bones.shape(0); ++j)
                frames.push_back(transforms(bones.data() + 12 * count * j, count));
              changing(own, [&] { own.body.balance_targets(frames); });
            });
          },
          "bones"_a,
          "Lets only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) act, "
          "so that targets do not sag.")
      .def(
          "start",
          [](AnySimulation& s, const FloatArray& now, const FloatArray& next, const VectorXd& weights,
             const std::optional<std::vector<ColliderMotion>>& colliders, const std::optional<VectorXd>& stiffness,
             const std::optional<double>& distance, const std::optional<double>& self_friction,
             const std::optional<Springs>& grabs) {
            const Transforms a = transforms("now", now), b = transforms("next", next);
            const std::vector<ColliderStep> met = at_rest(colliders);
            if (distance) check_not_negative("distance", *distance);
            if (self_friction) check_not_negative("self_friction", *self_friction);
            const auto pointer = [](const auto& value) { return value ? &*value : nullptr; };
            return s.visit([&](auto& own) {
              auto springs = pulled(own.body.model(), grabs);
              if (grabs) grabs->at(0, springs.springs);
              return Report(changing(own, [&] {
                return own.body.start({a, weights, nullptr, &springs, &met, pointer(stiffness), pointer(distance),
                                       pointer(self_friction)},
                                      b);
              }));
            });
          },
          "now"_a, "next"_a, "weights"_a, "colliders"_a = py::none(), "stiffness"_a = py::none(),
          "distance"_a = py::none(), "self_friction"_a = py::none(), "grabs"_a = py::none(),
          "Starts from the static solution at the bones `now` (B, 3, 4). The past continues the motion from `now` to "
          "`next` backward. grabs: what pulls the skin then, with goals of one step. colliders: what the skin lies on "
          "then, each with the motion of one step in which it stays "
          "where it is. stiffness (J), distance, self_friction: as of `advance`, then.")
      .def(
          "advance",
          [](AnySimulation& s, const FloatArray& bones, const FloatArray& weights,
             const std::optional<FloatArray>& external, const std::optional<Springs>& grabs,
             const std::optional<std::vector<ColliderMotion>>& colliders, const std::optional<FloatArray>& stiffness,
             const std::optional<FloatArray>& distance, const std::optional<FloatArray>& self_friction) {
            return s.visit([&](auto& own) {
              const Motion motion{bones, weights, external, grabs, colliders, stiffness, distance, self_friction};
              return advance({&own}, own.alone, {motion}).front();
            });
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "grabs"_a = py::none(), "colliders"_a = py::none(),
          "stiffness"_a = py::none(), "distance"_a = py::none(), "self_friction"_a = py::none(),
          "Takes one step to each of the bones (S, B, 3, 4) and target weights (S, J). external: newtons on the "
          "nodes, world space, (S, n, 3) or the same at all steps (n, 3). grabs: of points of a skin. colliders: "
          "what pushes the points of its contact. stiffness (S, J): how many times as stiff as its material each "
          "target is. distance (S): at which contact begins, meters, and self_friction (S): instead of the "
          "simulation's. "
          "Returns a StepReport.")
      .def(
          "solve_static",
          [](AnySimulation& s, const FloatArray& bones, const VectorXd& weights,
             const std::optional<FloatArray>& external, const std::optional<VectorXd>& guess,
             const std::optional<VectorXd>& stiffness) {
            VectorXd q = guess.value_or(VectorXd());
            const Transforms frame = transforms("bones", bones);
            return s.visit([&](auto& own) {
              if (guess) check_coordinates(own.body.model(), q);
              External forces(own.body.model().body(), external, 1);
              const auto report = changing(own, [&] {
                const VectorXd* stiffer = stiffness ? &*stiffness : nullptr;
                return own.body.solve_static({frame, weights, forces.at(0), nullptr, nullptr, stiffer}, q);
              });
              return py::make_tuple(q, Report(report));
            });
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "guess"_a = py::none(), "stiffness"_a = py::none(),
          "Returns (coordinates, StepReport) of the static solution. The search starts from `guess`, or from the "
          "blended targets.")
      .def_property_readonly(
          "model",
          [](const AnySimulation& s) {
            return s.visit([](const auto& own) {
              using Model = std::decay_t<decltype(own.body.model())>;
              return EitherModel(std::const_pointer_cast<Model>(own.body.shared_model()));
            });
          },
          "The model that it steps.")
      .def_property_readonly(
          "coordinates",
          [](const AnySimulation& s) {
            return s.visit(
                [](const auto& own) { return in_turn(own, [&] { return VectorXd(own.body.coordinates()); }); });
          },
          "A copy of the coordinates after the last step, as of `State`.")
      .def_property_readonly(
          "dents",
          [](const AnySimulation& s) {
            return s.visit(
                [](const auto& own) { return in_turn(own, [&] { return VectorXd(own.body.state().dents); }); });
          },
          "A copy of the amplitudes of its contact's local responses after the last step, as of `State`.")
      .def_property_readonly(
          "excess",
          [](const AnySimulation& s) {
            return s.visit([](const auto& own) {
              return in_turn(own, [&] { return VectorXd(own.body.state().driven.excess[0]); });
            });
          },
          "By how much each bone's load (G) exceeded its limit in the last step: above 1/2 it was held back. Empty "
          "without a motion limit.")
      .def_property_readonly(
          "kinetic_energy",
          [](const AnySimulation& s) {
            return s.visit([](const auto& own) { return in_turn(own, [&] { return own.body.kinetic_energy(); }); });
          },
          "Kinetic energy of the posed nodes, J, from the integrator's own velocity.")
      .def_property_readonly(
          "elastic_energy",
          [](const AnySimulation& s) {
            return s.visit([](const auto& own) { return in_turn(own, [&] { return own.body.elastic_energy(); }); });
          },
          "Elastic energy, J, at the target weights of the last step.")
      .def_property(
          "state",
          [](const AnySimulation& s) {
            const State state =
                s.visit([](const auto& own) { return in_turn(own, [&] { return State(own.body.state()); }); });
            return PastArrays{state.q, state.bones, driven_numbers(state.driven), contact_numbers(state), state.dents};
          },
          [](AnySimulation& s, const PastArrays& numbers) {
            s.visit([&](auto& own) {
              State state{
                  numbers.coordinates, numbers.bones, read_driven(numbers.limit, own.body.model().dofs()), {}, {},
                  numbers.dents};
              read_contact(numbers.contact, state);
              changing(own, [&] { own.body.set_state(state); });
            });
          },
          "A copy of its State. Set it to resume a simulation; raises Error for what is not finite.");
}

/// Bodies for Python that take their steps together.
template <class Model>
struct Coupling {
  using Body = std::pair<std::shared_ptr<InTurn<Model>>, std::shared_ptr<const SelfContact<Model>>>;

  Coupling(std::vector<Body> list, double friction, const std::vector<Garment>& garments)
      : bodies(std::move(list)), simulation(touching(), friction, garments) {}

  std::vector<InTurn<Model>*> in_turn() const {
    std::vector<InTurn<Model>*> out;
    for (const Body& each : bodies) out.push_back(each.first.get());
    return out;
  }
  /// Throws std::invalid_argument where one is there twice.
  std::vector<TouchingBody<Model>> touching() const {
    std::vector<TouchingBody<Model>> out;
    std::set<const void*> seen;
    for (const auto& [body, skin] : bodies) {
      if (!seen.insert(body.get()).second) throw std::invalid_argument("coupling: each body must be there once");
      out.push_back({&body->body, skin});
    }
    return out;
  }

  std::vector<Body> bodies;
  Simulation<Model> simulation;
};

using CouplingBodies = std::vector<std::pair<AnySimulation, Either<SelfContact>>>;
using CouplingGarments = std::vector<std::tuple<int, int, PointTransform>>;

Either<Coupling> make_coupling(const CouplingBodies& bodies, double friction, const CouplingGarments& worn) {
  std::vector<Garment> garments;
  for (const auto& [clothes, body, to_body] : worn) garments.push_back({clothes, body, to_body});
  if (bodies.empty()) throw std::invalid_argument("coupling: expected two bodies at least");
  return bodies[0].first.visit([&](const auto& first) {
    using Model = std::decay_t<decltype(first.body.model())>;
    std::vector<typename Coupling<Model>::Body> own;
    for (const auto& [simulation, skin] : bodies)
      own.emplace_back(simulation.template of<Model>("coupling: a body"), skin.template of<Model>("coupling: a skin"));
    return Either<Coupling>(std::make_shared<Coupling<Model>>(std::move(own), friction, garments));
  });
}

void bind_coupling(py::module_& m) {
  py::class_<Either<Coupling>>(
      m, "Coupling", "Soft bodies that press on each other and take their steps together: both sides give way.")
      .def(
          py::init(&make_coupling), "bodies"_a, "friction"_a = 0.0, "garments"_a = CouplingGarments(),
          "bodies: two simulations at least, of models of one kind, each with its skin, that of its contact. friction: "
          "of skin on skin. garments: (clothes, body, to_body), numbers of clothes that lie on a body at rest and of "
          "that, and the transform (3, 4) of the bind space of the first to that of the second. "
          "Raises ValueError for others, or if their time steps or integrators differ.")
      .def(
          "advance",
          [](Either<Coupling>& coupling, const std::vector<Motion>& motions) {
            return coupling.visit([&](auto& own) { return advance(own.in_turn(), own.simulation, motions); });
          },
          "motions"_a,
          "As `advance` of one simulation, for all bodies: motions has, for each, (bones, weights, external, grabs, "
          "colliders, stiffness, distance, self_friction). Returns a StepReport of each.");
}

}  // namespace

void bind_step(py::module_& m) {
  py::enum_<Integrator>(m, "Integrator", "How a step goes on in time. Both are implicit.")
      .value("EULER", Integrator::implicit_euler,
             "first order: it damps motion of itself, the more the longer the step")
      .value("BDF2", Integrator::bdf2, "second order: it damps motion much less");
  bind_grabs(m);
  bind_limit(m);
  bind_state(m);
  bind_report(m);
  bind_simulation(m);
  bind_coupling(m);
}
