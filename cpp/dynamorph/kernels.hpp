// SPDX-License-Identifier: GPL-3.0-or-later
// The few loops a reduced step spends its time in. Compiled for several instruction sets and chosen when loaded, so
// that a wheel built for any x86-64 uses AVX2 where the machine has it. Matrices are column-major unless said.
#pragma once

#include "dynamorph/types.hpp"

namespace dynamorph {

/// y += A x, A (rows, columns).
void add_product(const double* A, Eigen::Index rows, const double* x, Eigen::Index columns, double* y);

/// y += A x with A in single precision, summed in double.
void add_product(const float* A, Eigen::Index rows, const double* x, Eigen::Index columns, double* y);

/// y += A x, A symmetric (size, size), its lower triangle packed column after column.
void add_symmetric_product(const double* A, Eigen::Index size, const double* x, double* y);

/// y = A^T x.
void transposed_product(const MatrixXd& A, const double* x, double* y);

}  // namespace dynamorph
