// SPDX-License-Identifier: GPL-3.0-or-later
// Newton's method with a line search for the potential of a step, Phi(q) = sum of terms. It minimizes for one
// character, with doubles as numbers, or for eight characters, one in each lane of every number.
//
// After evaluate(q), a term must have
//
//   energy (J), gradient and hessian (of the energy by q),
//   forces      sum of the norms of the parts that cancel in its gradient
//   round_off   of its gradient: what no iteration can improve
//   length      of the displacements that its energy is made of, for the round-off of that energy
//   resolution  of the coordinates: smaller steps change nothing
//   longest(q, direction)  the longest admissible step, 1 for most terms: states that must not be passed lie beyond it
//
// An `Arithmetic` defines numbers, vectors and matrices, and what can be done to them: one.hpp, eight.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <tuple>

namespace dynamorph {

/// One bit per character: one bit or eight.
using Lanes = unsigned;

constexpr double kSmallestScale = 1e-6;  ///< smallest scale of a tangent's diagonal, relative to the largest

/// The sums of the terms at some q.
template <class Arithmetic>
struct Value {
  using Number = typename Arithmetic::Number;
  typename Arithmetic::Vector gradient;
  Number potential, magnitude;  ///< J; magnitude: sum of the energies' magnitudes
  Number forces, round_off, length, resolution;
};

/// The sum of some terms, which must outlive it.
template <class Arithmetic, class... Terms>
class Potential {
 public:
  using Number = typename Arithmetic::Number;
  using Vector = typename Arithmetic::Vector;

  explicit Potential(Terms&... terms) : terms_(terms...) {}

  void evaluate(const Vector& q, Value<Arithmetic>& out) {
    std::apply(
        [&](Terms&... terms) {
          (terms.evaluate(q), ...);
          Arithmetic::sum(out.gradient, terms.gradient...);
          out.potential = (... + terms.energy);
          out.magnitude = (... + Arithmetic::size(terms.energy));
          out.forces = (... + terms.forces);
          out.round_off = (... + terms.round_off);
          out.length = (... + terms.length);
          out.resolution = (... + terms.resolution);
        },
        terms_);
  }

  /// The Hessian where the potential was evaluated last.
  void hessian(typename Arithmetic::Matrix& out) const {
    std::apply([&](const Terms&... terms) { Arithmetic::sum(out, terms.hessian...); }, terms_);
  }

  /// The longest admissible step along `direction`, at most 1.
  Number longest(const Vector& q, const Vector& direction) const {
    Number out = Number() + 1.0;
    std::apply([&](const Terms&... terms) { (Arithmetic::shorten(out, terms.longest(q, direction)), ...); }, terms_);
    return out;
  }

