// SPDX-License-Identifier: GPL-3.0-or-later
// A soft skin that moves, and its part in a step. With posed positions x(q) = A (X + u(q)) + a, a step minimizes
//
//   Phi(q) = 1/(2 h^2 c^2) |x(q) - x^|^2_M + E(q) + D(q) - f . x(q)
//
// over the bind-pose coordinates q. x^ is a fixed combination of past *posed* positions. So the Euler, Coriolis and
// centrifugal forces of moving bones act without their accelerations ever being computed, and a jump in velocity is a
// finite impulse. D damps the bind-pose velocity, so a bone's rigid motion is not damped.
//
//   implicit Euler     x^ = 2 x(n) - x(n-1),                                           c = 1
//   BDF2 twice         x^ = (24 x(n) - 22 x(n-1) + 8 x(n-2) - x(n-3)) / 9,             c = 2/3
#pragma once

#include <array>
#include <memory>

#include "dynamorph/models/full_model.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/step/contact_search.hpp"
#include "dynamorph/step/contact_term.hpp"
#include "dynamorph/step/state.hpp"
#include "dynamorph/step/step_load.hpp"
#include "dynamorph/step/step_options.hpp"
#include "dynamorph/step/terms.hpp"

namespace dynamorph {

/// Throws std::invalid_argument unless the weights of every target set are >= 0 and sum to one.
void check_weights(const std::vector<MorphTarget>& targets, int sets, const Eigen::Ref<const VectorXd>& weights);

/// What a body has besides its model, which must be theirs too; each may be missing.
template <class Model>
struct Parts {
  std::shared_ptr<const MotionLimit<Model>> limit;         ///< of its motion
  std::shared_ptr<const ContactSamples<Model>> contact;    ///< samples that colliders push
  double distance = 0;                                     ///< at which that begins, meters
  std::shared_ptr<const SelfContact<Model>> self_contact;  ///< of those samples: the skin touches itself
  double self_friction = 0;                                ///< of skin on skin of itself
};

/// A model with its parts and its state. `Simulation` steps it.
template <class Model>
class MovingBody {
 public:
  using Matrix = typename Model::Matrix;
  /// Of the energies that a step minimizes.
  using Sum = Potential<Matrix, QuadraticTerm<Matrix>, ElasticTerm<Model>, GrabTerm<Model>, PullTerm<Model>,
                        ContactTerm<Model>>;

  /// Throws std::invalid_argument for options that no step can be taken with, and parts that do not fit.
  MovingBody(std::shared_ptr<const Model> model, StepOptions options, Parts<Model> parts = {});
  MovingBody(const MovingBody&) = delete;
  MovingBody& operator=(const MovingBody&) = delete;

  /// Targets are sculpted as they look under gravity. From now on, only the difference between gravity in a pose and
  /// gravity in the targets' own poses acts, so that targets do not sag. `bones`: for each target (B, 12), the skin
  /// frame of its pose.
  void balance_targets(const std::vector<Transforms>& bones);

  /// Starts at rest with what acts `now`, while the rig moves on to `next` by the end of the first step. u is the
  /// static solution, lying on what it touches, and the past continues the rig's motion backward. now.colliders: before
  /// and after alike.
  StepReport start(const StepInput<Model>& now, const Transforms& next);

  /// Finds the static solution, starting from the coordinates q, or from the blended targets when q is empty. Does not
  /// change the state.
  StepReport solve_static(const StepInput<Model>& input, VectorXd& q);

  /// Drops the factors of earlier steps, which save time: the steps that follow depend on the state alone, to the last
  /// bit. Call it where the state is copied, and after it is set.
  void forget() { newton_.solver.forget(); }

