// SPDX-License-Identifier: GPL-3.0-or-later
// Bodies for the C++ tests: a bar on two bones with sculpted targets.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>

#include "dynamorph/models/full_model.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/reduced/responses/response_tables.hpp"

namespace scenes {

using namespace dynamorph;

/// nx x ny x nz cells of `size` meters along +x from the origin, six tetrahedra a cell.
inline TetMesh bar(int nx, int ny, int nz, double size) {
  const auto node = [&](int i, int j, int k) { return (i * (ny + 1) + j) * (nz + 1) + k; };
  TetMesh mesh;
  mesh.nodes.resize((nx + 1) * (ny + 1) * (nz + 1), 3);
  for (int i = 0; i <= nx; ++i)
    for (int j = 0; j <= ny; ++j)
      for (int k = 0; k <= nz; ++k) mesh.nodes.row(node(i, j, k)) << i * size, j * size, k * size;
  mesh.tets.resize(6 * nx * ny * nz, 4);
  const int order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {1, 0, 2}, {2, 1, 0}};
  int tet = 0;
  for (int i = 0; i < nx; ++i)
    for (int j = 0; j < ny; ++j)
      for (int k = 0; k < nz; ++k)
        for (int p = 0; p < 6; ++p) {
          int at[3] = {i, j, k}, corner[4] = {node(i, j, k)};
          for (int s = 0; s < 3; ++s) {
            ++at[order[p][s]];
            corner[s + 1] = node(at[0], at[1], at[2]);
          }
          if (p >= 3) std::swap(corner[2], corner[3]);
          mesh.tets.row(tet++) << corner[0], corner[1], corner[2], corner[3];
        }
  return mesh;
}

/// The faces of one tet alone (T, 3), outward.
inline Triangles surface_of(const TetMesh& mesh) {
  std::map<std::array<int, 3>, std::array<int, 3>> faces;  // by their sorted corners
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t)
    for (const std::array<int, 3>& k : {std::array{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}}) {
      const std::array<int, 3> face{mesh.tets(t, k[0]), mesh.tets(t, k[1]), mesh.tets(t, k[2])};
      std::array<int, 3> sorted = face;
      std::sort(sorted.begin(), sorted.end());
      if (!faces.emplace(sorted, face).second) faces.erase(sorted);
    }
  Triangles out(Eigen::Index(faces.size()), 3);
  Eigen::Index row = 0;
  for (const auto& [_, face] : faces) out.row(row++) << face[0], face[1], face[2];
  return out;
}

/// The bar pinned at x = 0, weights passing smoothly from bone 0 to bone 1.
inline std::shared_ptr<const SoftBody> two_bone_bar(int sets = 1) {
  const TetMesh mesh = bar(6, 2, 2, 0.05);
  const Eigen::Index n = mesh.nodes.rows(), m = mesh.tets.rows();
  MatrixXd weights(n, 2);
  std::vector<bool> pinned(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double s = mesh.nodes(i, 0) / 0.3;
    weights.row(i) << 1 - s * s * (3 - 2 * s), s * s * (3 - 2 * s);
    pinned[i] = mesh.nodes(i, 0) < 1e-9;
  }
  const VectorXd fill = VectorXd::LinSpaced(m, 0.3, 1.0);
  return std::make_shared<SoftBody>(mesh, fill, VectorXd::Ones(m), MatrixXd::Constant(m, sets, 1.0 / sets), pinned,
                                    weights);
}

/// The bar's bones when the second has turned.
inline Transforms bent(double angle) {
  Transforms bones(2, 12);
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(bones.data()) << 1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0;
  Eigen::Matrix<double, 3, 4> second;
  second << Eigen::AngleAxisd(angle, Vector3d(0.2, 1, 0.3).normalized()).toRotationMatrix(), Vector3d(0.1, 0.2, -0.1);
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(bones.data() + 12) = second;
  return bones;
}

/// Neutral, a stiff bulge and a soft twist, in sets 0, 0 and `last_set`.
inline std::vector<MorphTarget> targets(const SoftBody& body, int last_set = 0) {
  const Points& X = body.mesh.nodes;
  Points bulge = Points::Zero(X.rows(), 3), twist = bulge;
  for (Eigen::Index i = 0; i < X.rows(); ++i) {
    const double s = X(i, 0) / 0.3, y = X(i, 1) - 0.05, z = X(i, 2) - 0.05;
    bulge.row(i) << 0, 0.6 * y * std::sin(kPi * s) * s, 0.6 * z * std::sin(kPi * s) * s;
    twist.row(i) << 0.02 * s, -0.5 * s * z, 0.5 * s * y;
  }
  const auto target = [&](const char* name, const Points& shape, double lambda, double mu, double density, int set) {
    return MorphTarget{name, set, body.expand(body.restrict_to_free(flat(shape))), {lambda, mu}, density, 0.7, 0.004};
  };
  return {target("neutral", Points::Zero(X.rows(), 3), 2e4, 1e4, 1000, 0), target("bulge", bulge, 1.5e5, 9e4, 1100, 0),
          target("twist", twist, 4e3, 6e3, 900, last_set)};
}

/// A body's targets in r modes.
inline std::shared_ptr<const ReducedModel> reduced_model(std::shared_ptr<const SoftBody> body,
                                                         std::vector<MorphTarget> targets, MaterialModel material_model,
                                                         Blending blending, int r) {
  const FullModel full(body, targets, material_model, blending);
  return std::make_shared<ReducedModel>(body, targets, reduce(full, make_basis(full, r).U), blending);
}

/// A body's targets in r modes and h responses, with all that they were made of.
struct ResponseScene {
  FullModel full;
  ResponseBasis basis;
  ReducedTables tables;
  std::shared_ptr<const ReducedModel> model;

  ResponseScene(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, MaterialModel material_model,
                Blending blending, int r = 10, int h = 20)
      : full(body, targets, material_model, blending),
        basis(make_response_basis(full, r, h)),
        tables(reduce(full, basis)),
        model(std::make_shared<ReducedModel>(body, targets, tables, blending)) {}
};

/// A bar of 0.8 m on `count` bones along it; each moves what is near; pinned at x = 0. Each set has less of it
/// toward the end than the one before. fine: 2 for cells of half the size.
inline std::shared_ptr<const SoftBody> chain_bar(int count, int sets = 1, int fine = 1) {
  const TetMesh mesh = bar(16 * fine, 2 * fine, 2 * fine, 0.05 / fine);
  const Eigen::Index n = mesh.nodes.rows(), m = mesh.tets.rows();
  MatrixXd weights(n, count);
  std::vector<bool> pinned(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double along = mesh.nodes(i, 0) / 0.8 * (count - 1);
    for (int b = 0; b < count; ++b) weights(i, b) = std::exp(-2 * (along - b) * (along - b));
    pinned[i] = mesh.nodes(i, 0) < 1e-9;
  }
  MatrixXd region_weights(m, sets);
  for (int s = 0; s < sets; ++s) region_weights.col(s) = VectorXd::LinSpaced(m, 1, 1.0 / (1 + s));
  region_weights.array().colwise() /= region_weights.rowwise().sum().array().eval();
  return std::make_shared<SoftBody>(mesh, VectorXd::Ones(m), VectorXd::Ones(m), region_weights, pinned, weights);
}

}  // namespace scenes
