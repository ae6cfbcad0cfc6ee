// SPDX-License-Identifier: GPL-3.0-or-later
// Colliders for the tests, and what a step does to samples of a skin.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <numeric>
#include <vector>

#include "dynamorph/contact/find_contacts.hpp"

namespace shapes {

using namespace dynamorph;

struct Mesh {
  Points points;
  Triangles triangles;
};

/// From -half to half, outward.
inline Mesh box(const Vector3d& half) {
  Mesh mesh{Points(8, 3), Triangles(12, 3)};
  for (int i = 0; i < 8; ++i)
    mesh.points.row(i) << (i & 1 ? 1 : -1) * half[0], (i & 2 ? 1 : -1) * half[1], (i & 4 ? 1 : -1) * half[2];
  mesh.triangles << 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5,
      3, 7, 5;
  return mesh;
}

/// Of the given radius, outward, of rings x 2 rings quads cut in two.
inline Mesh sphere(double radius, int rings = 24) {
  const int around = 2 * rings, south = (rings - 1) * around, north = south + 1;
  Mesh mesh{Points(north + 1, 3), Triangles(2 * (rings - 1) * around, 3)};
  mesh.points.row(south) << 0, 0, -radius;
  mesh.points.row(north) << 0, 0, radius;
  int t = 0;
  for (int i = 0; i < rings - 1; ++i)
    for (int j = 0; j < around; ++j) {
      const double latitude = kPi * (i + 1) / rings, longitude = 2 * kPi * j / around;
      const int a = i * around + j, b = i * around + (j + 1) % around;
      mesh.points.row(a) << radius * std::sin(latitude) * std::cos(longitude),
          radius * std::sin(latitude) * std::sin(longitude), -radius * std::cos(latitude);
      if (i == 0) mesh.triangles.row(t++) << south, b, a;
      if (i == rings - 2) {
        mesh.triangles.row(t++) << a, b, north;
        continue;
      }
      mesh.triangles.row(t++) << a, b, a + around;
      mesh.triangles.row(t++) << b, b + around, a + around;
    }
  return mesh;
}

/// Two triangles at z = 0, facing up.
inline Mesh floor(double half) {
  Mesh mesh{Points(4, 3), Triangles(2, 3)};
  mesh.points << -half, -half, 0, half, -half, 0, half, half, 0, -half, half, 0;
  mesh.triangles << 0, 1, 2, 0, 2, 3;
  return mesh;
}

/// A closed ring of rectangular section around z, as a belt or a cuff, outward.
inline Mesh tube(double inner, double outer, double half, int around = 48) {
  Mesh mesh{Points(4 * around, 3), Triangles(8 * around, 3)};
  const double radius[] = {inner, outer, outer, inner}, height[] = {-half, -half, half, half};
  for (int i = 0, t = 0; i < around; ++i)
    for (int k = 0; k < 4; ++k) {
      const double angle = 2 * kPi * i / around;
      const int next = 4 * ((i + 1) % around), a = 4 * i + k, b = 4 * i + (k + 1) % 4, c = next + (k + 1) % 4;
      mesh.points.row(a) << radius[k] * std::cos(angle), radius[k] * std::sin(angle), height[k];
      mesh.triangles.row(t++) << a, c, b;
      mesh.triangles.row(t++) << a, next + k, c;
    }
  return mesh;
}

inline Mesh joined(const Mesh& a, const Mesh& b) {
  Mesh mesh{Points(a.points.rows() + b.points.rows(), 3), Triangles(a.triangles.rows() + b.triangles.rows(), 3)};
  mesh.points << a.points, b.points;
  mesh.triangles << a.triangles, (b.triangles.array() + int(a.points.rows())).matrix();
  return mesh;
}

inline Mesh inside_out(Mesh mesh) {
  mesh.triangles = mesh.triangles.rowwise().reverse().eval();
  return mesh;
}

inline Mesh moved(Mesh mesh, const Vector3d& by) {
  mesh.points.rowwise() += by.transpose();
  return mesh;
}

inline Collider collider(const Mesh& mesh, bool one_sided = false) {
  return Collider(mesh.points, mesh.triangles, one_sided);
}

/// 3 x 4, row by row.
inline RowMajor transform(const Matrix3d& linear, const Vector3d& shift) {
  RowMajor m(3, 4);
  m << linear, shift;
  return m;
}
inline RowMajor shifted(double x, double y, double z) { return transform(Matrix3d::Identity(), Vector3d(x, y, z)); }

inline Eigen::Map<const RowMajor> rows(const RowMajor& m) { return {m.data(), m.rows(), m.cols()}; }
inline Eigen::Map<const RowMajor> rows(const Points& m) { return {m.data(), m.rows(), m.cols()}; }

/// Samples that go where they are predicted unless something is in their way.
struct Skin {
  Points at, normal;
  VectorXd thickness;
  ContactMemory memory;
  ContactFinder finder;
  std::vector<Contact> contacts;

  /// A single sample.
  Skin(const Vector3d& place, const Vector3d& outward, double thick)
      : at(place.transpose()), normal(outward.transpose()), thickness(VectorXd::Constant(1, thick)) {}

  /// The bones take the samples to `unmoved`. Contacts push with all their weight; `give`: how much of the depth is
  /// left, as it is with an elastic force.
  void step(const std::vector<ColliderStep>& colliders, const Points& unmoved, double margin, double give = 0) {
    const Points predicted = unmoved;
    std::vector<int> all(std::size_t(at.rows()));
    std::iota(all.begin(), all.end(), 0);
    finder.find(colliders, {all, at, predicted, unmoved, normal, thickness}, 0.25 * margin, margin, memory, contacts);
    at = predicted;
    for (int round = 0; round < 20; ++round)  // to where all planes agree
      for (const Contact& contact : contacts) {
        const double gap = contact.normal.dot(Vector3d(at.row(contact.sample)) - contact.point);
        at.row(contact.sample) -= (1 - give) * contact.weight * std::min(gap, 0.0) * contact.normal.transpose();
      }
  }
  /// With the samples' own places as those that the bones take them to.
  void step(const std::vector<ColliderStep>& colliders, double margin, double give = 0) {
    step(colliders, at, margin, give);
  }
};

}  // namespace shapes
