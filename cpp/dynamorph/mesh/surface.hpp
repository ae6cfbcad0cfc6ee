// SPDX-License-Identifier: GPL-3.0-or-later
// Distance to a triangle mesh, and whether a point is inside it, however broken the mesh is.
//
// Inside is where the generalized winding number w(q) = 1/(4 pi) sum_t Omega_t(q) exceeds 1/2 in magnitude; Omega_t is
// the solid angle of triangle t seen from q. Far triangles are summed as one dipole,
//
//   w = sum_t a_t n_t . (c - q) / (4 pi |c - q|^3),
//
// where c is their centroid (Barill, Dickson, Schmidt, Levin, Jacobson 2018, Fast winding numbers for soups and clouds,
// doi 10.1145/3197517.3201337).
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/bvh.hpp"

namespace dynamorph {

using Triangle = std::array<int, 3>;  ///< indices of its corners
using Edge = std::pair<int, int>;     ///< indices of its ends

/// The same for both directions of an edge.
inline Edge undirected(int a, int b) { return {std::min(a, b), std::max(a, b)}; }

/// Throws std::invalid_argument when a triangle names a vertex that does not exist.
void check_triangles(const Points& vertices, const Triangles& triangles);

/// As long as the area of triangle t, and normal to it.
inline Vector3d area_vector(const Points& vertices, const Triangles& triangles, Eigen::Index t) {
  const Vector3d a = vertices.row(triangles(t, 0)), b = vertices.row(triangles(t, 1)),
                 c = vertices.row(triangles(t, 2));
  return (b - a).cross(c - a) / 2;
}

/// The point of triangle abc nearest to p.
Vector3d closest_on_triangle(const Vector3d& p, const Vector3d& a, const Vector3d& b, const Vector3d& c);

/// The triangles below a node of a tree, seen from afar.
struct Dipole {
  Vector3d centroid = Vector3d::Zero(), area_vector = Vector3d::Zero();
  double area = 0, radius = 0;
};

/// Those of all nodes of a tree over the triangles.
void find_dipoles(const Points& vertices, const Triangles& triangles, const Bvh& bvh, std::vector<Dipole>& out);

/// About 1 inside a closed mesh of outward triangles, about 0 outside, and in between for open ones.
double winding_number(const Points& vertices, const Triangles& triangles, const Bvh& bvh,
                      const std::vector<Dipole>& dipoles, const Vector3d& p);

class Surface {
 public:
  Surface(Points vertices, Triangles triangles);

  /// Bounds of the vertices that have triangles.
  Eigen::AlignedBox3d box() const { return bvh_.nodes.empty() ? Eigen::AlignedBox3d() : bvh_.nodes[0].box; }
  /// Unsigned distance, meters; infinite without triangles.
  double distance(const Vector3d& p) const { return (nearest(p) - p).norm(); }
  /// The point of the surface nearest to p; infinite without triangles.
  Vector3d nearest(const Vector3d& p) const { return nearest(p, Vector3d::Constant(kInfinity)); }
  /// The same, found sooner with a point of the surface that is near p.
  Vector3d nearest(const Vector3d& p, Vector3d guess) const;
  double winding_number(const Vector3d& p) const {
    return dynamorph::winding_number(vertices_, triangles_, bvh_, dipoles_, p);
  }
  /// Whether p is inside. This also works for a mesh that is inside out.
  bool contains(const Vector3d& p) const { return std::abs(winding_number(p)) > 0.5; }
  /// How many of a few points (columns) that are near each other are inside. Where `contains` is in doubt, as on the
  /// surface, it may decide otherwise.
  int count_inside(const Eigen::Ref<const Eigen::Matrix3Xd>& points) const;

 private:
  Vector3d corner(int triangle, int k) const { return vertices_.row(triangles_(triangle, k)); }

  Points vertices_;
  Triangles triangles_;
  Bvh bvh_;
  std::vector<Dipole> dipoles_;
};

}  // namespace dynamorph
