// SPDX-License-Identifier: GPL-3.0-or-later
// Local responses (local_responses.hpp) in a step. The contacts i have the depth d_i where the model's coordinates
// alone put them, and the stiffness k_i. What gives way has no mass and no past, so it is always at rest:
//
//   E = min_a  sum_i k_i ramp(d_i - rho_i a) + a^T C a / 2 + sum_m 1000 C_mm ramp(|a_m| - A_m)
//
// where A_m is the amplitude at which a patch moves some skin 1.5 times as far as the deepest contact is deep. Samples
// that a patch is too coarse for would ask for more, and throw skin about.
//
// is a function of the depths alone. Its derivative in d_i is the force k_i ramp'(d_i - rho_i a), and its Hessian in
// them is that of the springs D = diag(k_i ramp'') and of what gives way beneath them, in series:
//
//   S = (D^-1 + rho C^-1 rho^T)^-1,
//
// over those that are pressed, with the slope of the last term in C. With C = L L^T, this works with b = L^T a and the
// rows rho L^-T, whose C is one.
#pragma once

#include <Eigen/Cholesky>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// The patches that take part in a step, m of them, and n contacts.
class Dents {
 public:
  void clear() { patches_.clear(); }
  bool empty() const { return patches_.empty(); }

  /// rho (n, m), C (m, m), A (m) > 0. They begin flat.
  void begin(std::vector<int> patches, const MatrixXd& rows, const MatrixXd& stiffness, VectorXd most);

  /// Finds a for contacts of these depths (n), meters, and stiffness (n), N/m; width of the ramp, meters.
  void settle(const VectorXd& depths, const VectorXd& stiffness, double width);
  double energy() const { return energy_; }             ///< of what gives way alone, J
  const VectorXd& given_way() const { return given_; }  ///< rho a (n), meters

  /// Turns rows of contacts (k, dofs) with the stiffness D (k) > 0 into rows with a stiffness of one each, whose
  /// squares sum to those of S. contacts (k): which ones.
  void soften(const std::vector<int>& contacts, Eigen::Ref<RowMajor> rows, Eigen::Ref<VectorXd> stiffness) const;

  /// Sets the amplitudes of all patches.
  void amplitudes(VectorXd& all) const;

 private:
  double evaluate(const VectorXd& depths, const VectorXd& stiffness, double width);
  /// Of what gives way, over b: one, and more where patches harden.
  MatrixXd own_stiffness() const;

  std::vector<int> patches_;
  VectorXd most_, hardness_;
  MatrixXd back_;  ///< L^-T
  RowMajor rows_;  ///< rho L^-T
  VectorXd b_, a_, given_, force_, slope_, hard_force_, hard_slope_;
  double energy_ = 0;
};

}  // namespace dynamorph
