// SPDX-License-Identifier: GPL-3.0-or-later
// What a whole body needs beside its tabulated modes: many responses that stay linear (docs/theory.md, Whole bodies).
// About a target, with v = z - z_j,
//
//   u = d_j + U v + W y,   E_j = E(U_j v) + 1/2 y' . D_j y' + theta y' . c_j(v),   y' = y + A_j v,   U_j = U - W A_j.
//
// W is K- and M-orthogonal to itself and K-orthogonal to U about the neutral target, so that D is diagonal and A zero
// there. A_j = (W^T K_j W)^-1 W^T K_j U makes the relaxed modes U_j K_j-orthogonal to W as well: E(U_j v) is their
// quartic table. What is left out is W^T K_j W beside its diagonal D_j. c_j = 1/2 S_j(v, v) has the second derivatives
// of the force on the responses; static condensation of y' gives the modal derivatives, without their locking. At d_j
// y' and c vanish, so targets stay exact.
//
// The energies are summed by weight: with forces blending each about its own z_j, with even blending all about the
// blended one. With D = sum_j w_j D_j, b = sum_j w_j D_j A_j v_j and c = sum_j w_j c_j, and y' = y + D^-1 b,
//
//   E = E_modes(z) + y . b(z) + 1/2 y . D y + theta y' . c(z),   E_modes = sum_j w_j (E(U_j v_j) + 1/2 A v . D A v).
//
// Far from the shapes, c grows beyond the true force. Condensing y reduces the energy by theta^2 P, P = 1/2 c . D^-1 c,
// and theta keeps that below what the modes can pay: with E = E_modes - 1/2 b . D^-1 b and its quadratic part E_2,
//
//   pay = E^2 / (E + E_2),   theta^2 P = g(P / pay) pay,   g(x) = x up to kExact, and below 1 everywhere.
//
// E is a sum of energies of the body, so that the whole is at least E - pay = E E_2 / (E + E_2) >= 0 for all
// coordinates, and theta is 1 in all motion but the largest. The factor E / (E + E_2) counts where modes soften under
// compression: with pay = E the condensed energy has minima there that neither the modes nor the body have
// (docs/decisions/0008).
#pragma once

#include <vector>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/reduced/modes/polynomials.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class Responses {
 public:
  /// coordinates: z_j of every target (r). Throws std::invalid_argument unless the tables fit the targets; those of the
  /// modes must.
  Responses(const ReducedTables& tables, const std::vector<MorphTarget>& targets,
            const std::vector<VectorXd>& coordinates, Blending blending);

  Eigen::Index count() const { return count_; }

  /// K of target j in the modes where y = 0, U_j^T K_j U_j + A_j^T D_j A_j (r, r).
  const MatrixXd& modal_stiffness(int j) const { return targets_[j].modal; }

  struct Blend {
    VectorXd stiffness;  ///< D
    /// sum_j e_j beta_j D_j (h), and the same of D_j A_j (h, r)
    VectorXd damping;
    MatrixXd border_damping;
    VectorXd shape;                     ///< x = z - shape: sum_j w_j z_j with even blending, otherwise zero (r)
    MatrixXd border, relaxation;        ///< B of b = B x + b(0) (h, r), and D^-1 B
    VectorXd border_force;              ///< b(0)
    MatrixXd modal;                     ///< of E_2 = 1/2 x . modal x + modal_force . x + modal_energy (r, r)
    VectorXd modal_force, shape_force;  ///< shape_force: of the last target, kept so that blending allocates nothing
    double modal_energy = 0;
    LaneVector<float> coupling;  ///< S of c = 1/2 S(x, x) + slopes x + c(0), unless a single target has all the weight
    MatrixXd coupling_slopes;    ///< padded (h, r)
    VectorXd coupling_force;     ///< c(0) (h)
    int only = -1;               ///< that target
    std::vector<const float*> active;
    std::vector<double> active_elastic;  ///< e of those
    double elastic_of_coupling() const { return only >= 0 ? active_elastic[0] : 1; }
  };

  /// What one evaluation needs beside its results: x; b, D^-1 b, y', c, D^-1 c (h); what is padded; dc/dz (padded
  /// h, r); second derivatives (r, r).
  struct Workspace {
    VectorXd x, b, relaxed, shifted, c, answer, padded, moved, products;
    VectorXd elastic_x, elastic_padded;                  ///< times e of the only target
    VectorXd work, energy, linear, pay, between, ratio;  ///< gradients by z
    MatrixXd slopes, unused_slopes, scaled, bend, cross, energy2, linear2, ratio2;
  };

  /// Blends at target weights w and their elastic weights e (J).
  void blend(const VectorXd& w, const VectorXd& e, Blend& out) const;
  void blend(const VectorXd& w, Blend& out) const { blend(w, w, out); }

  /// Adds the responses' part at coordinates q = (z, y) to force and stiffness of the modes, whose energy is `modes`.
  /// Returns its energy.
  double add(const Blend& blend, const VectorXd& q, double modes, Workspace& s, VectorXd& force,
             ArrowMatrix& stiffness) const;

 private:
  struct Target {
    double damping;  ///< beta
    VectorXd coordinates, stiffness;
    MatrixXd border;             ///< D A (h, r)
    MatrixXd modal;              ///< (r, r)
    LaneVector<float> coupling;  ///< S (rows, pairs); empty for the linear law
    MatrixXd coupling_slopes;    ///< forces blending: of c at z = 0 (rows, r), and c there
    VectorXd coupling_force;
  };
  /// E and E_2 where y is what it relaxes to.
  struct Payers {
    double energy, linear;
  };
  double add_coupling(const Blend& blend, const LaneVector<float>& S, Payers payers, Workspace& s, VectorXd& force,
                      ArrowMatrix& stiffness) const;
  void differentiate_ratio(const Blend& blend, const LaneVector<float>& S, Payers payers, double ratio,
                           Workspace& s) const;

  Eigen::Index r_, count_, rows_;  ///< rows_: count_ in whole chunks
  bool even_, relaxed_;            ///< relaxed_: whether some A is not zero
  std::vector<Target> targets_;
};

}  // namespace dynamorph
