// SPDX-License-Identifier: GPL-3.0-or-later
// Shapes that are extended from the skin into the cage.
#include <doctest/doctest.h>

#include <algorithm>

#include "dynamorph/elastic/elasticity.hpp"
#include "dynamorph/models/extend_shapes.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

/// The bar's nodes as its surface, displaced by `depth` toward its axis in the middle.
VectorXd squeezed(const Points& nodes, double depth) {
  Points out = Points::Zero(nodes.rows(), 3);
  for (Eigen::Index i = 0; i < nodes.rows(); ++i)
    if (std::abs(nodes(i, 0) - 0.15) < 0.06)
      out.row(i) << 0, depth * (0.05 - nodes(i, 1)) / 0.05, depth * (0.05 - nodes(i, 2)) / 0.05;
  return flat(out);
}

bool all_usable(const TetMesh& mesh, const VectorXd& displacement) {
  const std::vector<bool> good = usable(mesh, displacement);
  return std::find(good.begin(), good.end(), false) == good.end();
}

}  // namespace

TEST_CASE("a shape is met where the tets can carry it, and crushes none where they cannot") {
  const auto body = scenes::two_bone_bar();
  const Embedding embedding = embed(body->mesh, body->mesh.nodes);
  for (const double depth : {0.01, 0.05, 0.08}) {
    const VectorXd surface = squeezed(body->mesh.nodes, depth);
    const VectorXd nodes = extend_shapes(*body, embedding, surface).col(0);
    CHECK(all_usable(body->mesh, nodes));
    CHECK(all_usable(body->mesh, surface) == (depth < 0.03));
    const double off = (nodes - surface).cwiseAbs().maxCoeff();
    if (depth < 0.03) CHECK(off < 1e-3 * depth);
    if (depth > 0.03) CHECK(off < depth);
  }
}
