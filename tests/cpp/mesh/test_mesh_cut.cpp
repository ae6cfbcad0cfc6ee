// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <cmath>
#include <functional>
#include <set>
#include <vector>

#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/mesh/mesh_cut.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

struct Surfaces {
  Points vertices;
  Triangles triangles;
};

Surfaces join(const std::vector<Surfaces>& skins) {
  Surfaces out{Points(0, 3), Triangles(0, 3)};
  for (const Surfaces& skin : skins) {
    const Eigen::Index v = out.vertices.rows(), t = out.triangles.rows();
    out.vertices.conservativeResize(v + skin.vertices.rows(), 3);
    out.vertices.bottomRows(skin.vertices.rows()) = skin.vertices;
    out.triangles.conservativeResize(t + skin.triangles.rows(), 3);
    out.triangles.bottomRows(skin.triangles.rows()) = skin.triangles.array() + int(v);
  }
  return out;
}

/// A tube around a line of points, closed at its ends: `around` corners, radius along y and x-z as given.
Surfaces tube(const std::vector<Vector3d>& line, double radius, double half_width, int around = 16) {
  const int rings = int(line.size()), last = rings * around;
  Surfaces skin{Points(last + 2, 3), Triangles(2 * rings * around, 3)};
  int t = 0;
  for (int i = 0; i < rings; ++i) {
    const Vector3d along = line[std::min(i + 1, rings - 1)] - line[std::max(i - 1, 0)];
    const Vector3d side = Vector3d::UnitY().cross(along).normalized();
    for (int k = 0; k < around; ++k) {
      const double angle = 2 * kPi * k / around;
      skin.vertices.row(i * around + k) =
          line[i] + radius * std::cos(angle) * side + half_width * std::sin(angle) * Vector3d::UnitY();
      const int a = i * around + k, b = i * around + (k + 1) % around;
      if (i == 0) skin.triangles.row(t++) << last, a, b;
      if (i == rings - 1)
        skin.triangles.row(t++) << last + 1, b, a;
      else {
        skin.triangles.row(t++) << a, a + around, b;
        skin.triangles.row(t++) << b, a + around, b + around;
      }
    }
  }
  skin.vertices.row(last) = line.front();
  skin.vertices.row(last + 1) = line.back();
  skin.triangles.col(1).swap(skin.triangles.col(2));
  return skin;
}

constexpr double length = 1, thickness = 0.1;

/// A U of round section in the x-z plane: prongs of 1 m along x, `gap` between them (below zero they overlap).
Surfaces fork(double gap) {
  const double bend = (gap + thickness) / 2;
  std::vector<Vector3d> line;
  const int pieces = 40, turns = 8;
  for (int i = 0; i < pieces; ++i) line.emplace_back(length * (1 - i / double(pieces)), 0, -bend);
  for (int i = 0; i <= turns; ++i) {
    const double angle = kPi * i / turns;
    line.emplace_back(-0.12 * std::sin(angle), 0, -bend * std::cos(angle));
  }
  for (int i = 1; i <= pieces; ++i) line.emplace_back(length * i / double(pieces), 0, bend);
  return tube(line, thickness / 2, thickness / 2);
}

/// A block of cells around a skin, as a coarse cage that fills its gaps.
TetMesh block(const Surfaces& skin, double cell) {
  const Vector3d low = skin.vertices.colwise().minCoeff(), high = skin.vertices.colwise().maxCoeff();
  const Eigen::Vector3i cells = ((high - low) / cell).array().ceil().cast<int>().max(1);
  TetMesh mesh = scenes::bar(cells[0], cells[1], cells[2], cell);
  const Vector3d middle = (low + high) / 2 - cell * cells.cast<double>() / 2;
  mesh.nodes.rowwise() += middle.transpose();
  return mesh;
}

int count(const std::vector<bool>& flags) { return int(std::count(flags.begin(), flags.end(), true)); }

/// Groups of nodes that tets join.
int pieces(const TetMesh& mesh) {
  std::vector<int> root(mesh.nodes.rows());
  std::iota(root.begin(), root.end(), 0);
  const std::function<int(int)> find = [&](int i) { return root[i] == i ? i : root[i] = find(root[i]); };
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t)
    for (int k = 1; k < 4; ++k) root[find(mesh.tets(t, k))] = find(mesh.tets(t, 0));
  std::set<int> roots;
  for (int i = 0; i < int(root.size()); ++i) roots.insert(find(i));
  return int(roots.size());
}

/// How far along x the two prongs of a fork share nodes.
double joined_up_to(const TetMesh& mesh, const Embedding& e) {
  std::vector<bool> lower(mesh.nodes.rows(), false), upper = lower;
  const Eigen::Index sides = e.nodes.rows() - 2;  // from the tip of the lower prong to that of the upper
  for (Eigen::Index i = 0; i < sides; ++i)
    for (int node : e.nodes.row(i)) (i < sides / 2 ? lower : upper)[node] = true;
  double x = -1;
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i)
    if (lower[i] && upper[i]) x = std::max(x, mesh.nodes(i, 0));
  return x;
}

}  // namespace

TEST_CASE("the prongs of a fork come apart, whether there is a gap, they touch or overlap") {
  for (double gap : {0.03, 0.0, -0.02}) {
    CAPTURE(gap);
    const Surfaces skin = fork(gap);
    const TetMesh mesh = block(skin, 0.06);
    const MeshCut mesh_cut(mesh, skin.vertices, skin.triangles);
    CHECK(count(mesh_cut.glued()) > 30);
    const TetMesh cut = mesh_cut.cut();
    CHECK(cut.tets.rows() == mesh.tets.rows());
    CHECK(cut.nodes.topRows(mesh.nodes.rows()) == mesh.nodes);
    CHECK(volumes(cut) == volumes(mesh));
    CHECK(pieces(cut) == 1);  // they still meet at the bend
    const Embedding before = embed(mesh, skin.vertices), after = mesh_cut.embed(cut);
    CHECK(joined_up_to(mesh, before) > 0.95);
    CHECK(joined_up_to(cut, after) < 0.35);
    CHECK(after.distances.maxCoeff() < 0.03);
    CHECK(after.weights.minCoeff() > -0.5 - 1e-9);
  }
}

