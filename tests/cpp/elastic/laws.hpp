// SPDX-License-Identifier: GPL-3.0-or-later
// The element laws of elasticity.hpp, one element at a time and as they are written on paper: what the engine's kernels
// are compared with. Their own derivatives are checked by finite differences (test_elasticity.cpp).
#pragma once

#include "dynamorph/elastic/elasticity.hpp"

namespace dynamorph {

using ElementStiffness = Eigen::Matrix<double, 12, 12>;
using ElementForce = Eigen::Matrix<double, 3, 4>;  ///< column a acts on node a

/// F of an element whose nodes are displaced by the columns of u (3 x 4).
inline Matrix3d deformation_gradient(const Element& element, const Eigen::Matrix<double, 3, 4>& u) {
  return element.origin + u * element.gradients.transpose();
}

inline Matrix3d linear_strain(const Matrix3d& F) { return 0.5 * (F + F.transpose()) - Matrix3d::Identity(); }

/// 1/2 (F^T F - I) by G = F - I, which does not cancel near rest.
inline Matrix3d green_strain(const Matrix3d& F) {
  const Matrix3d G = F - Matrix3d::Identity();
  return 0.5 * (G + G.transpose() + G.transpose() * G);
}

/// tr E - det F + 1, likewise.
inline double stabilizer(const Matrix3d& F) {
  const Matrix3d G = F - Matrix3d::Identity();
  const double trace = G.trace();
  return 0.5 * (G.squaredNorm() - trace * trace + G.cwiseProduct(G.transpose()).sum()) - G.determinant();
}

inline Matrix3d hooke(const Lame& lame, const Matrix3d& strain) {
  return lame.lambda * strain.trace() * Matrix3d::Identity() + 2 * lame.mu * strain;
}

/// The stable law is StVK with (lambda + mu, 0) and a remainder mu (tr E - det F + 1).
inline Lame stvk_part(MaterialModel material_model, const Lame& lame) {
  return material_model == MaterialModel::stable_stvk ? Lame{lame.lambda + lame.mu, 0} : lame;
}

inline Matrix3d cofactor(const Matrix3d& F) {
  Matrix3d C;
  C.col(0) = F.col(1).cross(F.col(2));
  C.col(1) = F.col(2).cross(F.col(0));
  C.col(2) = F.col(0).cross(F.col(1));
  return C;
}

inline Matrix3d cross_matrix(const Vector3d& c) {
  Matrix3d m;
  m << 0, -c.z(), c.y(), c.z(), 0, -c.x(), -c.y(), c.x(), 0;
  return m;
}

/// Energy density, J/m^3.
inline double energy_density(MaterialModel material_model, const Lame& lame, const Matrix3d& F) {
  const Matrix3d strain = material_model == MaterialModel::linear ? linear_strain(F) : green_strain(F);
  const Lame part = stvk_part(material_model, lame);
  const double trace = strain.trace();
  double density = 0.5 * part.lambda * trace * trace + part.mu * strain.squaredNorm();
  if (material_model == MaterialModel::stable_stvk) density += lame.mu * stabilizer(F);
  return density;
}

/// First Piola-Kirchhoff stress, Pa.
inline Matrix3d stress(MaterialModel material_model, const Lame& lame, const Matrix3d& F) {
  if (material_model == MaterialModel::linear) return hooke(lame, linear_strain(F));
  Matrix3d P = F * hooke(stvk_part(material_model, lame), green_strain(F));
  if (material_model == MaterialModel::stable_stvk) P += lame.mu * (F - cofactor(F));
  return P;
}

/// d(force)/du of one element, force = +dE/du, node-major 12 x 12.
inline void element_stiffness(MaterialModel material_model, const Lame& lame, const Element& element, const Matrix3d& F,
                              ElementStiffness& K) {
  // The linear law's stiffness is StVK's at the rest shape.
  const bool linear = material_model == MaterialModel::linear;
  const Matrix3d G = linear ? Matrix3d::Identity() : F;
  const Lame part = stvk_part(material_model, lame);
  const Matrix3d S = linear ? Matrix3d(Matrix3d::Zero()) : hooke(part, green_strain(F));
  const double kappa = material_model == MaterialModel::stable_stvk ? lame.mu : 0;

  const Eigen::Matrix<double, 3, 4>& g = element.gradients;
  const Eigen::Matrix<double, 3, 4> Gg = G * g;
  const Eigen::Matrix4d gg = g.transpose() * g;
  const Eigen::Matrix4d geometric = g.transpose() * S * g + kappa * gg;
  const Matrix3d GGt = G * G.transpose();
  for (int b = 0; b < 4; ++b) {
    for (int a = 0; a <= b; ++a) {
      Matrix3d block = geometric(a, b) * Matrix3d::Identity() + part.lambda * Gg.col(a) * Gg.col(b).transpose();
      if (part.mu != 0) block += part.mu * (Gg.col(b) * Gg.col(a).transpose() + gg(a, b) * GGt);
      // d2(det F) = u_a . (u_b x F (g_a x g_b)), and the law holds -kappa det F.
      if (kappa != 0) block += kappa * cross_matrix(G * g.col(a).cross(g.col(b)));
      K.block<3, 3>(3 * a, 3 * b) = element.weight * block;
      if (a != b) K.block<3, 3>(3 * b, 3 * a) = element.weight * block.transpose();
    }
  }
}

}  // namespace dynamorph
