// SPDX-License-Identifier: GPL-3.0-or-later
// The terms of a step's potential, as newton.hpp needs them, but for that of contact (contact_term.hpp). `begin` says
// what a term is in a step. To add one, add a struct here, and its name to `Sum` of MovingBody.
#pragma once

#include <algorithm>
#include <cmath>

#include "dynamorph/core/types.hpp"
#include "dynamorph/models/skin.hpp"
#include "dynamorph/step/motion_limit.hpp"
#include "dynamorph/step/newton.hpp"
#include "dynamorph/step/step_input.hpp"

namespace dynamorph {

/// 1/2 d.H d + g.d with d = q - origin: inertia, damping, gravity, external forces. The origin is the predicted
/// coordinates, so that g is a force and not the round-off of a large displacement.
template <class Matrix>
struct QuadraticTerm {
  Matrix H;
  VectorXd g, origin;
  double round_off_of_g = 0;

  double value(const VectorXd& x) {
    d_ = x.head(origin.size()) - origin;
    multiply(H, d_, Hd_);
    return 0.5 * d_.dot(Hd_) + d_.dot(g);
  }
  Term<Matrix> linearize(const VectorXd& x) {
    const double energy = value(x);
    gradient_ = Hd_ + g;
    return {energy, gradient_, H, {Hd_.norm() + g.norm(), round_off_of_g, 0}};
  }

 private:
  VectorXd d_, Hd_, gradient_;
};

/// E(q) in one pose: the elastic energy, and the energy of the hold.
template <class Model>
struct ElasticTerm {
  using Matrix = typename Model::Matrix;

  /// reference: norm of the quadratic term's origin, for the round-off. tolerance: of Newton's method. Model and blend
  /// must outlive the step.
  void begin(const Model& model, const typename Model::Blend& blend, double reference, double tolerance) {
    model_ = &model;
    blend_ = &blend;
    reference_ = reference;
    workspace_.begin(tolerance);
  }

  double value(const VectorXd& x) {
    q_ = x.head(model_->dofs());
    return model_->energy(*blend_, q_, workspace_);
  }
  Term<Matrix> linearize(const VectorXd& x) {
    q_ = x.head(model_->dofs());
    energy_ = model_->linearize(*blend_, q_, workspace_, force_, stiffness_);
    const double length = q_.norm() + reference_ + 0.1 * model_->body().size * model_->meter();
    const double largest = values(stiffness_).cwiseAbs().maxCoeff();  // terms of that size cancel in the force
    return {energy_, force_, stiffness_, {force_.norm(), 1e-14 * largest * length, length}};
  }
  /// E where it was linearized last, or after a short step from there: its third power does not count.
  double energy() const { return energy_; }
  double energy_after(const VectorXd& step) {
    multiply(stiffness_, step, q_);
    return energy_ + step.dot(force_ + 0.5 * q_);
  }

 private:
  const Model* model_ = nullptr;
  const typename Model::Blend* blend_ = nullptr;
  double reference_ = 0, energy_ = 0;
  typename Model::Workspace workspace_;
  VectorXd q_, force_;
  Matrix stiffness_;
};

/// sum_k s_k / 2 |x_k(q) - goal_k|^2 over grabbed points of the skin. With the bones at the end of the step, x is
/// linear in q, so that the rows are made once a step.
template <class Model>
struct GrabTerm {
  using Points = PointStiffness<typename Model::Matrix>;

  /// Throws std::invalid_argument for grabs of another model's skin, or of points that it does not have.
  void begin(const Model& model, const StepInput<Model>& input) {
    const std::size_t count = input.grabs ? input.grabs->springs.size() : 0;
    points_.stiffness.resize(3 * Eigen::Index(count));
    if (count == 0) return;
    const SkinMap<Model>* skin = input.grabs->skin.get();
    if (!skin || &skin->model() != &model) throw std::invalid_argument("grabs: the skin belongs to another model");
    from_goal_.resize(points_.stiffness.size());
    numbers_.clear();
    magnitude_ = 0;
    for (std::size_t k = 0; k < count; ++k) {
      const Grab& grab = input.grabs->springs[k];
      if (grab.point < 0 || grab.point >= skin->size())
        throw std::invalid_argument("grabs: expected points from 0 to " + std::to_string(skin->size() - 1) + ", got " +
                                    std::to_string(grab.point));
      if (!(grab.stiffness >= 0) || !std::isfinite(grab.stiffness) || !grab.goal.allFinite())
        throw std::invalid_argument("grabs: goals must be finite, and stiffness finite and not negative");
      const Vector3d unmoved = skin->unmoved(input.bones, input.weights, grab.point);
      from_goal_.segment<3>(3 * Eigen::Index(k)) = unmoved - grab.goal;
      points_.stiffness.template segment<3>(3 * Eigen::Index(k)).setConstant(grab.stiffness);
      magnitude_ += grab.stiffness * (unmoved.norm() + grab.goal.norm());
      for (int axis = 0; axis < 3; ++axis) {
        numbers_.add_row();
        numbers_.add(grab.point, Vector3d::Unit(axis));
      }
    }
    skin->rows(input.bones, numbers_, scratch_, points_.rows);
  }

