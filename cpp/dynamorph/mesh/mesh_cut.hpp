// SPDX-License-Identifier: GPL-3.0-or-later
// Parts of a body that touch at rest (arms at the sides, thighs, fingers) share the tetrahedra of a cage that is
// coarser than the gap between them. MeshCut cuts such a cage apart.
//
// Each tet t belongs to a point s(t) of the skin close to it. Two tets that share a face are *glued* when the path
// through the body from s(t1) to s(t2) is longer than 3 |s(t1) - s(t2)| and longer than 4 times their longest edge.
// Tets of loose parts, which no path joins, are not glued.
#pragma once

#include <vector>

#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/mesh/interior_graph.hpp"
#include "dynamorph/mesh/shortest_paths.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

class MeshCut {
 public:
  /// vertices (V), triangles: the skin in the mesh, as for InteriorGraph. Throws std::invalid_argument if the mesh has
  /// no tets.
  MeshCut(const TetMesh& mesh, const Points& vertices, const Triangles& triangles);

  /// Whether each tet (m) joins skin that is far apart.
  std::vector<bool> glued() const;

  /// The mesh with a crack between glued tets. The tets stay the same; nodes along the crack are duplicated, and the
  /// duplicates come last. A crack ends by itself where the parts meet.
  TetMesh cut() const;

  /// Embeds the V vertices in the cut mesh, each in the nearest tet that belongs to skin near it.
  Embedding embed(const TetMesh& cut) const;

 private:
  using Pair = std::pair<int, int>;  ///< two tets

  void find_glued();
  bool adopt_loose();
  bool far_apart(ShortestPaths& paths, int a, int b, double size) const;
  std::vector<int> take_connected(std::vector<int>& tets) const;

  TetMesh mesh_;
  Points vertices_;
  std::vector<double> sizes_;  ///< longest edge of each tet
  InteriorGraph graph_;
  std::vector<int> owner_;                ///< s(t); -1 when there is no skin
  std::vector<Pair> pairs_;               ///< tets that share a face
  std::vector<Pair> glued_;               ///< those of them that no short path joins
  std::vector<std::vector<int>> beside_;  ///< the tets that share a face with each tet and are not glued to it
};

}  // namespace dynamorph
