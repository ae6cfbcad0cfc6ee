// SPDX-License-Identifier: GPL-3.0-or-later
// The shape that soft tissue has in a pose: a bar that two bones bend.
#include <doctest/doctest.h>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/models/posed_shape.hpp"
#include "dynamorph/models/posed_statics.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

constexpr double kHalf = 0.3, kWidth = 0.1;

/// A bar and its mirror image in z = 0, which share the nodes there.
TetMesh mirrored_bar() {
  const TetMesh half = scenes::bar(24, 4, 2, 0.025);
  const Eigen::Index n = half.nodes.rows(), m = half.tets.rows();
  std::vector<int> image(std::size_t(n), -1);
  TetMesh mesh{Points(2 * n, 3), Tets(2 * m, 4)};
  mesh.nodes.topRows(n) = half.nodes;
  Eigen::Index count = n;
  for (Eigen::Index i = 0; i < n; ++i) {
    image[std::size_t(i)] = half.nodes(i, 2) == 0 ? int(i) : int(count);
    if (half.nodes(i, 2) != 0) mesh.nodes.row(count++) = half.nodes.row(i).cwiseProduct(Eigen::RowVector3d(1, 1, -1));
  }
  mesh.nodes.conservativeResize(count, 3);
  mesh.tets.topRows(m) = half.tets;
  for (Eigen::Index t = 0; t < m; ++t)
    for (int k = 0; k < 4; ++k) mesh.tets(m + t, k) = image[std::size_t(half.tets(t, k == 1 ? 2 : k == 2 ? 1 : k))];
  return mesh;
}

/// A bar along x, 0.6 m, centered at the joint; its weights pass from one bone to the other within its width.
PosedBody bar() {
  PosedBody body;
  body.mesh = mirrored_bar();
  body.mesh.nodes.rowwise() -= Eigen::RowVector3d(kHalf, kWidth / 2, 0);
  body.stiffness = VectorXd::Ones(body.mesh.tets.rows());
  const Eigen::Index n = body.mesh.nodes.rows();
  MatrixXd weights(n, 2);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double second = smooth_step(0.5 + body.mesh.nodes(i, 0) / kWidth);
    weights.row(i) << 1 - second, second;
  }
  body.weights = normalized(weights);
  body.skin = {body.mesh.nodes, embed(body.mesh, body.mesh.nodes), body.weights, {}};
  body.triangles = scenes::surface_of(body.mesh);
  body.thickness = VectorXd::Constant(n, kWidth / 2);
  return body;
}

/// The second bone turned about an axis through the joint, in steps of 11 degrees.
std::vector<Transforms> bent(double degrees, const Vector3d& axis) {
  std::vector<Transforms> path;
  const int steps = int(std::ceil(std::abs(degrees) / 11));
  for (int k = 1; k <= steps; ++k) {
    Transforms bones(2, 12);
    Eigen::Matrix<double, 3, 4, Eigen::RowMajor> second = Eigen::Matrix<double, 3, 4>::Identity();
    bones.row(0) = second.reshaped<Eigen::RowMajor>();
    second.leftCols<3>() = Eigen::AngleAxisd(degrees * kPi / 180 * k / steps, axis).toRotationMatrix();
    bones.row(1) = second.reshaped<Eigen::RowMajor>();
    path.push_back(bones);
  }
  return path;
}

double volume_of(const PosedBody& body, const Transforms& bones, const Points& shape) {
  double volume = 0;
  Points x(shape.rows(), 3);
  for (Eigen::Index p = 0; p < x.rows(); ++p) {
    const PointTransform T = body.skin.transform(bones, p);
    x.row(p) = T.leftCols<3>() * (body.skin.rest.row(p) + shape.row(p)).transpose() + T.col(3);
  }
  for (const auto& t : body.triangles.rowwise())
    volume += Vector3d(x.row(t(0))).dot(Vector3d(x.row(t(1))).cross(Vector3d(x.row(t(2))))) / 6;
  return volume;
}

}  // namespace

TEST_CASE("a bent bar keeps its volume, stays out of itself and usable in bind space") {
  const PosedBody body = bar();
  const double rest = volume_of(body, bent(1, Vector3d::UnitY())[0], Points::Zero(body.skin.rest.rows(), 3));
  for (const double degrees : {60., 110.}) {
    const std::vector<Transforms> path = bent(degrees, Vector3d::UnitY());
    const PosedShape shape = shape_by_physics(body, path, {});
    const double plain = volume_of(body, path.back(), Points::Zero(body.skin.rest.rows(), 3));
    const double sculpted = volume_of(body, path.back(), shape.skin);
    INFO(degrees, " degrees: ", plain / rest, " -> ", sculpted / rest, " of the volume");
    CHECK(std::abs(sculpted / rest - 1) < 0.02);
    CHECK(std::abs(sculpted / rest - 1) < 0.4 * std::abs(plain / rest - 1));
    CHECK(shape.least_volume > 0.1);
    CHECK(shape.overlap < 1e-3);
    CHECK(shape.plain.maxCoeff() == 0);
    CHECK(shape.iterations > 0);
    // Its ends, which the bones hold, are where they were.
    for (Eigen::Index p = 0; p < shape.skin.rows(); ++p)
      if (std::abs(body.skin.rest(p, 0)) > 0.9 * kHalf) CHECK(shape.skin.row(p).norm() < 1e-12);
  }
}

