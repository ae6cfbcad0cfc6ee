// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/reduced/responses/response_tables.hpp"
#include "model_interface.hpp"

using namespace dynamorph;

void bind_reduced(py::module_& m) {
  py::class_<Basis>(m, "Basis", "The subspace of a soft skin: a few modes.")
      .def_readonly("U", &Basis::U, "The modes (3 free, r), orthonormal in the mass for unit density.")
      .def_readonly("explained_variance", &Basis::explained_variance,
                    "Fraction of the candidates' variance that the basis spans.");
  m.def(
      "make_basis",
      [](const FullModel& model, int r, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return make_basis(model, r, report);
      },
      "model"_a, "r"_a, "progress"_a = py::none(),
      "Makes r modes. They span the targets' shapes exactly, then linear modes, modal derivatives and static responses "
      "by mass-PCA. progress(fraction) -> bool: returning False raises Cancelled. Raises Error when the body can move "
      "without resistance.");

  py::class_<ResponseBasis>(m, "ResponseBasis", "The subspace of a whole body: few modes and many responses.")
      .def_readonly("U", &ResponseBasis::U, "The modes (3 free, r), orthonormal in the mass for unit density.")
      .def_readonly("W", &ResponseBasis::W, "The responses (3 free, h), in which the energy stays quadratic.")
      .def_readonly("amplitudes", &ResponseBasis::amplitudes, "How much each mode moves (r), relative to the others.");
  m.def(
      "make_response_basis",
      [](const FullModel& model, int r, int h, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return make_response_basis(model, r, h, report);
      },
      "model"_a, "r"_a, "h"_a, "progress"_a = py::none(),
      "Makes r modes and h responses from the static answers to what the bones can do. The modes span the targets' "
      "shapes exactly. progress(fraction) -> bool: returning False raises Cancelled. Raises Error when the body can "
      "move without resistance.");

  m.def("adapt_response_basis", &adapt_response_basis, "model"_a, "U"_a, "W"_a,
        py::call_guard<py::gil_scoped_release>(),
        "The same modes U (3 free, r), and responses of the span of W (3 free, h) that decouple with the model's "
        "stiffness, which may be another one than they were made for.");

  py::class_<ReducedTables>(m, "ReducedTables",
                            "The tables that a built reduced model stores. They hold geometry only, no material.")
      .def(
          py::init([](MaterialModel material_model, const MatrixXd& basis, const std::vector<VectorXd>& lambda,
                      const std::vector<VectorXd>& mu, const MatrixXd& responses,
                      const std::vector<VectorXd>& response_lambda, const std::vector<VectorXd>& response_mu,
                      const std::vector<MatrixXd>& relaxation) {
            return ReducedTables{material_model, basis,           lambda,      mu,
                                 responses,      response_lambda, response_mu, relaxation};
          }),
          "material_model"_a, "basis"_a, "lame_lambda"_a, "lame_mu"_a, "responses"_a = MatrixXd(),
          "response_lambda"_a = std::vector<VectorXd>(), "response_mu"_a = std::vector<VectorXd>(),
          "relaxation"_a = std::vector<MatrixXd>(),
          "Restores stored tables; `reduce` computes them. lame_lambda, lame_mu: for each target the coefficients of "
          "its tangent for lambda = 1 Pa and mu = 1 Pa: of the constant part K(k, l), of the linear one K(k, l, m) and "
          "of the quadratic one K(k, l, m, n), for k <= l <= m <= n with the last index fastest; for the linear law "
          "the first part only. docs/file_format.md has the layout of the others.")
      .def_readonly("material_model", &ReducedTables::material_model, "How stress follows from strain.")
      .def_readonly("basis", &ReducedTables::basis, "The modes (3 free, r).")
      .def_readonly("lame_lambda", &ReducedTables::lambda, "Per target, for lambda = 1 Pa.")
      .def_readonly("lame_mu", &ReducedTables::mu, "Per target, for mu = 1 Pa.")
      .def_readonly("responses", &ReducedTables::responses, "The responses (3 free, h), or (0, 0).")
      .def_readonly("response_lambda", &ReducedTables::response_lambda,
                    "Per target, stiffness and coupling of the responses for lambda = 1 Pa.")
      .def_readonly("response_mu", &ReducedTables::response_mu, "Per target, for mu = 1 Pa.")
      .def_readonly("relaxation", &ReducedTables::relaxation,
                    "Per target A (h, r): its tables are of the modes basis - responses A.");
  m.def(
      "reduce",
      [](const FullModel& model, const MatrixXd& U, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return reduce(model, U, report);
      },
      "model"_a, "U"_a, "progress"_a = py::none(),
      "Computes the energy polynomials of every target in the basis U (3 free, r).");
  m.def(
      "reduce",
      [](const FullModel& model, const Basis& basis, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return reduce(model, basis.U, report);
      },
      "model"_a, "basis"_a, "progress"_a = py::none(), "As above, in the basis that `make_basis` returned.");
  m.def(
      "reduce",
      [](const FullModel& model, const ResponseBasis& basis, const py::object& progress) {
        const ProgressFn report = with_gil(progress);
        py::gil_scoped_release release;
        return reduce(model, basis, report);
      },
      "model"_a, "basis"_a, "progress"_a = py::none(),
      "The same in a basis with responses, whose stiffness and coupling are computed too.");

  py::class_<ReducedModel, std::shared_ptr<ReducedModel>> reduced(m, "ReducedModel", "The soft skin in r modes.");
  reduced.def(py::init<std::shared_ptr<SoftBody>, std::vector<MorphTarget>, const ReducedTables&, Blending>(),
              "body"_a.none(false), "targets"_a, "tables"_a, "blending"_a,
              "targets: those that the tables were computed for; their materials may have changed. Raises ValueError "
              "when a table does not fit them, or when a shape displaces pinned nodes.");
  bind_model(reduced);
}
