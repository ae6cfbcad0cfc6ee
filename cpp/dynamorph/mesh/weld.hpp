// SPDX-License-Identifier: GPL-3.0-or-later
// Vertices of a triangle soup that are at the same place.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Where the triangles' vertices lie: x = origin + size * unit, in meters.
struct UnitBox {
  Vector3d origin;
  double size;  ///< the diagonal
};

/// Throws Error when the soup is empty, flat, not finite, or outside 1e-6 .. 1e6 m across, and std::invalid_argument
/// when a triangle names a vertex that does not exist.
UnitBox unit_box(const Points& vertices, const Triangles& triangles);

/// For tables of indices or cells.
struct HashNumbers {
  template <class Number, std::size_t kCount>
  std::size_t operator()(const std::array<Number, kCount>& numbers) const {
    std::uint64_t hash = 0;
    for (const Number number : numbers) hash = hash * 0x9e3779b97f4a7c15u + std::uint64_t(number);
    return std::size_t(hash);
  }
};

struct Welded {
  std::vector<Vector3d> points;  ///< in the unit box, in the order in which the triangles name them
  std::vector<int> of_vertex;    ///< the point of each vertex; -1 without a triangle
};

/// Makes one point of the vertices within 1e-6 of the box's size of the first of them.
Welded weld(const Points& vertices, const Triangles& triangles, const UnitBox& box);

}  // namespace dynamorph
