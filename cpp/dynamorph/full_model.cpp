// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/full_model.hpp"

#include <Eigen/SparseCholesky>
#include <array>

namespace dynamorph {

namespace {

void check_size(const char* name, Eigen::Index actual, Eigen::Index expected) {
  if (actual != expected)
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(expected) + " rows, got " +
                                std::to_string(actual));
}

}  // namespace

SoftBody::SoftBody(TetMesh mesh_, VectorXd fill_, const VectorXd& stiffness, MatrixXd shares_,
                   const std::vector<bool>& pinned, const Eigen::Ref<const MatrixXd>& weights)
    : mesh(std::move(mesh_)), fill(std::move(fill_)), shares(std::move(shares_)) {
  const Eigen::Index n = mesh.nodes.rows(), m = mesh.tets.rows();
  check_size("fill", fill.size(), m);
  check_size("stiffness", stiffness.size(), m);
  check_size("shares", shares.rows(), m);
  check_size("pinned", Eigen::Index(pinned.size()), n);
  check_size("weights", weights.rows(), n);
  if (!(fill.array() > 0).all() || !(stiffness.array() > 0).all())
    throw std::invalid_argument("fill, stiffness: must be positive for every tetrahedron");
  if (!((shares.array() >= 0).all() && ((shares.rowwise().sum().array() - 1).abs() < 1e-6).all()))
    throw std::invalid_argument("shares: every row must be >= 0 and sum to one");
  if (!stiffness.allFinite() || !fill.allFinite())
    throw std::invalid_argument("fill, stiffness: must be finite for every tetrahedron");
  stiffness_scale = fill.cwiseProduct(stiffness);
  free_of_node.assign(n, -1);
  for (int i = 0; i < n; ++i)
    if (!pinned[i]) {
      free_of_node[i] = int(free_nodes.size());
      free_nodes.push_back(i);
    }
  if (free_nodes.empty())
    throw Error("every node of the cage is held by a bone: lower the bone pinning or raise the cage resolution");

  const Eigen::Index f = Eigen::Index(free_nodes.size());
  MatrixXd free_weights(f, weights.cols());
  for (Eigen::Index i = 0; i < f; ++i) free_weights.row(i) = weights.row(free_nodes[i]);
  skin = normalized(free_weights);
  rest = restrict_to_free(flat(mesh.nodes));
  volumes.resize(f, sets());
  for (int s = 0; s < sets(); ++s) {
    const VectorXd all = lumped_volumes(mesh, fill.cwiseProduct(shares.col(s)));
    for (Eigen::Index i = 0; i < f; ++i) volumes(i, s) = all(free_nodes[i]);
  }
  centre.setZero();
  for (Eigen::Index i = 0; i < f; ++i) centre += volumes.row(i).sum() / volumes.sum() * rest.segment<3>(3 * i);
  moments.assign(skin.cols(), Eigen::Matrix4d::Zero());
  for (Eigen::Index i = 0; i < f; ++i) {
    const Eigen::Vector4d p = (rest.segment<3>(3 * i) - centre).homogeneous();
    for (SkinWeights::InnerIterator b(skin, i); b; ++b)
      moments[b.col()] += volumes.row(i).sum() * b.value() * p * p.transpose();
  }
  size = (mesh.nodes.colwise().maxCoeff() - mesh.nodes.colwise().minCoeff()).norm();
}

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

void SetDensities::blend(const std::vector<MorphTarget>& targets, int sets, const VectorXd& w) {
  density.setZero(sets);
  damped.setZero(sets);
  for (size_t j = 0; j < targets.size(); ++j) {
    density(targets[j].set) += w(j) * targets[j].density;
    damped(targets[j].set) += w(j) * targets[j].density * targets[j].mass_damping;
  }
}

