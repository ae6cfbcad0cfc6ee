// SPDX-License-Identifier: GPL-3.0-or-later
// One time step for every model. With posed positions x(q) = A (X + u(q)) + a, a step minimizes
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

#include "dynamorph/contact/contact_samples.hpp"
#include "dynamorph/contact/find_contacts.hpp"
#include "dynamorph/contact/self_contact.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/step/contact_term.hpp"
#include "dynamorph/step/step_options.hpp"
#include "dynamorph/step/terms.hpp"

namespace dynamorph {

/// Where a soft skin is: its coordinates and the bones' transforms, now and at the last three steps; with a motion
/// limit, how far each bone's load has lately exceeded it; with contact, what it touches. Copy it to undo, resume or
/// fork a simulation.
struct State {
  std::array<VectorXd, InertialTarget::kMoments> q;
  std::array<Transforms, InertialTarget::kMoments> bones;
  DrivenLoad driven;      ///< empty without a limit
  ContactMemory contact;  ///< from which sides
  std::vector<Pressure> pressures;
};

/// Throws std::invalid_argument unless the weights of every target set are >= 0 and sum to one.
void check_weights(const std::vector<MorphTarget>& targets, int sets, const Eigen::Ref<const VectorXd>& weights);

template <class Model>
class CoupledSimulation;

struct StepReport {
  int iterations = 0;  ///< of Newton's method
  /// Whether the gradient was within the tolerance of the forces, or Newton's last step within the tolerance of the
  /// body's size (root mean square). If false, the state is the best one found, and it is finite.
  bool converged = true;
  double residual = 0;  ///< gradient relative to the largest force term
  double energy = 0;    ///< elastic energy, J
  bool teleported = false;
  double excess = 0;     ///< the largest x of motion_limit.hpp; above 1/2 the load of that bone was held back
  int excess_bone = -1;  ///< whose it is; -1 without a motion limit
  double farthest = 0;   ///< of a point from its targets' shape, relative to its limit, before Newton's method
  int pulled = 0;        ///< 1 where anything was so far that a motion limit pulled it back
  Vector3d body_force = Vector3d::Zero();  ///< newtons that other soft bodies push it with
  int contacts = 0;                        ///< samples that are pushed
  double penetration = 0;  ///< the largest depth of a sample under a surface, meters, where the bones leave it room
  double too_deep = 0;     ///< how much deeper the bones take a sample into a collider than it can give way, meters
  int too_deep_sample = -1, too_deep_collider = -1;  ///< which ones; -1 where nothing is too deep
  std::vector<Vector3d> contact_forces;              ///< newtons on each collider
  std::vector<int> unusable_colliders;               ///< active, but not finite or without extent
};

template <class Model>
class Simulation {
 public:
  Simulation(std::shared_ptr<const Model> model, StepOptions options);

  /// Targets are sculpted as they look under gravity. From now on, only the difference between gravity in a pose and
  /// gravity in the targets' own poses acts, so that targets do not sag. `bones`: for each target (B, 12), the skin
  /// frame of its pose.
  void balance_targets(const std::vector<Transforms>& bones);

  /// Starts at rest with the bones `now`, while the rig moves on to `next` by the end of the first step. u is the
  /// static solution, lying on what it touches, and the past continues the rig's motion backward. colliders: where they
  /// are now, before and after alike; null for none.
  StepReport start(const Transforms& now, const Transforms& next, const VectorXd& weights,
                   const std::vector<ColliderStep>* colliders = nullptr);

  /// Takes one step to where the bones and weights are at its end.
  StepReport step(const StepInput& input);

  /// Finds the static solution, starting from the coordinates q, or from the blended targets when q is empty. Does not
  /// change the state.
  StepReport solve_static(const StepInput& input, VectorXd& q);

  /// The skin whose points can be grabbed; null for none. Its model must be this one.
  void set_skin(std::shared_ptr<const SkinMap<Model>> skin);

  /// Limits the motion from now on; null for no limit. Its model must be this one.
  void set_limit(std::shared_ptr<const MotionLimit<Model>> limit);

  /// Lets colliders push the samples from now on; null for none. Their model must be this one. The push begins at a
  /// distance in meters.
  void set_contact(std::shared_ptr<const ContactSamples<Model>> samples, double distance);

  /// Lets the skin touch itself from now on; null: not. Its samples must be those of the contact, whose distance it
  /// keeps. friction: of skin on skin.
  void set_self_contact(std::shared_ptr<const SelfContact<Model>> self, double friction);

  /// Drops the factors of earlier steps, which save time: the steps that follow depend on the state alone, to the last
  /// bit. Call it where the state is copied, and after it is set.
  void forget() { newton_.solver.forget(); }

  const Model& model() const { return *model_; }
  const std::shared_ptr<const Model>& shared_model() const { return model_; }
  const StepOptions& options() const { return options_; }
  const State& state() const { return state_; }
  const MatrixXd& rest_gravity() const { return rest_gravity_; }  ///< gravity in the targets' poses (dofs, J), or empty
  /// Without a driven load, its motion limit has not acted; without a limit, it does not count. Throws Error
  /// for what is not finite.
  void set_state(const State& state);
  const VectorXd& coordinates() const { return state_.q[0]; }
  /// Amplitudes of the local responses after the last step, none without. The state does not have them: they have no
  /// past.
  const VectorXd& dents() const { return dents_; }
  /// Energies of the state, J, at the target weights of the last start() or step(). The kinetic energy uses the
  /// integrator's own velocity.
  double kinetic_energy() const;
  double elastic_energy() const;
  const typename Model::Blend& blend() const { return blend_; }

