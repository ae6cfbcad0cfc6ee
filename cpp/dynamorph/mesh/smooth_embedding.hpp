// SPDX-License-Identifier: GPL-3.0-or-later
// Points carried by a tet mesh more smoothly than by its tets alone, whose faces show where they are bent:
//
//   x = sum_k w_k (x_k + 1/2 F_k (X - X_k))
//
// over the nodes k of the tet around X, with F_k the mean deformation gradient of the tets around node k. It is exact
// for deformations that are quadratic where F_k is (James, Phong Deformation: A Better C0 Interpolant for Embedded
// Deformation, ACM TOG 39(4), 2020).
#pragma once

#include "dynamorph/mesh/embedding.hpp"

namespace dynamorph {

/// S (V, n): x = S times the nodes' places. Its rows sum to one, and S times the nodes at rest is where the embedding
/// has the points at rest.
Eigen::SparseMatrix<double, Eigen::RowMajor> smooth_embedding(const TetMesh& mesh, const Embedding& embedding);

}  // namespace dynamorph
