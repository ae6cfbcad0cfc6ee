// SPDX-License-Identifier: GPL-3.0-or-later
// Points of the skin of every model: where they are, which forces act on the coordinates, and their rows.
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "scenes.hpp"
#include "skins.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

MatrixXd dense(const RowMajor& rows) { return rows; }
MatrixXd dense(const SparseRows& rows) {
  MatrixXd out = MatrixXd::Zero(rows.rows(), rows.parts.cols());
  for (Eigen::Index row = 0; row < out.rows(); ++row)
    for (int part = rows.first(row); part < rows.ends[std::size_t(row)]; ++part) out.row(row) += rows.parts.row(part);
  return out;
}

template <class Model>
void check_skin(std::shared_ptr<const Model> model) {
  const SkinMap<Model> map(model, skin_of(model->body(), 3));
  const Transforms bones = bent(0.9);
  const VectorXd w = Vector3d(0.2, 0.5, 0.3), q = random_vector(model->dofs(), 0.01, 3);

  // x = A (X + E u + R w) + a, from the nodes.
  const Skin& skin = map.skin();
  VectorXd u, x;
  model->displacement(q, u);
  const Points nodes = as_points(model->body().expand(u));
  const VectorXd residual = skin.residual_shapes * w;
  map.positions(bones, w, q, x);
  for (Eigen::Index p = 0; p < map.size(); ++p) {
    Vector3d bind = skin.rest.row(p).transpose() + residual.segment<3>(3 * p);
    for (int k = 0; k < 4; ++k)
      bind += skin.embedding.weights(p, k) * nodes.row(skin.embedding.nodes(p, k)).transpose();
    Vector3d expected = Vector3d::Zero();
    for (SkinWeights::InnerIterator b(skin.weights, p); b; ++b)
      expected += b.value() * (transform(bones, b.col()).leftCols<3>() * bind + transform(bones, b.col()).col(3));
    CHECK((x.segment<3>(3 * p) - expected).norm() < 1e-14);
  }
  CHECK((map.unmoved(bones, w, 1) -
         [&] {
           VectorXd at_zero;
           map.positions(bones, w, VectorXd::Zero(q.size()), at_zero);
           return Vector3d(at_zero.segment<3>(3));
         }())
            .norm() < 1e-15);

  // Virtual work: f . dx = (J^T f) . dq.
  const VectorXd forces = random_vector(x.size(), 1, 4), dq = random_vector(q.size(), 1, 5);
  VectorXd moved, pulled;
  map.positions(bones, w, q + dq, moved);
  map.pull_back(bones, forces, pulled);
  CHECK(forces.dot(moved - x) == doctest::Approx(pulled.dot(dq)).epsilon(1e-11));

  // Two numbers; one depends on two points.
  PointRows numbers, scratch;
  const Vector3d up(0.3, -1, 2), side(1, 0.5, 0);
  numbers.add_row();
  numbers.add(0, up);
  numbers.add_row();
  numbers.add(2, side);
  numbers.add(1, up);
  typename SkinMap<Model>::Rows rows;
  map.rows(bones, numbers, scratch, rows);
  const MatrixXd J = dense(rows);
  REQUIRE(J.rows() == 2);
  const VectorXd dx = moved - x;
  CHECK(J.row(0).dot(dq) == doctest::Approx(up.dot(dx.segment<3>(0))).epsilon(1e-11));
  CHECK(J.row(1).dot(dq) == doctest::Approx(side.dot(dx.segment<3>(6)) + up.dot(dx.segment<3>(3))).epsilon(1e-11));
}

}  // namespace

TEST_CASE("a skin's positions, forces and rows are those of its nodes, for every model") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  check_skin(std::make_shared<const FullModel>(body, all, MaterialModel::stvk, Blending::even));
  check_skin(reduced_model(body, all, MaterialModel::stvk, Blending::even, 12));
  check_skin(ResponseScene(body, all, MaterialModel::stvk, Blending::even).model);
}

TEST_CASE("a skin that does not fit its model is refused") {
  const auto body = two_bone_bar();
  const auto model = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 6);
  const auto refused = [&](const char* what, const auto& change) {
    Skin skin = skin_of(*body, 3);
    change(skin);
    CHECK_THROWS_WITH_AS(SkinMap<ReducedModel>(model, skin), doctest::Contains(what), std::invalid_argument);
  };
  refused("embedding: expected 3 rows", [](Skin& skin) { skin.embedding.nodes.conservativeResize(2, 4); });
  refused("embedding: it belongs to another mesh", [](Skin& skin) { skin.embedding.nodes(1, 2) = 100000; });
  refused("weights: expected 3 rows", [](Skin& skin) { skin.weights.resize(4, 2); });
  refused("weights: expected those of 2 bones, got 5", [](Skin& skin) { skin.weights.resize(3, 5); });
  refused("residual_shapes: expected those of 3 points and 3 targets",
          [](Skin& skin) { skin.residual_shapes.conservativeResize(9, 2); });
}