FullModel::FullModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, Law law, Blending blending)
    : body_(std::move(body)), targets_(std::move(targets)), law_(law), blending_(blending) {
  if (targets_.empty()) throw std::invalid_argument("targets: at least one is needed");
  build_pattern();
  for (const MorphTarget& target : targets_) {
    if (target.set < 0 || target.set >= body_->sets())
      throw std::invalid_argument("targets: '" + target.name + "' is in set " + std::to_string(target.set) +
                                  ", there are " + std::to_string(body_->sets()));
    check_size("displacement", target.displacement.size(), body_->mesh.nodes.size());
    if (!target.displacement.allFinite()) throw Error("target '" + target.name + "' has a shape that is not finite");
    const double properties =
        target.lame.mu + target.lame.lambda + target.density + target.mass_damping + target.stiffness_damping;
    if (!(target.lame.mu > 0 && target.lame.lambda >= 0 && target.density > 0 && target.mass_damping >= 0 &&
          target.stiffness_damping >= 0 && std::isfinite(properties)))
      throw std::invalid_argument("targets: '" + target.name + "' needs finite stiffness and density above zero");
    const VectorXd d = body_->restrict_to_free(target.displacement);
    if (body_->expand(d) != target.displacement)
      throw std::invalid_argument("targets: '" + target.name + "' displaces pinned nodes");
    rest_displacements_.push_back(d);
    shapes_.push_back(rest_shape(body_->mesh, target.displacement,
                                 body_->stiffness_scale.cwiseProduct(body_->shares.col(target.set)), target.shifted));
    Matrix K = zero();
    ElementStiffness block;
    for (Eigen::Index e = 0; e < body_->mesh.tets.rows(); ++e) {
      element_stiffness(law_, target.lame, shapes_.back().elements[e], Matrix3d::Identity(), block);
      scatter(e, block, 1, K);
    }
    rest_stiffness_.push_back(values(K));
  }
}

void FullModel::build_pattern() {
  const Tets& tets = body_->mesh.tets;
  const int free = int(body_->free_nodes.size());
  std::vector<std::vector<int>> neighbours(free);
  for (Eigen::Index e = 0; e < tets.rows(); ++e)
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b) {
        const int i = body_->free_of_node[tets(e, a)], j = body_->free_of_node[tets(e, b)];
        if (i >= 0 && j >= 0) neighbours[j].push_back(i);
      }
  pattern_.resize(3 * free, 3 * free);
  std::vector<Eigen::Triplet<double>> entries;
  for (int j = 0; j < free; ++j) {
    std::vector<int>& rows = neighbours[j];
    rows.push_back(j);
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    for (int i : rows)
      for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) entries.emplace_back(3 * i + r, 3 * j + c, 0.0);
  }
  pattern_.setFromTriplets(entries.begin(), entries.end());
  slots_.resize(tets.rows());
  for (Eigen::Index e = 0; e < tets.rows(); ++e)
    for (int b = 0; b < 4; ++b)
      for (int a = 0; a < 4; ++a) {
        const int i = body_->free_of_node[tets(e, a)], j = body_->free_of_node[tets(e, b)];
        int slot = -1;
        if (i >= 0 && j >= 0) {
          const auto first = neighbours[j].begin();
          const auto at = std::lower_bound(first, neighbours[j].end(), i);
          slot = pattern_.outerIndexPtr()[3 * j] + 3 * int(at - first);
        }
        slots_[e][4 * b + a] = slot;
      }
}

Eigen::Matrix<double, 3, 4> FullModel::gather(Eigen::Index e, const VectorXd& u) const {
  Eigen::Matrix<double, 3, 4> out;
  for (int a = 0; a < 4; ++a) {
    const int i = body_->free_of_node[body_->mesh.tets(e, a)];
    if (i >= 0)
      out.col(a) = u.segment<3>(3 * i);
    else
      out.col(a).setZero();
  }
  return out;
}

void FullModel::scatter(Eigen::Index e, const ElementForce& f, VectorXd& force) const {
  for (int a = 0; a < 4; ++a) {
    const int i = body_->free_of_node[body_->mesh.tets(e, a)];
    if (i >= 0) force.segment<3>(3 * i) += f.col(a);
  }
}

void FullModel::scatter(Eigen::Index e, const ElementStiffness& K, double scale, Matrix& out) const {
  for (int b = 0; b < 4; ++b) {
    const int j = body_->free_of_node[body_->mesh.tets(e, b)];
    if (j < 0) continue;
    const int stride = out.outerIndexPtr()[3 * j + 1] - out.outerIndexPtr()[3 * j];
    for (int a = 0; a < 4; ++a) {
      const int slot = slots_[e][4 * b + a];
      if (slot < 0) continue;
      for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) out.valuePtr()[slot + c * stride + r] += scale * K(3 * a + r, 3 * b + c);
    }
  }
}

