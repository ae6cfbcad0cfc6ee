// SPDX-License-Identifier: GPL-3.0-or-later
// The load of a step: inertia, gravity and external forces. A motion limit lets through what is not too much.
#pragma once

#include <array>
#include <memory>

#include "dynamorph/models/full_model.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/step/motion_limit.hpp"

namespace dynamorph {

template <class Model>
class StepLoad {
 public:
  /// What loads the tissue in a step.
  struct Input {
    const InertialTarget& inertial;  ///< its force is divided by `square`
    double square;                   ///< s^2
    const typename Model::Blend& blend;
    const VectorXd* external;  ///< forces on the nodes, or null

    Vector3d gravity() const { return inertial.gravity_offset / square; }
  };

  /// limit: null for none.
  StepLoad(std::shared_ptr<const Model> model, std::shared_ptr<const MotionLimit<Model>> limit)
      : model_(std::move(model)), limit_(std::move(limit)) {}

  /// From now on, takes off the gravity in the targets' own poses: its loads (dofs, J), and its directions A^T g at
  /// each transform (3T, J).
  void balance(MatrixXd gravity, MatrixXd directions);

  /// The gradient g (dofs) of the load's potential at the origin, and `inertia`. Without the balance of the targets.
  void unbalanced(const Input& input, VectorXd& g);
  /// g of a step of h seconds, after what the limit remembers from `before`. stiffer: as of `MotionLimit::drive`.
  void step(const Input& input, double h, double stiffer, const DrivenLoad& before, VectorXd& g);
  /// g of a load that lasts.
  void lasting(const Input& input, VectorXd& g);

  const typename Model::Inertia& inertia() const { return inertia_; }  ///< of the last load
  const DrivenLoad& driven() const { return driven_; }                 ///< after the last load

 private:
  void add_balance(const Input& input, VectorXd& g) const;
  /// Takes external forces off g. scales: of the transforms' loads (T), or null for ones.
  void add_external(const Input& input, const VectorXd* scales, VectorXd& g);
  /// g with as much of the load as driven_ lets through.
  void hold_back(const Input& input, VectorXd& g);
  /// The same inertial target with the accelerations of the transforms, and of gravity, scaled: the past x^ becomes
  /// x_in + s (x^ - x_in), where x_in is the past without the motion of the bones. Where s has changed, it also
  /// corrects what earlier steps have let through: velocity and place become what they would be with the s of now. Of
  /// the bones' last second difference a, (s - s') a is added twice and taken off in the next step, because the tissue
  /// has moved with it for a step. The one before acts by a part 3 - past[0] of `StepRule`, and only its velocity is.
  InertialTarget scaled(const Input& input);

  std::shared_ptr<const Model> model_;
  std::shared_ptr<const MotionLimit<Model>> limit_;
  MatrixXd rest_gravity_;     ///< gravity in each target's own pose (dofs, J), or empty
  MatrixXd rest_directions_;  ///< the same at each transform, A^T g (3T, J)
  typename Model::Inertia inertia_;
  DrivenLoad driven_;
  Transforms acceleration_;  ///< second difference of the bones
  typename MotionLimit<Model>::Scratch answers_;
  std::array<VectorXd, 3> scales_;                           ///< s, in this step and the last two
  std::array<Transforms, InertialTarget::kMoments> slowed_;  ///< bones of a scaled past
  SkinFrame frame_;                                          ///< of the nodes, where external forces act
  VectorXd nodal_, projected_;
};

extern template class StepLoad<FullModel>;
extern template class StepLoad<ReducedModel>;

}  // namespace dynamorph
