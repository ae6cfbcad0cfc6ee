// SPDX-License-Identifier: GPL-3.0-or-later
// The terms of a step's potential, as newton.hpp needs them. To add one, add a struct here and its name to the list of
// terms in Simulation.
#pragma once

#include "dynamorph/core/types.hpp"
#include "dynamorph/step/newton.hpp"

namespace dynamorph {

/// 1/2 d.H d + g.d with d = q - origin: inertia, damping, gravity, external forces. The origin is the predicted
/// coordinates, so that g is a force and not the round-off of a large displacement.
template <class Matrix>
struct QuadraticTerm {
  Matrix H;
  VectorXd g, origin;
  double round_off_of_g = 0;

  void at(const VectorXd& q) {
    d_ = q - origin;
    multiply(H, d_, Hd_);
    gradient_ = Hd_ + g;
  }
  double value() const { return 0.5 * d_.dot(Hd_) + d_.dot(g); }
  const VectorXd& gradient() const { return gradient_; }
  const Matrix& hessian() const { return H; }
  RoundOff round_off() const { return {Hd_.norm() + g.norm(), round_off_of_g, 0}; }

 private:
  VectorXd d_, Hd_, gradient_;
};

/// E(q) in one pose: the elastic energy, and the energy of the hold.
template <class Model>
struct ElasticTerm {
  using Matrix = typename Model::Matrix;
  const Model* model;
  const typename Model::Blend* blend;
  double reference = 0;  ///< norm of the quadratic term's origin, for the round-off

  void at(const VectorXd& q) {
    q_ = q;
    known_ = Known::nothing;
  }
  double value() {
    if (known_ == Known::nothing) {
      energy_ = model->energy(*blend, q_);
      known_ = Known::energy;
    }
    return energy_;
  }
  const VectorXd& gradient() {
    linearize();
    return force_;
  }
  const Matrix& hessian() {
    linearize();
    return stiffness_;
  }
  RoundOff round_off() {
    const double length = q_.norm() + reference + 0.1 * model->body().size * model->metre();
    const double largest = values(hessian()).cwiseAbs().maxCoeff();  // terms of that size cancel in the force
    return {force_.norm(), 1e-14 * largest * length, length};
  }

 private:
  /// Force and stiffness share nearly all of their arithmetic, the energy little of it.
  void linearize() {
    if (known_ == Known::all) return;
    energy_ = model->linearize(*blend, q_, force_, stiffness_);
    known_ = Known::all;
  }

  enum class Known { nothing, energy, all };
  VectorXd q_;
  Known known_ = Known::nothing;
  double energy_ = 0;
  VectorXd force_;
  Matrix stiffness_;
};

}  // namespace dynamorph
