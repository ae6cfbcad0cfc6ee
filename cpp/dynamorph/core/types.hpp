// SPDX-License-Identifier: GPL-3.0-or-later
// Shared vocabulary: array types, errors, progress.
#pragma once

#include <Eigen/Dense>
#include <Eigen/Sparse>
#include <cstdint>
#include <functional>
#include <stdexcept>
#include <string>

namespace dynamorph {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

/// One point a row, xyz, metres. Row-major, so that `flat(points)` is the displacement vector x0 y0 z0 x1 ...
using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Triangles = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Tets = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
using SparseMatrix = Eigen::SparseMatrix<double>;

inline Eigen::Map<const VectorXd> flat(const Points& points) { return {points.data(), points.size()}; }
inline Eigen::Map<const Points> as_points(const VectorXd& x) { return {x.data(), x.size() / 3, 3}; }

/// Bad data (mesh, tetrahedra, eigensolver): the message says what the artist can do about it.
/// A caller's mistake (shape, range) is std::invalid_argument instead.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Thrown out of a long call whose Progress returned false.
struct Cancelled : std::runtime_error {
  Cancelled() : std::runtime_error("cancelled") {}
};

/// Called with the fraction done, 0..1; false asks the call to stop.
using ProgressFn = std::function<bool(double)>;

inline void report(const ProgressFn& progress, double fraction) {
  if (progress && !progress(fraction)) throw Cancelled();
}

}  // namespace dynamorph
