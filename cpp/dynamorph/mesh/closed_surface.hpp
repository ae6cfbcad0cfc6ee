// SPDX-License-Identifier: GPL-3.0-or-later
// Turns any triangle soup into a closed surface with outward faces, and reports its defects.
//
// Faces are oriented alike across every edge of exactly two faces. Each patch connected in this way is then turned
// outward as a whole. The open edges form a flow: the flow along a -> b is the number of faces that run that way minus
// the number that run the other way. A boundary has no boundary itself, so as much flows into every vertex as out of
// it. The flow therefore always splits into closed loops, even at T-junctions and at edges of many faces. Every loop is
// capped with triangles that run against the faces.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Counts of what was wrong with a triangle soup.
struct Defects {
  int boundary_loops = 0;     ///< capped
  int open_edges = 0;         ///< with one face
  int nonmanifold_edges = 0;  ///< with three faces or more
  int flipped_faces = 0;      ///< turned over
  int duplicate_faces = 0;    ///< dropped: same corners, in either direction
  int degenerate_faces = 0;   ///< without area; dropped if two corners coincide
  int stray_vertices = 0;     ///< without a face
  int components = 0;         ///< pieces that share no vertex
};

struct ClosedSurface {
  Points vertices;      ///< those of the faces, welded; meters
  Triangles triangles;  ///< outward; the first `authored` are from the soup, the rest are caps
  int authored = 0;
  Defects defects;
  std::vector<bool> flipped;  ///< which triangles of the soup face inward
};

/// Welds vertices nearer than 1e-6 of the diagonal. Throws Error when the soup is empty, flat, not finite, or outside
/// 1e-6 .. 1e6 m across; accepts anything else.
ClosedSurface close_surface(const Points& vertices, const Triangles& triangles);

}  // namespace dynamorph
