// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/step_load.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "dynamorph/step/choices.hpp"

namespace dynamorph {

using Eigen::Index;

template <class Model>
void StepLoad<Model>::balance(MatrixXd gravity, MatrixXd directions) {
  rest_gravity_ = std::move(gravity);
  rest_directions_ = std::move(directions);
}

template <class Model>
void StepLoad<Model>::unbalanced(const Input& input, VectorXd& g) {
  model_->inertia(input.inertial, input.blend.mass, inertia_);
  g = inertia_.force / input.square;
}

template <class Model>
void StepLoad<Model>::add_balance(const Input& input, VectorXd& g) const {
  if (rest_gravity_.size() > 0) g.noalias() += rest_gravity_ * input.blend.weights;
}

template <class Model>
void StepLoad<Model>::add_external(const Input& input, const VectorXd* scales, VectorXd& g) {
  if (!input.external) return;
  const Index size = model_->body().rest.size();
  if (input.external->size() != size)
    throw std::invalid_argument("external: expected " + std::to_string(size) + " values, got " +
                                std::to_string(input.external->size()));
  if (!input.external->allFinite()) throw std::invalid_argument("external: forces must be finite");
  frame_.bones = *input.inertial.bones[0];
  pose_nodes(model_->body().skin, frame_);
  nodal_ = *input.external;
  if (scales) nodal_.array() *= at_coordinates(model_->body().skin * *scales).array();
  pull_back(frame_, nodal_);
  model_->project_force(nodal_, projected_);
  g -= projected_;
}

template <class Model>
void StepLoad<Model>::step(const Input& input, double h, double stiffer, const DrivenLoad& before, VectorXd& g) {
  if (!limit_) {
    unbalanced(input, g);
    add_balance(input, g);
    return add_external(input, nullptr, g);
  }
  // By plain second differences of the bones: those of BDF2 spread a jump over three steps, forth and back.
  const auto& bones = input.inertial.bones;
  acceleration_ = *bones[0] - 2 * *bones[1] + *bones[2];
  slowed_[0] = acceleration_ / (h * h);
  const Vector3d gravity = input.gravity();
  for (int axis = 0; axis < 3; ++axis) slowed_[0].col(4 * axis + 3).array() -= gravity(axis);
  model_->rigid_force(*bones[0], slowed_[0], input.blend.mass, inertia_, g);
  add_balance(input, g);
  add_external(input, nullptr, g);
  g *= -1;
  limit_->drive(g, input.blend.elastic, stiffer, acceleration_, h, before, answers_, driven_);
  hold_back(input, g);
}

template <class Model>
void StepLoad<Model>::lasting(const Input& input, VectorXd& g) {
  unbalanced(input, g);
  add_balance(input, g);
  add_external(input, nullptr, g);
  if (!limit_) return;
  limit_->drive_long(-g, input.blend.elastic, answers_, driven_);
  hold_back(input, g);
}

template <class Model>
void StepLoad<Model>::hold_back(const Input& input, VectorXd& g) {
  const auto& x = driven_.excess;
  const bool any =
      std::any_of(x.begin(), x.end(), [](const VectorXd& each) { return (each.array() > kLoadBegins).any(); });
  if (!any) {
    unbalanced(input, g);
  } else {
    for (std::size_t k = 0; k < x.size(); ++k) limit_->scales(x[k], scales_[k]);
    const InertialTarget slow = scaled(input);
    unbalanced({slow, input.square, input.blend, nullptr}, g);
  }
  add_balance(input, g);
  add_external(input, any ? &scales_[0] : nullptr, g);
}

template <class Model>
InertialTarget StepLoad<Model>::scaled(const Input& input) {
  // Gravity is an acceleration like any other: a shift of the newest past. Without a past, one is made up.
  InertialTarget inertial = input.inertial;
  if (inertial.coefficients.isZero(0)) inertial.coefficients.row(0).head<2>() << 1, -1;
  const double newest = inertial.coefficients.col(1).sum();
  const std::array<const Transforms*, InertialTarget::kPoses> bones = inertial.bones;
  const Transforms& now = *bones[0];
  const VectorXd &scale = scales_[0], &last = scales_[1], &before = scales_[2];
  for (std::size_t n = 1; n < bones.size(); ++n) {
    Transforms& slowed = slowed_[n - 1];
    slowed = *bones[n];
    for (Index t = 0; t < slowed.rows(); ++t)
      if (scale(t) < 1) slowed.row(t) = now.row(t) + scale(t) * (slowed.row(t) - now.row(t));
    inertial.bones[n] = &slowed;
  }
  for (Index t = 0; t < now.rows(); ++t) {
    const auto acceleration = [&](std::size_t n) {
      return bones[n]->row(t) - 2 * bones[n + 1]->row(t) + bones[n + 2]->row(t);
    };
    if (scale(t) != last(t))
      slowed_[0].row(t) += (scale(t) - last(t)) / newest * (2 * acceleration(1) + (3 + newest) * acceleration(2));
    if (last(t) != before(t)) slowed_[0].row(t) -= (last(t) - before(t)) / newest * acceleration(2);
    if (scale(t) == 1) continue;
    Vector3d gravity = input.gravity();  // less that of the targets' own poses, in this one
    if (rest_directions_.size() > 0) {
      const Matrix3d pose = transform(now, t).leftCols<3>();
      const Vector3d own = rest_directions_.middleRows<3>(3 * t) * input.blend.weights / model_->body().sets();
      gravity -= pose * own * (3 / std::max(pose.squaredNorm(), 1e-12));
    }
    const Vector3d shift = (1 - scale(t)) * input.square / newest * gravity;
    for (int axis = 0; axis < 3; ++axis) slowed_[0](t, 4 * axis + 3) += shift(axis);
  }
  return inertial;
}

template class StepLoad<FullModel>;
template class StepLoad<ReducedModel>;

}  // namespace dynamorph
