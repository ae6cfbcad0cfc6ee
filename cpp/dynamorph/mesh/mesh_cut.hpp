// SPDX-License-Identifier: GPL-3.0-or-later
// Parts of a body that touch at rest (arms at the sides, thighs, fingers) share the tetrahedra of a cage that is
// coarser than the gap between them. Here such a cage is cut apart.
//
// Each tet t belongs to a point s(t) of the skin, near its nearest point. Two tets that share a face are *glued* when
// the path through the flesh from s(t1) to s(t2) is longer than 3 |s(t1) - s(t2)|, and than 4 times their longest edge.
// Without any path, between loose parts, they are not.
#pragma once

#include <vector>

#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/mesh/interior_graph.hpp"
#include "dynamorph/mesh/shortest_paths.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

class MeshCut {
 public:
  /// vertices (V), triangles: the skin in the mesh, as for InteriorGraph. Throws std::invalid_argument without tets.
  MeshCut(const TetMesh& mesh, const Points& vertices, const Triangles& triangles);

  /// Which tets (m) join skin that is far apart.
  std::vector<bool> glued() const;

  /// The mesh with a crack between glued tets: the same tets, the nodes along the crack doubled, the doubles at the
  /// end. A crack ends by itself where the parts meet.
  TetMesh cut() const;

  /// Embeds the V vertices in the mesh as cut, each in the nearest tet that belongs to skin near it.
  Embedding embed(const TetMesh& cut) const;

 private:
  struct Pair {
    int first, second;  // tets
  };

  void find_glued();
  bool adopt_loose();
  bool far_apart(ShortestPaths& paths, int a, int b, double size) const;
  std::vector<int> take_connected(std::vector<int>& tets) const;

  TetMesh mesh_;
  Points vertices_;
  std::vector<double> sizes_;  // longest edge of each tet
  InteriorGraph graph_;
  std::vector<int> owner_;                // s(t); -1 when there is no skin
  std::vector<Pair> pairs_;               // tets that share a face
  std::vector<Pair> glued_;               // those of them that share no flesh
  std::vector<std::vector<int>> beside_;  // the others that share a face with each tet
};

}  // namespace dynamorph
