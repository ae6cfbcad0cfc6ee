// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/models/extend_shapes.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/models/posed_shape.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "model_interface.hpp"

using namespace dynamorph;

namespace {

/// An embedding in another mesh would read past the nodes.
void check_embedding(const Embedding& embedding, Eigen::Index nodes) {
  if (embedding.nodes.size() > 0 && embedding.nodes.maxCoeff() >= nodes)
    throw std::invalid_argument("embedding: it belongs to another mesh");
}

void bind_morph_target(py::module_& m) {
  py::enum_<MaterialModel>(m, "MaterialModel", "How stress follows from strain.")
      .value("LINEAR", MaterialModel::linear, "small strains: the fastest, but large rotations swell the body")
      .value("STVK", MaterialModel::stvk, "St. Venant-Kirchhoff: Green strains, which rotations leave alone")
      .value("STABLE_STVK", MaterialModel::stable_stvk, "the same, and a body that is crushed pushes back");
  py::enum_<Blending>(m, "Blending", "How targets blend between their poses. Both are exact at each target's own pose.")
      .value("FORCES", Blending::forces, "the weighted sum of the targets' forces: the stiffer shape dominates")
      .value("EVEN", Blending::even, "also blends the shapes: halfway in pose is halfway in shape");

  const auto target = [](std::string name, const FloatArray& displacement, Lame lame, double density,
                         double mass_damping, double stiffness_damping, int set, bool shifted) {
    return MorphTarget{
        std::move(name),   set,    flat_points("displacement", displacement, -1), lame, density, mass_damping,
        stiffness_damping, shifted};
  };
  py::class_<MorphTarget>(m, "MorphTarget", "A dynamic morph target: a shape and its elastic properties.")
      .def(py::init([target](std::string name, const FloatArray& displacement, double lambda, double mu, double density,
                             double mass_damping, double stiffness_damping, int set, bool shifted) {
             return target(std::move(name), displacement, {lambda, mu}, density, mass_damping, stiffness_damping, set,
                           shifted);
           }),
           "name"_a, "displacement"_a, py::kw_only(), "lame_lambda"_a, "lame_mu"_a, "density"_a, "mass_damping"_a = 0.0,
           "stiffness_damping"_a = 0.0, "set"_a = 0, "shifted"_a = false,
           "displacement (n, 3): meters, bind space, zero at pinned nodes. Lame's parameters are in Pa, lame_lambda at "
           "most 100 times lame_mu, the density in kg/m^3, Rayleigh damping in 1/s (mass) and s (stiffness). set: "
           "index of the target set. shifted: the target has the elasticity of the neutral shape, moved by the "
           "displacement.")
      .def(py::init([target](std::string name, const FloatArray& displacement, double young, double poisson,
                             double density, double mass_damping, double stiffness_damping, int set, bool shifted) {
             return target(std::move(name), displacement, lame_of(young, poisson), density, mass_damping,
                           stiffness_damping, set, shifted);
           }),
           "name"_a, "displacement"_a, py::kw_only(), "young"_a, "poisson"_a, "density"_a, "mass_damping"_a = 0.0,
           "stiffness_damping"_a = 0.0, "set"_a = 0, "shifted"_a = false,
           "As above, with the material given by Young's modulus (Pa) and Poisson's ratio (0 to 0.495).")
      .def_readonly("name", &MorphTarget::name)
      .def_readonly("set", &MorphTarget::set, "Index of its target set.")
      .def_readonly("shifted", &MorphTarget::shifted,
                    "Whether it has the elasticity of the neutral shape, moved by its displacement.")
      .def_property_readonly(
          "displacement", [](const MorphTarget& t) { return Points(as_points(t.displacement)); },
          "(n, 3): meters, bind space.");
}

void bind_soft_body(py::module_& m) {
  py::class_<SoftBody, std::shared_ptr<SoftBody>>(m, "SoftBody", "The data that all models of one character share.")
      .def(py::init([](const TetMesh& mesh, const VectorXd& fill, const VectorXd& stiffness,
                       const MatrixXd& region_weights, const std::vector<bool>& pinned,
                       const std::optional<MatrixXd>& weights, const std::optional<VectorXd>& hold) {
             return std::make_shared<SoftBody>(mesh, fill, stiffness, region_weights, pinned,
                                               weights.value_or(MatrixXd(mesh.nodes.rows(), 0)),
                                               hold.value_or(VectorXd()));
           }),
           "mesh"_a, "fill"_a, "stiffness"_a, "region_weights"_a, "pinned"_a, "weights"_a, "hold"_a = py::none(),
           "fill, stiffness (m): filled fraction and painted factor of each tet. region_weights (m, S): each target "
           "set's part of a tet; rows sum to one. pinned (n): bool. weights (n, B): skin weights at any positive "
           "scale, or None when every free node has its own transform; such a body has one bone per free node. hold "
           "(m): 1/m^2, or None. Each target adds mu / 2 times the integral of hold |u - d|^2 to its energy.")
      .def_readonly("size", &SoftBody::size, "Bounding-box diagonal, meters.")
      .def_readonly("free_nodes", &SoftBody::free_nodes,
                    "Index of the node of each free node, those that are not pinned.")
      .def_readonly("volumes", &SoftBody::volumes, "Lumped volumes of the free nodes by target set, m^3.")
      .def(
          "extend_shapes",
          [](const SoftBody& body, const Embedding& embedding, const FloatArray& surfaces) {
            const py::ssize_t nodes = body.mesh.nodes.rows();
            check_embedding(embedding, nodes);
            check_shape("surfaces", surfaces, {-1, embedding.nodes.rows(), 3});
            const py::ssize_t count = surfaces.shape(0);
            const Eigen::Map<const MatrixXd> columns(surfaces.data(), 3 * embedding.nodes.rows(), count);
            FloatArray out({count, nodes, py::ssize_t(3)});
            Eigen::Map<MatrixXd> displacements(out.mutable_data(), 3 * nodes, count);
            py::gil_scoped_release release;
            displacements = extend_shapes(body, embedding, columns);
            return out;
          },
          "embedding"_a, "surfaces"_a,
          "Node displacements (k, n, 3) that follow the surface displacements (k, V, 3). They are elastic in between "
          "and zero at pinned nodes.");
}

void bind_full_model(py::module_& m) {
  py::class_<FullModel, std::shared_ptr<FullModel>> full(m, "FullModel", "The unreduced soft skin.");
  full.def(py::init<std::shared_ptr<SoftBody>, std::vector<MorphTarget>, MaterialModel, Blending>(),
           "body"_a.none(false), "targets"_a, "material_model"_a, "blending"_a,
           "targets: of all sets; each set's first is its neutral one. Raises ValueError when a shape does not fit the "
           "body or displaces pinned nodes; `SoftBody.extend_shapes` makes shapes that do not.")
      .def(
          "linear_modes",
          [](const FullModel& model, int target, int k) {
            py::gil_scoped_release release;
            const LinearModes modes = linear_modes(model, checked_target(model, target), k);
            return std::make_pair(modes.omega, modes.shapes);
          },
          "target"_a, "k"_a,
          "Returns (omega (k) in rad/s, mass-orthonormal shapes (3 free, k)) at a target's shape. Raises Error when "
          "the body can move without resistance, as about a line on which all pinned nodes are.");
  bind_model(full);
}

void bind_posed_shape(py::module_& m) {
  py::class_<PosedShape>(m, "PosedShape", "What `shape_by_physics` found.")
      .def_property_readonly(
          "skin", [](const PosedShape& s) { return s.skin; }, "Displacements of the skin (P, 3), bind space, meters.")
      .def_readonly("least_volume", &PosedShape::least_volume,
                    "Of a tet with that displacement, in bind space, relative to rest.")
      .def_readonly("overlap", &PosedShape::overlap,
                    "How deep the skin is still in itself, meters: the bones leave no room there.")
      .def_readonly("overlaps", &PosedShape::overlaps, "The point that is deepest, or -1.")
      .def_readonly("plain", &PosedShape::plain,
                    "How much of plain skinning stays at each point (P), from 0 to 1, where it cannot be inverted.")
      .def_readonly("iterations", &PosedShape::iterations, "Of Newton's method, in all steps.")
      .def_readonly("converged", &PosedShape::converged, "Whether the last step ended.");

  m.def(
      "shape_by_physics",
      [](const TetMesh& mesh, const VectorXd& stiffness, const MatrixXd& weights, const FloatArray& rest,
         const Embedding& embedding, const MatrixXd& skin_weights, const IndexArray& triangles,
         const VectorXd& thickness, const std::vector<FloatArray>& path, const py::object& progress) {
        const Points points = as_points(flat_points("rest", rest, -1));
        check_finite("rest", points);
        const PosedBody body{mesh,
                             stiffness,
                             normalized(weights),
                             {points, embedding, normalized(skin_weights), {}},
                             to_indices<Triangles>(triangles, "triangles"),
                             thickness};
        std::vector<Transforms> bones;
        for (const FloatArray& each : path) bones.push_back(transforms("path", each));
        const ProgressFn report = with_gil(progress);
        return without_gil([&] { return shape_by_physics(body, bones, report); });
      },
      "mesh"_a, "stiffness"_a, "weights"_a, "rest"_a, "embedding"_a, "skin_weights"_a, "triangles"_a, "thickness"_a,
      "path"_a, "progress"_a = py::none(),
      R"(The shape that a soft body has in a pose, found by statics: what an artist would sculpt there.

stiffness (m): of each tet, relative to the others. weights (n, B) of the nodes and skin_weights (P, B) at any positive
scale. rest (P, 3), embedding: of the skin, bind space, meters. triangles (T, 3): of the skin, outward. thickness (P):
from the skin to the middle of the body, meters. path: skin transforms (B, 3, 4) of the bones, from near rest to the
pose. progress: called with 0..1, returns False to cancel. Raises Error for transforms that are not finite.)");
}

}  // namespace

void bind_models(py::module_& m) {
  bind_morph_target(m);
  bind_soft_body(m);
  bind_full_model(m);
  bind_posed_shape(m);
}
