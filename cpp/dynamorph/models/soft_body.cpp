// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/soft_body.hpp"

#include "dynamorph/core/errors.hpp"
#include "dynamorph/elastic/elasticity.hpp"

namespace dynamorph {

SoftBody::SoftBody(TetMesh mesh_, VectorXd fill_, const VectorXd& stiffness, MatrixXd region_weights_,
                   const std::vector<bool>& pinned, const Eigen::Ref<const MatrixXd>& weights, const VectorXd& hold)
    : mesh(std::move(mesh_)), fill(std::move(fill_)), region_weights(std::move(region_weights_)) {
  const Eigen::Index n = mesh.nodes.rows(), m = mesh.tets.rows();
  check_size("fill", fill.size(), m);
  check_size("stiffness", stiffness.size(), m);
  check_size("region_weights", region_weights.rows(), m);
  check_size("pinned", Eigen::Index(pinned.size()), n);
  check_size("weights", weights.rows(), n);
  if (!(fill.array() > 0).all() || !(stiffness.array() > 0).all())
    throw std::invalid_argument("fill, stiffness: must be positive for every tetrahedron");
  if (!((region_weights.array() >= 0).all() && ((region_weights.rowwise().sum().array() - 1).abs() < 1e-6).all()))
    throw std::invalid_argument("region_weights: every row must be >= 0 and sum to one");
  if (!stiffness.allFinite() || !fill.allFinite())
    throw std::invalid_argument("fill, stiffness: must be finite for every tetrahedron");
  if (hold.size() > 0) check_size("hold", hold.size(), m);
  if (!hold.allFinite() || (hold.array() < 0).any())
    throw std::invalid_argument("hold: must be finite and not negative for every tetrahedron");
  stiffness_scale = fill.cwiseProduct(stiffness);
  free_of_node.assign(n, -1);
  for (int i = 0; i < n; ++i)
    if (!pinned[i]) {
      free_of_node[i] = int(free_nodes.size());
      free_nodes.push_back(i);
    }
  if (free_nodes.empty())
    throw Error("Every node of the cage is pinned to a bone. Pin fewer nodes, or raise the cage resolution.");

  const Eigen::Index f = Eigen::Index(free_nodes.size());
  own_transforms = weights.cols() == 0;
  if (own_transforms) {
    skin.resize(f, f);
    skin.setIdentity();
  } else {
    MatrixXd free_weights(f, weights.cols());
    for (Eigen::Index i = 0; i < f; ++i) free_weights.row(i) = weights.row(free_nodes[i]);
    skin = normalized(free_weights);
  }
  rest = restrict_to_free(flat(mesh.nodes));
  const auto lumped = [&](const VectorXd& density) {
    MatrixXd out(f, sets());
    for (int s = 0; s < sets(); ++s) {
      const VectorXd all = lumped_volumes(mesh, density.cwiseProduct(region_weights.col(s)));
      for (Eigen::Index i = 0; i < f; ++i) out(i, s) = all(free_nodes[i]);
    }
    return out;
  };
  volumes = lumped(fill);
  if ((hold.array() > 0).any()) hold_stiffness = lumped(stiffness_scale.cwiseProduct(hold));
  volume = volumes.sum();
  center.setZero();
  for (Eigen::Index i = 0; i < f; ++i) center += volumes.row(i).sum() / volume * rest.segment<3>(3 * i);
  moments.assign(skin.cols(), Eigen::Matrix4d::Zero());
  for (Eigen::Index i = 0; i < f; ++i) {
    const Eigen::Vector4d p = (rest.segment<3>(3 * i) - center).homogeneous();
    for (SkinWeights::InnerIterator b(skin, i); b; ++b)
      moments[b.col()] += volumes.row(i).sum() * b.value() * p * p.transpose();
  }
  size = (mesh.nodes.colwise().maxCoeff() - mesh.nodes.colwise().minCoeff()).norm();
}

VectorXd SoftBody::unit_mass() const { return at_coordinates(volumes.rowwise().sum()); }

VectorXd SoftBody::restrict_to_free(const VectorXd& node_values) const {
  VectorXd out(3 * free_nodes.size());
  for (size_t i = 0; i < free_nodes.size(); ++i) out.segment<3>(3 * i) = node_values.segment<3>(3 * free_nodes[i]);
  return out;
}

VectorXd SoftBody::expand(const VectorXd& free_values) const {
  VectorXd out = VectorXd::Zero(3 * free_of_node.size());
  for (size_t i = 0; i < free_nodes.size(); ++i) out.segment<3>(3 * free_nodes[i]) = free_values.segment<3>(3 * i);
  return out;
}

}  // namespace dynamorph
