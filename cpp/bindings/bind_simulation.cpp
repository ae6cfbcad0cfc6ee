// SPDX-License-Identifier: GPL-3.0-or-later
// Models, pose space and time stepping as NumPy sees them.
#include <chrono>

#include "bindings.hpp"
#include "dynamorph/pose/pose_space.hpp"
#include "dynamorph/reduced/basis.hpp"
#include "dynamorph/step/crowd.hpp"
#include "dynamorph/step/integrator.hpp"

namespace py = pybind11;
using namespace dynamorph;
using namespace pybind11::literals;

namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

std::string shape_of(const py::array& array) {
  std::string text = "(";
  for (py::ssize_t i = 0; i < array.ndim(); ++i) text += (i ? ", " : "") + std::to_string(array.shape(i));
  return text + ")";
}

/// -1 in `expected` stands for any size.
void check_shape(const char* name, const py::array& array, const std::vector<py::ssize_t>& expected) {
  bool good = array.ndim() == py::ssize_t(expected.size());
  for (size_t i = 0; good && i < expected.size(); ++i) good = expected[i] < 0 || array.shape(i) == expected[i];
  if (good) return;
  std::string text;
  for (py::ssize_t e : expected) text += (text.empty() ? "" : ", ") + (e < 0 ? std::string("any") : std::to_string(e));
  throw std::invalid_argument(std::string(name) + ": expected shape (" + text + "), got " + shape_of(array));
}

VectorXd flat_points(const char* name, const Array& array, py::ssize_t rows) {
  check_shape(name, array, {rows, 3});
  return Eigen::Map<const VectorXd>(array.data(), array.size());
}

Transforms transforms(const double* data, py::ssize_t bones) { return Eigen::Map<const Transforms>(data, bones, 12); }

Transforms transforms(const char* name, const Array& array) {
  check_shape(name, array, {-1, 3, 4});
  return transforms(array.data(), array.shape(0));
}

template <class Model>
void check_coordinates(const Model& model, const VectorXd& q) {
  if (q.size() != model.dofs())
    throw std::invalid_argument("q: expected " + std::to_string(model.dofs()) + " coordinates, got " +
                                std::to_string(q.size()));
}

template <class Model>
int checked_target(const Model& model, int target) {
  const int count = int(model.targets().size());
  if (target < 0 || target >= count)
    throw std::invalid_argument("target: expected 0 to " + std::to_string(count - 1) + ", got " +
                                std::to_string(target));
  return target;
}

/// An embedding of another mesh would read past the nodes.
void check_embedding(const Embedding& embedding, Eigen::Index nodes) {
  if (embedding.nodes.size() > 0 && embedding.nodes.maxCoeff() >= nodes)
    throw std::invalid_argument("embedding: is of another mesh");
}

/// Bind-space node displacement (n, 3) of coordinates q.
template <class Model>
Points node_displacement(const Model& model, const VectorXd& q) {
  check_coordinates(model, q);
  VectorXd u;
  model.displacement(q, u);
  return as_points(model.body().expand(u));
}

/// What both kinds of model offer.
template <class Model>
void bind_model(py::class_<Model, std::shared_ptr<Model>>& c) {
  c.def_property_readonly("dofs", &Model::dofs, "Number of coordinates.")
      .def_property_readonly("body", [](const Model& m) { return std::const_pointer_cast<SoftBody>(m.shared_body()); })
      .def(
          "energy",
          [](const Model& m, const VectorXd& weights, const VectorXd& q) {
            check_coordinates(m, q);
            typename Model::Blend blend;
            m.blend(weights, blend);
            return m.energy(blend, q);
          },
          "weights"_a, "q"_a, "Elastic energy, J, at target weights (J) and coordinates q.")
      .def(
          "linearize",
          [](const Model& m, const VectorXd& weights, const VectorXd& q) {
            check_coordinates(m, q);
            typename Model::Blend blend;
            m.blend(weights, blend);
            VectorXd force;
            typename Model::Matrix stiffness = m.zero();
            const double energy = m.linearize(blend, q, force, stiffness);
            return py::make_tuple(energy, force, stiffness);
          },
          "weights"_a, "q"_a,
          "(energy J, force dE/dq, stiffness dF/dq) at target weights (J) and coordinates q; the stiffness of a full "
          "model is a scipy.sparse matrix.")
      .def(
          "inertia",
          [](const Model& m, const Array& bones, double density) {
            check_shape("bones", bones, {py::ssize_t(m.body().skin.cols()), 3, 4});
            const Transforms pose = transforms("bones", bones);
            const VectorXd rest = VectorXd::Zero(m.dofs());
            Motion still;
            still.q.fill(&rest);
            still.bones.fill(&pose);
            typename Model::Inertia out;
            m.inertia(still, {VectorXd::Constant(m.body().sets(), density), VectorXd::Zero(m.body().sets())}, out);
            return out.mass;
          },
          "bones"_a, "density"_a, "A^T M A in the model's coordinates at the bones' transforms (B, 3, 4).")
      .def(
          "target", [](const Model& m, int target) { return m.target(checked_target(m, target)); }, "target"_a,
          "Coordinates of a target's shape.")
      .def("displacement", &node_displacement<Model>, "q"_a, "Bind-space node displacement (n, 3), metres.");
}

