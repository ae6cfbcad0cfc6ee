// SPDX-License-Identifier: GPL-3.0-or-later
// dynamorph._mesher: TetGen, which is under the AGPL and crashes or hangs on some input. Only the process of the mesher
// imports it (dynamorph/meshing.py).
#include "arrays.hpp"
#include "bindings.hpp"
#include "dynamorph/core/errors.hpp"
#include "dynamorph/mesh/tetrahedralize.hpp"

using namespace dynamorph;

namespace {

/// Error becomes that of `_core`.
void translate(std::exception_ptr thrown) {
  try {
    std::rethrow_exception(thrown);
  } catch (const Error& error) {
    py::set_error(py::module_::import("dynamorph._core").attr("Error"), error.what());
  }
}

}  // namespace

PYBIND11_MODULE(_mesher, m) {
  m.doc() = "Dynamorph's mesher, which only its own process imports.";
  // Here, not in `_core`, whose C++ library may be another copy, to which exceptions of this one are unknown.
  py::register_local_exception_translator(&py::detail::translate_exception);
  py::register_local_exception_translator(&translate);
  m.def(
      "tetrahedralize",
      [](const FloatArray& vertices, const IndexArray& faces, int target_nodes, const FloatArray& inner) {
        const auto v = to_matrix<Points>(vertices, "vertices"), more = to_matrix<Points>(inner, "inner");
        const auto f = to_indices<Triangles>(faces, "triangles");
        TetMesh mesh = without_gil([&] { return tetrahedralize(v, f, target_nodes, more); });
        return std::make_pair(std::move(mesh.nodes), std::move(mesh.tets));
      },
      "vertices"_a, "triangles"_a, "target_nodes"_a, "inner"_a = Points(0, 3),
      R"(Fills a closed surface that does not intersect itself with about `target_nodes` nodes.

vertices (V, 3): meters; they become the first nodes. triangles (T, 3): vertex indices. inner (k, 3): points inside that
become nodes too. Returns the nodes (n, 3) and the tets (m, 4) of a TetMesh. Raises Error when the surface cannot be
filled. On some input this crashes or hangs; `mesh_body` runs it in a child process.)");
}
