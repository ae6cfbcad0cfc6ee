// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/contact_search.hpp"

#include <algorithm>

#include "dynamorph/contact/choices.hpp"

namespace dynamorph {

namespace {

using Box = Eigen::AlignedBox3d;

/// A box around where a collider is during a step; around everything if it is not finite.
Box extent(const ColliderStep& step) {
  const Vector3d everywhere = Vector3d::Constant(kInfinity);
  if (!step.before.allFinite() || !step.after.allFinite()) return {-everywhere, everywhere};
  const Box& own = step.collider.rest().bvh.nodes[0].box;
  Box out;
  for (const auto* at : {&step.before, &step.after}) {
    if (step.rigid()) {
      const Vector3d center = at->leftCols<3>() * own.center() + at->col(3);
      const Vector3d half = at->leftCols<3>().cwiseAbs() * own.sizes() / 2;
      out.extend(center - half).extend(center + half);
    } else {
      out.extend(Vector3d(at->colwise().minCoeff())).extend(Vector3d(at->colwise().maxCoeff()));
    }
  }
  return out;
}

/// Whether a collider was somewhere at the beginning of a step, and not scaled to nothing.
bool came(const ColliderStep& step) {
  return step.before.allFinite() && (!step.rigid() || step.before.leftCols<3>().determinant() != 0);
}

}  // namespace

template <class Model>
ContactSearch<Model>::ContactSearch(std::shared_ptr<const ContactSamples<Model>> samples, double distance,
                                    std::shared_ptr<const SelfContact<Model>> self, double self_friction)
    : samples_(std::move(samples)),
      usual_distance_(distance),
      usual_self_friction_(self_friction),
      self_(std::move(self)) {}

template <class Model>
void ContactSearch<Model>::find(const StepInput<Model>& input, const State& state, const VectorXd& predicted) {
  found_.clear();
  unusable_.clear();
  friction_.clear();
  memory_ = state.contact;
  distance_ = input.distance ? *input.distance : usual_distance_;
  self_friction_ = input.self_friction ? *input.self_friction : usual_self_friction_;
  find_at_colliders(input, state, predicted);
  if (!self_) return;
  self_->find(posed_skin(input, state, predicted), self_scratch_, found_on_self_);
  found_.insert(found_.begin(), found_on_self_.begin(), found_on_self_.end());
}

template <class Model>
ContactStep ContactSearch<Model>::contact_step(const StepOptions& options) const {
  const double size = samples_->model().body().size;
  return {friction_,
          self_friction_,
          StepRule(options).square,
          distance_,
          kContactWidth * size,
          kSticks * size * options.h,
          distance_ + kContactNear * size};
}

template <class Model>
PosedSkin ContactSearch<Model>::posed_skin(const StepInput<Model>& input, const State& state,
                                           const VectorXd& predicted) {
  const double size = samples_->model().body().size;
  blended_shape(samples_->model(), input.weights, shape_);
  return {state.bones[0],
          input.bones,
          input.weights,
          shape_,
          state.q[0],
          predicted,
          distance_ + kContactNear * size,
          distance_ + kContactMargin * size};
}

template <class Model>
void ContactSearch<Model>::find_at_colliders(const StepInput<Model>& input, const State& state,
                                             const VectorXd& predicted) {
  if (!input.colliders || input.colliders->empty()) return memory_.clear();
  if (!samples_) throw std::invalid_argument("colliders: the simulation has no samples that can touch them");
  const double size = samples_->model().body().size, margin = distance_ + kContactMargin * size;
  choose_samples(input, state, predicted, margin);
  if (near_.samples.empty()) {
    memory_.planes.clear();
    memory_.active.clear();
    for (const ColliderStep& step : *input.colliders) memory_.active.push_back(step.active);
    return;
  }
  place_samples(input, state, predicted);
  const bool held = input.grabs && !input.grabs->springs.empty();  // a hand may lead the skin anywhere
  const double near = held ? margin : distance_ + kContactNear * size;
  finder_.find(*input.colliders, near_, near, margin, memory_, found_);
  unusable_ = finder_.unusable();
  for (const ColliderStep& collider : *input.colliders) friction_.push_back(collider.friction);
}

template <class Model>
void ContactSearch<Model>::choose_samples(const StepInput<Model>& input, const State& state, const VectorXd& predicted,
                                          double margin) {
  struct Extent {
    Box box;
    bool known;  ///< it acted in the last step: nothing is inside that has not come in
  };
  std::vector<Extent> extents;
  for (int c = 0; c < int(input.colliders->size()); ++c)
    if (const ColliderStep& step = (*input.colliders)[std::size_t(c)]; step.active)
      extents.push_back({extent(step), memory_.acted(c) && came(step)});
  blended_shape(samples_->model(), input.weights, shape_);
  double farthest = 0;
  for (const VectorXd* q : {&state.q[0], &predicted, &std::as_const(shape_)})
    farthest = std::max(farthest, samples_->farthest(input.weights, *q));
  std::vector<int>& samples = near_.samples;
  samples.clear();
  for (const auto& group : samples_->groups()) {
    const double near = farthest + margin, appears = kFadeEnds * group.thickness;
    const Box box = samples_->region(group, state.bones[0], near).merged(samples_->region(group, input.bones, near));
    const auto reaches = [&](const Extent& extent) {
      const double square = extent.known ? 0 : appears * appears;
      return extent.box.squaredExteriorDistance(box) <= square;
    };
    if (std::any_of(extents.begin(), extents.end(), reaches))
      samples.insert(samples.end(), group.samples.begin(), group.samples.end());
  }
  std::sort(samples.begin(), samples.end());
}

template <class Model>
void ContactSearch<Model>::place_samples(const StepInput<Model>& input, const State& state, const VectorXd& predicted) {
  const SkinMap<Model>& map = samples_->map();
  vertices_.clear();
  vertex_at_.assign(std::size_t(map.size()), -1);
  near_.begin(Eigen::Index(near_.samples.size()));
  for (Eigen::Index row = 0; row < near_.before.rows(); ++row) {
    const int p = near_.samples[std::size_t(row)];
    PointTransform whole = PointTransform::Zero();
    samples_->points().each_corner(p, [&](int v, double weight) {
      int& at = vertex_at_[std::size_t(v)];
      if (at < 0) {  // many samples share it
        at = int(vertices_.size());
        const PointTransform then = map.skin().transform(state.bones[0], v), now = map.skin().transform(input.bones, v);
        vertices_.push_back({map.posed(then, v, map.displacement(input.weights, state.q[0], v)),
                             map.posed(now, v, map.displacement(input.weights, predicted, v)),
                             map.posed(now, v, samples_->shape(input.weights, v)), now});
      }
      const PlacedVertex& vertex = vertices_[std::size_t(at)];
      near_.before.row(row) += weight * vertex.before;
      near_.predicted.row(row) += weight * vertex.predicted;
      near_.unmoved.row(row) += weight * vertex.unmoved;
      whole += weight * vertex.transform;
    });
    near_.normal.row(row) = samples_->normal(whole, p);
    near_.thickness(row) = samples_->thickness()(p);
  }
}

template class ContactSearch<FullModel>;
template class ContactSearch<ReducedModel>;

}  // namespace dynamorph
