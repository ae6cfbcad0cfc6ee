// SPDX-License-Identifier: GPL-3.0-or-later
// Energy, force and tangent stiffness of a whole tet mesh, the elements of several targets in one pass.
//
// Computes the laws of elasticity.hpp (assembly_kernels.cpp has the formulas), four tetrahedra at a time in the lanes
// of vector registers, and sums the targets' contributions to a tetrahedron before they go anywhere. Tetrahedra are
// worked through in chunks that are compact in space; each sums into a store of its own, and the stores are added up
// block by block. Chunks do not depend on the number of threads, so neither does the result.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/assembly_kernels.hpp"
#include "dynamorph/elastic/elasticity.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

class Assembly {
 public:
  /// One target's elements in the assembly's order.
  struct Elements {
    std::vector<ElementGroup> groups;
    std::vector<OriginGroup>
        origins;  ///< empty where displacements are given from the target's shape, about which F = I
  };
  /// What a target counts at some target weights.
  struct Part {
    double weight;
    Lame lame;
    const Elements* elements;
  };

  Assembly(const TetMesh& mesh, const std::vector<int>& free_of_node);

  /// absolute: displacements will be given from the neutral shape.
  Elements pack(const RestShape& shape, bool absolute) const;

  /// A zero matrix (3 free, 3 free) of 3x3 blocks, both triangles stored.
  const SparseMatrix& pattern() const { return pattern_; }

  /// Energy at displacements x (3 free), of StVK or stable StVK.
  double energy(Law law, const std::vector<Part>& parts, const VectorXd& x) const;

  /// The same, with the force dE/dx and its derivative; `stiffness` has the pattern.
  double linearize(Law law, const std::vector<Part>& parts, const VectorXd& x, VectorXd& force,
                   SparseMatrix& stiffness) const;

 private:
  struct Chunk {
    int first, last;  ///< groups
    int store;        ///< where its store begins
  };
  /// A block (i, j) with i <= j and what is summed to it.
  struct Block {
    int row, column;          ///< free nodes
    int first, last;          ///< of `addends_`
    int upper, upper_stride;  ///< its first value in the matrix, and from one column to the next
    int lower, lower_stride;  ///< that of the transposed block
  };
  /// The energy; without stores nothing else.
  double sum_chunks(Law law, const std::vector<Part>& parts, const VectorXd& x, double* stores) const;
  void group_tets(const TetMesh& mesh, const std::vector<int>& free_of_node);
  void place_blocks();
  void build_pattern();

  int free_ = 0;
  std::vector<TetGroup> groups_;
  std::vector<Chunk> chunks_;
  std::vector<Block> blocks_;  ///< by columns
  std::vector<int> addends_;   ///< where in the stores
  int stores_size_ = 0;
  SparseMatrix pattern_;
};

}  // namespace dynamorph
