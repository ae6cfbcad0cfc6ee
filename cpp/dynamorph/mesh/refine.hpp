// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <limits>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

/// Halves triangles at their longest edge until no edge is longer than `longest`. The triangles at an edge share its
/// midpoint; midpoints come after the other points. Returns false, with the triangles as they were, if that would take
/// more than `limit` of them.
bool refine(std::vector<Vector3d>& points, std::vector<Triangle>& triangles, double longest,
            std::size_t limit = std::numeric_limits<std::size_t>::max());

}  // namespace dynamorph
