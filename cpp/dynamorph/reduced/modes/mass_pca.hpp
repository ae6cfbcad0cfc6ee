// SPDX-License-Identifier: GPL-3.0-or-later
// Principal directions of many displacements, in the mass. All columns are y = M^1/2 u.
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Orthonormal basis of the columns' span, with a relative rank tolerance of 1e-9.
MatrixXd orthonormal(const MatrixXd& columns);

/// The `count` strongest orthogonal combinations of the columns, strongest first; fewer where the
/// columns have fewer than that beyond a relative 1e-7.
MatrixXd strongest(const RowMajor& columns, Eigen::Index count);

/// Columns up to which `strongest` is fast. A rig of hundreds of bones has more loads, each with few entries.
constexpr Eigen::Index kManyColumns = 1200;

/// The strongest combinations (columns, at most `count`) of sparse columns, strongest first: orthonormal eigenvectors
/// of A^T A. It is meant for many more columns than `count`. The last combinations are the least exact, unless the ones
/// that were left out are much weaker; what is weaker than 1e-5 of the strongest may be missing.
MatrixXd strongest_combinations(const SparseMatrix& A, Eigen::Index count);

}  // namespace dynamorph
