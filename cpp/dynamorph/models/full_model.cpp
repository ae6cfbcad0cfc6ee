// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/full_model.hpp"

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/elastic/sparse_solver.hpp"

namespace dynamorph {

namespace {

constexpr Eigen::Index kBlended = 2048;  // values blended at a time, so that the sums stay in the L1 cache

}  // namespace

FullModel::FullModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets,
                     MaterialModel material_model, Blending blending)
    : body_(std::move(body)),
      targets_(std::move(targets)),
      material_model_(material_model),
      blending_(blending),
      assembly_(body_->mesh, body_->free_of_node) {
  check(material_model_);
  check(blending_);
  check_targets(*body_, targets_);
  VectorXd force;
  Matrix K = zero();
  for (Eigen::Index i = 0; i < dofs(); ++i) diagonal_.push_back(&K.coeffRef(i, i) - K.valuePtr());
  for (const MorphTarget& target : targets_) {
    const VectorXd d = body_->restrict_to_free(target.displacement);
    rest_displacements_.push_back(d);
    shapes_.push_back(rest_shape(body_->mesh, target.displacement,
                                 body_->stiffness_scale.cwiseProduct(body_->region_weights.col(target.set)),
                                 target.shifted));
    elements_.push_back(assembly_.pack(shapes_.back(), false));
    // The linear law's stiffness is StVK's at the rest shape.
    const MaterialModel material_model =
        material_model_ == MaterialModel::linear ? MaterialModel::stvk : material_model_;
    assembly_.linearize(material_model, {{1, target.lame, &elements_.back()}}, VectorXd::Zero(d.size()), force, K);
    for (Eigen::Index i = 0; body_->hold_stiffness.size() > 0 && i < dofs(); ++i)
      K.valuePtr()[diagonal_[i]] += target.lame.mu * body_->hold_stiffness(i / 3, target.set);
    rest_stiffness_.push_back(values(K));
    rest_pull_.push_back(K * d);
    if (blending_ == Blending::forces) elements_.back() = assembly_.pack(shapes_.back(), true);
  }
}

FullModel::Matrix FullModel::rest_stiffness(int target) const {
  Matrix K = zero();
  values(K) = rest_stiffness_[target];
  return K;
}

void FullModel::blend(const VectorXd& w, const VectorXd& e, Blend& out) const {
  check_size("weights", w.size(), Eigen::Index(targets_.size()));
  check_size("elastic", e.size(), w.size());
  if (out.of == this && out.weights.size() == w.size() && out.weights == w && out.elastic == e) return;  // as before
  out.of = this;
  out.weights = w;
  out.elastic = e;
  out.mass.blend(targets_, body_->sets(), w);
  const bool linear = material_model_ == MaterialModel::linear, even = blending_ == Blending::even;
  if (out.damping.nonZeros() != assembly_.pattern().nonZeros()) out.damping = assembly_.pattern();
  if (linear && out.stiffness.nonZeros() != assembly_.pattern().nonZeros()) out.stiffness = assembly_.pattern();
  const Eigen::Index size = out.damping.nonZeros();
  parallel_for(int((size + kBlended - 1) / kBlended), [&](int chunk) {
    const Eigen::Index first = chunk * kBlended, count = std::min(kBlended, size - first);
    auto damping = values(out.damping).segment(first, count);
    damping.setZero();
    if (linear) values(out.stiffness).segment(first, count).setZero();
    for (Eigen::Index j = 0; j < w.size(); ++j) {
      if (e(j) == 0) continue;
      const auto rest = rest_stiffness_[j].segment(first, count);
      damping += e(j) * targets_[j].stiffness_damping * rest;
      if (linear) values(out.stiffness).segment(first, count) += e(j) * rest;
    }
  });
  if (even) {
    out.displacement.setZero(dofs());
    for (Eigen::Index j = 0; j < w.size(); ++j)
      if (w(j) != 0) out.displacement += w(j) * rest_displacements_[j];
  }
  if (!linear) return blend_hold(e, out);
  out.energy = 0;
  if (even) {
    multiply_symmetric(out.stiffness, out.displacement, out.force);
    out.force = -out.force;
    out.energy = -0.5 * out.displacement.dot(out.force);
    return;
  }
  out.force.setZero(dofs());
  for (Eigen::Index j = 0; j < w.size(); ++j) {
    if (e(j) == 0) continue;
    out.force -= e(j) * rest_pull_[j];
    out.energy += 0.5 * e(j) * rest_displacements_[j].dot(rest_pull_[j]);
  }
}

std::vector<Assembly::Part> FullModel::parts(const Blend& blend) const {
  std::vector<Assembly::Part> out;
  for (size_t j = 0; j < targets_.size(); ++j)
    if (blend.elastic(j) != 0) out.push_back({blend.elastic(j), targets_[j].lame, &elements_[j]});
  return out;
}

