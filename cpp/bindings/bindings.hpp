// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>

#include "dynamorph/core/progress.hpp"

namespace py = pybind11;

void bind_mesh(py::module_& m);
void bind_pose(py::module_& m);
void bind_models(py::module_& m);
void bind_reduced(py::module_& m);
void bind_skin(py::module_& m);
void bind_contact(py::module_& m);
void bind_step(py::module_& m);
void bind_file(py::module_& m);

namespace dynamorph {

using namespace py::literals;

/// What the Python callable `name` answered, as a bool. Throws TypeError when it has no truth value, and for None: a
/// callable that forgets its answer would cancel.
inline bool answer(const char* name, const py::object& answered) {
  try {
    if (!answered.is_none()) return answered.cast<bool>();
  } catch (const py::cast_error&) {
  }
  throw py::type_error(std::string(name) + ": expected it to return a bool, got " +
                       py::repr(py::type::of(answered)).cast<std::string>());
}

/// A Python callable that can be copied and dropped without the GIL, as a std::function is.
using SharedCallable = std::shared_ptr<const py::object>;

inline SharedCallable shared(const py::object& callable) {
  return {new py::object(callable), [](const py::object* last) {
            py::gil_scoped_acquire gil;
            delete last;
          }};
}

/// Wraps a Python callable `progress(fraction) -> bool` (or None) in a ProgressFn that acquires the GIL for each call.
/// A Python exception raised inside it (KeyboardInterrupt, say) passes through to the caller.
inline ProgressFn with_gil(const py::object& progress) {
  if (progress.is_none()) return {};
  return [callable = shared(progress)](double fraction) {
    py::gil_scoped_acquire gil;
    return answer("progress", (*callable)(fraction));
  };
}

/// Calls function() without the GIL, so that other Python threads can run.
template <class Function>
auto without_gil(Function function) {
  py::gil_scoped_release released;
  return function();
}

}  // namespace dynamorph
