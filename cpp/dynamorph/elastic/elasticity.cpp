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

}  // namespace

void check(MaterialModel material_model) {
  if (material_model != MaterialModel::linear && material_model != MaterialModel::stvk &&
      material_model != MaterialModel::stable_stvk)
    throw std::invalid_argument("material_model: expected one of MaterialModel's values, got " +
                                std::to_string(int(material_model)));
}

namespace {

/// map: from the neutral shape of a tet to another one.
bool is_usable(const Matrix3d& map) {
  const double ratio = map.determinant();
  return ratio >= 0.2 && ratio <= 5 && Eigen::JacobiSVD<Matrix3d>(map).singularValues()(2) >= 0.2;
}

}  // namespace

std::vector<bool> usable(const TetMesh& mesh, const VectorXd& displacement) {
  const Points x = mesh.nodes + as_points(displacement);
  std::vector<bool> out;
  for (Eigen::Index e = 0; e < mesh.tets.rows(); ++e)
    out.push_back(is_usable(edges(x, mesh.tets, e) * edges(mesh.nodes, mesh.tets, e).inverse()));
  return out;
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
    const bool usable = is_usable(map), about_shape = usable && !shifted;
    const Matrix3d& rest = about_shape ? deformed : neutral;
    Element& element = shape.elements[e];
    element.gradients = gradients_of(rest);
    element.weight = rest.determinant() / 6 * scale(e);
    // Either way F(d) = I. The deformed rest shape gives F0 = D(X) D(X+d)^-1, the neutral one F0 = I - grad d.
    element.origin = about_shape ? Matrix3d(neutral * deformed.inverse()) : Matrix3d(2 * Matrix3d::Identity() - map);
    shape.fallbacks += !usable && !shifted;
  }
  return shape;
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
