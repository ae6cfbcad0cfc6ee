// SPDX-License-Identifier: GPL-3.0-or-later
// Soft bodies take their steps together. A step minimizes the sum of their potentials (moving_body.hpp) and of the
// contacts between them,
//
//   Phi(q_1, ..., q_n) = sum_i Phi_i(q_i) + sum of contacts,
//
// by one Newton's method over the coordinates of all, so that each gives way by its own compliance and the forces
// between them sum to zero; without such contacts, as of one body, each is minimized by itself. Contacts are found as
// those of a body with itself (self_contact.hpp), from the poses alone, with both bodies in either part: the order of
// the bodies does not matter. A body whose rig jumps by more than its size in a step, as in a bad frame, touches no
// other one until its rig is back.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/step/joint_layout.hpp"
#include "dynamorph/step/moving_body.hpp"

namespace dynamorph {

/// A soft body among others.
template <class Model>
struct TouchingBody {
  MovingBody<Model>* body;                         ///< must outlive the simulation
  std::shared_ptr<const SelfContact<Model>> skin;  ///< of the samples of its contact
};

/// Which body is clothes that lie on another one at rest.
struct Garment {
  int clothes, body;       ///< numbers of bodies
  PointTransform to_body;  ///< of the clothes' bind space to that of the body
};

template <class Model>
class JointSamples;

template <class Model>
class Simulation {
 public:
  /// Of one body, which must outlive it.
  explicit Simulation(MovingBody<Model>& body);
  /// Throws std::invalid_argument unless there are two bodies at least, with the same time step and integrator, and
  /// each skin is that of its body's contact. friction: of skin on skin. garments: which of them are clothes.
  Simulation(std::vector<TouchingBody<Model>> bodies, double friction, const std::vector<Garment>& garments = {});

  /// Takes one step of all to where their bones and weights are at its end, and reports on each. inputs: one for each
  /// body. If it fails, none has moved.
  const std::vector<StepReport>& step(const std::vector<StepInput<Model>>& inputs);
  /// The same of the only body.
  const StepReport& step(const StepInput<Model>& input);

  /// As of `MovingBody`, of all.
  void forget();

 private:
  using Matrix = typename Model::Matrix;
  class Sum;

  void take_step(const StepInput<Model>* inputs);
  /// A body's unknowns, its coordinates and those of its patches, out of those of all, and into them.
  void take(const VectorXd& all, std::size_t body, VectorXd& own) const;
  void put(const VectorXd& own, std::size_t body, VectorXd& all) const;
  void find_contacts(const StepInput<Model>* inputs);
  /// Finds the minimum of all potentials together.
  void solve_together();
  /// Where Newton's method is to begin, in all_, and when it ends.
  NewtonLimits begin_together();
  /// Leaves the pressures between bodies to their states.
  void remember_pressures();
  void report_contacts();

  std::vector<TouchingBody<Model>> bodies_;
  std::vector<StepReport> reports_;  ///< of each body
  double friction_ = 0;
  std::vector<Worn> worn_;
  std::vector<int> first_sample_;  ///< of each body, among those of all
  JointLayout<Matrix> layout_;
  std::vector<typename SelfContact<Model>::Scratch> scratch_;
  std::vector<Contact> found_;
  ContactTerm<Model, JointSamples<Model>> contacts_;
  NewtonScratch<Matrix> newton_;
  std::vector<Hessian<Matrix>> hessians_;  ///< of each body
  VectorXd all_;                           ///< unknowns: the coordinates of all, then of each body those of its patches
  std::vector<Eigen::Index> first_patch_;  ///< in them, of each body, and their end
};

extern template class Simulation<FullModel>;
extern template class Simulation<ReducedModel>;

}  // namespace dynamorph
