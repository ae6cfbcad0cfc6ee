// SPDX-License-Identifier: GPL-3.0-or-later
// Points of a skin that moves with a soft body, and forces on them:
//
//   x = A (X + E u(q) + R w) + a,   [A | a] = sum_b w_b B_b
//
// with X the points at rest, E their embedding in the body's tets, R the targets' residual shapes, which the tets
// cannot carry, and w the targets' weights. For each model there is one way from its coordinates q to the points and
// back: positions, x(q); pull_back, (dx/dq)^T f of forces f; and rows, dg/dq of numbers g that depend on chosen points.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/sparse_rows.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/skinning.hpp"

namespace dynamorph {

using PointTransform = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

/// P points that move with a body. Bind space, meters.
struct Skin {
  Points rest;               ///< X (P, 3)
  Embedding embedding;       ///< E (P)
  SkinWeights weights;       ///< (P, B), as for the body's skin; rows sum to one
  MatrixXd residual_shapes;  ///< R (3P, J), or (0, 0) for none

  /// [A | a] of a point.
  PointTransform transform(const Transforms& bones, Eigen::Index point) const;
};

/// Points of a surface (P): each is a mean of up to three of its vertices.
struct SurfacePoints {
  Triangles corners;                                                  ///< (P, 3); those of weight zero do not count
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> weights;  ///< (P, 3), not negative; rows sum to one

  /// The vertices themselves.
  static SurfacePoints vertices(Eigen::Index count);
  Eigen::Index size() const { return corners.rows(); }

  /// Calls f(vertex, weight) for each corner of a point.
  template <class F>
  void each_corner(Eigen::Index point, F&& f) const {
    for (int k = 0; k < 3; ++k)
      if (weights(point, k) > 0) f(int(corners(point, k)), weights(point, k));
  }
};

/// Throws std::invalid_argument unless the points are such of a surface with so many vertices.
void check_points(const SurfacePoints& points, Eigen::Index vertices);

/// The skin's embedding. Throws std::invalid_argument unless its arrays fit each other, the body and its targets.
const Embedding& checked_embedding(const Skin& skin, const SoftBody& body, Eigen::Index targets);

/// Numbers that depend on points to first order: the change of each is a sum of direction . (change of x), over a few
/// points. Directions are in world space.
class PointRows {
 public:
  void clear();
  /// Begins the next row.
  void add_row();
  /// Adds a point to the last row.
  void add(int point, const Vector3d& direction);

  int size() const { return int(ends_.size()); }
  /// The points of a row are first(row) .. first(row + 1) - 1 of all.
  int first(int row) const { return row == 0 ? 0 : ends_[row - 1]; }
  int parts() const { return int(points_.size()); }  ///< points of all rows
  int point(int k) const { return points_[k]; }
  const Vector3d& direction(int k) const { return directions_[k]; }
  Vector3d& direction(int k) { return directions_[k]; }

 private:
  std::vector<int> points_, ends_;
  std::vector<Vector3d> directions_;
};

/// Points embedded in a mesh whose free nodes are the coordinates: u = q.
class NodalPoints {
 public:
  using Rows = SparseRows;
  NodalPoints(const SoftBody& body, const Embedding& embedding);

  /// E u (3P).
  void displacement(const VectorXd& q, VectorXd& out) const;
  /// The same of one point.
  Vector3d displacement(const VectorXd& q, Eigen::Index point) const;
  /// E^T f (3 free) of bind-space forces f (3P).
  void project(const VectorXd& f, VectorXd& out) const;
  /// Rows over bind-space directions.
  void rows(const PointRows& numbers, Rows& out) const;

 private:
  Eigen::Index free_;
  Tets nodes_;  ///< free nodes, -1 where pinned
  Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> weights_;
};

/// Points of a model with few coordinates: E u = (E U) q.
class ModalPoints {
 public:
  using Rows = RowMajor;
  /// U (3 free, dofs).
  ModalPoints(const SoftBody& body, const Embedding& embedding, const MatrixXd& U);