  double value(const VectorXd& x) {
    if (points_.stiffness.size() == 0) return 0;
    multiply(points_.rows, x, offset_);
    offset_ += from_goal_;
    force_ = points_.stiffness.cwiseProduct(offset_);
    return 0.5 * offset_.dot(force_);
  }
  Term<Points> linearize(const VectorXd& x) {
    gradient_.setZero(x.size());
    if (points_.stiffness.size() == 0) return {0, gradient_, points_, {}};
    const double energy = value(x);
    add_transposed_product(points_.rows, force_, gradient_);
    return {energy, gradient_, points_, {gradient_.norm(), 1e-15 * magnitude_, x.norm()}};
  }

 private:
  Points points_;
  PointRows numbers_, scratch_;
  VectorXd from_goal_, offset_, force_, gradient_;  ///< from the goals at q = 0 and at q, meters; stiffness times that
  double magnitude_ = 0;                            ///< of the forces that cancel in `force_`
};

/// sum_p k_p ramp(|x_p(q)|) over the pulls p of a motion limit, whose numbers x are linear in q and zero in the
/// targets' shape (motion_limit.hpp).
template <class Model>
struct PullTerm {
  using Points = PointStiffness<typename Model::Matrix>;

  /// limit: null for none. What can be pulled is what has gone at least `watched` of its limit at the `predicted`
  /// coordinates. stiffer: as of `MotionLimit::drive`.
  void begin(const MotionLimit<Model>* limit, const VectorXd& weights, double stiffer, const VectorXd& predicted,
             double watched) {
    limit_ = limit;
    watched_.clear();
    points_.stiffness.resize(0);
    farthest_ = 0;
    if (!limit) return;
    blended_shape(limit->model(), weights, shape_);
    from_shape_ = predicted - shape_;
    limit->pull_values(from_shape_, scratch_, values_);
    numbers_.clear();
    for (const Pull& pull : limit->pulls()) {
      const double far = values_.segment(pull.first, pull.count).norm() / pull.limit;
      if (pull.count == 3) farthest_ = std::max(farthest_, far);
      if (far < watched) continue;
      watched_.push_back({numbers_.size(), pull.count, pull.limit, stiffer * pull.stiffness});
      for (int row = pull.first; row < pull.first + pull.count; ++row) copy(limit->pull_numbers(), row, numbers_);
    }
    if (!watched_.empty()) limit->pull_points().rows(numbers_, rows_);
  }

  /// Distance of the point that is farthest at the predicted coordinates, relative to its limit.
  double farthest() const { return farthest_; }

  double value(const VectorXd& x) {
    return evaluate(x, [](const auto&...) {});
  }

  /// Its Hessian is along the pull, and of a point across it, of all that is pulled.
  Term<Points> linearize(const VectorXd& x) {
    stiff_numbers_.clear();
    stiffness_.clear();
    forces_.setZero(numbers_.size());
    double force_norms = 0;
    const double energy = evaluate(x, [&](const Pull& pull, const auto& offset, const Ramp& at) {
      forces_.segment(pull.first, pull.count) = pull.stiffness * at.across * offset;
      force_norms += pull.stiffness * at.across * offset.norm();
      stiffness_.push_back(pull.stiffness * at.along);
      if (pull.count == 1) return copy(numbers_, pull.first, stiff_numbers_);
      const Vector3d along = offset.normalized(), across = along.unitOrthogonal();
      for (const Vector3d& direction : {along, across, Vector3d(along.cross(across))}) {
        stiff_numbers_.add_row();
        stiff_numbers_.add(numbers_.point(numbers_.first(pull.first)), direction);
      }
      stiffness_.insert(stiffness_.end(), 2, pull.stiffness * at.across);
    });
    gradient_.setZero(x.size());
    points_.stiffness = Eigen::Map<const VectorXd>(stiffness_.data(), Eigen::Index(stiffness_.size()));
    if (!acts()) return {energy, gradient_, points_, {}};
    add_transposed_product(rows_, forces_, gradient_);
    limit_->pull_points().rows(stiff_numbers_, points_.rows);
    return {energy, gradient_, points_, {gradient_.norm(), 1e-15 * force_norms, from_shape_.norm() + shape_.norm()}};
  }
  /// Whether anything was pulled where it was linearized last.
  bool acts() const { return points_.stiffness.size() > 0; }

 private:
  /// The energy; calls f(pull, its numbers, ramp) for all that is pulled.
  template <class F>
  double evaluate(const VectorXd& x, F&& f) {
    if (watched_.empty()) return 0;
    from_shape_ = x.head(shape_.size()) - shape_;
    multiply(rows_, from_shape_, values_);
    double energy = 0;
    for (const Pull& pull : watched_) {
      const auto offset = values_.segment(pull.first, pull.count);
      const Ramp at = ramp(offset.norm(), pull.limit);
      energy += pull.stiffness * at.energy;
      if (at.along > 0) f(pull, offset, at);
    }
    return energy;
  }

  static void copy(const PointRows& from, int row, PointRows& to) {
    to.add_row();
    for (int k = from.first(row); k < from.first(row + 1); ++k) to.add(from.point(k), from.direction(k));
  }

  const MotionLimit<Model>* limit_ = nullptr;
  std::vector<Pull> watched_;          ///< their numbers are rows of rows_
  PointRows numbers_, stiff_numbers_;  ///< of what is watched; along and across the pulls
  typename Model::SkinPoints::Rows rows_;
  typename MotionLimit<Model>::Scratch scratch_;
  Points points_;
  std::vector<double> stiffness_;
  VectorXd shape_, from_shape_, values_, forces_, gradient_;
  double farthest_ = 0;
};

}  // namespace dynamorph
