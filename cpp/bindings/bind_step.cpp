// SPDX-License-Identifier: GPL-3.0-or-later
#include <chrono>
#include <memory>
#include <mutex>

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

/// The same for a call that changes it. Throws std::invalid_argument within another one: from keep_going, that is.
template <class Stepper, class Function>
auto changing(InTurn<Stepper>& stepper, const Function& function) {
  struct Under {
    bool& way;
    ~Under() { way = false; }
  };
  return in_turn(stepper, [&] {
    if (stepper.changes) throw std::invalid_argument("keep_going: must not change the simulation that calls it");
    const Under under{stepper.changes = true};
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

py::dict summary(const StepReport& worst, int steps, double seconds) {
  return py::dict("steps"_a = steps, "iterations"_a = worst.iterations, "converged"_a = worst.converged,
                  "residual"_a = worst.residual, "energy"_a = worst.energy, "teleported"_a = worst.teleported,
                  "seconds"_a = seconds);
}

template <class Model>
void bind_simulation_of(py::module_& m, const char* name) {
  using Sim = InTurn<Simulation<Model>>;
  py::class_<Sim>(m, name, "Steps a model through time, in world space and SI units.")
      .def(py::init([](std::shared_ptr<Model> model, double h, Scheme scheme, const Vector3d& gravity, double tolerance,
                       int max_iterations, double teleport, const py::object& keep_going) {
             std::function<bool()> asked;
             if (!keep_going.is_none())
               asked = [callable = shared(keep_going)] {
                 py::gil_scoped_acquire gil;
                 return answer("keep_going", (*callable)());
               };
             return std::make_unique<Sim>(
                 Simulation<Model>(model, {h, scheme, gravity, tolerance, max_iterations, teleport, asked}));
           }),
           "model"_a.none(false), "h"_a, py::kw_only(), "scheme"_a = Scheme::bdf2, "gravity"_a = Vector3d(0, 0, 0),
           "tolerance"_a = 1e-6, "max_iterations"_a = 30, "teleport"_a = 0.0, "keep_going"_a = py::none(),
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
          [](Sim& s, const FloatArray& bones, const FloatArray& weights, const std::optional<FloatArray>& external) {
            check_shape("bones", bones, {-1, -1, 3, 4});
            check_shape("weights", weights, {bones.shape(0), py::ssize_t(s.model().targets().size())});
            const VectorXd force = external ? s.model().body().restrict_to_free(flat_points(
                                                  "external", *external, s.model().body().mesh.nodes.rows()))
                                            : VectorXd();
            StepReport worst;
            const py::ssize_t steps = bones.shape(0), count = bones.shape(1);
            const auto begin = std::chrono::steady_clock::now();
            changing(s, [&] {
              Transforms frame;
              VectorXd w;
              s.forget();  // so that a state resumes bit for bit, between any two calls
              for (py::ssize_t i = 0; i < steps; ++i) {
                frame = Eigen::Map<const Transforms>(bones.data() + i * count * 12, count, 12);
                w = Eigen::Map<const VectorXd>(weights.data() + i * weights.shape(1), weights.shape(1));
                const StepReport report = s.step(frame, w, force);
                worst.iterations += report.iterations;
                worst.converged &= report.converged;
                worst.residual = std::max(worst.residual, report.residual);
                worst.energy = report.energy;
                worst.teleported |= report.teleported;
              }
            });
            const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
            return summary(worst, int(steps), elapsed.count());
          },
          "bones"_a, "weights"_a, "external"_a = py::none(),
          "Takes one step to each of the bones (S, B, 3, 4) and target weights (S, J). external (n, 3): newtons on the "
          "nodes, world space, constant over the call. Returns a report on the steps: total iterations, converged, "
          "worst residual, elastic energy at the end, teleported, seconds.")
      .def(
          "solve_static",
          [](Sim& s, const FloatArray& bones, const VectorXd& weights, const std::optional<FloatArray>& external,
             const std::optional<VectorXd>& guess) {
            VectorXd q = guess.value_or(VectorXd());
            if (guess) check_coordinates(s.model(), q);
            const VectorXd force = external ? s.model().body().restrict_to_free(flat_points(
                                                  "external", *external, s.model().body().mesh.nodes.rows()))
                                            : VectorXd();
            const Transforms frame = transforms("bones", bones);
            const StepReport report = changing(s, [&] { return s.solve_static(frame, weights, q, force); });
            return py::make_tuple(q, summary(report, 0, 0));
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "guess"_a = py::none(),
          "Returns (coordinates, report) of the static solution. The search starts from `guess`, or from the blended "
          "targets.")
      .def_property_readonly("model", &Sim::shared_model)
      .def_property_readonly(
          "coordinates", [](const Sim& s) { return in_turn(s, [&] { return VectorXd(s.coordinates()); }); },
          "A copy of the coordinates after the last step. The unit is meters times the square root of cubic meters for "
          "a reduced model, and meters for a full one.")
      .def_property_readonly(
          "kinetic_energy", [](const Sim& s) { return in_turn(s, [&] { return s.kinetic_energy(); }); },
          "Kinetic energy of the posed nodes, J, from the scheme's own velocity.")
      .def_property_readonly(
          "elastic_energy", [](const Sim& s) { return in_turn(s, [&] { return s.elastic_energy(); }); },
          "Elastic energy, J, at the target weights of the last step.")
      .def_property(
          "state",
          [](const Sim& s) {
            const State state = in_turn(s, [&] { return State(s.state()); });
            return py::make_tuple(state.q, state.bones);
          },
          [](Sim& s, const std::pair<std::array<VectorXd, 4>, std::array<Transforms, 4>>& state) {
            changing(s, [&] { s.set_state({state.first, state.second}); });
          },
          "(coordinates, bones' transforms (B, 12)), each now and at the last three steps. Set it to resume a "
          "simulation; raises Error for what is not finite.");
}

}  // namespace

void bind_step(py::module_& m) {
  py::enum_<Scheme>(m, "Scheme").value("EULER", Scheme::implicit_euler).value("BDF2", Scheme::bdf2);
  bind_simulation_of<FullModel>(m, "FullSimulation");
  bind_simulation_of<ReducedModel>(m, "ReducedSimulation");
}
