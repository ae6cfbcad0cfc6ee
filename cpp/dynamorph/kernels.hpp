// SPDX-License-Identifier: GPL-3.0-or-later
// The few loops a reduced step spends its time in. Compiled for several instruction sets and chosen when loaded, so
// that a wheel built for any x86-64 uses AVX2 where the machine has it.
#pragma once

#include "dynamorph/types.hpp"

namespace dynamorph {

/// y += A x. A column-major.
void add_product(const MatrixXd& A, Eigen::Index first_column, const double* x, Eigen::Index columns, double* y);

/// y += A x with A in single precision, summed in double.
void add_product(const Eigen::MatrixXf& A, Eigen::Index first_column, const double* x, Eigen::Index columns, double* y);

/// y = A^T x.
void transposed_product(const MatrixXd& A, const double* x, double* y);

/// y += s x.
void add_scaled(double s, const double* x, Eigen::Index size, double* y);

}  // namespace dynamorph
