// SPDX-License-Identifier: GPL-3.0-or-later
// The Python interface that both kinds of model share.
#pragma once

#include <cmath>

#include "arrays.hpp"
#include "bindings.hpp"
#include "dynamorph/core/errors.hpp"
#include "dynamorph/models/skin.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"

namespace dynamorph {

template <class Model>
void check_coordinates(const Model& model, const VectorXd& q) {
  if (q.size() != model.dofs())
    throw std::invalid_argument("q: expected " + std::to_string(model.dofs()) + " coordinates, got " +
                                std::to_string(q.size()));
  check_finite("q", q);
}

/// Throws Error when what was computed of finite numbers is not finite.
inline void check_result(bool finite) {
  if (!finite) throw Error("The result is not finite: the numbers that it was asked for are too large.");
}
inline void check_result(const MatrixXd& m) { check_result(m.allFinite()); }
inline void check_result(const SparseMatrix& m) { check_result(values(m).allFinite()); }

template <class Model>
int checked_target(const Model& model, int target) {
  const int count = int(model.targets().size());
  if (target < 0 || target >= count)
    throw std::invalid_argument("target: expected 0 to " + std::to_string(count - 1) + ", got " +
                                std::to_string(target));
  return target;
}

/// A model's matrix as Python sees it: sparse, which takes SciPy, or dense.
inline const SparseMatrix& as_numpy(const SparseMatrix& m) {
  try {
    py::module_::import("scipy.sparse");
  } catch (const py::error_already_set& error) {
    if (!error.matches(PyExc_ImportError)) throw;
    throw py::import_error("The matrices of a FullModel are those of scipy.sparse: install SciPy (pip install scipy)");
  }
  return m;
}
inline MatrixXd as_numpy(const ArrowMatrix& m) { return m.dense(); }

/// Bind-space node displacement (n, 3) at coordinates q.
template <class Model>
Points node_displacement(const Model& model, const VectorXd& q) {
  check_coordinates(model, q);
  VectorXd u;
  model.displacement(q, u);
  check_result(u.allFinite());
  return as_points(model.body().expand(u));
}

template <class Model>
void bind_model(py::class_<Model, std::shared_ptr<Model>>& c) {
  c.def_property_readonly("dofs", &Model::dofs, "Number of coordinates.")
      .def_property_readonly(
          "body", [](const Model& m) { return std::const_pointer_cast<SoftBody>(m.shared_body()); },
          "The data that it shares with other models.")
      .def(
          "energy",
          [](const Model& m, const VectorXd& weights, const VectorXd& q) {
            check_coordinates(m, q);
            check_finite("weights", weights);
            typename Model::Blend blend;
            m.blend(weights, blend);
            const double energy = m.energy(blend, q);
            check_result(std::isfinite(energy));
            return energy;
          },
          "weights"_a, "q"_a, "Elastic energy, J, at target weights (J) and coordinates q.")
      .def(
          "linearize",
          [](const Model& m, const VectorXd& weights, const VectorXd& q) {
            check_coordinates(m, q);
            check_finite("weights", weights);
            typename Model::Blend blend;
            m.blend(weights, blend);
            VectorXd force;
            typename Model::Matrix stiffness = m.zero();
            const double energy = m.linearize(blend, q, force, stiffness);
            const auto& matrix = as_numpy(stiffness);
            check_result(std::isfinite(energy) && force.allFinite());
            check_result(matrix);
            return py::make_tuple(energy, force, matrix);
          },
          "weights"_a, "q"_a,
          "Returns (energy in J, force dE/dq, stiffness dF/dq) at target weights (J) and coordinates q. The stiffness "
          "of a FullModel is a scipy.sparse matrix, for which SciPy must be installed.")
      .def(
          "inertia",
          [](const Model& m, const FloatArray& bones, double density) {
            check_shape("bones", bones, {py::ssize_t(m.body().skin.cols()), 3, 4});
            const Transforms pose = transforms("bones", bones);
            check_finite("bones", pose);
            if (!(density > 0 && std::isfinite(density)))
              throw std::invalid_argument("density: expected a finite number above zero, got " +
                                          std::to_string(density));
            const VectorXd rest = VectorXd::Zero(m.dofs());
            InertialTarget still;
            still.q.fill(&rest);
            still.bones.fill(&pose);
            typename Model::Inertia out;
            m.inertia(still, {VectorXd::Constant(m.body().sets(), density), VectorXd::Zero(m.body().sets())}, out);
            const auto& matrix = as_numpy(out.mass);
            check_result(matrix);
            return matrix;
          },
          "bones"_a, "density"_a,
          "The mass matrix A^T M A in the model's coordinates, at the bones' transforms (B, 3, 4). That of a FullModel "
          "is a scipy.sparse matrix, for which SciPy must be installed.")
      .def(
          "target", [](const Model& m, int target) { return m.target(checked_target(m, target)); }, "target"_a,
          "Coordinates of a target's shape.")
      .def("displacement", &node_displacement<Model>, "q"_a, "Bind-space node displacement (n, 3), meters.");
}

/// (J, P, 3) -> (3P, J).
inline MatrixXd residual_columns(const FloatArray& shapes, Eigen::Index points) {
  check_shape("residual_shapes", shapes, {-1, points, 3});
  return Eigen::Map<const MatrixXd>(shapes.data(), 3 * points, shapes.shape(0));
}

inline Skin skin_of(const FloatArray& rest, const Embedding& embedding, const MatrixXd& weights,
                    const std::optional<FloatArray>& residual_shapes) {
  Skin skin{as_points(flat_points("rest", rest, -1)), embedding, normalized(weights), {}};
  check_finite("rest", skin.rest);
  if (residual_shapes) skin.residual_shapes = residual_columns(*residual_shapes, skin.rest.rows());
  check_finite("residual_shapes", skin.residual_shapes);
  return skin;
}

}  // namespace dynamorph