FullModel::Matrix FullModel::rest_stiffness(int target) const {
  Matrix K = zero();
  values(K) = rest_stiffness_[target];
  return K;
}

void FullModel::blend(const VectorXd& w, Blend& out) const {
  check_size("weights", w.size(), Eigen::Index(targets_.size()));
  out.weights = w;
  out.mass.blend(targets_, body_->sets(), w);
  if (out.damping.nonZeros() != pattern_.nonZeros()) out.damping = out.stiffness = pattern_;
  values(out.damping).setZero();
  if (blending_ == Blending::even) out.displacement.setZero(dofs());
  for (size_t j = 0; j < targets_.size(); ++j) {
    values(out.damping) += w(j) * targets_[j].stiffness_damping * rest_stiffness_[j];
    if (blending_ == Blending::even) out.displacement += w(j) * rest_displacements_[j];
  }
  if (law_ != Law::linear) return;
  values(out.stiffness).setZero();
  out.force.setZero(dofs());
  out.energy = 0;
  Matrix K = zero();
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (w(j) == 0) continue;
    values(out.stiffness) += w(j) * rest_stiffness_[j];
    if (blending_ == Blending::even) continue;
    values(K) = rest_stiffness_[j];
    const VectorXd pull = K * rest_displacements_[j];
    out.force -= w(j) * pull;
    out.energy += 0.5 * w(j) * rest_displacements_[j].dot(pull);
  }
  if (blending_ == Blending::even) {
    out.force = -(out.stiffness * out.displacement);
    out.energy = -0.5 * out.displacement.dot(out.force);
  }
}

VectorXd FullModel::shifted(const Blend& blend, const VectorXd& q, int target) const {
  return blending_ == Blending::even ? VectorXd(q - blend.displacement + rest_displacements_[target]) : q;
}

double FullModel::energy(const Blend& blend, const VectorXd& q) const {
  if (law_ == Law::linear) return blend.energy + q.dot(0.5 * (blend.stiffness * q) + blend.force);
  double sum = 0;
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (blend.weights(j) == 0) continue;
    const VectorXd u = shifted(blend, q, int(j));
    for (Eigen::Index e = 0; e < body_->mesh.tets.rows(); ++e) {
      const Element& element = shapes_[j].elements[e];
      sum += blend.weights(j) * element.volume *
             energy_density(law_, targets_[j].lame, deformation_gradient(element, gather(e, u)));
    }
  }
  return sum;
}

double FullModel::linearize(const Blend& blend, const VectorXd& q, VectorXd& force, Matrix& stiffness) const {
  if (stiffness.nonZeros() != pattern_.nonZeros()) stiffness = pattern_;
  if (law_ == Law::linear) {
    values(stiffness) = values(blend.stiffness);
    force = blend.stiffness * q + blend.force;
    return blend.energy + 0.5 * q.dot(force + blend.force);
  }
  double sum = 0;
  force.setZero(dofs());
  values(stiffness).setZero();
  ElementStiffness block;
  for (size_t j = 0; j < targets_.size(); ++j) {
    const double w = blend.weights(j);
    if (w == 0) continue;
    const Lame& lame = targets_[j].lame;
    const VectorXd u = shifted(blend, q, int(j));
    for (Eigen::Index e = 0; e < body_->mesh.tets.rows(); ++e) {
      const Element& element = shapes_[j].elements[e];
      const Matrix3d F = deformation_gradient(element, gather(e, u));
      sum += w * element.volume * energy_density(law_, lame, F);
      scatter(e, w * element.volume * stress(law_, lame, F) * element.gradients, force);
      element_stiffness(law_, lame, element, F, block);
      scatter(e, block, w, stiffness);
    }
  }
  return sum;
}

