// SPDX-License-Identifier: GPL-3.0-or-later
// The full model: its vectorized assembly against the element laws, one element at a time, and its stiffness at rest.
#include <doctest/doctest.h>

#include "derivatives.hpp"
#include "dynamorph/elastic/sparse_solver.hpp"
#include "elastic/laws.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

struct Reference {
  double energy = 0;
  VectorXd force;
  MatrixXd stiffness;
};

/// sum_j w_j E_j over all nodes' degrees of freedom by the laws of laws.hpp, restricted to the free ones.
Reference element_by_element(const FullModel& model, const VectorXd& w, const VectorXd& q) {
  const SoftBody& body = model.body();
  VectorXd blended = VectorXd::Zero(model.dofs());
  for (Eigen::Index j = 0; j < w.size(); ++j) blended += w(j) * model.target(int(j));
  Reference out{0, VectorXd::Zero(model.dofs()), MatrixXd::Zero(model.dofs(), model.dofs())};
  for (Eigen::Index j = 0; j < w.size(); ++j) {
    const VectorXd own = model.blending() == Blending::even ? VectorXd(q - blended + model.target(int(j))) : q;
    const VectorXd all = body.expand(own);
    const Lame& lame = model.targets()[j].lame;
    for (Eigen::Index e = 0; e < body.mesh.tets.rows(); ++e) {
      const Element& element = model.shape(int(j)).elements[e];
      Eigen::Matrix<double, 3, 4> u;
      for (int a = 0; a < 4; ++a) u.col(a) = all.segment<3>(3 * body.mesh.tets(e, a));
      const Matrix3d F = deformation_gradient(element, u);
      out.energy += w(j) * element.weight * energy_density(model.material_model(), lame, F);
      const ElementForce f = w(j) * element.weight * stress(model.material_model(), lame, F) * element.gradients;
      ElementStiffness K;
      element_stiffness(model.material_model(), lame, element, F, K);
      for (int a = 0; a < 4; ++a) {
        const int i = body.free_of_node[body.mesh.tets(e, a)];
        if (i < 0) continue;
        out.force.segment<3>(3 * i) += f.col(a);
        for (int b = 0; b < 4; ++b) {
          const int k = body.free_of_node[body.mesh.tets(e, b)];
          if (k >= 0) out.stiffness.block<3, 3>(3 * i, 3 * k) += w(j) * K.block<3, 3>(3 * a, 3 * b);
        }
      }
    }
  }
  return out;
}

}  // namespace

TEST_CASE("full model: energy, force and stiffness are the sums of the element laws") {
  const auto body = scenes::two_bone_bar(2);
  std::srand(5);
  for (MaterialModel material_model : {MaterialModel::linear, MaterialModel::stvk, MaterialModel::stable_stvk})
    for (Blending blending : {Blending::forces, Blending::even}) {
      const FullModel model(body, scenes::targets(*body, 1), material_model, blending);
      const VectorXd q = 0.01 * VectorXd::Random(model.dofs());
      FullModel::Blend blend;
      for (const Vector3d& w : {Vector3d(0.3, 0.7, 1), Vector3d(0, 1, 0), Vector3d(0.3, 0.7, 1)}) {
        model.blend(w, blend);
        const Reference expected = element_by_element(model, w, q);
        VectorXd force;
        SparseMatrix stiffness;
        const double energy = model.linearize(blend, q, force, stiffness);
        CHECK(std::abs(energy - expected.energy) < 1e-11 * expected.energy);
        CHECK(std::abs(model.energy(blend, q) - energy) < 1e-11 * energy);
        CHECK((force - expected.force).norm() < 1e-11 * expected.force.norm());
        CHECK((MatrixXd(stiffness) - expected.stiffness).norm() < 1e-11 * expected.stiffness.norm());
        VectorXd image;
        multiply_symmetric(stiffness, q, image);
        CHECK((image - expected.stiffness * q).norm() < 1e-11 * image.norm());
      }
    }
}

TEST_CASE("full model: every call gives the same digits") {
  const auto body = scenes::two_bone_bar();
  const FullModel model(body, scenes::targets(*body), MaterialModel::stable_stvk, Blending::even);
  const VectorXd q = 0.01 * VectorXd::Random(model.dofs());
  FullModel::Blend blend;
  model.blend(Vector3d(0.5, 0.2, 0.3), blend);
  VectorXd force, again;
  SparseMatrix K, K_again;
  const double energy = model.linearize(blend, q, force, K);
  for (int repeat = 0; repeat < 20; ++repeat) {
    CHECK(model.linearize(blend, q, again, K_again) == energy);
    CHECK(again == force);
    CHECK(values(K_again) == values(K));
  }
}

TEST_CASE("a shifted target has the neutral's stiffness about its own shape") {
  const auto body = scenes::two_bone_bar();
  auto targets = scenes::targets(*body);
  for (MorphTarget& target : targets) {
    target.lame = targets[0].lame;
    target.shifted = true;
  }
  for (MaterialModel material_model : kMaterialModels) {
    const FullModel model(body, targets, material_model, Blending::even);
    for (int j = 0; j < int(targets.size()); ++j) {
      CHECK(model.shape(j).fallbacks == 0);
      VectorXd w = VectorXd::Zero(targets.size()), force;
      SparseMatrix stiffness;
      w(j) = 1;
      FullModel::Blend blend;
      model.blend(w, blend);
      CHECK(std::abs(model.linearize(blend, model.target(j), force, stiffness)) < 1e-12);
      const VectorXd neutral = values(model.rest_stiffness(0));
      CHECK((values(stiffness) - neutral).norm() < 1e-9 * neutral.norm());
    }
  }
}

TEST_CASE("between targets the stiffness at rest is positive definite for random weights") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  for (MaterialModel material_model : kMaterialModels) {
    const FullModel model(body, targets, material_model, Blending::even);
    for (unsigned seed = 0; seed < 5; ++seed) {
      VectorXd w = random_vector(3, 1, seed).cwiseAbs();
      w /= w.sum();
      FullModel::Blend blend;
      model.blend(w, blend);
      VectorXd f;
      SparseMatrix K = model.zero();
      model.linearize(blend, blend.displacement, f, K);
      CHECK(f.norm() < 1e-8 * K.norm());
      CHECK(Eigen::LLT<MatrixXd>(MatrixXd(K)).info() == Eigen::Success);
    }
  }
}
