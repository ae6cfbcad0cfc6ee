// SPDX-License-Identifier: GPL-3.0-or-later
// Principal directions of many displacements, in the mass. All columns are y = M^1/2 u.
#pragma once

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// The lower triangle of A^T A.
MatrixXd gram(const RowMajor& A);

/// Orthonormal basis of the columns' span, with a relative rank tolerance of 1e-9.
MatrixXd orthonormal(const MatrixXd& columns);

/// The `most` strongest orthogonal combinations of the columns, strongest first, as long as they are strong; fewer
/// where the columns have fewer beyond a relative 1e-7. Of very many columns they are approximate.
MatrixXd strongest(const RowMajor& columns, Eigen::Index most);

}  // namespace dynamorph
