// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/weld.hpp"

#include <array>
#include <cmath>
#include <sstream>
#include <unordered_map>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

namespace {

constexpr double kWeldDistance = 1e-6;  // relative to the diagonal

void check_finite(const Points& vertices) {
  std::ostringstream list;
  int bad = 0;
  for (Eigen::Index i = 0; i < vertices.rows(); ++i)
    if (!vertices.row(i).allFinite() && ++bad <= 5) list << (bad > 1 ? ", " : "") << i;
  if (bad == 0) return;
  std::ostringstream message;
  message << bad << " of " << vertices.rows() << " vertices have a NaN or infinite coordinate (first: " << list.str()
          << "). Delete them, or repair what moves them.";
  throw Error(message.str());
}

/// Numbers points in the order they come. A point within the weld distance of an earlier one gets the same number.
class Welder {
 public:
  int number(const Vector3d& p) {
    Cell last = cell(p, 0);
    for (int corner = 0; corner < 8; ++corner) {
      const Cell next = cell(p, corner);
      if (corner > 0 && next == last) continue;
      const auto found = cells_.find(last = next);
      if (found == cells_.end()) continue;
      for (int i : found->second)
        if ((points[i] - p).squaredNorm() <= kWeldDistance * kWeldDistance) return i;
    }
    cells_[cell(p, -1)].push_back(int(points.size()));
    points.push_back(p);
    return int(points.size()) - 1;
  }

  std::vector<Vector3d> points;

 private:
  using Cell = std::array<std::int64_t, 3>;

  /// The cell of p, or (corner >= 0) of a corner of the box around p, which may hold its neighbors.
  static Cell cell(const Vector3d& p, int corner) {
    Cell c;
    for (int k = 0; k < 3; ++k) {
      const double shift = corner < 0 ? 0 : (corner >> k & 1 ? kWeldDistance : -kWeldDistance);
      c[k] = std::int64_t(std::floor((p[k] + shift) / (4 * kWeldDistance)));
    }
    return c;
  }

  std::unordered_map<Cell, std::vector<int>, HashNumbers> cells_;
};

}  // namespace

UnitBox unit_box(const Points& vertices, const Triangles& triangles) {
  check_triangles(vertices, triangles);
  check_finite(vertices);
  if (triangles.rows() == 0) throw Error("The mesh has no faces. Give it some.");
  Eigen::AlignedBox3d box;
  Vector3d mean = Vector3d::Zero();
  for (int i : triangles.reshaped()) {
    box.extend(Vector3d(vertices.row(i)));
    mean += vertices.row(i) / double(triangles.size());
  }
  const double size = box.diagonal().norm();
  if (!(size > 1e-6 && size < 1e6)) {
    std::ostringstream message;
    message << "The mesh is " << size << " m across; sizes from 1e-6 to 1e6 m can be built. Scale it.";
    throw Error(message.str());
  }
  Matrix3d covariance = Matrix3d::Zero();
  for (int i : triangles.reshaped()) {
    const Vector3d d = (vertices.row(i).transpose() - mean) / size;
    covariance += d * d.transpose() / double(triangles.size());
  }
  const double thickness = Eigen::SelfAdjointEigenSolver<Matrix3d>(covariance).eigenvalues()[0];
  if (thickness < 1e-12)  // squared and relative
    throw Error("The mesh is flat: it has no volume to simulate. Give it thickness.");
  return {box.min(), size};
}

Welded weld(const Points& vertices, const Triangles& triangles, const UnitBox& box) {
  Welder welder;
  std::vector<int> of_vertex(vertices.rows(), -1);
  for (int i : triangles.reshaped<Eigen::RowMajor>())
    if (of_vertex[i] < 0) of_vertex[i] = welder.number((vertices.row(i).transpose() - box.origin) / box.size);
  return {std::move(welder.points), std::move(of_vertex)};
}

}  // namespace dynamorph
