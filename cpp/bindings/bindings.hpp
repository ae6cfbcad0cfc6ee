// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "dynamorph/types.hpp"

void bind_file(pybind11::module_& m);
void bind_meshing(pybind11::module_& m);
void bind_simulation(pybind11::module_& m);

/// A Python callable `progress(fraction) -> bool` (or None) as a ProgressFn that takes the GIL for each call.
/// A Python exception raised inside it (KeyboardInterrupt, say) passes through to the caller.
inline dynamorph::ProgressFn with_gil(const pybind11::object& progress) {
  if (progress.is_none()) return {};
  return [progress](double fraction) {
    pybind11::gil_scoped_acquire gil;
    return progress(fraction).cast<bool>();
  };
}
