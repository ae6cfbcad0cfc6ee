// SPDX-License-Identifier: GPL-3.0-or-later
// The terms of a step's potential, as newton.hpp needs them. To add one, contact for example, add a struct here and its
// name to the lists of terms in Simulation and Crowd.
#pragma once

#include "dynamorph/core/types.hpp"
#include "dynamorph/step/newton.hpp"

namespace dynamorph {

/// 1/2 d.H d + g.d with d = q - origin: inertia, damping, gravity, external forces. The origin is the predicted
/// coordinates, so that g is a force and not the round-off of a large displacement.
template <class Arithmetic>
struct QuadraticTerm {
  using Number = typename Arithmetic::Number;
  using Vector = typename Arithmetic::Vector;
  typename Arithmetic::Matrix hessian;  ///< H
  Vector g, origin;
  Number round_off{};  ///< of g

  Vector gradient;
  Number energy{}, forces{}, length{}, resolution{};

  void evaluate(const Vector& q) {
    Arithmetic::subtract(q, origin, d_);
    Arithmetic::multiply(hessian, d_, Hd_);
    Arithmetic::sum(gradient, Hd_, g);
    energy = 0.5 * Arithmetic::dot(d_, Hd_) + Arithmetic::dot(d_, g);
    forces = Arithmetic::norm(Hd_) + Arithmetic::norm(g);
  }
  Number longest(const Vector&, const Vector&) const { return Number() + 1.0; }

 private:
  Vector d_, Hd_;
};

/// E(q) in one pose: the elastic energy, and the energy of the hold.
template <class Model, class Arithmetic, class Blend>
struct ElasticTerm {
  using Number = typename Arithmetic::Number;
  using Vector = typename Arithmetic::Vector;
  const Model* model;
  Blend* blend;
  Number reference{};  ///< norm of the quadratic term's origin, for the round-off

  Vector gradient;
  typename Arithmetic::Matrix hessian;
  Number energy{}, forces{}, round_off{}, length{}, resolution{};

  void evaluate(const Vector& q) {
    if constexpr (Arithmetic::kLanes == 1) {
      energy = model->linearize(*blend, q, gradient, hessian);
    } else {
      model->linearize(*blend, q, energy, gradient, hessian);
      Arithmetic::subtract(q, blend->centre, from_centre_);
      resolution = 1e-6 * Arithmetic::norm(from_centre_);  // the tables use them in single precision
    }
    forces = Arithmetic::norm(gradient);
    length = Arithmetic::norm(q) + reference + 0.1 * model->body().size * model->metre();
    round_off = 1e-14 * Arithmetic::largest(hessian) * length;  // terms of that size cancel in the force
  }
  Number longest(const Vector&, const Vector&) const { return Number() + 1.0; }

 private:
  Vector from_centre_;
};

}  // namespace dynamorph
