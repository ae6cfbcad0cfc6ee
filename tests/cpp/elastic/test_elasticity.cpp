// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "elastic/laws.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

TEST_CASE("element laws: stress is the derivative of the energy, stiffness of the force") {
  const TetMesh mesh = scenes::bar(1, 1, 1, 0.1);
  const RestShape shape = rest_shape(mesh, random_vector(24, 0.01, 1), VectorXd::Ones(6));
  const Element& element = shape.elements[2];
  const Lame lame{3e4, 1e4};
  for (MaterialModel material_model : kMaterialModels)
    check_derivatives(
        [&](const VectorXd& x, VectorXd& f, VectorXd& Kd, const VectorXd& d) {
          const Matrix3d F = deformation_gradient(element, Eigen::Map<const Eigen::Matrix<double, 3, 4>>(x.data()));
          const ElementForce force = element.weight * stress(material_model, lame, F) * element.gradients;
          f = Eigen::Map<const VectorXd>(force.data(), 12);
          ElementStiffness K;
          element_stiffness(material_model, lame, element, F, K);
          Kd = K * d;
          return element.weight * energy_density(material_model, lame, F);
        },
        random_vector(12, 0.03, 2), 1e-5);
}

TEST_CASE("element laws: energy is zero at the rest shape, also for an element that had to fall back") {
  const TetMesh mesh = scenes::bar(1, 1, 1, 0.1);
  VectorXd d = random_vector(24, 0.01, 3);
  d(3 * mesh.tets(0, 3) + 2) -= 0.3;  // turns tets inside out
  const RestShape shape = rest_shape(mesh, d, VectorXd::Ones(6));
  CHECK(shape.fallbacks > 0);
  CHECK(shape.fallbacks < 6);
  for (size_t e = 0; e < 6; ++e) {
    Eigen::Matrix<double, 3, 4> u;
    for (int a = 0; a < 4; ++a) u.col(a) = d.segment<3>(3 * mesh.tets(Eigen::Index(e), a));
    const Matrix3d F = deformation_gradient(shape.elements[e], u);
    CHECK((F - Matrix3d::Identity()).norm() < 1e-10);
    for (MaterialModel material_model : kMaterialModels)
      CHECK(std::abs(energy_density(material_model, {1, 1}, F)) < 1e-10);
  }
}

TEST_CASE("stable StVK resists inversion, and has StVK's stiffness at rest") {
  const Lame lame{2e4, 1e4};
  const Matrix3d mirrored = Vector3d(-1, 1, 1).asDiagonal();
  CHECK(energy_density(MaterialModel::stvk, lame, mirrored) == doctest::Approx(0));
  CHECK(energy_density(MaterialModel::stable_stvk, lame, mirrored) == doctest::Approx(2 * lame.mu));
  const TetMesh mesh = scenes::bar(1, 1, 1, 0.1);
  const RestShape shape = rest_shape(mesh, VectorXd::Zero(24), VectorXd::Ones(6));
  ElementStiffness linear, stvk, stable;
  element_stiffness(MaterialModel::linear, lame, shape.elements[0], Matrix3d::Identity(), linear);
  element_stiffness(MaterialModel::stvk, lame, shape.elements[0], Matrix3d::Identity(), stvk);
  element_stiffness(MaterialModel::stable_stvk, lame, shape.elements[0], Matrix3d::Identity(), stable);
  CHECK((stvk - linear).norm() < 1e-12 * linear.norm());
  CHECK((stable - linear).norm() < 1e-12 * linear.norm());
}