void FullModel::displacement_from_shape(const Blend& blend, const VectorXd& q, VectorXd& out) const {
  out = q;
  // Even blending: target j's displacement is q - d(q) + d_j. Relative to the target's own shape, it is the same for
  // all targets.
  if (blending_ == Blending::even) out -= blend.displacement;
}

void FullModel::blend_hold(const VectorXd& e, Blend& out) const {
  if (body_->hold_stiffness.size() == 0) return;
  out.hold.setZero(dofs());
  out.hold_shapes.setZero(blending_ == Blending::even ? 0 : dofs());
  out.hold_energy = 0;
  for (Eigen::Index j = 0; j < e.size(); ++j) {
    if (e(j) == 0) continue;
    const VectorXd stiffness = at_coordinates(e(j) * targets_[j].lame.mu * body_->hold_stiffness.col(targets_[j].set));
    out.hold += stiffness;
    if (blending_ == Blending::even) continue;  // x is zero at each target's own shape, so there are no more terms
    out.hold_shapes += stiffness.cwiseProduct(rest_displacements_[j]);
    out.hold_energy += 0.5 * stiffness.dot(rest_displacements_[j].cwiseAbs2());
  }
}

double FullModel::hold_energy(const Blend& blend, const VectorXd& x, VectorXd& pull) const {
  pull = blend.hold.cwiseProduct(x);
  const double energy = 0.5 * x.dot(pull);
  if (blending_ == Blending::even) return energy;
  pull -= blend.hold_shapes;
  return energy - x.dot(blend.hold_shapes) + blend.hold_energy;
}

double FullModel::energy(const Blend& blend, const VectorXd& q, Workspace& workspace) const {
  if (material_model_ == MaterialModel::linear) return blend.energy + q.dot(0.5 * (blend.stiffness * q) + blend.force);
  VectorXd& x = workspace.from_shape;
  displacement_from_shape(blend, q, x);
  const double of_hold = body_->hold_stiffness.size() > 0 ? hold_energy(blend, x, workspace.pull) : 0;
  return assembly_.energy(material_model_, parts(blend), x) + of_hold;
}

double FullModel::linearize(const Blend& blend, const VectorXd& q, Workspace& workspace, VectorXd& force,
                            Matrix& stiffness) const {
  if (stiffness.nonZeros() != assembly_.pattern().nonZeros()) stiffness = assembly_.pattern();
  if (material_model_ != MaterialModel::linear) {
    VectorXd& x = workspace.from_shape;
    displacement_from_shape(blend, q, x);
    const double energy = assembly_.linearize(material_model_, parts(blend), x, force, stiffness);
    if (body_->hold_stiffness.size() == 0) return energy;
    const double of_hold = hold_energy(blend, x, workspace.pull);
    force += workspace.pull;
    for (Eigen::Index i = 0; i < dofs(); ++i) stiffness.valuePtr()[diagonal_[i]] += blend.hold(i);
    return energy + of_hold;
  }
  values(stiffness) = values(blend.stiffness);
  multiply_symmetric(blend.stiffness, q, force);
  force += blend.force;
  return blend.energy + 0.5 * q.dot(force + blend.force);
}

void FullModel::inertia(const InertialTarget& inertial, const SetDensities& densities, Inertia& out) const {
  out.force.setZero(dofs());
  out.frame.bones = *inertial.bones[0];
  pose_nodes(body_->skin, out.frame);
  for (int n = 0; n < InertialTarget::kPoses; ++n) {
    if (inertial.coefficients.col(n).isZero(0)) continue;
    if (n > 0) {
      out.past.bones = *inertial.bones[n];
      pose_nodes(body_->skin, out.past);
    }
    const double sum = inertial.coefficients.col(n).sum();
    out.bind = sum * body_->rest;
    for (int m = 0; m < InertialTarget::kMoments; ++m)
      if (inertial.coefficients(m, n) != 0) out.bind += inertial.coefficients(m, n) * *inertial.q[m];
    to_world(n > 0 ? out.past : out.frame, sum, out.bind, out.posed);
    out.force += out.posed;
  }
  if (out.mass.nonZeros() != assembly_.pattern().nonZeros()) out.mass = out.damped = assembly_.pattern();
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
    out.force.segment<3>(3 * i) = mass * (out.force.segment<3>(3 * i) - inertial.gravity_offset);
  }
  pull_back(out.frame, out.force);
}

void FullModel::rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities,
                            Inertia& scratch, VectorXd& force) const {
  scratch.frame.bones = now;
  scratch.past.bones = moved;
  pose_nodes(body_->skin, scratch.frame);
  pose_nodes(body_->skin, scratch.past);
  to_world(scratch.past, 1, body_->rest, force);
  force.array() *= at_coordinates(body_->volumes * densities.density).array();
  pull_back(scratch.frame, force);
}

}  // namespace dynamorph
