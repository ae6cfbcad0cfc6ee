// SPDX-License-Identifier: GPL-3.0-or-later
// Energy, force and tangent stiffness of a whole tet mesh. One pass handles the elements of several targets.
//
// The laws of elasticity.hpp are computed for four tetrahedra at a time, in the lanes of vector registers
// (assembly_kernels.cpp has the formulas). The targets' contributions to a tetrahedron are summed before they are
// stored. Tetrahedra are processed in chunks that are compact in space. Each chunk sums into its own store, and the
// stores are then added block by block. Chunks do not depend on the number of threads, so neither does the result.
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
    std::vector<OriginGroup> origins;  ///< empty if displacements are relative to the target's shape, where F = I
  };
  /// The contribution of a target at some target weights.
  struct Part {
    double weight;
    Lame lame;
    const Elements* elements;
  };

  Assembly(const TetMesh& mesh, const std::vector<int>& free_of_node);

  /// absolute: displacements will be relative to the neutral shape instead of the target's shape.
  Elements pack(const RestShape& shape, bool absolute) const;

  /// A zero matrix (3 free, 3 free) of 3x3 blocks, both triangles stored.
  const SparseMatrix& pattern() const { return pattern_; }

  /// Energy of StVK or stable StVK at displacements x (3 free).
  double energy(MaterialModel material_model, const std::vector<Part>& parts, const VectorXd& x) const;

  /// Computes the force dE/dx and its derivative as well. `stiffness` must have the pattern.
  double linearize(MaterialModel material_model, const std::vector<Part>& parts, const VectorXd& x, VectorXd& force,
                   SparseMatrix& stiffness) const;

 private:
  struct Chunk {
    int first, last;  ///< groups
    int store;        ///< where its store begins
  };
  /// A block (i, j) with i <= j, and the addends that it is the sum of.
  struct Block {
    int row, column;          ///< free nodes
    int first, last;          ///< range in `addends_`
    int upper, upper_stride;  ///< place of its first value in the matrix, and step between columns
    int lower, lower_stride;  ///< the same for the transposed block
  };
  /// Returns the energy. Computes forces and stiffness only if there are stores.
  double sum_chunks(MaterialModel material_model, const std::vector<Part>& parts, const VectorXd& x,
                    double* stores) const;
  void group_tets(const TetMesh& mesh, const std::vector<int>& free_of_node);
  void place_blocks();
  void build_pattern();

  int free_ = 0;
  std::vector<TetGroup> groups_;
  std::vector<Chunk> chunks_;
  std::vector<Block> blocks_;  ///< sorted by column
  std::vector<int> addends_;   ///< places in the stores
  int stores_size_ = 0;
  SparseMatrix pattern_;
};

}  // namespace dynamorph