 private:
  std::tuple<Terms&...> terms_;
};

/// The memory that Newton's method works in. Keep it: nothing is allocated after the first time, and factors are
/// reused.
template <class Arithmetic>
struct NewtonScratch {
  Value<Arithmetic> value;
  typename Arithmetic::Vector from, direction, scales;
  typename Arithmetic::Matrix tangent;
  typename Arithmetic::Number shift{};  ///< of the last tangent, relative to its scales
  typename Arithmetic::Solver solver;
};

struct NewtonLimits {
  double tolerance;  ///< on the gradient, relative to the forces in it
  double step;       ///< negligible step of the coordinates: ending on such a step counts as converged
  int iterations;
};

template <class Arithmetic>
struct NewtonReport {
  int iterations = 0;                      ///< for all characters together
  Lanes unseen = 0;                        ///< ended with a step after which the potential was not evaluated
  Lanes open = 0;                          ///< missed the tolerance, and the last step was not negligible
  Lanes broken = 0;                        ///< a force is not finite, or there is no direction
  typename Arithmetic::Number residual{};  ///< gradient relative to the forces in it, foretold where it is unseen
};

/// Norm of the gradient relative to the forces in it, with an allowance for their round-off.
template <class Arithmetic>
typename Arithmetic::Number relative_residual(const Value<Arithmetic>& value, double tolerance) {
  return Arithmetic::norm(value.gradient) / (value.forces + value.round_off / tolerance + 1e-300);
}

/// Finds a downhill scratch.direction from the tangent at scratch.value. Under compression, and without inertia where a
/// bone has collapsed, the tangent is not positive definite. Then each entry of its diagonal is raised by a part of its
/// own size, so that the stiffest place does not hold back the softest (Marquardt 1963, doi 10.1137/0111030). Returns
/// the lanes for which there is no direction.
template <class Arithmetic, class Potential>
Lanes newton_direction(const Potential& potential, NewtonScratch<Arithmetic>& scratch, Lanes moving) {
  using Number = typename Arithmetic::Number;
  constexpr int kShifts = 20;
  constexpr double kLeast = 1e-4;  // relative to an entry
  potential.hessian(scratch.tangent);
  Number more{};  // a lane that needed a shift in the last iteration needs less of it now
  bool raised = false, scaled = false;
  for (int lane = 0; lane < Arithmetic::kLanes; ++lane) {
    double& shift = Arithmetic::at(scratch.shift, lane);
    shift = shift < 8 * kLeast ? 0 : shift / 8;
    Arithmetic::at(more, lane) = shift;
    raised |= shift > 0;
  }
  Lanes indefinite = 0;
  for (int attempt = 0; attempt <= kShifts; ++attempt) {
    if (raised) {
      if (!scaled) Arithmetic::scales(scratch.tangent, scratch.scales);
      scaled = true;
      Arithmetic::add_to_diagonal(scratch.tangent, more, scratch.scales);
    }
    indefinite = scratch.solver.solve(scratch.tangent, scratch.value.gradient, scratch.direction) & moving;
    if (!indefinite) break;
    raised = true;
    for (int lane = 0; lane < Arithmetic::kLanes; ++lane) {
      double& shift = Arithmetic::at(scratch.shift, lane);
      const double next = indefinite >> lane & 1 ? std::max(kLeast, 4 * shift) : shift;
      Arithmetic::at(more, lane) = next - shift;
      shift = next;
    }
  }
  Arithmetic::negate(scratch.direction, moving & ~indefinite);
  return indefinite;
}

/// Moves q of the moving lanes along scratch.direction to where the potential is lower, and evaluates it there. The
/// whole step is nearly always taken; a lane that would not descend halves it. Returns the lanes that stay where they
/// were, because round-off leaves no descent.
template <class Arithmetic, class Potential>
Lanes line_search(Potential& potential, NewtonScratch<Arithmetic>& scratch, Lanes moving,
                  typename Arithmetic::Vector& q) {
  using Number = typename Arithmetic::Number;
  Value<Arithmetic>& value = scratch.value;
  const Number slope = Arithmetic::dot(value.gradient, scratch.direction), steep = Arithmetic::norm(value.gradient);
  const Number start = value.potential, magnitude = value.magnitude;
  const Number slack = Arithmetic::kNoise * magnitude + value.round_off * value.length;
  Number length = potential.longest(q, scratch.direction);
  for (int lane = 0; lane < Arithmetic::kLanes; ++lane)
    if (!(moving >> lane & 1)) Arithmetic::at(length, lane) = 0;
  scratch.from = q;
  Lanes rising = moving;
  for (int halving = 0;; ++halving) {
    Arithmetic::move(scratch.from, length, scratch.direction, q);
    potential.evaluate(q, value);
    const Number limit = start + 1e-4 * (length * slope) + slack;
    rising &= ~Arithmetic::below(value.potential, limit);
    if (rising && halving == 0) {  // where the potential's digits run out, the gradient decides
      const Lanes flatter = Arithmetic::below(Arithmetic::norm(value.gradient), 0.5 * steep);
      rising &= ~(flatter & Arithmetic::below(value.potential, start + 1e-6 * magnitude + slack));
    }
    if (!rising) return 0;
    const bool last = halving == Arithmetic::kHalvings;
    for (int lane = 0; lane < Arithmetic::kLanes; ++lane)
      if (rising >> lane & 1) Arithmetic::at(length, lane) *= last ? 0 : 0.5;
    if (last) break;
  }
  Arithmetic::move(scratch.from, length, scratch.direction, q);
  potential.evaluate(q, value);
  return rising;
}

/// Takes the last step of the lanes whose residual will then be below the tolerance, without evaluating the potential
/// again, and writes what it will be. Newton's method leaves w |g|^2 of a gradient g, so two gradients tell what the
/// third will be (Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 2.2); their directions differ, hence
/// a margin. Returns these lanes.
template <class Arithmetic, class Potential>
Lanes last_step(const Potential& potential, const NewtonScratch<Arithmetic>& scratch, Lanes moving,
                const typename Arithmetic::Number& before, const typename Arithmetic::Number& tolerance,
                typename Arithmetic::Vector& q, typename Arithmetic::Number& residual) {
  using Number = typename Arithmetic::Number;
  constexpr double kMargin = 10;
  const Number ratio = residual / (before + 1e-300), left = kMargin * (ratio * ratio * residual);
  const Number whole = Number() + 1.0;
  Lanes ending = moving & Arithmetic::below(left, tolerance) & Arithmetic::below(scratch.shift, Number());
  if (ending) ending &= Arithmetic::below(whole, potential.longest(q, scratch.direction));
  if (!ending) return 0;
  Number length{};
  for (int lane = 0; lane < Arithmetic::kLanes; ++lane)
    if (ending >> lane & 1) {
      Arithmetic::at(length, lane) = 1;
      Arithmetic::at(residual, lane) = Arithmetic::at(left, lane);
    }
  Arithmetic::move(q, length, scratch.direction, q);
  return ending;
}

/// Minimizes the potential from q on, for the lanes that are `moving`; the others stay. It calls `ask`, which may
/// throw, before every iteration.
template <class Arithmetic, class Potential, class Ask>
NewtonReport<Arithmetic> minimize(Potential& potential, NewtonScratch<Arithmetic>& scratch,
                                  typename Arithmetic::Vector& q, Lanes moving, const NewtonLimits& limits,
                                  const Ask& ask) {
  using Number = typename Arithmetic::Number;
  NewtonReport<Arithmetic> report;
  scratch.shift = typename Arithmetic::Number();
  potential.evaluate(q, scratch.value);
  const Number tolerance = Number() + limits.tolerance;
  Number before{};       // the residual before the last step
  Lanes far = ~Lanes();  // lanes in which the last step was not negligible
  for (int iteration = 0;; ++iteration) {
    ask();
    const Value<Arithmetic>& value = scratch.value;
    report.broken |= moving & ~Arithmetic::finite(value.forces);
    report.residual = relative_residual(value, limits.tolerance);
    moving &= ~report.broken & ~Arithmetic::below(report.residual, tolerance);
    if (!moving) return report;
    if (iteration == limits.iterations) {
      report.open |= moving & far;
      return report;
    }
    report.broken |= newton_direction(potential, scratch, moving);
    const auto step = Arithmetic::norm(scratch.direction);
    moving &= ~report.broken & ~Arithmetic::below(step, value.resolution);
    far = ~Arithmetic::below(step, value.resolution + limits.step);
    const Number last = report.residual;
    const Lanes ending = last_step(potential, scratch, moving, before, tolerance, q, report.residual);
    before = last;
    moving &= ~ending;
    report.unseen = moving ? 0 : ending;
    const Lanes stuck = moving ? line_search(potential, scratch, moving, q) : 0;
    report.open |= stuck & far;
    moving &= ~stuck;
    for (Lanes rest = moving | ending; rest; rest &= rest - 1) ++report.iterations;
    if (!moving) return report;
  }
}

}  // namespace dynamorph
