// SPDX-License-Identifier: GPL-3.0-or-later
// The points of a skin that can touch something, and how firmly they do. A sample p under a surface is pushed out with
// the stiffness
//
//   k_p = 30 (f_p / C_p + m_p / (c h)^2),      f_p = sum_j w_j mu_j / mu_0,
//
// where C_p is the compliance of the body at the sample along its normal, n^T E K^-1 E^T n at the neutral targets,
// 1 / C_p + m_p / (c h)^2 that in a step (m_p is fitted at 1/96 s), and f_p how much stiffer the blended targets are.
// So what is left of a dent that the surface makes is about 1/30 at every mesh size, stiffness and step without a
// setting for it, and what is held firmly is pushed firmly. K is the model's own: a reduced model is stiffer at a
// point. Its few coordinates can move firm skin only by moving other skin far: where that would move any other sample
// 1.7 times as far as the pushed one they take no part in contact, and all of it from 1.5 times as far on.
// Without the local responses of patches (local_responses.hpp) such a sample is not pushed; with them they give way
// there alone, and C_p is the compliance of both.
//
// A sample is a vertex of the skin or a point of one of its edges or faces. It is where the mean of its corners is, as
// the skin is drawn, and a push on it pushes all of them.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "dynamorph/contact/local_responses.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/models/skin.hpp"
#include "dynamorph/reduced/reduced_model.hpp"

namespace dynamorph {

/// Points of a skin that can touch something: the samples. Bind space, meters.
struct ContactSkin {
  Skin skin;             ///< its vertices (V)
  SurfacePoints points;  ///< the samples (P)
  Points normals;        ///< (P): out of the body, any length above zero
  VectorXd thickness;    ///< T (P) > 0: of the tissue below; a collider that the bones take in deeper pushes less
};

/// Immutable: simulations may share it.
template <class Model>
class ContactSamples {
 public:
  /// local: of a reduced model's mesh; null for none. found: that of the same samples before, or none.
  /// Throws std::invalid_argument unless all fit each other and the model.
  ContactSamples(std::shared_ptr<const Model> model, ContactSkin samples,
                 std::shared_ptr<const LocalResponses> local = nullptr, std::optional<MatrixXd> found = {});

  const Model& model() const { return map_.model(); }
  const std::shared_ptr<const Model>& shared_model() const { return map_.shared_model(); }
  const SkinMap<Model>& map() const { return map_; }
  const SurfacePoints& points() const { return points_; }
  Eigen::Index size() const { return points_.size(); }  ///< P
  const Points& rest() const { return rest_; }          ///< (P, 3), bind space
  const VectorXd& thickness() const { return thickness_; }
  /// 1 / C (P), N/m, at the neutral targets; 0 where pins leave next to nothing to move.
  const VectorXd& stiffness() const { return stiffness_; }
  const VectorXd& mass() const { return mass_; }  ///< m (P), kg
  /// What takes long to find (P, 3): `stiffness`, `mass` and `taken`.
  MatrixXd found() const;

  /// k of a sample at elastic weights (J) of the targets; square: (c h)^2, s^2.
  double stiffness(Eigen::Index sample, const VectorXd& elastic, double square) const;

  /// The local responses, or null.
  const LocalResponses* local() const { return local_.get(); }
  /// The patches that a sample is part of.
  const std::vector<int>& patches(Eigen::Index sample) const { return patches_[std::size_t(sample)]; }
  /// The part of a push that the model's coordinates take, in [0, 1]; one without local responses.
  double taken(Eigen::Index sample) const { return taken_(sample); }
  /// What some numbers of the skin's vertices, with directions in bind space, are for a unit of each of these patches:
  /// out (chosen, patches).
  void local_rows(const PointRows& numbers, const std::vector<int>& chosen, const std::vector<int>& patches,
                  RowMajor& out) const;
  /// How much stiffer the local responses at a sample are at those weights.
  double local_stiffer(Eigen::Index sample, const VectorXd& elastic) const {
    return stiffer(sample, elastic, local_->shear().cwiseInverse());
  }

  /// A bound on the displacements of samples in bind space, meters, at target weights (J) and coordinates q.
  double farthest(const VectorXd& weights, const VectorXd& q) const;
  /// Samples near each other: what is far from all of them need not be compared with each.
  struct Group {
    std::vector<int> samples;
    double thickness = 0;                                             ///< the largest
    std::vector<std::pair<Eigen::Index, Eigen::AlignedBox3d>> boxes;  ///< bones, and the samples that each moves
  };
  const std::vector<Group>& groups() const { return groups_; }
  /// A box in world space around all samples of a group that are displaced by no more than `farthest`.
  static Eigen::AlignedBox3d region(const Group& group, const Transforms& bones, double farthest);

  /// Displacement of a vertex of the skin in the targets' shapes blended by the weights (J), bind space, meters.
  Vector3d shape(const VectorXd& weights, Eigen::Index vertex) const {
    return shapes_.middleRows<3>(3 * vertex) * weights;
  }
  /// Where a sample is at q = 0, world space.
  Vector3d unmoved(const Transforms& bones, const VectorXd& weights, Eigen::Index sample) const;
  /// Adds how far a sample moves along a direction to the last row of numbers.
  void add(Eigen::Index sample, const Vector3d& direction, PointRows& numbers) const;
  /// Out of the body, unit, world space, as a sample's transform has it.
  Vector3d normal(const PointTransform& T, Eigen::Index sample) const;

 private:
  void bound_motion(const typename Model::SkinPoints& vertices);
  void find_patches();
  void find_stiffness(const typename Model::SkinPoints& vertices, const VectorXd& neutral);
  /// How far a unit of each patch moves these vertices: (3 vertices, patches).
  MatrixXd local_shapes(const std::vector<int>& vertices) const;
  double stiffer(Eigen::Index sample, const VectorXd& elastic, const VectorXd& softness) const;

  SkinMap<Model> map_;  ///< of the vertices
  SurfacePoints points_;
  Points rest_, normals_;  ///< of the samples; unit
  VectorXd thickness_, stiffness_, mass_;
  std::vector<Group> groups_;
  MatrixXd share_;     ///< of the target sets in a sample's tissue (P, S); rows sum to one
  VectorXd softness_;  ///< 1 / mu of each set's neutral target
  VectorXd moved_;     ///< the most that a unit of each coordinate displaces a vertex; of a mesh, of a node (1)
  VectorXd residual_;  ///< the same of each target's residual shape (J)
  MatrixXd shapes_;    ///< displacements of the vertices in each target's shape (3V, J)
  std::shared_ptr<const LocalResponses> local_;
  std::vector<std::vector<int>> patches_;
  VectorXd taken_;
};

extern template class ContactSamples<FullModel>;
extern template class ContactSamples<ReducedModel>;

}  // namespace dynamorph