/// Of a Simulation or a Crowd, bones (J, B, 3, 4).
template <class Stepper>
void held_in(Stepper& stepper, const Array& bones) {
  check_shape("bones", bones, {-1, -1, 3, 4});
  std::vector<Transforms> frames;
  for (py::ssize_t j = 0; j < bones.shape(0); ++j) frames.push_back(transforms(bones.data(j, 0, 0, 0), bones.shape(1)));
  stepper.hold_targets(frames);
}

py::dict summary(const StepReport& worst, int steps, double seconds) {
  return py::dict("steps"_a = steps, "iterations"_a = worst.iterations, "converged"_a = worst.converged,
                  "residual"_a = worst.residual, "energy"_a = worst.energy, "teleported"_a = worst.teleported,
                  "seconds"_a = seconds);
}

template <class Model>
void bind_simulation_of(py::module_& m, const char* name) {
  using Sim = Simulation<Model>;
  py::class_<Sim>(m, name, "Steps a model through time. World space, SI.")
      .def(
          py::init([](std::shared_ptr<Model> model, double h, Scheme scheme, const Vector3d& gravity, double tolerance,
                      int max_iterations, double teleport, const py::object& keep_going) {
            std::function<bool()> asked;
            if (!keep_going.is_none())
              asked = [keep_going] {
                py::gil_scoped_acquire gil;
                return keep_going().cast<bool>();
              };
            return Sim(model, {h, scheme, gravity, tolerance, max_iterations, teleport, asked});
          }),
          "model"_a, "h"_a, py::kw_only(), "scheme"_a = Scheme::bdf2, "gravity"_a = Vector3d(0, 0, 0),
          "tolerance"_a = 1e-6, "max_iterations"_a = 30, "teleport"_a = 0.0, "keep_going"_a = py::none(),
          "h: seconds a step; gravity (3,) m/s^2; teleport: jump of the skin off its course in one step, metres, above "
          "which the past is carried along (0: never); keep_going() -> bool is asked before every Newton iteration, "
          "False "
          "raises Cancelled.")
      .def("hold_targets", &held_in<Sim>, "bones"_a,
           "Only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) acts.")
      .def(
          "start",
          [](Sim& s, const Array& now, const Array& next, const VectorXd& weights) {
            const Transforms a = transforms("now", now), b = transforms("next", next);
            StepReport report;
            {
              py::gil_scoped_release release;
              report = s.start(a, b, weights);
            }
            return summary(report, 0, 0);
          },
          "now"_a, "next"_a, "weights"_a,
          "Static solution at the bones `now` (B, 3, 4); the past follows the rig backward from its motion to `next`.")
      .def(
          "advance",
          [](Sim& s, const Array& bones, const Array& weights, const std::optional<Array>& external) {
            check_shape("bones", bones, {-1, -1, 3, 4});
            check_shape("weights", weights, {bones.shape(0), py::ssize_t(s.model().targets().size())});
            const VectorXd force = external ? s.model().body().restrict_to_free(flat_points(
                                                  "external", *external, s.model().body().mesh.nodes.rows()))
                                            : VectorXd();
            StepReport worst;
            const py::ssize_t steps = bones.shape(0), count = bones.shape(1);
            const auto begin = std::chrono::steady_clock::now();
            {
              py::gil_scoped_release release;
              Transforms frame;
              VectorXd w;
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
            }
            const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
            return summary(worst, int(steps), elapsed.count());
          },
          "bones"_a, "weights"_a, "external"_a = py::none(),
          "One step to each of the bones (S, B, 3, 4) and target weights (S, J); external (n, 3): newtons on the "
          "nodes, world space, constant over the call. Returns what the steps did: iterations in all, converged, the "
          "worst residual, elastic energy at the end, seconds.")
      .def(
          "solve_static",
          [](Sim& s, const Array& bones, const VectorXd& weights, const std::optional<Array>& external,
             const std::optional<VectorXd>& guess) {
            VectorXd q = guess.value_or(VectorXd());
            if (guess) check_coordinates(s.model(), q);
            const VectorXd force = external ? s.model().body().restrict_to_free(flat_points(
                                                  "external", *external, s.model().body().mesh.nodes.rows()))
                                            : VectorXd();
            const Transforms frame = transforms("bones", bones);
            StepReport report;
            {
              py::gil_scoped_release release;
              report = s.solve_static(frame, weights, q, force);
            }
            return py::make_tuple(q, summary(report, 0, 0));
          },
          "bones"_a, "weights"_a, "external"_a = py::none(), "guess"_a = py::none(),
          "(coordinates, report) of the static solution, sought from `guess` or from the blended targets.")
      .def_property_readonly("model", &Sim::shared_model)
      .def_property_readonly(
          "coordinates", [](const Sim& s) { return VectorXd(s.coordinates()); },
          "Of the last step, a copy: metres times the square root of cubic metres when reduced, metres when full.")
      .def_property_readonly("kinetic_energy", &Sim::kinetic_energy, "J, of the posed nodes.")
      .def_property_readonly("elastic_energy", &Sim::elastic_energy, "J.")
      .def_property(
          "state", [](const Sim& s) { return py::make_tuple(s.state().q, s.state().bones); },
          [](Sim& s, const std::pair<std::array<VectorXd, 4>, std::array<Transforms, 4>>& state) {
            s.set_state({state.first, state.second});
          },
          "(coordinates, bones' transforms (B, 12)), each now and at the last three steps: set it to resume.");
}

