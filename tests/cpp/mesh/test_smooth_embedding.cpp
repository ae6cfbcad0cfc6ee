// SPDX-License-Identifier: GPL-3.0-or-later
// Points that a tet mesh carries smoothly.
#include <doctest/doctest.h>

#include "dynamorph/mesh/smooth_embedding.hpp"
#include "scenes.hpp"

using namespace dynamorph;

TEST_CASE("smooth embedding: affine maps exactly, bends far better than the tets alone") {
  const TetMesh mesh = scenes::bar(8, 8, 8, 0.125);
  Points points(40, 3);
  for (Eigen::Index p = 0; p < points.rows(); ++p)
    points.row(p) << 0.3 + 0.01 * double(p), 0.35 + 0.3 * std::sin(double(p)) * 0.5,
        0.5 + 0.2 * std::cos(1.7 * double(p));
  const Embedding embedding = embed(mesh, points);
  const auto S = smooth_embedding(mesh, embedding);
  CHECK((S * VectorXd::Ones(mesh.nodes.rows()) - VectorXd::Ones(points.rows())).norm() < 1e-12);
  const auto error = [&](const auto& map, const auto& carry) {
    Points nodes(mesh.nodes.rows(), 3), wanted(points.rows(), 3);
    for (Eigen::Index i = 0; i < nodes.rows(); ++i) nodes.row(i) = map(Vector3d(mesh.nodes.row(i)));
    for (Eigen::Index p = 0; p < points.rows(); ++p) wanted.row(p) = map(Vector3d(points.row(p)));
    return (carry * nodes - wanted).rowwise().norm().maxCoeff();
  };
  const SparseMatrix linear = embedding.matrix(mesh.nodes.rows());
  const auto affine = [](const Vector3d& x) {
    return Vector3d(0.3 * x.y() + x.x(), 2 * x.y() - x.z() + 1, 0.5 * x.z() + 0.2 * x.x());
  };
  CHECK(error(affine, S) < 1e-12);
  const auto bend = [](const Vector3d& x) {
    return Vector3d(std::sin(1.5 * x.x()) * (1 + x.y()), std::cos(1.5 * x.x()) * (1 + x.y()), x.z());
  };
  CHECK(error(bend, S) < 0.15 * error(bend, linear));
}
