// SPDX-License-Identifier: GPL-3.0-or-later
// Shared types for numbers and arrays.
#pragma once

#include <Eigen/Dense>
#include <Eigen/Sparse>
#include <algorithm>
#include <cstdint>
#include <limits>

namespace dynamorph {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

/// One point per row, xyz, meters. Row-major, so that `flat(points)` is the displacement vector x0 y0 z0 x1 ...
using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Triangles = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Tets = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
/// As in NumPy, a row's entries are contiguous.
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using SparseMatrix = Eigen::SparseMatrix<double>;

constexpr double kPi = 3.14159265358979323846;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// 0 for t <= 0, 1 for t >= 1, with continuous slope in between.
inline double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

inline Eigen::Map<const VectorXd> flat(const Points& points) { return {points.data(), points.size()}; }
inline Eigen::Map<const Points> as_points(const VectorXd& x) { return {x.data(), x.size() / 3, 3}; }
/// Values at nodes (n) as values at coordinates (3n): each three times.
inline VectorXd at_coordinates(const VectorXd& nodes) { return nodes.replicate(1, 3).transpose().reshaped(); }

/// All stored values of a dense or sparse matrix. Matrices of one model share their pattern, so their values
/// correspond.
inline Eigen::Map<VectorXd> values(MatrixXd& m) { return {m.data(), m.size()}; }
inline Eigen::Map<const VectorXd> values(const MatrixXd& m) { return {m.data(), m.size()}; }
inline Eigen::Map<VectorXd> values(SparseMatrix& m) { return {m.valuePtr(), m.nonZeros()}; }
inline Eigen::Map<const VectorXd> values(const SparseMatrix& m) { return {m.valuePtr(), m.nonZeros()}; }

}  // namespace dynamorph
