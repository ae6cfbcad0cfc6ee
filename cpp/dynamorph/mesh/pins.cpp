// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/pins.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

namespace {

constexpr int kMostPieces = 1000000;  // per bone; the bones of a rig need hundreds

double distance_to_segment(const Vector3d& p, const Vector3d& a, const Vector3d& b) {
  const Vector3d ab = b - a;
  const double length2 = ab.squaredNorm();
  const double t = length2 > 0 ? std::clamp(ab.dot(p - a) / length2, 0.0, 1.0) : 0;
  return (a + t * ab - p).norm();
}

void check_bones(const Points& heads, const Points& tails) {
  if (heads.rows() != tails.rows()) throw std::invalid_argument("tails: expected as many as heads");
  if (!heads.allFinite() || !tails.allFinite())
    throw std::invalid_argument("heads, tails: expected finite coordinates");
}

}  // namespace

Points points_on_bones(const Points& cage, const Triangles& triangles, const Points& skin, const Triangles& faces,
                       const Points& heads, const Points& tails, double ratio) {
  check_bones(heads, tails);
  const Surface surface(cage, triangles), body(skin, faces);
  double spacing = 0;
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    spacing += (cage.row(triangles(t, 0)) - cage.row(triangles(t, 1))).norm() / double(triangles.rows());
  if (!(spacing > 0)) return Points(0, 3);  // nothing is inside
  const double room = 0.4 * spacing;        // nodes nearer to the cage or to each other make slivers
  std::vector<Vector3d> kept;
  const auto keep = [&](const Vector3d& p) {
    const auto crowds = [&](const Vector3d& other) { return (other - p).norm() < room; };
    const bool fits =
        std::none_of(kept.begin(), kept.end(), crowds) && surface.contains(p) && surface.distance(p) >= room;
    if (fits) kept.push_back(p);
    return fits;
  };
  for (Eigen::Index b = 0; b < heads.rows(); ++b) {
    const Vector3d head = heads.row(b), along = Vector3d(tails.row(b)) - head;
    const Eigen::Quaterniond frame = Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), along);
    const double length = along.norm() / spacing;
    if (!(length < kMostPieces))
      throw Error("A bone is more than " + std::to_string(kMostPieces) +
                  " times as long as the cage's edges. Check the scale of the bones.");
    const int pieces = std::max(1, int(std::round(length)));
    for (int i = 0; i <= pieces; ++i) {
      const Vector3d p = head + along * i / pieces;
      // Well within the pinned range, and away from the cage too.
      const double radius =
          surface.contains(p) ? ratio * std::min(0.75 * surface.distance(p), 0.9 * body.distance(p)) : 0;
      bool around = false;
      for (int corner = 0; corner < 3 && std::sqrt(3) * radius >= room; ++corner) {
        const double angle = kPi / 3 * (2 * corner + i % 2);  // each triangle is turned against the last
        around |= keep(p + radius * (frame * Vector3d(std::cos(angle), std::sin(angle), 0)));
      }
      if (!around) keep(p);
    }
  }
  Points out(kept.size(), 3);
  for (size_t i = 0; i < kept.size(); ++i) out.row(i) = kept[i];
  return out;
}

std::vector<bool> pinned(const TetMesh& mesh, const Points& vertices, const Triangles& triangles, const Points& heads,
                         const Points& tails, double ratio) {
  check_bones(heads, tails);
  const ClosedSurface closed = close_surface(vertices, triangles);
  const Surface body(closed.vertices, closed.triangles);
  const Surface skin(closed.vertices, closed.triangles.topRows(closed.authored));
  std::vector<bool> found(mesh.nodes.rows());
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
    const Vector3d p = mesh.nodes.row(i);
    double to_bone = kInfinity;
    for (Eigen::Index b = 0; b < heads.rows(); ++b)
      to_bone = std::min(to_bone, distance_to_segment(p, heads.row(b), tails.row(b)));
    // Written so that without bones (an infinite distance) no node is pinned.
    found[i] = (1 - ratio) * to_bone < ratio * skin.distance(p) && body.contains(p);
  }
  return found;
}

}  // namespace dynamorph