  const Model& model() const { return *model_; }
  const std::shared_ptr<const Model>& shared_model() const { return model_; }
  const StepOptions& options() const { return options_; }
  const Parts<Model>& parts() const { return parts_; }
  const State& state() const { return state_; }
  /// Without a driven load, its motion limit has not acted; without a limit, it does not count. Throws Error
  /// for what is not finite.
  void set_state(const State& state);
  const VectorXd& coordinates() const { return state_.q[0]; }
  /// The weights of the targets in the step that has begun, times how stiff each of them is (J).
  const VectorXd& elastic() const { return blend_.elastic; }
  /// Energies of the state, J, at the target weights of the last start() or step. The kinetic energy uses the
  /// integrator's own velocity.
  double kinetic_energy() const;
  double elastic_energy() const;

  // A step, in this order.

  /// Makes all that its potential consists of. If this, or what comes after it, fails, `give_up` makes it as if the
  /// step had not begun.
  void begin_step(const StepInput<Model>& input);
  void give_up();
  /// Moves the unknowns to the minimum, if no other body touches it.
  StepReport solve_alone();
  /// The state becomes that at the minimum.
  void end_step(const StepInput<Model>& input, StepReport& report);

  // For a Newton's method over several bodies.

  Sum& potential() { return potential_; }
  ContactTerm<Model>& contacts() { return contacts_; }
  /// Where Newton's method is to begin: coordinates, and after them what patches give way by.
  void guess(VectorXd& unknowns) const;
  /// To be called before each Newton's method.
  void begin_newton();
  NewtonLimits limits() const;
  /// Throws Cancelled if keep_going says so.
  void ask() const;
  /// Goes on with what Newton's method found, and where; throws Error where that broke.
  StepReport accept(const NewtonReport& found, const VectorXd& unknowns);
  ContactStep contact_step() const { return search_.contact_step(options_); }
  PosedSkin posed_skin(const StepInput<Model>& input) { return search_.posed_skin(input, state_, next_); }
  /// Puts pressures before its own: of contacts with other bodies.
  void remember(const std::vector<Pressure>& pressures);

 private:
  void pose(const Transforms& bones, const VectorXd& weights, const VectorXd* stiffness);
  void prepare(const StepInput<Model>& input);
  /// Moves the state from the static solution to where what it touches holds it.
  void lie_down(const StepInput<Model>& input, StepReport& report);
  /// Says what the terms at points of the skin are in a step that would end at the predicted coordinates. watched: of
  /// its limit, from which on something can be pulled.
  void begin_terms(const StepInput<Model>& input, const VectorXd& predicted, double watched);
  /// Decides what can touch what in that step.
  void find_contacts(const StepInput<Model>& input);
  /// Adds what the contacts do at the minimum.
  void report_contacts(const StepInput<Model>& input, StepReport& report);
  /// Moves next_ to the minimum of the potential, with the contacts as they are.
  StepReport minimize(int max_iterations);
  void require_pose() const;
  double farthest(const Transforms& bones) const;
  Eigen::Index patches() const;  ///< of the local responses; 0 without

  std::shared_ptr<const Model> model_;
  StepOptions options_;
  Parts<Model> parts_;
  State state_;
  State before_;  ///< before a jump, in case the step fails
  bool teleported_ = false;
  VectorXd weights_, elastic_weights_;  ///< of the last start() or step
  VectorXd shares_;                     ///< of the target sets (S) in the body's volume
  double stiffer_ = 1;  ///< how many times as stiff as its material the tissue is in the step, on average

  typename Model::Blend blend_;
  StepLoad<Model> load_;
  Matrix damped_;
  VectorXd next_, velocity_, resistance_;  ///< coordinates of the step, bind-pose velocity, and damping at it
  VectorXd unknowns_;                      ///< of Newton's method
  QuadraticTerm<Matrix> quadratic_;
  ElasticTerm<Model> elastic_;
  GrabTerm<Model> grabs_;
  PullTerm<Model> pulls_;
  ContactTerm<Model> contacts_;
  Sum potential_{quadratic_, elastic_, grabs_, pulls_, contacts_};
  ContactSearch<Model> search_;
  NewtonScratch<Matrix> newton_;
};

extern template class MovingBody<FullModel>;
extern template class MovingBody<ReducedModel>;

}  // namespace dynamorph
