// SPDX-License-Identifier: GPL-3.0-or-later
// Newton's method with a line search for the potential of a step, Phi(q) = sum of terms.
//
// A term is an energy E(q), and has two calls:
//
//   value(x)       E, J
//   linearize(x)   a Term: E, dE/dq, d2E/dq2, and how exact they are
//
// Newton's method is over x: the coordinates q, and after them the unknowns that points have of their own
// (DensePoints), which contact's patches are. Terms are given all of them; a gradient is over q, or over all.
//
// Each iteration linearizes once: the whole step is nearly always taken. Only where it is not, shorter ones ask for
// values, and what was linearized last does not count.
#pragma once

#include <algorithm>
#include <cmath>
#include <tuple>

#include "dynamorph/step/hessian.hpp"

namespace dynamorph {

/// What the numbers of a term can be trusted for, in the units of its coordinates.
struct RoundOff {
  double forces = 0;    ///< sum of the norms of the forces that cancel in its gradient: what a residual is relative to
  double gradient = 0;  ///< error of its gradient, which no iteration can improve
  double length = 0;    ///< of the displacements that its energy is made of: that error times it is the energy's

  friend RoundOff operator+(const RoundOff& a, const RoundOff& b) {
    return {a.forces + b.forces, a.gradient + b.gradient, a.length + b.length};
  }
};

/// A term at some x, until it is evaluated at another one. Derivative: a matrix of the model, or PointStiffness where
/// the term acts at points of the skin.
template <class Derivative>
struct Term {
  double value;              ///< J
  const VectorXd& gradient;  ///< over the coordinates, or over all unknowns
  const Derivative& hessian;
  RoundOff round_off;
};

/// A potential at some x, but for its Hessian.
struct Linearization {
  VectorXd gradient;
  double value = 0, magnitude = 0;  ///< J; magnitude: sum of the terms' magnitudes
  RoundOff round_off;
};

/// The sum of some terms, which must outlive it, over the coordinates of a model with such matrices. The first
/// term must not act at points alone.
template <class Matrix, class... Terms>
class Potential {
 public:
  explicit Potential(Terms&... terms) : terms_(terms...) {}

  double value(const VectorXd& x) {
    return std::apply([&](Terms&... terms) { return (... + terms.value(x)); }, terms_);
  }

  void linearize(const VectorXd& x, Linearization& out) {
    out.gradient.setZero(x.size());
    out.value = out.magnitude = 0;
    out.round_off = {};
    hessians_ = std::apply([&](Terms&... terms) { return Hessians{add(terms.linearize(x), out)...}; }, terms_);
  }

  /// The Hessian where it was linearized last.
  void hessian(Hessian<Matrix>& out) const {
    out.points.clear();
    std::apply([&](const auto* first, const auto*... others) { collect(out, values(*first), *others...); }, hessians_);
  }

 private:
  template <class OfTerm>
  using HessianOf =
      std::remove_reference_t<decltype((std::declval<OfTerm&>().linearize(std::declval<VectorXd>()).hessian))>;
  using Hessians = std::tuple<HessianOf<Terms>*...>;

  /// Adds a term, but for its Hessian, which it returns.
  template <class Derivative>
  static const Derivative* add(const Term<Derivative>& term, Linearization& out) {
    out.gradient.head(term.gradient.size()) += term.gradient;
    out.value += term.value;
    out.magnitude += std::abs(term.value);
    out.round_off = out.round_off + term.round_off;
    return &term.hessian;
  }

  /// Writes the sum of the terms' matrices, after those that are in `sum`, and what acts at points.
  template <class Sum>
  static void collect(Hessian<Matrix>& out, const Sum& sum) {
    values(out.base) = sum;
  }
  template <class Sum, class Derivative, class... Others>
  static void collect(Hessian<Matrix>& out, const Sum& sum, const Derivative& hessian, const Others&... others) {
    if constexpr (std::is_same_v<Derivative, PointStiffness<Matrix>>) {
      if (acts(hessian)) out.points.push_back(&hessian);
      collect(out, sum, others...);
    } else {
      collect(out, sum + values(hessian), others...);
    }
  }

