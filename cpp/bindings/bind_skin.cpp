// SPDX-License-Identifier: GPL-3.0-or-later
#include "either.hpp"
#include "model_interface.hpp"

using namespace dynamorph;

namespace {

template <class Model>
Transforms posed(const SkinMap<Model>& map, const FloatArray& bones) {
  check_shape("bones", bones, {py::ssize_t(map.model().body().skin.cols()), 3, 4});
  const Transforms out = transforms("bones", bones);
  check_finite("bones", out);
  return out;
}

template <class Model>
void check_weights(const SkinMap<Model>& map, const VectorXd& weights) {
  check_size("weights", weights.size(), Eigen::Index(map.model().targets().size()));
  check_finite("weights", weights);
}

}  // namespace

void bind_skin(py::module_& m) {
  py::class_<Either<SkinMap>>(
      m, "Skin", "P points that move with a model: x = A (X + E u(q) + R w) + a. Simulations may share it.")
      .def(py::init([](const EitherModel& model, const FloatArray& rest, const Embedding& embedding,
                       const MatrixXd& weights, const std::optional<FloatArray>& residual_shapes) {
             return make_either<SkinMap>(model, [&](const auto& own) {
               return std::make_shared<SkinMap<typename std::decay_t<decltype(*own)>>>(
                   own, skin_of(rest, embedding, weights, residual_shapes));
             });
           }),
           "model"_a.none(false), "rest"_a, "embedding"_a, "weights"_a, "residual_shapes"_a = py::none(),
           "rest (P, 3): meters, bind space. embedding: of the P points in the body's mesh. weights (P, B): skin "
           "weights at any positive scale; those below 1 % do not count. residual_shapes (J, P, 3): what the mesh "
           "cannot carry of each target's shape, or None.")
      .def(
          "displacement",
          [](const Either<SkinMap>& skin, const VectorXd& weights, const VectorXd& q) {
            return skin.visit([&](const auto& map) {
              check_weights(map, weights);
              check_coordinates(map.model(), q);
              VectorXd out;
              map.displacement(weights, q, out);
              check_result(out.allFinite());
              return Points(as_points(out));
            });
          },
          "weights"_a, "q"_a, "E u(q) + R w (P, 3), meters, bind space, at target weights (J) and coordinates q.")
      .def(
          "positions",
          [](const Either<SkinMap>& skin, const FloatArray& bones, const VectorXd& weights, const VectorXd& q) {
            return skin.visit([&](const auto& map) {
              const Transforms pose = posed(map, bones);
              check_weights(map, weights);
              check_coordinates(map.model(), q);
              VectorXd out;
              map.positions(pose, weights, q, out);
              check_result(out.allFinite());
              return Points(as_points(out));
            });
          },
          "bones"_a, "weights"_a, "q"_a, "x (P, 3), meters, world space, at the bones' transforms (B, 3, 4).")
      .def(
          "pull_back",
          [](const Either<SkinMap>& skin, const FloatArray& bones, const FloatArray& forces) {
            return skin.visit([&](const auto& map) {
              const Transforms pose = posed(map, bones);
              const VectorXd flat = flat_points("forces", forces, map.size());
              check_finite("forces", flat);
              VectorXd out;
              map.pull_back(pose, flat, out);
              check_result(out.allFinite());
              return out;
            });
          },
          "bones"_a, "forces"_a,
          "Forces on the coordinates (dofs) that do the work of forces on the points (P, 3), newtons, world space.");
}
