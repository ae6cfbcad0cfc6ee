// SPDX-License-Identifier: GPL-3.0-or-later
// What tests of reduced models have in common: all kinds of models with responses, and inertia of a moving rig.
#pragma once

#include <array>

#include "derivatives.hpp"
#include "dynamorph/step/step_options.hpp"
#include "scenes.hpp"

namespace scenes {

using Affine = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

/// Calls visit(scene, sets) for models with responses of the bar in one set and in two, with every law and blending.
template <class Visit>
void for_each_response_scene(const Visit& visit) {
  for (int sets : {1, 2})
    for (MaterialModel material_model : kMaterialModels)
      for (Blending blending : kBlendings) {
        const auto body = two_bone_bar(sets);
        visit(ResponseScene(body, targets(*body, sets - 1), material_model, blending), sets);
      }
}

/// Modes and responses (3 free, r + h).
inline MatrixXd side_by_side(const ResponseBasis& basis) {
  MatrixXd out(basis.U.rows(), basis.U.cols() + basis.W.cols());
  out << basis.U, basis.W;
  return out;
}

/// Coordinates of the modes (r) in a random direction of the motion that they are made for, in which the body moves by
/// its size in the root mean square.
inline VectorXd motion_of_size(const ResponseScene& scene, unsigned seed) {
  const SoftBody& body = scene.full.body();
  const VectorXd& amplitudes = scene.basis.amplitudes;
  const VectorXd scales = amplitudes.cwiseMax(0.05 * amplitudes.maxCoeff());
  const VectorXd v = random_vector(scales.size(), 1, seed).cwiseProduct(scales);
  return body.size * std::sqrt(body.volume) * v.normalized();
}

/// The transforms of `count` bones; of_bone(b) is an Affine.
template <class OfBone>
Transforms pose_of(int count, const OfBone& of_bone) {
  Transforms out(count, 12);
  for (int b = 0; b < count; ++b) {
    const Affine T = of_bone(b);
    out.row(b) = Eigen::Map<const Eigen::Matrix<double, 1, 12>>(T.data());
  }
  return out;
}

/// Inertia of a moving rig and of random coordinates, in the full model (`big`) and in the span of `basis` (`small`).
struct Moving {
  const MatrixXd& basis;
  std::array<VectorXd, InertialTarget::kMoments> q, u;
  std::array<Transforms, InertialTarget::kPoses> poses;
  std::array<SkinFrame, InertialTarget::kPoses> frames;
  InertialTarget small, big;

  /// speed: of the coordinates; pose(n): n steps back.
  template <class Pose>
  Moving(const MatrixXd& basis_, double speed, const Pose& pose) : basis(basis_) {
    small.coefficients = StepRule(StepOptions{1 / 120.}).coefficients();
    small.gravity_offset = Vector3d(1e-4, -2e-4, 7e-4);
    big = small;
    for (int m = 0; m < InertialTarget::kMoments; ++m) {
      q[m] = speed * random_vector(basis.cols(), 1e-3, 40 + m);
      u[m] = basis * q[m];
      small.q[m] = &q[m];
      big.q[m] = &u[m];
    }
    for (int n = 0; n < InertialTarget::kPoses; ++n) {
      poses[n] = pose(n);
      small.bones[n] = big.bones[n] = &poses[n];
    }
  }
  Moving(const Moving&) = delete;  // the targets point into it

  /// Gives `small` the transforms of the nodes instead of those of the bones that pose them.
  void use_nodes(const SoftBody& body) {
    for (int n = 0; n < InertialTarget::kPoses; ++n) {
      frames[n].bones = poses[n];
      pose_nodes(body.skin, frames[n]);
      small.bones[n] = &frames[n].nodes;
    }
  }

  struct Inertia {
    MatrixXd mass, damped;
    VectorXd force;
  };

  /// The full model's, projected on the basis.
  Inertia projected(const FullModel& full, const SetDensities& densities) const {
    FullModel::Inertia found;
    full.inertia(big, densities, found);
    return {basis.transpose() * (found.mass * basis), basis.transpose() * (found.damped * basis),
            basis.transpose() * found.force};
  }

  Inertia reduced(const ReducedModel& model, const SetDensities& densities) const {
    ReducedModel::Inertia found;
    model.inertia(small, densities, found);
    return {found.mass.dense(), found.damped.dense(), found.force};
  }
};

/// The same body, known only by where its nodes go.
inline std::shared_ptr<const SoftBody> with_own_transforms(const SoftBody& body) {
  std::vector<bool> pinned(body.free_of_node.size());
  for (size_t i = 0; i < pinned.size(); ++i) pinned[i] = body.free_of_node[i] < 0;
  return std::make_shared<SoftBody>(body.mesh, body.fill, VectorXd::Ones(body.fill.size()), body.region_weights, pinned,
                                    MatrixXd(pinned.size(), 0));
}

}  // namespace scenes
