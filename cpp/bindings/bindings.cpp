// SPDX-License-Identifier: GPL-3.0-or-later
// dynamorph._core: the engine as NumPy sees it. Thin: shapes are checked here, everything else is the engine's.
#include "bindings.hpp"

#include "dynamorph/types.hpp"

namespace py = pybind11;

PYBIND11_MODULE(_core, m) {
  m.doc() = "Dynamorph engine: soft skins from dynamic morph targets.";
  py::register_exception<dynamorph::Error>(m, "Error", PyExc_RuntimeError);
  py::register_exception<dynamorph::Cancelled>(m, "Cancelled", PyExc_RuntimeError);
  bind_meshing(m);
  bind_simulation(m);
}
