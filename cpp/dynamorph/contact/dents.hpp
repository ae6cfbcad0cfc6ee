// SPDX-License-Identifier: GPL-3.0-or-later
// Local responses (local_responses.hpp) in a step. What gives way has no mass and no past: its amplitudes a are
// unknowns of the step beside the model's coordinates, with the energy
//
//   E = a^T C a / 2 + sum_m 300 C_mm (ramp(|a_m| - A_m) + ramp(|g_m a| - A_m)).
//
// g_m a is what all patches together do where patch m moves the skin farthest, as if it alone did it, and A_m the
// amplitude at which that is as far as the deepest contact is deep. Samples that patches are too coarse for would ask
// for more, and throw skin about. A contact i is moved by rho_i a along its normal.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// The patches that take part in a step, m of them, and n contacts.
class Dents {
 public:
  void clear();
  bool empty() const { return patches_.empty(); }

  /// rho (n, m), C (m, m), g (m, m), A (m) > 0. They begin at these amplitudes of all patches.
  void begin(std::vector<int> patches, RowMajor rows, MatrixXd stiffness, const RowMajor& together, VectorXd most,
             const VectorXd& amplitudes);

  /// Moves them to a (m).
  void at(const Eigen::Ref<const VectorXd>& a);
  const VectorXd& unknowns() const { return a_; }           ///< a
  const VectorXd& given_way() const { return given_; }      ///< rho a (n), meters
  double energy() const { return energy_; }                 ///< E, J
  const VectorXd& resisting() const { return force_; }      ///< dE/da (m)
  const RowMajor& rows() const { return rows_; }            ///< rho
  const MatrixXd& stiffness() const { return stiffness_; }  ///< C
  /// Calls f(row over a, stiffness > 0) for each bound A that is reached.
  template <class F>
  void each_hard(F&& f) const {
    for (Eigen::Index m = 0; m < hard_slope_.size(); ++m)
      if (hard_slope_(m) > 0) f(bounded_rows_.row(m), hard_slope_(m));
  }

  /// Sets the amplitudes of all patches.
  void amplitudes(VectorXd& all) const;

 private:
  std::vector<int> patches_;
  VectorXd most_, hardness_;
  RowMajor bounded_rows_, rows_;  ///< of a and g a (2m), and of the contacts
  MatrixXd stiffness_;
  double energy_ = 0;
  VectorXd a_, bounded_, given_, force_, hard_force_, hard_slope_;
};

}  // namespace dynamorph
