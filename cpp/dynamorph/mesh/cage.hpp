// SPDX-License-Identifier: GPL-3.0-or-later
// Wraps a closed surface around any triangle soup, coarse enough to simulate: that of the cage of tetrahedra.
//
// CGAL's alpha wrap (Portaneri et al. 2022, Alpha wrapping with an offset, doi 10.1145/3528223.3530152) shrinks a
// surface around the soup with balls of radius alpha, at distance offset = 0.2 alpha or more. The result is closed and
// manifold, has no self-intersections and encloses every input triangle. The balls would enter through holes, so the
// soup is closed first. The number of vertices is roughly proportional to alpha^-2, so alpha is found by the secant
// method on log(count) against log(alpha).
#pragma once

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"

namespace dynamorph {

struct CageSurface {
  Points vertices;
  Triangles triangles;  ///< outward
};

/// Makes a surface of about `target_vertices` vertices (within 7 % where the shape allows) around the soup. Open,
/// self-intersecting or multi-part input is fine; parts closer than about alpha come out glued. Throws Error when the
/// input is empty, flat, not finite, or outside 1e-6 .. 1e6 m, and std::invalid_argument for more than a million
/// vertices.
CageSurface make_cage_surface(const Points& vertices, const Triangles& triangles, int target_vertices,
                              const ProgressFn& progress = {});

}  // namespace dynamorph
