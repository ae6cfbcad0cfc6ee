// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "dynamorph/mesh/symmetry.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

struct Soup {
  Points vertices;
  Triangles triangles;
};

Soup outside(const TetMesh& mesh) { return {mesh.nodes, scenes::surface_of(mesh)}; }

/// A box of tets around the origin, in which the planes of nodes are `shift` of a cell away from the middle.
TetMesh around_origin(int cells, double shift = 0) {
  TetMesh mesh = scenes::bar(cells, 3, 3, 0.1);
  mesh.nodes.col(0).array() -= 0.1 * (cells / 2 + shift);
  return mesh;
}

Soup box(double length) {
  Soup skin = outside(scenes::bar(1, 1, 1, 1));
  skin.vertices.col(0) = length * (skin.vertices.col(0).array() - 0.5);
  skin.vertices.rightCols(2) *= 0.3;
  return skin;
}

/// Whether each node and each tet is the mirror image of another, or of itself.
bool is_symmetric(const TetMesh& mesh) {
  std::map<std::array<double, 3>, int> at;
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i)
    at[{mesh.nodes(i, 0) + 0.0, mesh.nodes(i, 1), mesh.nodes(i, 2)}] = int(i);
  std::vector<int> image;
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
    const auto found = at.find({0.0 - mesh.nodes(i, 0), mesh.nodes(i, 1), mesh.nodes(i, 2)});
    if (found == at.end()) return false;
    image.push_back(found->second);
  }
  std::set<std::set<int>> tets, images;
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) {
    const auto corner = [&](int k) { return mesh.tets(t, k); };
    tets.insert({corner(0), corner(1), corner(2), corner(3)});
    images.insert({image[corner(0)], image[corner(1)], image[corner(2)], image[corner(3)]});
  }
  return tets == images;
}

}  // namespace

TEST_CASE("a symmetric skin makes its mesh symmetric, wherever the plane cuts it") {
  for (double shift : {0.0, 0.1, 0.3, 0.45, 0.5}) {
    CAPTURE(shift);
    const TetMesh mesh = around_origin(6, shift), found = symmetric_like(mesh, box(0.5).vertices, box(0.5).triangles);
    CHECK(!is_symmetric(mesh));
    CHECK(is_symmetric(found));
    const double above = 0.1 * (3 - shift);  // the length of the half that stays
    CHECK(volumes(found).sum() == doctest::Approx(2 * above * 0.09));
    // No gaps and no overlaps: what is inside the outside is as much as the tets together.
    const Soup skin = outside(found);
    double enclosed = 0;
    for (Eigen::Index t = 0; t < skin.triangles.rows(); ++t) {
      const Eigen::RowVector3i c = skin.triangles.row(t);
      const Vector3d a = skin.vertices.row(c[0]), b = skin.vertices.row(c[1]), d = skin.vertices.row(c[2]);
      enclosed += a.dot(b.cross(d)) / 6;
    }
    CHECK(enclosed == doctest::Approx(volumes(found).sum()));
    CHECK(face_neighbors(found.tets).size() == std::size_t(4 * found.tets.rows() - skin.triangles.rows()) / 2);
    CHECK(volumes(found).minCoeff() > 0.05 * volumes(mesh).minCoeff());
  }
}

TEST_CASE("any other skin leaves its mesh as it is") {
  const TetMesh mesh = around_origin(6, 0.3);
  Soup skin = box(0.5);
  skin.vertices(0, 0) -= 0.02;
  skin.vertices(0, 1) -= 0.02;
  skin.vertices(0, 2) -= 0.02;
  const TetMesh found = symmetric_like(mesh, skin.vertices, skin.triangles);
  CHECK(found.nodes == mesh.nodes);
  CHECK(found.tets == mesh.tets);
  CHECK(!mirror_plane(skin.vertices, skin.triangles));
  const std::vector<int> images = mirror_images(skin.vertices, skin.triangles);
  CHECK(std::all_of(images.begin(), images.end(), [](int image) { return image == -1; }));
  CHECK(!mirror_plane(skin.vertices, Triangles(0, 3)));
}

TEST_CASE("points have mirror images about the middle of a skin") {
  Soup skin = box(0.5);
  skin.vertices.col(0).array() += 7;
  const auto plane = mirror_plane(skin.vertices, skin.triangles);
  REQUIRE(plane);
  CHECK(plane->axis == 0);
  CHECK(plane->at == doctest::Approx(7));
  const std::vector<int> images = mirror_images(skin.vertices, skin.triangles);
  for (int v = 0; v < int(images.size()); ++v) {
    CHECK(images[std::size_t(images[std::size_t(v)])] == v);
    CHECK((plane->image(skin.vertices.row(v)) - skin.vertices.row(images[std::size_t(v)]).transpose()).norm() < 1e-12);
  }
}

TEST_CASE("X comes first, and any axis serves") {
  Soup skin = box(0.5);
  CHECK(mirror_plane(skin.vertices, skin.triangles)->axis == 0);
  for (Eigen::Index v = 0; v < skin.vertices.rows(); ++v)
    if (skin.vertices(v, 0) > 0) skin.vertices(v, 1) = 0.5 * skin.vertices(v, 1) + 0.075;  // a wedge
  CHECK(mirror_plane(skin.vertices, skin.triangles)->axis == 1);
}
