// SPDX-License-Identifier: GPL-3.0-or-later
#include "bindings.hpp"

void bind_simulation(pybind11::module_&) {}
