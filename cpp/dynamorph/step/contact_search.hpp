// SPDX-License-Identifier: GPL-3.0-or-later
// Which samples of a body can touch what in a step: poses those that a collider comes near, and lets find_contacts.hpp
// and self_contact.hpp search.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/contact/contact_samples.hpp"
#include "dynamorph/contact/find_contacts.hpp"
#include "dynamorph/contact/self_contact.hpp"
#include "dynamorph/step/contact_term.hpp"
#include "dynamorph/step/state.hpp"
#include "dynamorph/step/step_input.hpp"
#include "dynamorph/step/step_options.hpp"

namespace dynamorph {

template <class Model>
class ContactSearch {
 public:
  /// samples: which colliders push from a distance in meters on; null for none. self: of these samples; null: the skin
  /// does not touch itself. self_friction: of skin on skin.
  ContactSearch(std::shared_ptr<const ContactSamples<Model>> samples, double distance,
                std::shared_ptr<const SelfContact<Model>> self, double self_friction);

  /// Searches in a step that begins at a state, and would end at the predicted coordinates without contact. Throws
  /// std::invalid_argument where there are colliders, but no samples.
  void find(const StepInput<Model>& input, const State& state, const VectorXd& predicted);

  // What it has found last.
  const std::vector<Contact>& found() const { return found_; }       ///< by collider, then by sample
  const ContactMemory& memory() const { return memory_; }            ///< for the state at the end of the step
  const std::vector<int>& unusable() const { return unusable_; }     ///< as of StepReport
  const std::vector<double>& friction() const { return friction_; }  ///< of the colliders

  /// The same for all of its contacts, in that step.
  ContactStep contact_step(const StepOptions& options) const;
  /// The body's skin in a step, for contacts of skin with skin; until the next call.
  PosedSkin posed_skin(const StepInput<Model>& input, const State& state, const VectorXd& predicted);

 private:
  /// A vertex of the samples' skin, where `SampleStep` has the samples.
  struct PlacedVertex {
    Vector3d before, predicted, unmoved;
    PointTransform transform;  ///< at the end of the step
  };

  void find_at_colliders(const StepInput<Model>& input, const State& state, const VectorXd& predicted);
  /// Chooses the samples that an active collider comes nearer than the margin (meters).
  void choose_samples(const StepInput<Model>& input, const State& state, const VectorXd& predicted, double margin);
  void place_samples(const StepInput<Model>& input, const State& state, const VectorXd& predicted);

  std::shared_ptr<const ContactSamples<Model>> samples_;
  double usual_distance_, usual_self_friction_;
  double distance_ = 0, self_friction_ = 0;  ///< in the last step
  std::shared_ptr<const SelfContact<Model>> self_;
  typename SelfContact<Model>::Scratch self_scratch_;
  ContactFinder finder_;
  std::vector<Contact> found_, found_on_self_;
  ContactMemory memory_;
  std::vector<int> unusable_;
  std::vector<double> friction_;
  SampleStep near_;  ///< samples that a collider comes near
  std::vector<PlacedVertex> vertices_;
  std::vector<int> vertex_at_;  ///< of each vertex, in vertices_; -1: not there
  VectorXd shape_;              ///< coordinates of the blended targets
};

extern template class ContactSearch<FullModel>;
extern template class ContactSearch<ReducedModel>;

}  // namespace dynamorph