  std::tuple<Terms&...> terms_;
  Hessians hessians_{};
};

/// The memory that Newton's method works in. Keep it: nothing is allocated after the first time, and factors are
/// reused.
template <class Matrix>
struct NewtonScratch {
  Linearization sum;
  VectorXd from, direction, scales;
  Hessian<Matrix> hessian;
  double shift = 0;  ///< of the last Hessian, relative to its scales
  HessianSolver<Matrix> solver;
};

struct NewtonLimits {
  double tolerance;  ///< on the gradient, relative to the forces in it
  double step;       ///< negligible step of the coordinates: ending on such a step counts as converged
  int iterations;
  bool foretell = true;  ///< whether the last step may go unseen; not where the potential has kinks
};

struct NewtonReport {
  int iterations = 0;
  bool converged = true;  ///< met the tolerance, or the last step was negligible
  bool unseen = false;    ///< ended with a step after which the potential was not evaluated
  bool broken = false;    ///< a force is not finite, or there is no direction
  double residual = 0;    ///< gradient relative to the forces in it, foretold where it is unseen
};

/// Norm of the gradient relative to the forces in it, with an allowance for their round-off.
inline double relative_residual(const Linearization& sum, double tolerance) {
  return sum.gradient.norm() / (sum.round_off.forces + sum.round_off.gradient / tolerance + 1e-300);
}

/// Finds a downhill scratch.direction from the Hessian at scratch.sum. Under compression, and without inertia where a
/// bone has collapsed, it is not positive definite. Then each entry of its diagonal is raised by a part of its own
/// size, so that the stiffest place does not hold back the softest (Marquardt 1963, doi 10.1137/0111030). Returns false
/// if there is no direction.
template <class Potential, class Matrix>
bool newton_direction(Potential& potential, NewtonScratch<Matrix>& scratch) {
  constexpr int kShifts = 20;
  constexpr double kLeast = 1e-4;  // relative to an entry
  potential.hessian(scratch.hessian);
  Matrix& base = scratch.hessian.base;
  double& shift = scratch.shift;
  shift = shift < 8 * kLeast ? 0 : shift / 8;  // where it was needed in the last iteration, less is needed now
  double more = shift;
  for (int attempt = 0; attempt <= kShifts; ++attempt) {
    if (more > 0) {
      if (more == shift) diagonal_scales(base, scratch.scales);  // of the Hessian that no shift has changed yet
      add_to_diagonal(base, more, scratch.scales);
    }
    if (scratch.solver.solve(scratch.hessian, scratch.sum.gradient, scratch.direction)) {
      scratch.direction = -scratch.direction;
      return true;
    }
    const double next = std::max(kLeast, 4 * shift);
    more = next - shift;
    shift = next;
  }
  return false;
}

/// Moves q along scratch.direction to where the potential is lower, and linearizes it there. The whole step is nearly
/// always taken; one that would not descend is halved. Returns false where round-off leaves no descent: then q stays.
template <class Potential, class Matrix>
bool line_search(Potential& potential, NewtonScratch<Matrix>& scratch, VectorXd& q) {
  constexpr int kHalvings = 19;
  constexpr double kNoise = 1e-12;  // relative, of an energy
  Linearization& sum = scratch.sum;
  const double slope = sum.gradient.dot(scratch.direction), steep = sum.gradient.norm();
  const double start = sum.value, magnitude = sum.magnitude;
  const double slack = kNoise * magnitude + sum.round_off.gradient * sum.round_off.length;
  scratch.from = q;
  q = scratch.from + scratch.direction;
  potential.linearize(q, sum);
  if (sum.value <= start + 1e-4 * slope + slack) return true;
  // Where the potential's digits run out, the gradient decides.
  if (sum.gradient.norm() <= 0.5 * steep && sum.value <= start + 1e-6 * magnitude + slack) return true;
  double length = 1;
  for (int halving = 1; halving <= kHalvings; ++halving) {
    length /= 2;
    q = scratch.from + length * scratch.direction;
    if (potential.value(q) <= start + 1e-4 * (length * slope) + slack) {
      potential.linearize(q, sum);
      return true;
    }
  }
  q = scratch.from;
  potential.linearize(q, sum);
  return false;
}

/// What the residual will be after the whole step along the direction. Newton's method leaves w |g|^2 of a gradient g,
/// so two gradients tell what the third will be (Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 2.2);
/// their directions differ, hence a margin.
inline double foretold_residual(double residual, double before) {
  constexpr double kMargin = 10;
  const double ratio = residual / (before + 1e-300);
  return kMargin * (ratio * ratio * residual);
}

/// Minimizes the potential from q on. It calls `ask`, which may throw, before every iteration. A last step that is
/// certain to meet the tolerance is taken without evaluating the potential again.
template <class Potential, class Matrix, class Ask>
NewtonReport minimize(Potential& potential, NewtonScratch<Matrix>& scratch, VectorXd& q, const NewtonLimits& limits,
                      const Ask& ask) {
  NewtonReport report;
  scratch.shift = 0;
  potential.linearize(q, scratch.sum);
  double before = 0;  // the residual before the last step
  bool far = true;    // whether the last step was not negligible
  for (;; ++report.iterations) {
    ask();
    report.residual = relative_residual(scratch.sum, limits.tolerance);
    report.broken = !std::isfinite(scratch.sum.round_off.forces);
    if (report.broken || report.residual <= limits.tolerance) return report;
    if (report.iterations == limits.iterations) break;
    report.broken = !newton_direction(potential, scratch);
    const double step = scratch.direction.norm();
    if (report.broken || step == 0) return report;
    far = !(step <= limits.step);
    const double left = foretold_residual(report.residual, before);
    if (limits.foretell && left <= limits.tolerance && scratch.shift == 0) {
      q += scratch.direction;
      report.residual = left;
      report.unseen = true;
      ++report.iterations;
      return report;
    }
    before = report.residual;
    if (!line_search(potential, scratch, q)) break;
  }
  report.converged = !far;
  return report;
}

/// The same where the potential has forces that each minimum changes (friction, which is proportional to pressure):
/// once more if next_round() says that there are any.
template <class Potential, class Matrix, class Ask, class NextRound>
NewtonReport minimize_in_rounds(Potential& potential, NewtonScratch<Matrix>& scratch, VectorXd& q,
                                const NewtonLimits& limits, const Ask& ask, const NextRound& next_round) {
  NewtonReport report = minimize(potential, scratch, q, limits, ask);
  if (!next_round()) return report;
  const int iterations = report.iterations;
  report = minimize(potential, scratch, q, limits, ask);
  report.iterations += iterations;
  return report;
}

}  // namespace dynamorph