  void displacement(const VectorXd& q, VectorXd& out) const { out.noalias() = basis_ * q; }
  Vector3d displacement(const VectorXd& q, Eigen::Index point) const { return basis_.middleRows<3>(3 * point) * q; }
  void project(const VectorXd& f, VectorXd& out) const { out.noalias() = basis_.transpose() * f; }
  void rows(const PointRows& numbers, Rows& out) const;

  const RowMajor& basis() const { return basis_; }  ///< E U (3P, dofs)

 private:
  RowMajor basis_;
};

/// The skin of a model, which stays the same while it moves: several simulations may share it. bones: (B, 12), bind to
/// world space; w (J): target weights; q: the model's coordinates.
template <class Model>
class SkinMap {
 public:
  using Rows = typename Model::SkinPoints::Rows;

  /// Throws std::invalid_argument unless the skin's arrays fit each other and the model.
  SkinMap(std::shared_ptr<const Model> model, Skin skin)
      : model_(std::move(model)),
        skin_(std::move(skin)),
        points_(model_->skin_points(checked_embedding(skin_, model_->body(), Eigen::Index(model_->targets().size())))) {
  }

  const Model& model() const { return *model_; }
  const std::shared_ptr<const Model>& shared_model() const { return model_; }
  const Skin& skin() const { return skin_; }
  Eigen::Index size() const { return skin_.rest.rows(); }  ///< P

  /// E u(q) + R w (3P), bind space.
  void displacement(const VectorXd& w, const VectorXd& q, VectorXd& out) const {
    points_.displacement(q, out);
    if (skin_.residual_shapes.size() > 0) out.noalias() += skin_.residual_shapes * w;
  }

  /// The same of one point.
  Vector3d displacement(const VectorXd& w, const VectorXd& q, Eigen::Index point) const {
    Vector3d out = points_.displacement(q, point);
    if (skin_.residual_shapes.size() > 0) out += skin_.residual_shapes.middleRows<3>(3 * point) * w;
    return out;
  }

  /// x (3P), world space.
  void positions(const Transforms& bones, const VectorXd& w, const VectorXd& q, VectorXd& x) const {
    displacement(w, q, x);
    for (Eigen::Index p = 0; p < size(); ++p) {
      const PointTransform T = skin_.transform(bones, p);
      x.segment<3>(3 * p) = T.leftCols<3>() * (skin_.rest.row(p).transpose() + x.segment<3>(3 * p)).eval() + T.col(3);
    }
  }

  /// Where a point is at q = 0, world space.
  Vector3d unmoved(const Transforms& bones, const VectorXd& w, Eigen::Index point) const {
    Vector3d displacement = Vector3d::Zero();
    if (skin_.residual_shapes.size() > 0) displacement = skin_.residual_shapes.middleRows<3>(3 * point) * w;
    return posed(skin_.transform(bones, point), point, displacement);
  }

  /// Where a point is with its transform and a displacement in bind space, world space.
  Vector3d posed(const PointTransform& T, Eigen::Index point, const Vector3d& displacement) const {
    return T.leftCols<3>() * (skin_.rest.row(point).transpose() + displacement) + T.col(3);
  }

  /// Generalized forces (dofs) of forces on the points (3P), newtons, world space.
  void pull_back(const Transforms& bones, VectorXd forces, VectorXd& out) const {
    for (Eigen::Index p = 0; p < size(); ++p)
      forces.segment<3>(3 * p) =
          (skin_.transform(bones, p).leftCols<3>().transpose() * forces.segment<3>(3 * p)).eval();
    points_.project(forces, out);
  }

  /// dg/dq of each of the numbers. scratch: the numbers in bind space.
  void rows(const Transforms& bones, const PointRows& numbers, PointRows& scratch, Rows& out) const {
    scratch = numbers;
    for (int k = 0; k < scratch.parts(); ++k)
      scratch.direction(k) =
          (skin_.transform(bones, scratch.point(k)).leftCols<3>().transpose() * scratch.direction(k)).eval();
    points_.rows(scratch, out);
  }

 private:
  std::shared_ptr<const Model> model_;
  Skin skin_;
  typename Model::SkinPoints points_;
};

}  // namespace dynamorph
