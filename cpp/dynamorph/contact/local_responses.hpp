// SPDX-License-Identifier: GPL-3.0-or-later
// What the few coordinates of a reduced model cannot do: give way where something presses. The skin is covered with
// patches. Loads f_P on the mesh press them, each along the normals of the skin, with weights that fade toward the next
// patches and sum to one. With K of the mesh at its neutral targets and the model's coordinates B, a patch gives way by
//
//   R_P = K^-1 f_P - s_P B (B^T K B)^-1 B^T f_P,
//
// without what the coordinates do by themselves (s_P = 1; K R and B are orthogonal). Its amplitude has the energy
// a^T C a / 2, C = R^T K R, no mass, no damping and no past. Where the coordinates move a firm patch only by moving
// other skin far, s_P falls to 0: there they take no part in contact, and the patches give way by all of K^-1 f.
#pragma once

#include <utility>
#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/models/skin.hpp"

namespace dynamorph {

/// How much a push may do that moves its own place by `own` and something else by `farthest`: nothing where that is
/// 1.7 times as far, and all from 1.5 times as far on.
double stays_local(double own, double farthest);

/// How unlike two points of a skin are, m^2: the square of their distance, and more for other unit normals. A right
/// angle between these counts as a tenth of `size`, the body's, meters.
double squared_unlikeness(const Vector3d& x, const Vector3d& normal, const Vector3d& y, const Vector3d& other_normal,
                          double size);

/// Points of a skin. Bind space, meters.
struct SkinPlaces {
  Points rest;           ///< (L)
  Points normals;        ///< (L): outward, unit
  SurfacePoints points;  ///< (L): which ones of its vertices
};

/// All that responses consist of, so that they can be made again where they were sent.
struct ResponseParts {
  SkinPlaces centers;              ///< (P)
  double size = 0;                 ///< of the body, meters
  double reach = 0;                ///< how unlike its center a point of a patch is at most, meters
  RowMajor shapes;                 ///< R (3 free, P)
  MatrixXd stiffness;              ///< C (P, P)
  VectorXd farthest, shear;        ///< (P), (S)
  std::vector<int> farthest_node;  ///< of each patch, among the free ones
};

/// Immutable: simulations may share it.
class LocalResponses {
 public:
  /// Throws std::invalid_argument for parts that do not fit each other.
  explicit LocalResponses(ResponseParts parts);
  /// places (L): spread evenly over the soft skin. embedding: of the skin's vertices in the mesh. Every one of
  /// `centers` is in the middle of a patch; at least one. B (3 free, dofs). Throws std::invalid_argument for arrays
  /// that do not fit each other.
  LocalResponses(const FullModel& model, const MatrixXd& basis, const SkinPlaces& places, const Embedding& embedding,
                 const std::vector<int>& centers);

  Eigen::Index size() const { return parts_.shapes.cols(); }  ///< P
  /// R (3 free, P): displacements of the free nodes, each with a mean square of one over the body's volume.
  const RowMajor& shapes() const { return parts_.shapes; }
  const MatrixXd& stiffness() const { return parts_.stiffness; }  ///< C (P, P), N/m times m^3
  const VectorXd& farthest() const {
    return parts_.farthest;
  }  ///< how far a unit of each patch (P) moves a node, at most, m
  const VectorXd& shear() const {
    return parts_.shear;
  }  ///< mu (S) of the neutral target of each set, for which C is, Pa

  const ResponseParts& parts() const { return parts_; }

  /// The share of its `farthest` that each of these patches (rows, m) is moved there, along its own way, by a unit of
  /// each (columns, m).
  RowMajor moved_where_farthest(const std::vector<int>& patches) const;

  /// The patches that a point of the skin is part of, with its weights in them.
  void patches_at(const Vector3d& rest, const Vector3d& normal, std::vector<std::pair<int, double>>& out) const;

 private:
  /// How unlike a point is to a patch's center, meters.
  double unlike(int patch, const Vector3d& rest, const Vector3d& normal) const;
  double reach_of(const SkinPlaces& places, const std::vector<int>& centers) const;
  RowMajor weights_of(const SkinPlaces& places) const;  ///< (L, P)
  /// Scales R and C. volume (free): of the nodes; compliance (P): of what is below the patches.
  void normalize(const VectorXd& volume, const VectorXd& compliance, MatrixXd& R);

  ResponseParts parts_;
};

}  // namespace dynamorph
