// SPDX-License-Identifier: GPL-3.0-or-later
// How firmly the points of a skin press, against dense matrices.
#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "contact_skins.hpp"
#include "derivatives.hpp"
#include "dynamorph/contact/at_rest.hpp"
#include "dynamorph/contact/contact_law.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

const VectorXd kNeutral = Vector3d(1, 0, 0);
constexpr double kSquare = 4.0 / 9 / (96 * 96);  // (c h)^2, s^2

/// A model's matrices at its neutral target, dense, the rows of the samples' normals, and those of the vertices.
template <class Model>
struct DenseModel {
  MatrixXd K, M, J, vertices;

  DenseModel(const Model& model, const ContactSkin& skin) {
    const auto [tangent, mass] = stiffness_and_mass(model, kNeutral);
    VectorXd column;
    const SkinMap<Model> map(std::shared_ptr<const Model>(&model, [](const Model*) {}), skin.skin);
    const Eigen::Index n = model.dofs();
    K.resize(n, n);
    M.resize(n, n);
    J.setZero(skin.points.size(), n);
    vertices.resize(3 * map.size(), n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const VectorXd unit = VectorXd::Unit(n, i);
      multiply(tangent, unit, column);
      K.col(i) = column;
      multiply(mass, unit, column);
      M.col(i) = column;
      map.displacement(VectorXd::Zero(0), unit, column);
      vertices.col(i) = column;
      for (Eigen::Index p = 0; p < J.rows(); ++p)
        skin.points.each_corner(p, [&](int v, double weight) {
          J(p, i) += weight * skin.normals.row(p).normalized().dot(column.segment<3>(3 * v).transpose());
        });
    }
  }
  double stiffness(Eigen::Index sample, double square) const {
    const MatrixXd A = square > 0 ? MatrixXd(K + M / square) : K;
    const VectorXd j = J.row(sample);
    return 1 / j.dot(A.ldlt().solve(j));
  }
  /// How much of its stiffness a sample presses with: all on a mesh; with few coordinates none if that would move
  /// another one 1.7 times as far.
  double part(Eigen::Index sample) const {
    if (std::is_same_v<Model, FullModel>) return 1;
    const MatrixXd A = K + M / 100;  // a push of ten seconds
    const VectorXd answer = A.ldlt().solve(J.row(sample).transpose()), moved = vertices * answer;
    double farthest = 0;
    for (Eigen::Index v = 0; v < moved.size(); v += 3) farthest = std::max(farthest, moved.segment<3>(v).norm());
    return smooth_step((J.row(sample).dot(answer) / farthest - 0.6) / 0.05);
  }
};

template <class Model>
void check_stiffness(std::shared_ptr<const Model> model) {
  const ContactSkin skin = contact_faces_of(model->body(), 0.05);
  const ContactSamples<Model> samples(model, skin);
  const DenseModel<Model> dense(*model, skin);
  int held = 0, checked = 0, pressing = 0;
  for (Eigen::Index p = 0; p < samples.size(); ++p) {
    bool pinned = true;
    skin.points.each_corner(p, [&](int v, double) { pinned = pinned && skin.skin.rest(v, 0) < 1e-9; });
    if (pinned) {
      CHECK(samples.stiffness(p, kNeutral, kSquare) == 0);
      held += p < skin.skin.rest.rows();
    } else if (p % 7 == 0) {
      const double part = dense.part(p);
      CHECK(samples.stiffness()(p) == doctest::Approx(part * dense.stiffness(p, 0)).epsilon(1e-3));
      CHECK(samples.stiffness(p, kNeutral, kSquare) ==
            doctest::Approx(part * 30 * dense.stiffness(p, kSquare)).epsilon(1e-6));
      CHECK(
          samples.stiffness(p, Vector3d(0, 1, 0), kSquare) - samples.stiffness(p, kNeutral, kSquare) ==
          doctest::Approx(8 * 30 * samples.stiffness()(p)).epsilon(1e-6));  // mu is 9 times that of the neutral target
      ++checked;
      pressing += part > 0.5;
    }
  }
  CHECK(pressing > 0);
  CHECK(held == 9);
  CHECK(checked > 3);
}

}  // namespace

TEST_CASE("samples press with thirty times the stiffness that the body has at them, in a step and at rest") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  check_stiffness(std::make_shared<const FullModel>(body, all, MaterialModel::stable_stvk, Blending::even));
  check_stiffness(reduced_model(body, all, MaterialModel::stable_stvk, Blending::even, 10));
  check_stiffness(ResponseScene(body, all, MaterialModel::stable_stvk, Blending::even).model);
}

TEST_CASE("the normals of samples turn with their bones, and stay outside in a mirror") {
  const auto body = two_bone_bar();
  const auto model = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 8);
  ContactSkin skin = contact_skin_of(*body, 0.05);
  skin.normals *= 3;
  const ContactSamples<ReducedModel> samples(model, skin);
  Transforms bones(2, 12);
  Points normals(samples.size(), 3);
  const auto pose = [&](const Matrix3d& A) {
    for (int b = 0; b < 2; ++b)
      Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(bones.data() + 12 * b) << A, Vector3d(1, 2, 3);
    for (Eigen::Index p = 0; p < samples.size(); ++p)
      normals.row(p) = samples.normal(samples.map().skin().transform(bones, p), p);
  };
  const Points rest = skin.normals.rowwise().normalized();
  const Matrix3d turn = Eigen::AngleAxisd(0.7, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  pose(turn);
  CHECK((normals - rest * turn.transpose()).cwiseAbs().maxCoeff() < 1e-12);
  pose(Vector3d(-1, 1, 1).asDiagonal());
  CHECK((normals - rest * Vector3d(-1, 1, 1).asDiagonal()).cwiseAbs().maxCoeff() < 1e-12);
  pose(Vector3d(2, 1, 1).asDiagonal());  // a face across x keeps its normal, others lean away from x
  for (Eigen::Index p = 0; p < samples.size(); ++p) {
    const Vector3d expected = Vector3d(rest(p, 0) / 2, rest(p, 1), rest(p, 2)).normalized();
    CHECK((normals.row(p).transpose() - expected).norm() < 1e-12);
  }
  pose(Matrix3d::Zero());  // nowhere is outside: whatever they are, they are unit vectors
  CHECK((normals.rowwise().norm().array() - 1).abs().maxCoeff() < 1e-12);
}

