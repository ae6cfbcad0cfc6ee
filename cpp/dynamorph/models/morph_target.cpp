// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/morph_target.hpp"

#include <cmath>

#include "dynamorph/core/errors.hpp"

namespace dynamorph {

namespace {

/// Largest lambda / mu, which is Poisson's ratio 0.495: linear tetrahedra hardly move beyond it, whatever the forces.
constexpr double kLocks = 100;

}  // namespace

Lame lame_of(double young, double poisson) {
  if (!(young > 0 && std::isfinite(young)))
    throw std::invalid_argument("young: expected a finite number of Pa above zero, got " + std::to_string(young));
  if (!(poisson >= 0 && poisson <= 0.495))
    throw std::invalid_argument("poisson: expected 0 to 0.495, above which tetrahedra lock, got " +
                                std::to_string(poisson));
  return {young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))};
}

void check_targets(const SoftBody& body, const std::vector<MorphTarget>& targets) {
  if (targets.empty()) throw std::invalid_argument("targets: at least one is needed");
  for (const MorphTarget& target : targets) {
    if (target.set < 0 || target.set >= body.sets())
      throw std::invalid_argument("targets: '" + target.name + "' is in set " + std::to_string(target.set) +
                                  ", there are " + std::to_string(body.sets()));
    check_size("displacement", target.displacement.size(), body.mesh.nodes.size());
    if (!target.displacement.allFinite())
      throw Error("Target '" + target.name + "' has a shape that is not finite. Repair that shape.");
    if (body.expand(body.restrict_to_free(target.displacement)) != target.displacement)
      throw std::invalid_argument("targets: '" + target.name +
                                  "' displaces pinned nodes; the shapes of extend_shapes do not");
    const double properties =
        target.lame.mu + target.lame.lambda + target.density + target.mass_damping + target.stiffness_damping;
    if (!(target.lame.mu > 0 && target.lame.lambda >= 0 && target.density > 0 && target.mass_damping >= 0 &&
          target.stiffness_damping >= 0 && std::isfinite(properties)))
      throw std::invalid_argument("targets: '" + target.name + "' needs finite stiffness and density above zero");
    if (target.lame.lambda > kLocks * target.lame.mu)
      throw std::invalid_argument("targets: '" + target.name +
                                  "' has a Poisson's ratio above 0.495, at which tetrahedra lock: lower lame_lambda");
  }
}

void check(Blending blending) {
  if (blending != Blending::forces && blending != Blending::even)
    throw std::invalid_argument("blending: expected one of Blending's values, got " + std::to_string(int(blending)));
}

VectorXd neutral_weights(const SoftBody& body, const std::vector<MorphTarget>& targets) {
  VectorXd out = VectorXd::Zero(Eigen::Index(targets.size()));
  for (int s = 0; s < body.sets(); ++s)
    for (std::size_t j = 0; j < targets.size(); ++j)
      if (targets[j].set == s) {
        out(Eigen::Index(j)) = 1;
        break;
      }
  return out;
}

void SetDensities::blend(const std::vector<MorphTarget>& targets, int sets, const VectorXd& w) {
  density.setZero(sets);
  damped.setZero(sets);
  for (size_t j = 0; j < targets.size(); ++j) {
    density(targets[j].set) += w(j) * targets[j].density;
    damped(targets[j].set) += w(j) * targets[j].density * targets[j].mass_damping;
  }
}

}  // namespace dynamorph
