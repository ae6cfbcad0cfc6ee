// SPDX-License-Identifier: GPL-3.0-or-later
// dynamorph._core: the engine's NumPy interface. It is thin: it checks shapes and leaves everything else to the engine.
#include "bindings.hpp"

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/simd/dispatch.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "Dynamorph engine: soft skins from dynamic morph targets.";
  py::register_exception<dynamorph::Error>(m, "Error", PyExc_RuntimeError).doc() =
      "A body that cannot be simulated. The message says what to do.";
  py::register_exception<dynamorph::Cancelled>(m, "Cancelled", PyExc_RuntimeError).doc() =
      "A long call ended because its progress function returned False.";
  m.def("set_threads", &dynamorph::set_threads, py::arg("limit"),
        "Uses at most this many cores from now on; 0 means all that the process may use. Results do not depend on it.");
  dynamorph::instruction_set();  // a bad DYNAMORPH_ISA must fail at import, not at the first call
  m.def(
      "instruction_set", [] { return dynamorph::name_of(dynamorph::instruction_set()); },
      "The instruction set that the engine's loops use: 'baseline', 'avx2' or 'avx512'. It is the best that the "
      "processor has, or the one that the environment variable DYNAMORPH_ISA named at import. Results are "
      "byte-identical on all machines that use the same one.");
  bind_mesh(m);
  bind_pose(m);
  bind_models(m);
  bind_reduced(m);
  bind_skin(m);
  bind_contact(m);
  bind_step(m);
  bind_file(m);
}