 private:
  friend class CoupledSimulation<Model>;
  using Matrix = typename Model::Matrix;
  using Sum = Potential<Matrix, QuadraticTerm<Matrix>, ElasticTerm<Model>, GrabTerm<Model>, PullTerm<Model>,
                        ContactTerm<Model>>;

  void pose(const Transforms& bones, const VectorXd& weights);
  /// Its skin in that step, for contacts of skin with skin.
  PosedSkin posed_skin(const StepInput& input);
  ContactStep contact_step() const;
  /// The first part of a step: all that its potential is made of. If this, or what comes after it, fails, `give_up`
  /// makes it as if the step had not begun.
  void begin_step(const StepInput& input);
  void give_up();
  /// Moves next_ to the minimum.
  StepReport solve_step();
  /// The last part, at the minimum.
  void end_step(const StepInput& input, StepReport& report);
  void prepare(const StepInput& input);
  /// Moves the state from the static solution to where what it touches holds it.
  void lie_down(const StepInput& input, StepReport& report);
  /// Sets g of the quadratic term to the forces at its origin: inertia's toward `inertial` divided by `square` s^2,
  /// external forces on the nodes if there are any, and gravity in the targets' own poses.
  /// scales: of the transforms' loads (T), for external forces.
  void load(const InertialTarget& inertial, double square, const VectorXd* external, const VectorXd* scales = nullptr);
  /// Decides how much of the load the limit lets through.
  void drive(const InertialTarget& inertial, const StepInput& input);
  /// `load`, with only that much where the rig drives the tissue too far.
  void hold_back(const InertialTarget& inertial, double square, const StepInput& input);
  /// The same inertial target with the accelerations of the transforms, and of gravity, scaled: the past x^ becomes
  /// x_in + s (x^ - x_in), where x_in is the past without the motion of the bones. Where s has changed, it also
  /// corrects what earlier steps have let through: velocity and place become what they would be with the s of now. Of
  /// the bones' last second difference a, (s - s') a is added twice and taken off in the next step, because the tissue
  /// has moved with it for a step. The one before acts by a part 3 - past[0] of `StepRule`, and only its velocity is.
  InertialTarget scaled(InertialTarget inertial, double square);
  /// Places the samples that a collider comes nearer than the margin (meters) in a step that would end at next_ without
  /// contact. Returns whether there are any.
  bool place_samples(const StepInput& input, double margin);
  /// Decides what can touch what in that step.
  void find_contacts(const StepInput& input);
  void find_at_colliders(const StepInput& input);
  /// Adds what the contacts do at next_.
  void report_contacts(const StepInput& input, StepReport& report);
  /// The sum of the terms, for a Newton's method that begins.
  Sum sum();
  /// Moves q to the minimum of that.
  StepReport minimize(VectorXd& q, int max_iterations);
  /// What Newton's method found; throws Error where that broke.
  StepReport report(const NewtonReport& found);
  void require_pose() const;
  double farthest(const Transforms& bones) const;

  std::shared_ptr<const Model> model_;
  StepOptions options_;
  State state_;
  VectorXd weights_;  ///< of the last start() or step()
  State before_;      ///< before a jump, in case the step fails
  bool teleported_ = false;
  typename Model::Blend blend_;
  typename Model::Inertia inertia_;
  Matrix damped_;
  VectorXd next_, velocity_, resistance_;  ///< coordinates of the step, bind-pose velocity, and damping at it
  VectorXd unknowns_;                      ///< of Newton's method: coordinates, and what patches give way by
  QuadraticTerm<Matrix> quadratic_;
  ElasticTerm<Model> elastic_;
  GrabTerm<Model> grabs_;
  PullTerm<Model> pulls_;
  std::shared_ptr<const SkinMap<Model>> skin_;
  std::shared_ptr<const MotionLimit<Model>> limit_;
  typename MotionLimit<Model>::Scratch answers_;
  DrivenLoad driven_;                                        ///< at the end of the step
  std::array<VectorXd, 3> scales_;                           ///< s, in this step and the last two
  std::array<Transforms, InertialTarget::kMoments> slowed_;  ///< bones of a scaled past
  ContactTerm<Model> contacts_;
  std::shared_ptr<const ContactSamples<Model>> samples_;
  std::shared_ptr<const SelfContact<Model>> self_;
  typename SelfContact<Model>::Scratch self_scratch_;
  double distance_ = 0, own_friction_ = 0;
  ContactFinder finder_;
  std::vector<Contact> found_, found_on_self_;
  std::vector<int> unusable_;
  VectorXd dents_;
  ContactMemory memory_;  ///< at the end of the step
  SampleStep near_;       ///< samples that a collider comes near
  /// A vertex of the samples' skin, where `SampleStep` has the samples.
  struct PlacedVertex {
    Vector3d before, predicted, unmoved;
    PointTransform transform;  ///< at the end of the step
  };
  std::vector<PlacedVertex> vertices_;
  std::vector<int> vertex_at_;  ///< of each vertex, in vertices_; -1: not there
  VectorXd shape_;              ///< coordinates of the blended targets
  /// Where an active collider is during the step.
  struct Extent {
    Eigen::AlignedBox3d box;
    bool known;  ///< it acted in the last step: nothing is inside that has not come in
  };
  std::vector<Extent> extents_;
  std::vector<double> friction_;  ///< of the colliders
  NewtonScratch<Matrix> newton_;
  MatrixXd rest_gravity_;     ///< gravity in each target's own pose (dofs, J), or empty
  MatrixXd rest_directions_;  ///< the same at each transform, A^T g (3T, J)
  SkinFrame frame_;           ///< of the nodes, where external forces act
  VectorXd nodal_, projected_;
};

extern template class Simulation<FullModel>;
extern template class Simulation<ReducedModel>;

}  // namespace dynamorph
