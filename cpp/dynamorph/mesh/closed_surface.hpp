// SPDX-License-Identifier: GPL-3.0-or-later
// Any triangle soup -> a closed surface with its faces outward, and what was wrong with it.
//
// Faces are oriented alike across every edge of two faces; each patch that hangs together so turns outward as a whole.
// What is open then is a flow: an edge a -> b is open as often as more faces run along it that way than the other. As
// the boundary of faces has no boundary itself, as much flows into every vertex as out of it: it always falls into
// closed loops, also at T-junctions and edges of many faces. Every loop is capped with triangles the other way round.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// What was wrong with a triangle soup. All counts.
struct Defects {
  int boundary_loops = 0;     // capped
  int open_edges = 0;         // of one face
  int nonmanifold_edges = 0;  // of three faces or more
  int flipped_faces = 0;      // turned over
  int duplicate_faces = 0;    // dropped: the same corners, either way round
  int degenerate_faces = 0;   // without area; dropped where two corners are one
  int stray_vertices = 0;     // of no face
  int components = 0;         // pieces that share no vertex
};

struct ClosedSurface {
  Points vertices;      // those of the faces, welded; metres
  Triangles triangles;  // outward; the first `authored` of the soup, the rest caps
  int authored = 0;
  Defects defects;
  std::vector<bool> flipped;  // which triangles of the soup look inward
};

/// Welds vertices nearer than 1e-6 of the diagonal. Throws Error when the soup is empty, flat, not finite, or outside
/// 1e-6 .. 1e6 m across; takes anything else.
ClosedSurface close_surface(const Points& vertices, const Triangles& triangles);

/// Where the triangles' vertices lie: x = origin + size * unit. Throws Error as `close_surface`.
struct UnitBox {
  Vector3d origin;
  double size;
};
UnitBox unit_box(const Points& vertices, const Triangles& triangles);

}  // namespace dynamorph
