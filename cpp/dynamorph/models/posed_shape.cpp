// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/posed_shape.hpp"

#include "dynamorph/core/errors.hpp"
#include "dynamorph/models/posed_statics.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr int kIterations = 10, kLastIterations = 24;         // of Newton's method a step, and in the pose
constexpr double kNegligible = 1e-2, kLastNegligible = 1e-3;  // step, in thicknesses

void check(const PosedBody& body, const std::vector<Transforms>& path) {
  const Index P = body.skin.rest.rows(), n = body.mesh.nodes.rows();
  check_size("stiffness", body.stiffness.size(), body.mesh.tets.rows());
  check_size("weights", body.weights.rows(), n);
  check_size("embedding", body.skin.embedding.nodes.rows(), P);
  check_size("skin weights", body.skin.weights.rows(), P);
  check_size("thickness", body.thickness.size(), P);
  if (P > 0 && (body.skin.embedding.nodes.minCoeff() < 0 || body.skin.embedding.nodes.maxCoeff() >= n))
    throw std::invalid_argument("embedding: it belongs to another mesh");
  if (!(body.thickness.array() > 0).all() || !(body.stiffness.array() >= 0).all())
    throw std::invalid_argument("thickness must be above zero, stiffness not below");
  if (path.empty()) throw std::invalid_argument("path: expected at least the pose");
  for (const Transforms& bones : path) {
    if (bones.rows() != body.weights.cols() || bones.rows() != body.skin.weights.cols())
      throw std::invalid_argument("path: expected transforms of " + std::to_string(body.weights.cols()) + " bones");
    if (!bones.allFinite()) throw Error("The pose has a bone transform that is not a number. Check what poses it.");
  }
}

}  // namespace

PosedShape shape_by_physics(const PosedBody& body, const std::vector<Transforms>& path, const ProgressFn& progress) {
  check(body, path);
  PosedShape shape;
  shape.skin = Points::Zero(body.skin.rest.rows(), 3);
  shape.plain = VectorXd::Zero(body.skin.rest.rows());
  PosedStatics statics(body, path.back());
  shape.converged = !statics.moves();
  if (!statics.moves()) return shape;
  for (std::size_t k = 0; k < path.size(); ++k) {
    report(progress, double(k) / double(path.size()));
    const bool last = k + 1 == path.size();
    shape.iterations += statics.solve(path[k], last ? kLastIterations : kIterations,
                                      last ? kLastNegligible : kNegligible, shape.converged);
  }
  statics.write(shape);
  report(progress, 1);
  return shape;
}

}  // namespace dynamorph
