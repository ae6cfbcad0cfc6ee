// SPDX-License-Identifier: GPL-3.0-or-later
// What a whole body needs beside its tabulated modes: many responses that stay linear (docs/theory.md, Whole bodies).
//
//   u = U z + W y,   E = E_modes(z) + y . c(z) + 1/2 y . D y,   c = fade(s) 1/2 S(v, v),   v = z - sum_j w_j z_j
//
// W is K- and M-orthogonal to itself and K-orthogonal to U about the neutral target, so D is diagonal. S holds the
// second derivatives of the force on the responses. Static condensation of y gives the modal derivatives, without
// their locking. D and S of a target j are those at its own shape; the parts of its K that are neither in the modes'
// table nor in D are left out. d_j is in the span of U, where c and y vanish, so targets stay exact.
//
// Far from the shape, 1/2 S(v, v) grows beyond the true force and could make E negative: there the coupling fades,
// fade = 1 / (1 + s^2) with s = sum_k (v_k / reach_k)^2, and the modes' own table remains.
#pragma once

#include <vector>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/reduced/modes/polynomials.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

class Responses {
 public:
  /// coordinates: z_j of every target (r). Throws std::invalid_argument unless the tables fit the targets.
  Responses(const ReducedTables& tables, const std::vector<MorphTarget>& targets,
            const std::vector<VectorXd>& coordinates);

  Eigen::Index count() const { return count_; }

  struct Blend {
    VectorXd stiffness, damping;  ///< D, and sum_j w_j beta_j D_j
    VectorXd shape;               ///< sum_j w_j z_j (r)
    LaneVector<float> coupling;   ///< sum_j w_j S_j, unless a single target has all the weight
    int only = -1;                ///< that target
    /// Scratch: S v (padded h, r), S : y (pairs), 1/2 S(v, v), its derivatives, padded y, the tables with a weight.
    mutable MatrixXd slopes, bend;
    mutable VectorXd products, curved, padded, from_shape, along, away;
    std::vector<const float*> active;
    std::vector<double> active_weights;
  };

  /// Blends at target weights w (J).
  void blend(const VectorXd& w, Blend& out) const;

  /// Adds the responses' part at coordinates q = (z, y) to the modes' part of force and stiffness. Returns its energy.
  double add(const Blend& blend, const VectorXd& q, VectorXd& force, ArrowMatrix& stiffness) const;

 private:
  Eigen::Index r_, count_, rows_;  ///< rows_: count_ in whole chunks
  std::vector<double> stiffness_damping_;
  std::vector<VectorXd> stiffness_, coordinates_;
  std::vector<LaneVector<float>> coupling_;  ///< S (rows, pairs) of each target; empty for the linear law
  VectorXd reach_;                           ///< (r)
};

}  // namespace dynamorph