TEST_CASE("what is cut once has nothing left to cut, and cutting is repeatable") {
  const Surfaces skin = fork(0.03);
  const TetMesh mesh = block(skin, 0.06), cut = MeshCut(mesh, skin.vertices, skin.triangles).cut();
  CHECK(count(MeshCut(cut, skin.vertices, skin.triangles).glued()) == 0);
  CHECK(MeshCut(mesh, skin.vertices, skin.triangles).cut().tets == cut.tets);
}

TEST_CASE("a thin slab is not cut, because its two sides belong to the same tissue") {
  std::vector<Vector3d> line;
  for (int i = 0; i <= 20; ++i) line.emplace_back(i / 20.0, 0, 0.1 * std::sin(i / 4.0));
  const Surfaces slab = tube(line, 0.01, 0.5, 32);
  const TetMesh mesh = block(slab, 0.06);
  const MeshCut mesh_cut(mesh, slab.vertices, slab.triangles);
  CHECK(count(mesh_cut.glued()) == 0);
  CHECK(mesh_cut.cut().nodes == mesh.nodes);
  const Embedding plain = embed(mesh, slab.vertices), own = mesh_cut.embed(mesh);
  CHECK(own.nodes == plain.nodes);
  CHECK(own.weights == plain.weights);
}

TEST_CASE("a sheet folded to a letter C opens along its gap") {
  std::vector<Vector3d> line;
  for (int i = 0; i <= 60; ++i) {
    const double angle = (0.02 + 0.96 * i / 60.0) * 2 * kPi;  // the ends nearly meet
    line.emplace_back(0.4 * std::cos(angle), 0, 0.4 * std::sin(angle));
  }
  const Surfaces sheet = tube(line, 0.04, 0.2);
  const TetMesh mesh = block(sheet, 0.06);
  const MeshCut mesh_cut(mesh, sheet.vertices, sheet.triangles);
  const std::vector<bool> glued = mesh_cut.glued();
  CHECK(count(glued) > 0);
  const TetMesh cut = mesh_cut.cut();
  const Embedding e = mesh_cut.embed(cut);
  std::set<int> first, last;
  for (Eigen::Index i = 0; i < sheet.vertices.rows(); ++i)
    if (sheet.vertices(i, 0) > 0.3 && std::abs(sheet.vertices(i, 2)) < 0.15)
      for (int node : e.nodes.row(i)) (sheet.vertices(i, 2) > 0 ? first : last).insert(node);
  REQUIRE(!first.empty());
  for (int node : first) CHECK(last.count(node) == 0);
}

TEST_CASE("loose parts are not cut apart: an eye in its head, a shell around a body") {
  const auto ball = [](double radius) {
    std::vector<Vector3d> line;
    Surfaces skin;
    for (int i = 1; i < 12; ++i) line.emplace_back(radius * -std::cos(kPi * i / 12), 0, 0);
    skin = tube(line, 1, 1);
    for (Eigen::Index i = 0; i < skin.vertices.rows() - 2; ++i) {
      const double x = skin.vertices(i, 0), r = std::sqrt(radius * radius - x * x);
      skin.vertices(i, 1) *= r;
      skin.vertices(i, 2) *= r;
    }
    return skin;
  };
  const Surfaces nested = join({ball(0.5), ball(0.45)});
  const TetMesh mesh = block(nested, 0.1);
  CHECK(count(MeshCut(mesh, nested.vertices, nested.triangles).glued()) == 0);
}

TEST_CASE("seams and long edges change nothing about what is glued") {
  const Surfaces skin = fork(0.03);
  const TetMesh mesh = block(skin, 0.06);
  Surfaces split{Points(3 * skin.triangles.rows(), 3), Triangles(skin.triangles.rows(), 3)};  // each triangle by itself
  for (Eigen::Index t = 0; t < skin.triangles.rows(); ++t)
    for (int k = 0; k < 3; ++k) {
      split.vertices.row(3 * t + k) = skin.vertices.row(skin.triangles(t, k));
      split.triangles(t, k) = int(3 * t + k);
    }
  CHECK(MeshCut(mesh, split.vertices, split.triangles).cut().tets ==
        MeshCut(mesh, skin.vertices, skin.triangles).cut().tets);
}

TEST_CASE("skin far larger than the mesh is refused, before it takes the memory") {
  const Surfaces skin = fork(0.03);
  const TetMesh mesh = block(skin, 0.06);
  for (double scale : {1e4, 1e5})
    CHECK_THROWS_WITH_AS(MeshCut(mesh, scale * skin.vertices, skin.triangles), doctest::Contains("same unit"),
                         std::invalid_argument);
}

TEST_CASE("a mesh without skin has nothing to cut, and a stray vertex is carried by the nearest tet") {
  const TetMesh mesh = scenes::bar(3, 1, 1, 0.1);
  Points stray(1, 3);
  stray << 0.05, 0.05, 0.05;
  const MeshCut mesh_cut(mesh, stray, Triangles(0, 3));
  CHECK(count(mesh_cut.glued()) == 0);
  CHECK(mesh_cut.embed(mesh_cut.cut()).distances[0] == 0);
  CHECK_THROWS_AS(mesh_cut.embed(scenes::bar(1, 1, 1, 0.1)), std::invalid_argument);
}