TEST_CASE("mirrored poses give mirrored shapes") {
  const PosedBody body = bar();
  const PosedShape up = shape_by_physics(body, bent(70, Vector3d::UnitY()), {});
  const PosedShape down = shape_by_physics(body, bent(-70, Vector3d::UnitY()), {});
  double farthest = 0, largest = 0;
  for (Eigen::Index p = 0; p < up.skin.rows(); ++p) {
    Eigen::Index partner = 0;
    const Eigen::RowVector3d mirrored = body.skin.rest.row(p).cwiseProduct(Eigen::RowVector3d(1, 1, -1));
    (body.skin.rest.rowwise() - mirrored).rowwise().squaredNorm().minCoeff(&partner);
    const Eigen::RowVector3d difference =
        up.skin.row(p) - down.skin.row(partner).cwiseProduct(Eigen::RowVector3d(1, 1, -1));
    farthest = std::max(farthest, difference.norm());
    largest = std::max(largest, up.skin.row(p).norm());
  }
  CHECK(farthest < 1e-6 * largest);
}

TEST_CASE("the same twice, to the last bit; nothing where nothing bends") {
  const PosedBody body = bar();
  const PosedShape first = shape_by_physics(body, bent(80, Vector3d::UnitZ()), {});
  CHECK(first.skin == shape_by_physics(body, bent(80, Vector3d::UnitZ()), {}).skin);
  CHECK(first.skin.norm() > 0);
  Transforms together(2, 12);
  Eigen::Matrix<double, 3, 4, Eigen::RowMajor> turn;
  turn << Eigen::AngleAxisd(2, Vector3d(1, 2, 3).normalized()).toRotationMatrix(), Vector3d(4, 5, 6);
  together.rowwise() = turn.reshaped<Eigen::RowMajor>().transpose();
  const PosedShape still = shape_by_physics(body, {together}, {});
  CHECK(still.skin.norm() == 0);
  CHECK(still.iterations == 0);
  CHECK(still.converged);
}

TEST_CASE("where skinning cannot be inverted, it stays") {
  const PosedBody body = bar();
  const PosedShape shape = shape_by_physics(body, bent(160, Vector3d::UnitX()), {});  // a candy wrapper
  CHECK(shape.plain.maxCoeff() == 1);
  for (Eigen::Index p = 0; p < shape.skin.rows(); ++p)
    if (shape.plain(p) == 1) CHECK(shape.skin.row(p).norm() == 0);
  CHECK(shape.skin.allFinite());
}

TEST_CASE("the energy's derivatives, with and without contact") {
  const PosedBody body = bar();
  for (const double degrees : {15., 110.}) {
    const Transforms pose = bent(degrees, Vector3d::UnitY()).back();
    PosedStatics statics(body, pose);
    statics.pose(pose);
    const Eigen::Index size = statics.size();
    const VectorXd u = 1e-3 * VectorXd::LinSpaced(size, 0, 40).array().sin();
    statics.linearize(u);
    const bool touches = statics.touches() > 0;
    CHECK(touches == (degrees > 90));
    const VectorXd gradient = statics.gradient();
    const SparseMatrix hessian = statics.hessian();
    CHECK(statics.value(u) == doctest::Approx(statics.energy()).epsilon(1e-12));
    const double h = 1e-7;
    for (int k = 0; k < 5; ++k) {
      const VectorXd d = (VectorXd::LinSpaced(size, k, 90 + 7 * k).array().cos()).matrix().normalized();
      const double slope = (statics.value(u + h * d) - statics.value(u - h * d)) / (2 * h);
      CHECK(gradient.dot(d) == doctest::Approx(slope).epsilon(1e-5));
      if (touches) continue;  // its Hessian has the tets' part alone
      statics.linearize(u + h * d);
      const VectorXd ahead = statics.gradient();
      statics.linearize(u - h * d);
      const VectorXd curve = (ahead - statics.gradient()) / (2 * h);
      CHECK((hessian * d - curve).norm() < 0.1 * curve.norm());  // little is left out where little bends
      CHECK(d.dot(hessian * d) >= (1 - 1e-5) * d.dot(curve));
    }
  }
}

TEST_CASE("a shape in a pose can be canceled, and bad input is refused") {
  const PosedBody body = bar();
  CHECK_THROWS_AS(shape_by_physics(body, bent(60, Vector3d::UnitY()), [](double done) { return done < 0.5; }),
                  Cancelled);
  CHECK_THROWS_AS(shape_by_physics(body, {}, {}), std::invalid_argument);
  PosedBody thin = body;
  thin.thickness(3) = 0;
  CHECK_THROWS_AS(shape_by_physics(thin, bent(60, Vector3d::UnitY()), {}), std::invalid_argument);
  std::vector<Transforms> broken = bent(60, Vector3d::UnitY());
  broken[1](0, 0) = std::nan("");
  CHECK_THROWS_AS(shape_by_physics(body, broken, {}), Error);
}