void bind_crowd(py::module_& m) {
  const auto poses = [](const Crowd& crowd, const char* name, const Array& bones, py::ssize_t axes) {
    std::vector<py::ssize_t> shape(axes - 4, -1);
    shape.insert(shape.end(), {crowd.size(), py::ssize_t(crowd.model().body().skin.cols()), 3, 4});
    check_shape(name, bones, shape);
  };
  const auto shares = [](const Crowd& crowd, const Array& weights, std::vector<py::ssize_t> shape) {
    shape.insert(shape.end(), {crowd.size(), py::ssize_t(crowd.model().targets().size())});
    check_shape("weights", weights, shape);
  };
  py::class_<Crowd>(m, "Crowd", "Many characters of one reduced model, stepped together. World space, SI.")
      .def(py::init([](std::shared_ptr<ReducedModel> model, double h, int size, Scheme scheme, const Vector3d& gravity,
                       double tolerance, int max_iterations, double teleport) {
             return Crowd(model, {h, scheme, gravity, tolerance, max_iterations, teleport, {}}, size);
           }),
           "model"_a, "h"_a, "size"_a, py::kw_only(), "scheme"_a = Scheme::bdf2, "gravity"_a = Vector3d(0, 0, 0),
           "tolerance"_a = 1e-6, "max_iterations"_a = 30, "teleport"_a = 0.0, "As ReducedSimulation; size: characters.")
      .def("hold_targets", &held_in<Crowd>, "bones"_a,
           "Only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) acts.")
      .def(
          "start",
          [poses, shares](Crowd& crowd, const Array& now, const Array& next, const Array& weights) {
            poses(crowd, "now", now, 4);
            poses(crowd, "next", next, 4);
            shares(crowd, weights, {});
            py::gil_scoped_release release;
            return crowd.start(now.data(), next.data(), weights.data()).converged;
          },
          "now"_a, "next"_a, "weights"_a,
          "Static solutions of N characters at the bones `now` (N, B, 3, 4) and target weights (N, J); the past "
          "follows "
          "their rigs backward from their motion to `next`. False where one did not converge.")
      .def(
          "advance",
          [poses, shares](Crowd& crowd, const Array& bones, const Array& weights) {
            poses(crowd, "bones", bones, 5);
            shares(crowd, weights, {bones.shape(0)});
            const py::ssize_t steps = bones.shape(0);
            CrowdReport all;
            const auto begin = std::chrono::steady_clock::now();
            {
              py::gil_scoped_release release;
              for (py::ssize_t i = 0; i < steps; ++i) {
                const CrowdReport report =
                    crowd.step(bones.data() + i * bones.size() / steps, weights.data() + i * weights.size() / steps);
                all.iterations += report.iterations;
                all.alone += report.alone;
                all.converged &= report.converged;
              }
            }
            const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
            return py::dict("steps"_a = steps, "iterations"_a = all.iterations, "alone"_a = all.alone,
                            "converged"_a = all.converged, "seconds"_a = elapsed.count());
          },
          "bones"_a, "weights"_a,
          "One step of all characters to each of the bones (S, N, B, 3, 4) and target weights (S, N, J). Returns what "
          "the steps did: iterations in all, steps of characters that had to be taken alone, converged, seconds.")
      .def_property_readonly(
          "coordinates",
          [](const Crowd& crowd) {
            MatrixXd out(crowd.size(), crowd.model().dofs());
            for (int i = 0; i < crowd.size(); ++i) out.row(i) = crowd.coordinates(i);
            return out;
          },
          "(N, r) of the last step, a copy.");
}