TEST_CASE("the laws of contact: forces and stiffness are derivatives of their energies") {
  constexpr double width = 0.3, e = 1e-6;
  for (double depth : {-0.1, 0.05, 0.2, 0.299, 0.301, 2.0}) {
    const ContactRamp at = contact_ramp(depth, width), less = contact_ramp(depth - e, width),
                      more = contact_ramp(depth + e, width);
    CHECK((more.energy - less.energy) / (2 * e) == doctest::Approx(at.force).epsilon(1e-6));
    CHECK((more.force - less.force) / (2 * e) == doctest::Approx(at.stiffness).epsilon(1e-4));
  }
  CHECK(contact_ramp(0, width).energy == 0);
  CHECK(contact_ramp(width, width).stiffness == 1);
  for (double slip : {0.01, 0.2, 0.299, 0.301, 2.0}) {
    const SmoothedSlip at = smoothed_slip(slip, width), less = smoothed_slip(slip - e, width),
                       more = smoothed_slip(slip + e, width);
    CHECK((more.energy - less.energy) / (2 * e) == doctest::Approx(at.force(slip)).epsilon(1e-6));
    CHECK((more.compliance - less.compliance) / (2 * e) == doctest::Approx(at.slope).epsilon(1e-4));
    CHECK(at.force(slip) <= 1);
  }
  CHECK(smoothed_slip(0, width).energy == 0);
  CHECK(smoothed_slip(2 * width, width).force(2 * width) == 1);
}

TEST_CASE("the stiffness of friction is that of its law at first, and grows where Newton's method overshoots") {
  constexpr double width = 0.3, e = 1e-6;
  const auto force = [&](const Eigen::Vector2d& y) -> Eigen::Vector2d {
    return y / smoothed_slip(y.norm(), width).compliance;
  };
  const auto matrix = [](const SlipForce::Stiffness& s) -> Eigen::Matrix2d {
    const Eigen::Vector2d across(-s.direction.y(), s.direction.x());
    return s.along * s.direction * s.direction.transpose() + s.across * across * across.transpose();
  };
  SlipForce slip;
  for (const Eigen::Vector2d& y : {Eigen::Vector2d(0.1, -0.2), Eigen::Vector2d(0.3, 0.5), Eigen::Vector2d(0, 0)}) {
    slip.begin();
    const Eigen::Matrix2d stiffness = matrix(slip.follow(y, width));
    for (int axis = 0; axis < 2; ++axis) {
      const Eigen::Vector2d moved = e * Eigen::Vector2d::Unit(axis);
      const Eigen::Vector2d expected = (force(y + moved) - force(y - moved)) / (2 * e);
      CHECK((stiffness.col(axis) - expected).norm() < 1e-5 * stiffness.norm());
    }
  }
  slip.begin();
  slip.follow(Eigen::Vector2d(2, 0), width);
  const SlipForce::Stiffness over = slip.follow(Eigen::Vector2d(-3, 0), width);
  CHECK(matrix(over)(0, 0) == doctest::Approx(2.0 / 3));                   // 0 beyond the width by the law itself
  for (int i = 0; i < 3; ++i) slip.follow(Eigen::Vector2d(-3, 0), width);  // where it stays it is the law's again
  CHECK(matrix(slip.follow(Eigen::Vector2d(-3, 0), width))(0, 0) == doctest::Approx(0));
}

TEST_CASE("samples that do not fit are refused") {
  const auto body = two_bone_bar();
  const auto model = reduced_model(body, targets(*body), MaterialModel::linear, Blending::even, 8);
  const auto refused = [&](const char* what, auto change) {
    ContactSkin skin = contact_skin_of(*body, 0.05);
    change(skin);
    CHECK_THROWS_WITH_AS(ContactSamples<ReducedModel>(model, skin), doctest::Contains(what), std::invalid_argument);
  };
  refused("thickness: must be finite and above zero", [](ContactSkin& s) { s.thickness(0) = 0; });
  refused("thickness: must be finite and above zero", [](ContactSkin& s) { s.thickness(0) = kInfinity; });
  refused("thickness: expected", [](ContactSkin& s) { s.thickness.setOnes(1); });
  refused("normals: must be finite and longer than zero", [](ContactSkin& s) { s.normals.row(0).setZero(); });
  refused("normals: must be finite and longer than zero", [](ContactSkin& s) { s.normals(0, 0) = NAN; });
  refused("normals: expected", [](ContactSkin& s) { s.normals = s.normals.topRows(1).eval(); });
  refused("embedding: it belongs to another mesh", [](ContactSkin& s) { s.skin.embedding.nodes(0, 0) = 1 << 20; });
}