void FullModel::inertia(const Motion& motion, const SetDensities& densities, Inertia& out) const {
  out.force.setZero(dofs());
  out.frame.bones = *motion.bones[0];
  pose_nodes(body_->skin, out.frame);
  for (int n = 0; n < Motion::kPoses; ++n) {
    if (motion.share.col(n).isZero(0)) continue;
    if (n > 0) {
      out.past.bones = *motion.bones[n];
      pose_nodes(body_->skin, out.past);
    }
    const double sum = motion.share.col(n).sum();
    out.bind = sum * body_->rest;
    for (int m = 0; m < Motion::kMoments; ++m)
      if (motion.share(m, n) != 0) out.bind += motion.share(m, n) * *motion.q[m];
    to_world(n > 0 ? out.past : out.frame, sum, out.bind, out.posed);
    out.force += out.posed;
  }
  if (out.mass.nonZeros() != pattern_.nonZeros()) out.mass = out.damped = pattern_;
  values(out.mass).setZero();
  values(out.damped).setZero();
  for (size_t i = 0; i < body_->free_nodes.size(); ++i) {
    const auto A = transform(out.frame.nodes, Eigen::Index(i)).leftCols<3>();
    const Matrix3d square = A.transpose() * A;
    const double mass = body_->volumes.row(i).dot(densities.density);
    const double damped = body_->volumes.row(i).dot(densities.damped);
    for (int c = 0; c < 3; ++c)
      for (int r = 0; r < 3; ++r) {
        out.mass.coeffRef(3 * i + r, 3 * i + c) = mass * square(r, c);
        out.damped.coeffRef(3 * i + r, 3 * i + c) = damped * square(r, c);
      }
    out.force.segment<3>(3 * i) = mass * (out.force.segment<3>(3 * i) - motion.lift);
  }
  pull_back(out.frame, out.force);
}

VectorXd FullModel::force_curvature(int target, const VectorXd& a, const VectorXd& b) const {
  VectorXd out = VectorXd::Zero(dofs());
  for (Eigen::Index e = 0; e < body_->mesh.tets.rows(); ++e) {
    const Element& element = shapes_[target].elements[e];
    const Matrix3d A = gather(e, a) * element.gradients.transpose(), B = gather(e, b) * element.gradients.transpose();
    scatter(e, element.volume * stress_curvature(targets_[target].lame, A, B) * element.gradients, out);
  }
  return out;
}

VectorXd extend_shape(const SoftBody& body, const Embedding& embedding, const Points& surface) {
  // Unit material: the shape of the fill-in does not depend on the stiffness. The pull is 1e4 times the mean nodal
  // stiffness per vertex, so the surface is met to about 1e-4 where the cage can carry it.
  MorphTarget neutral;
  neutral.displacement = VectorXd::Zero(3 * body.mesh.nodes.rows());
  neutral.lame = {1, 1};
  auto whole = std::make_shared<SoftBody>(body);
  whole->shares.setOnes(body.mesh.tets.rows(), 1);
  const FullModel model(whole, {neutral}, Law::linear, Blending::forces);
  SparseMatrix A = model.rest_stiffness(0);
  const double pull = 1e4 * A.diagonal().mean();

  check_size("surface", surface.rows(), embedding.nodes.rows());
  if (!surface.allFinite()) throw Error("a target's shape is not finite: repair its shape key");
  const SparseMatrix E = embedding.matrix(body.mesh.nodes.rows());
  std::vector<Eigen::Triplet<double>> entries;
  for (int node = 0; node < E.outerSize(); ++node)
    for (SparseMatrix::InnerIterator it(E, node); it; ++it)
      if (body.free_of_node[node] >= 0)
        for (int c = 0; c < 3; ++c)
          entries.emplace_back(3 * int(it.row()) + c, 3 * body.free_of_node[node] + c, it.value());
  SparseMatrix B(3 * surface.rows(), model.dofs());
  B.setFromTriplets(entries.begin(), entries.end());
  A += pull * SparseMatrix(B.transpose() * B);
  const Eigen::SimplicialLDLT<SparseMatrix> solver(A);
  if (solver.info() != Eigen::Success) throw Error("a target's shape could not be carried into the cage: rebuild it");
  return body.expand(solver.solve(pull * (B.transpose() * flat(surface))));
}

}  // namespace dynamorph