void bind_pose_space(py::module_& m) {
  py::enum_<Kernel>(m, "Kernel")
      .value("LINEAR", Kernel::linear)
      .value("GAUSSIAN", Kernel::gaussian)
      .value("THIN_PLATE", Kernel::thin_plate);
  const auto rotations = [](const char* name, const Array& local) {
    check_shape(name, local, {-1, 4, 4});
    Rotations out(local.shape(0), 4);
    const LocalTransforms transforms(local.data(), local.shape(0), 16);
    for (int bone = 0; bone < out.rows(); ++bone) rotation_of(transforms, bone, out);
    return out;
  };
  py::class_<TargetSet>(m, "TargetSet", "Targets whose weights sum to one.")
      .def(py::init([rotations](std::vector<int> bones, std::vector<std::string> names, const std::vector<Array>& poses,
                                Kernel kernel, std::vector<double> radii) {
             TargetSet set{std::move(bones), std::move(names), {}, kernel, std::move(radii)};
             for (const Array& pose : poses) set.poses.push_back(rotations("poses", pose));
             return set;
           }),
           "bones"_a, "names"_a, "poses"_a, "kernel"_a = Kernel::linear, "radii"_a = std::vector<double>(),
           "bones: indices whose local rotations place the targets; poses: per target the local transforms (B, 4, 4) "
           "of the whole skeleton; radii: per target the joint angle, radians, at which it has faded out, 0 for "
           "never, which all are by default. What has faded goes to the first target, whose own radius is ignored.");
  // answer(space, pose, (J) out) at every sample of local transforms (S, B, 4, 4).
  const auto sampled = [](const PoseSpace& space, const Array& local, auto answer) {
    check_shape("local", local, {-1, -1, 4, 4});
    const py::ssize_t bones = local.shape(1);
    if (!space.bones().empty() && space.bones().back() >= bones)
      throw std::invalid_argument("local: expected at least " + std::to_string(space.bones().back() + 1) +
                                  " bones, got " + std::to_string(bones));
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> out(local.shape(0), space.targets());
    py::gil_scoped_release release;
    VectorXd at(space.targets());
    Rotations pose = Rotations::Zero(bones, 4);
    for (py::ssize_t i = 0; i < local.shape(0); ++i) {
      const LocalTransforms transforms(local.data() + i * bones * 16, bones, 16);
      for (int bone : space.bones()) rotation_of(transforms, bone, pose);
      answer(space, pose, at);
      out.row(i) = at;
    }
    return out;
  };
  const auto weights = [](const PoseSpace& space, const Rotations& pose, VectorXd& w) { space.weights(pose, w); };
  const auto distances = [](const PoseSpace& space, const Rotations& pose, VectorXd& d) { space.distances(pose, d); };
  py::class_<PoseSpace>(m, "PoseSpace", "Interpolates target weights over pose space.")
      .def(py::init<std::vector<TargetSet>>(), "sets"_a,
           "Raises Error, naming both, when two targets of a set have the same pose.")
      .def_property_readonly("targets", &PoseSpace::targets)
      .def(
          "weights",
          [sampled, weights](const PoseSpace& space, const Array& local) { return sampled(space, local, weights); },
          "local"_a,
          "Weights (S, J) at the local transforms (S, B, 4, 4): each set's are >= 0, sum to 1, and are one at a "
          "target's own pose.")
      .def(
          "distances",
          [sampled, distances](const PoseSpace& space, const Array& local) { return sampled(space, local, distances); },
          "local"_a,
          "Distances (S, J) in radians of the local transforms (S, B, 4, 4) to each target's pose: the root of the "
          "summed squares of the joint angles that its set names.");
}

