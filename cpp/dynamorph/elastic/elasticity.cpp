// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/elasticity.hpp"

#include <Eigen/SVD>
#include <stdexcept>
#include <string>

namespace dynamorph {

namespace {

Matrix3d edges(const Points& x, const Tets& tets, Eigen::Index e) {
  Matrix3d D;
  for (int a = 0; a < 3; ++a) D.col(a) = (x.row(tets(e, a + 1)) - x.row(tets(e, 0))).transpose();
  return D;
}

Matrix3d linear_strain(const Matrix3d& F) { return 0.5 * (F + F.transpose()) - Matrix3d::Identity(); }

/// 1/2 (F^T F - I) by G = F - I, which does not cancel near rest.
Matrix3d green_strain(const Matrix3d& F) {
  const Matrix3d G = F - Matrix3d::Identity();
  return 0.5 * (G + G.transpose() + G.transpose() * G);
}

/// tr E - det F + 1, likewise.
double stabilizer(const Matrix3d& F) {
  const Matrix3d G = F - Matrix3d::Identity();
  const double trace = G.trace();
  return 0.5 * (G.squaredNorm() - trace * trace + G.cwiseProduct(G.transpose()).sum()) - G.determinant();
}

Matrix3d hooke(const Lame& lame, const Matrix3d& strain) {
  return lame.lambda * strain.trace() * Matrix3d::Identity() + 2 * lame.mu * strain;
}

/// The stable law is StVK with (lambda + mu, 0) and a remainder mu (tr E - det F + 1).
Lame stvk_part(Law law, const Lame& lame) { return law == Law::stable_stvk ? Lame{lame.lambda + lame.mu, 0} : lame; }

Matrix3d cofactor(const Matrix3d& F) {
  Matrix3d C;
  C.col(0) = F.col(1).cross(F.col(2));
  C.col(1) = F.col(2).cross(F.col(0));
  C.col(2) = F.col(0).cross(F.col(1));
  return C;
}

Matrix3d cross_matrix(const Vector3d& c) {
  Matrix3d m;
  m << 0, -c.z(), c.y(), c.z(), 0, -c.x(), -c.y(), c.x(), 0;
  return m;
}

}  // namespace

void check(Law law) {
  if (law != Law::linear && law != Law::stvk && law != Law::stable_stvk)
    throw std::invalid_argument("law: expected one of Law's values, got " + std::to_string(int(law)));
}

RestShape rest_shape(const TetMesh& mesh, const VectorXd& displacement, const VectorXd& scale, bool shifted) {
  const Points& X = mesh.nodes;
  const Points x = X + as_points(displacement);
  RestShape shape;
  shape.elements.resize(mesh.tets.rows());
  for (Eigen::Index e = 0; e < mesh.tets.rows(); ++e) {
    const Matrix3d neutral = edges(X, mesh.tets, e);
    const Matrix3d deformed = edges(x, mesh.tets, e);
    const Matrix3d map = deformed * neutral.inverse();
    const double ratio = map.determinant();
    const bool usable = ratio >= 0.2 && ratio <= 5 && Eigen::JacobiSVD<Matrix3d>(map).singularValues()(2) >= 0.2;
    const bool own = usable && !shifted;
    const Matrix3d& rest = own ? deformed : neutral;
    Element& element = shape.elements[e];
    element.gradients.rightCols<3>() = rest.inverse().transpose();
    element.gradients.col(0) = -element.gradients.rightCols<3>().rowwise().sum();
    element.weight = rest.determinant() / 6 * scale(e);
    // F(d) = I. With the deformed rest shape F0 = D(X) D(X+d)^-1; with the neutral one F0 = I - grad d.
    element.origin = own ? Matrix3d(neutral * deformed.inverse()) : Matrix3d(2 * Matrix3d::Identity() - map);
    shape.fallbacks += !usable && !shifted;
  }
  return shape;
}

double energy_density(Law law, const Lame& lame, const Matrix3d& F) {
  const Matrix3d strain = law == Law::linear ? linear_strain(F) : green_strain(F);
  const Lame part = stvk_part(law, lame);
  const double trace = strain.trace();
  double density = 0.5 * part.lambda * trace * trace + part.mu * strain.squaredNorm();
  if (law == Law::stable_stvk) density += lame.mu * stabilizer(F);
  return density;
}

Matrix3d stress(Law law, const Lame& lame, const Matrix3d& F) {
  if (law == Law::linear) return hooke(lame, linear_strain(F));
  Matrix3d P = F * hooke(stvk_part(law, lame), green_strain(F));
  if (law == Law::stable_stvk) P += lame.mu * (F - cofactor(F));
  return P;
}

void element_stiffness(Law law, const Lame& lame, const Element& element, const Matrix3d& F, ElementStiffness& K) {
  // The linear law's stiffness is StVK's at the rest shape.
  const bool linear = law == Law::linear;
  const Matrix3d G = linear ? Matrix3d::Identity() : F;
  const Lame part = stvk_part(law, lame);
  const Matrix3d S = linear ? Matrix3d(Matrix3d::Zero()) : hooke(part, green_strain(F));
  const double kappa = law == Law::stable_stvk ? lame.mu : 0;

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

VectorXd lumped_volumes(const TetMesh& mesh, const VectorXd& fill) {
  VectorXd volumes = VectorXd::Zero(mesh.nodes.rows());
  for (Eigen::Index e = 0; e < mesh.tets.rows(); ++e) {
    const double quarter = edges(mesh.nodes, mesh.tets, e).determinant() / 24 * fill(e);
    for (int a = 0; a < 4; ++a) volumes(mesh.tets(e, a)) += quarter;
  }
  return volumes;
}

}  // namespace dynamorph
