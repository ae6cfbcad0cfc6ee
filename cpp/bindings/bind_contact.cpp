// SPDX-License-Identifier: GPL-3.0-or-later
#include "collider_motion.hpp"
#include "dynamorph/contact/contact_samples.hpp"
#include "dynamorph/contact/self_contact.hpp"
#include "either.hpp"
#include "model_interface.hpp"

using namespace dynamorph;

namespace {

using Flags = py::array_t<bool, py::array::c_style>;

/// One value for each step, or the same for all: how far apart they are.
py::ssize_t checked_stride(const char* name, const py::array& values, py::ssize_t steps) {
  if (values.ndim() == 0) return 0;
  check_shape(name, values, {steps});
  return 1;
}

ColliderMotion collider_motion(std::shared_ptr<Collider> collider, const FloatArray& motion, const FloatArray& friction,
                               const Flags& active) {
  if (motion.ndim() == 3 && motion.shape(2) == 4)
    check_shape("motion", motion, {-1, 3, 4});
  else
    check_shape("motion", motion, {-1, py::ssize_t(collider->rest().points.rows()), 3});
  if (motion.shape(0) < 1) throw std::invalid_argument("motion: expected the beginning of the first step");
  const py::ssize_t steps = motion.shape(0) - 1;
  const py::ssize_t each = checked_stride("friction", friction, steps), on = checked_stride("active", active, steps);
  ColliderMotion out{std::move(collider), motion, VectorXd(steps), std::vector<bool>(std::size_t(steps))};
  for (py::ssize_t i = 0; i < steps; ++i) {
    out.friction(i) = friction.data()[each * i];
    out.active[std::size_t(i)] = active.data()[on * i];
  }
  if (!out.friction.allFinite() || (out.friction.array() < 0).any())
    throw std::invalid_argument("friction: must be finite and not negative");
  return out;
}

void bind_collider(py::module_& m) {
  py::class_<Collider, std::shared_ptr<Collider>>(m, "Collider",
                                                  "A triangle mesh that soft skins run into. Simulations may share it.")
      .def(py::init([](const FloatArray& points, const IndexArray& triangles, bool one_sided) {
             Points p = to_matrix<Points>(points, "points");
             Triangles t = to_indices<Triangles>(triangles, "triangles");
             check_finite("points", p);
             return without_gil([&] { return std::make_shared<Collider>(std::move(p), std::move(t), one_sided); });
           }),
           "points"_a, "triangles"_a, "one_sided"_a = false,
           "points (V, 3): meters, in its own frame. triangles (T, 3): any triangle soup; closed parts push outward, "
           "open ones from both sides. one_sided: all that is behind its faces counts as inside, unless both sides of "
           "one are there. Raises ValueError without triangles, for indices out of range and for points that are not "
           "finite.")
      .def(
          "signed_distances",
          [](const Collider& collider, const FloatArray& points) {
            const Points x = to_matrix<Points>(points, "points");
            check_finite("points", x);
            VectorXd out(x.rows());
            for (Eigen::Index i = 0; i < x.rows(); ++i) out(i) = collider.signed_distance(collider.rest(), x.row(i));
            return out;
          },
          "points"_a,
          "Of points (N, 3) from the mesh as it was built, in its own frame: (N,), meters, negative inside. An open "
          "part that is not one-sided has no inside. Raises ValueError for points that are not finite.");
  py::class_<ColliderMotion>(m, "ColliderMotion", "Where a collider is during S steps, in world space.")
      .def(py::init(&collider_motion), "collider"_a.none(false), "motion"_a, "friction"_a = 0.5,
           "active"_a = py::bool_(true),
           "motion: meters, a rigid collider's transforms (S + 1, 3, 4) or a deforming one's points (S + 1, V, 3), the "
           "first at the beginning of the first step, each other at the end of one. They need not be finite: where "
           "they are not, nothing touches the collider. friction: Coulomb's coefficient, for each step (S) or for all. "
           "active: whether something can touch it, for each step (S) or for all.");
}

using CornerWeights = decltype(SurfacePoints::weights);

/// corners, corner_weights (P, 3); by default all vertices of the surface.
SurfacePoints surface_points(const std::optional<IndexArray>& corners, const std::optional<CornerWeights>& weights,
                             Eigen::Index vertices) {
  if (corners.has_value() != weights.has_value())
    throw std::invalid_argument("corners, corner_weights: give both of them or none");
  if (!corners) return SurfacePoints::vertices(vertices);
  return {to_indices<Triangles>(*corners, "corners"), *weights};
}

/// Responses on their way to another process, and there.
py::tuple pickled(const LocalResponses& responses) {
  const ResponseParts& parts = responses.parts();
  return py::make_tuple(MatrixXd(parts.centers.rest), MatrixXd(parts.centers.normals), parts.size, parts.reach,
                        MatrixXd(parts.shapes), parts.stiffness, parts.farthest, parts.shear, parts.farthest_node);
}

/// Throws std::invalid_argument for a state that `pickled` did not make.
std::shared_ptr<LocalResponses> unpickled(const py::tuple& state) {
  ResponseParts parts;
  try {
    const auto read = [&](std::size_t k, auto& part) {
      part = state[k].cast<std::decay_t<decltype(part)>>();
      check_finite("state", part);
    };
    read(0, parts.centers.rest);
    read(1, parts.centers.normals);
    parts.size = state[2].cast<double>();
    parts.reach = state[3].cast<double>();
    read(4, parts.shapes);
    read(5, parts.stiffness);
    read(6, parts.farthest);
    read(7, parts.shear);
    parts.farthest_node = state[8].cast<std::vector<int>>();
  } catch (const std::exception&) {  // those of pybind11 have no class in common
    throw std::invalid_argument("state: it is none of local responses");
  }
  return std::make_shared<LocalResponses>(std::move(parts));
}

void bind_local_responses(py::module_& m) {
  py::class_<LocalResponses, std::shared_ptr<LocalResponses>>(
      m, "LocalResponses",
      "How patches of a skin give way where something presses, which a reduced model's coordinates cannot do. "
      "Simulations may share it.")
      .def(py::init([](std::shared_ptr<FullModel> model, const MatrixXd& basis, const FloatArray& rest,
                       const FloatArray& normals, const Embedding& embedding, const std::vector<int>& centers,
                       const std::optional<IndexArray>& corners, const std::optional<CornerWeights>& weights) {
             const SkinPlaces places{as_points(flat_points("rest", rest, -1)),
                                     as_points(flat_points("normals", normals, rest.shape(0))).rowwise().normalized(),
                                     surface_points(corners, weights, embedding.nodes.rows())};
             check_finite("basis", basis);
             check_finite("rest", places.rest);
             check_finite("normals", places.normals);
             return without_gil(
                 [&] { return std::make_shared<LocalResponses>(*model, basis, places, embedding, centers); });
           }),
           "model"_a.none(false), "basis"_a, "rest"_a, "normals"_a, "embedding"_a, "centers"_a,
           "corners"_a = py::none(), "corner_weights"_a = py::none(),
           "model: the unreduced one. basis (3 free, dofs): the reduced model's. rest (L, 3): places that are spread "
           "evenly over the soft skin, meters, bind space; normals (L, 3): outward, any length; embedding: of the "
           "skin's V vertices. centers (P): those in the middle of a patch. corners (L, 3), corner_weights (L, 3): "
           "the places are means of these vertices; by default they are the vertices.")
      .def_property_readonly(
          "shapes", [](const LocalResponses& r) { return MatrixXd(r.shapes()); },
          "Displacement (3 free, P) of the free nodes by a unit of each patch's amplitude, which has a mean square of "
          "one over the body's volume.")
      .def_property_readonly(
          "stiffness", [](const LocalResponses& r) { return MatrixXd(r.stiffness()); },
          "C (P, P) of the energy a^T C a / 2, at the neutral targets.")
      .def(py::pickle(&pickled, &unpickled));
}

void bind_samples(py::module_& m) {
  py::class_<Either<ContactSamples>>(
      m, "Contact", "The points of a model's skin that can touch colliders. Simulations may share them.")
      .def(
          py::init(
              [](const EitherModel& model, const FloatArray& rest, const Embedding& embedding, const MatrixXd& weights,
                 const FloatArray& normals, const VectorXd& thickness, const std::optional<FloatArray>& residual_shapes,
                 const std::optional<std::shared_ptr<LocalResponses>>& local, const std::optional<IndexArray>& corners,
                 const std::optional<CornerWeights>& corner_weights, const std::optional<MatrixXd>& found) {
                ContactSkin samples{skin_of(rest, embedding, weights, residual_shapes), {}, {}, thickness};
                samples.points = surface_points(corners, corner_weights, samples.skin.rest.rows());
                samples.normals = as_points(flat_points("normals", normals, samples.points.size()));
                return without_gil([&] {
                  return make_either<ContactSamples>(model, [&](const auto& own) {
                    using Model = std::decay_t<decltype(*own)>;
                    return std::make_shared<ContactSamples<Model>>(own, std::move(samples), local.value_or(nullptr),
                                                                   found);
                  });
                });
              }),
          "model"_a.none(false), "rest"_a, "embedding"_a, "weights"_a, "normals"_a, "thickness"_a,
          "residual_shapes"_a = py::none(), "local"_a = py::none(), "corners"_a = py::none(),
          "corner_weights"_a = py::none(), "found"_a = py::none(),
          "rest (V, 3): the skin's vertices, meters, bind space. embedding: of these in the body's mesh. weights "
          "(V, B): skin weights at any positive scale; those below 1 % do not count. corners (P, 3), corner_weights "
          "(P, 3): the points are means of these vertices, with weights that sum to one; by default they are the "
          "vertices. normals (P, 3): out of the body, bind space. "
          "thickness (P): of the tissue below, meters; a collider that the bones take in by more pushes less, and by "
          "1.2 times that not at all. residual_shapes (J, V, 3): what the mesh cannot carry of each target's shape, "
          "or None. local: how a reduced model's skin gives way; None for an unreduced one. found: that of the same "
          "points before, so that it is not found again.")
      .def_property_readonly(
          "stiffness",
          [](const Either<ContactSamples>& samples) {
            return samples.visit([](const auto& own) { return VectorXd(own.stiffness()); });
          },
          "The model's own stiffness at each point (P) along its normal, N/m, at the neutral "
          "targets; 0 where pins hold it.")
      .def_property_readonly(
          "found",
          [](const Either<ContactSamples>& samples) {
            return samples.visit([](const auto& own) { return own.found(); });
          },
          "What takes long to find of each point (P, 3): its `stiffness`, the mass that it moves (kg), and the part of "
          "a push that a reduced model's coordinates take.");
}

void bind_self_contact(py::module_& m) {
  py::class_<Either<SelfContact>>(m, "SelfContact",
                                  "Where the skin of a model touches the same skin. Simulations may share it.")
      .def(py::init([](const Either<ContactSamples>& contact, const FloatArray& centers, const VectorXd& radii,
                       const Embedding& embedding, const MatrixXd& weights, std::vector<int> points,
                       std::vector<int> of_balls, std::vector<int> of_points, std::vector<std::array<int, 2>> joints) {
             BodyParts body{skin_of(centers, embedding, weights, std::nullopt),
                            radii,
                            std::move(points),
                            std::move(of_balls),
                            std::move(of_points),
                            std::move(joints)};
             return without_gil([&] {
               return contact.visit_shared([&](const auto& samples) {
                 using Model = std::decay_t<decltype(samples->model())>;
                 return Either<SelfContact>(std::make_shared<SelfContact<Model>>(samples, std::move(body)));
               });
             });
           }),
           "contact"_a, "centers"_a, "radii"_a, "embedding"_a, "weights"_a, "points"_a, "of_balls"_a, "of_points"_a,
           "joints"_a = std::vector<std::array<int, 2>>(),
           "contact: the points of the skin. centers (K, 3), radii (K): of balls that fill the body, meters, bind "
           "space, as `Thickness.covering` finds them. embedding: of the centers in the body's mesh. weights (K, B): "
           "skin weights of the centers. points (P): numbers of those points that touch the balls, ascending; a few "
           "thousand, spread evenly. of_balls (K), of_points (P): which parts of the body they belong to, as the bones "
           "that move them most; within a part nothing touches. joints: pairs of parts that share skin. What a point "
           "touches at rest, or nearly, it does not touch. Raises ValueError for arrays that do not fit each other.");
}

}  // namespace

void bind_contact(py::module_& m) {
  bind_collider(m);
  bind_local_responses(m);
  bind_samples(m);
  bind_self_contact(m);
}