void bind_models(py::module_& m) {
  py::enum_<Law>(m, "Law").value("LINEAR", Law::linear).value("STVK", Law::stvk).value("STABLE_STVK", Law::stable_stvk);
  py::enum_<Blending>(m, "Blending").value("FORCES", Blending::forces).value("EVEN", Blending::even);
  py::enum_<Scheme>(m, "Scheme").value("EULER", Scheme::euler).value("BDF2", Scheme::bdf2);

  py::class_<MorphTarget>(m, "MorphTarget", "A dynamic morph target: shape and elastic properties.")
      .def(py::init([](std::string name, const Array& displacement, double lambda, double mu, double density,
                       double mass_damping, double stiffness_damping, int set, bool shifted) {
             return MorphTarget{std::move(name),   set,     flat_points("displacement", displacement, -1),
                                {lambda, mu},      density, mass_damping,
                                stiffness_damping, shifted};
           }),
           "name"_a, "displacement"_a, py::kw_only(), "lame_lambda"_a, "lame_mu"_a, "density"_a, "mass_damping"_a = 0.0,
           "stiffness_damping"_a = 0.0, "set"_a = 0, "shifted"_a = false,
           "displacement (n, 3) metres, bind space, zero at pinned nodes; Lame's parameters in Pa, density kg/m^3, "
           "Rayleigh damping in 1/s and s; set: index of its target set; shifted: elastic as the neutral shape, moved "
           "by the displacement.");

  py::class_<SoftBody, std::shared_ptr<SoftBody>>(m, "SoftBody", "What all models of one character share.")
      .def(py::init([](const TetMesh& mesh, const VectorXd& fill, const VectorXd& stiffness, const MatrixXd& shares,
                       const std::vector<bool>& pinned, const std::optional<MatrixXd>& weights,
                       const std::optional<VectorXd>& hold) {
             return std::make_shared<SoftBody>(mesh, fill, stiffness, shares, pinned,
                                               weights.value_or(MatrixXd(mesh.nodes.rows(), 0)),
                                               hold.value_or(VectorXd()));
           }),
           "mesh"_a, "fill"_a, "stiffness"_a, "shares"_a, "pinned"_a, "weights"_a, "hold"_a = py::none(),
           "fill, stiffness (m): filled fraction and painted multiplier of each tet; shares (m, S): each target set's "
           "part of a tet, rows sum to one; pinned (n) bool; weights (n, B) skin weights, any positive scale, or None "
           "where "
           "a transform of every free node is known instead: such a body has as many bones. hold (m), 1/m^2, or None: "
           "each target adds mu / 2 times the integral of hold |u - d|^2 to its energy.")
      .def_readonly("size", &SoftBody::size, "Bounding-box diagonal, metres.")
      .def_readonly("free_nodes", &SoftBody::free_nodes)
      .def_readonly("volumes", &SoftBody::volumes, "Lumped volume of the free nodes by target set, m^3.")
      .def(
          "extend_shapes",
          [](const SoftBody& body, const Embedding& embedding, const Array& surfaces) {
            const py::ssize_t nodes = body.mesh.nodes.rows();
            check_embedding(embedding, nodes);
            check_shape("surfaces", surfaces, {-1, embedding.nodes.rows(), 3});
            const py::ssize_t count = surfaces.shape(0);
            const Eigen::Map<const MatrixXd> columns(surfaces.data(), 3 * embedding.nodes.rows(), count);
            Array out({count, nodes, py::ssize_t(3)});
            Eigen::Map<MatrixXd> displacements(out.mutable_data(), 3 * nodes, count);
            py::gil_scoped_release release;
            displacements = extend_shapes(body, embedding, columns);
            return out;
          },
          "embedding"_a, "surfaces"_a,
          "Node displacements (k, n, 3) that follow the surface displacements (k, V, 3): elastic in between, zero at "
          "pins.");

  py::class_<FullModel, std::shared_ptr<FullModel>> full(m, "FullModel", "The unreduced soft skin.");
  full.def(py::init<std::shared_ptr<SoftBody>, std::vector<MorphTarget>, Law, Blending>(), "body"_a, "targets"_a,
           "law"_a, "blending"_a)
      .def(
          "linear_modes",
          [](const FullModel& model, int target, int k) {
            py::gil_scoped_release release;
            const LinearModes modes = linear_modes(model, checked_target(model, target), k);
            return std::make_pair(modes.frequencies, modes.shapes);
          },
          "target"_a, "k"_a, "(omega (k) rad/s, mass-orthonormal shapes (3 free, k)) at a target's shape.")
      .def(
          "fallbacks",
          [](const FullModel& model, int target) { return model.shape(checked_target(model, target)).fallbacks; },
          "target"_a,
          "Tetrahedra of a target that keep the neutral rest shape, because the sculpt would invert or crush them.");
  bind_model(full);

  py::class_<Basis>(m, "Basis")
      .def_readonly("U", &Basis::U, "(3 free, r), orthonormal in unit-density mass.")
      .def_readonly("captured", &Basis::captured, "Fraction of the candidates' variance in the span.");
  m.def(
      "make_basis",
      [](const FullModel& model, int r, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return make_basis(model, r, report);
      },
      "model"_a, "r"_a, "progress"_a = py::none(),
      "r modes: the targets' shapes exactly, then linear modes, modal derivatives and static responses by mass-PCA. "
      "progress(fraction) -> bool, False raises Cancelled.");

  py::class_<ReducedTables>(m, "ReducedTables", "What a built reduced model stores: geometry only, no material.")
      .def(py::init([](Law law, const MatrixXd& basis, const std::vector<VectorXd>& lambda,
                       const std::vector<VectorXd>& mu) { return ReducedTables{law, basis, lambda, mu}; }),
           "law"_a, "basis"_a, "lame_lambda"_a, "lame_mu"_a)
      .def_readonly("law", &ReducedTables::law)
      .def_readonly("basis", &ReducedTables::basis)
      .def_readonly("lame_lambda", &ReducedTables::lambda, "Per target, for lambda = 1 Pa.")
      .def_readonly("lame_mu", &ReducedTables::mu, "Per target, for mu = 1 Pa.");
  m.def(
      "reduce",
      [](const FullModel& model, const MatrixXd& U, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return reduce(model, U, report);
      },
      "model"_a, "U"_a, "progress"_a = py::none(), "Energy polynomials of every target in the basis U (3 free, r).");

  py::class_<ReducedModel, std::shared_ptr<ReducedModel>> reduced(m, "ReducedModel", "The soft skin in r modes.");
  reduced.def(py::init<std::shared_ptr<SoftBody>, std::vector<MorphTarget>, const ReducedTables&, Blending>(), "body"_a,
              "targets"_a, "tables"_a, "blending"_a);
  bind_model(reduced);
}

}  // namespace

void bind_simulation(py::module_& m) {
  bind_pose_space(m);
  bind_models(m);
  bind_simulation_of<FullModel>(m, "FullSimulation");
  bind_simulation_of<ReducedModel>(m, "ReducedSimulation");
  bind_crowd(m);
}
