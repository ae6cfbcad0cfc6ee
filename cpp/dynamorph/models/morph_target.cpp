// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/morph_target.hpp"

namespace dynamorph {

void SetDensities::blend(const std::vector<MorphTarget>& targets, int sets, const VectorXd& w) {
  density.setZero(sets);
  damped.setZero(sets);
  for (size_t j = 0; j < targets.size(); ++j) {
    density(targets[j].set) += w(j) * targets[j].density;
    damped(targets[j].set) += w(j) * targets[j].density * targets[j].mass_damping;
  }
}

}  // namespace dynamorph
