// SPDX-License-Identifier: GPL-3.0-or-later
// The term of contact in a step's potential. Each contact is a plane for the length of the step, with the gap g and the
// slip t, which are linear in the coordinates q:
//
//   g = n . (x_p(q) - point),     t = (I - n n^T) (x_p(q) - x_p(before) - motion + t'),
//   E = s k ramp(distance - g) + mu lambda F(|t|),
//
// x_p is the place of a sample, less that of the other side where skin touches skin (self_contact.hpp). Here s is the
// contact's weight, k the sample's stiffness (contact_samples.hpp), ramp and F are of contact_law.hpp, mu is the
// friction, and lambda the pressure in the round before. t' is the slip of the step before, as far as friction gives
// way before it holds: what sticks is held where it stuck, and does not creep. With local responses the skin gives way
// beneath the contacts, by rho a along their normals, with the energy of dents.hpp, and the coordinates take a part of
// the push alone: then n . x_p in g is that of the targets' shape, plus `taken` times what q moves it by, plus rho a.
// The patches that give way are those of the samples that are nearer than `giving`: what else a search finds does not
// change how soft the skin is.
// Friction has no potential of its own: with lambda of the round before it has one, and each step takes two rounds. The
// first one has the pressures of the step before.
#pragma once

#include <algorithm>
#include <map>
#include <utility>
#include <vector>

#include "dynamorph/contact/choices.hpp"
#include "dynamorph/contact/contact.hpp"
#include "dynamorph/contact/contact_law.hpp"
#include "dynamorph/contact/contact_samples.hpp"
#include "dynamorph/contact/dents.hpp"
#include "dynamorph/step/newton.hpp"

namespace dynamorph {

/// The same for all contacts of a step. It owns nothing.
struct ContactStep {
  const std::vector<double>& friction;  ///< mu of the colliders
  double own_friction;                  ///< mu of skin on skin
  double square;                        ///< (c h)^2, s^2
  double distance;                      ///< at which samples begin to be pushed, meters
  double width;                         ///< over which the push grows to its full stiffness, meters
  double sticks;                        ///< slip below which friction holds, meters
  double giving;                        ///< gap of a contact up to which the skin's patches there give way, meters
};

namespace contact_rows {

/// A row that is made of a row of J and the one after it, which are of the same points.
struct Sum {
  int first;
  double factor, after;
};

inline void make(const RowMajor& J, const std::vector<Sum>& sums, RowMajor& out) {
  out.resize(Eigen::Index(sums.size()), J.cols());
  for (std::size_t k = 0; k < sums.size(); ++k) {
    out.row(Eigen::Index(k)) = sums[k].factor * J.row(sums[k].first);
    if (sums[k].after != 0) out.row(Eigen::Index(k)) += sums[k].after * J.row(sums[k].first + 1);
  }
}
inline void make(const SparseRows& J, const std::vector<Sum>& sums, SparseRows& out) {
  using Part = Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator;
  int parts = 0;
  for (const Sum& sum : sums) parts += J.ends[std::size_t(sum.first)] - J.first(sum.first);
  out.ends.clear();
  out.parts.resize(parts, J.parts.cols());
  out.parts.reserve(12 * Eigen::Index(parts));
  int made = 0;
  for (const Sum& sum : sums) {
    const bool both = sum.after != 0;
    for (int part = J.first(sum.first); part < J.ends[std::size_t(sum.first)]; ++part) {
      out.parts.startVec(made);
      Part after(J.parts, both ? part - J.first(sum.first) + J.first(sum.first + 1) : part);  // with the same columns
      for (Part it(J.parts, part); it; ++it, ++after)
        out.parts.insertBack(made, it.col()) = sum.factor * it.value() + (both ? sum.after * after.value() : 0);
      ++made;
    }
    out.ends.push_back(made);
  }
  out.parts.finalize();
}

inline void scale(RowMajor& J, int row, double factor) { J.row(row) *= factor; }
inline void scale(SparseRows&, int, double) {}

}  // namespace contact_rows

/// The samples of a body at the end of a step. It owns nothing.
template <class Model>
struct PosedSamples {
  const ContactSamples<Model>& of;
  const Transforms& bones;
  const VectorXd& weights;  ///< of the targets (J)
  const VectorXd& elastic;  ///< the same times how stiff each target is

  /// k of a sample; square: (c h)^2, s^2.
  double stiffness(int sample, double square) const { return of.stiffness(sample, elastic, square); }
  /// Where it is at q = 0, world space.
  Vector3d unmoved(int sample) const { return of.unmoved(bones, weights, sample); }
  /// Adds how far it moves along a direction to the last row of numbers.
  void add(int sample, const Vector3d& direction, PointRows& numbers) const { of.add(sample, direction, numbers); }
  /// What numbers are for the coordinates. scratch: the numbers in bind space.
  void rows(const PointRows& numbers, PointRows& scratch, typename Model::SkinPoints::Rows& out) const {
    of.map().rows(bones, numbers, scratch, out);
  }
};

/// Contacts that begin where the samples' stiffness is above zero. Samples: those of one body, or of several that press
/// on each other (simulation.cpp).
template <class Model, class Samples = PosedSamples<Model>>
struct ContactTerm {
  using Points = PointStiffness<typename Model::Matrix>;
  /// Whether the skin may give way by patches: an unreduced model does so by itself.
  static constexpr bool kGivesWay = std::is_same_v<Points, DensePoints>;

  /// Nothing touches anything.
  void clear() {
    touching_.clear();
    touch_of_.clear();
    dents_.clear();
    points_.stiffness.resize(0);
    if constexpr (kGivesWay) points_.own_rows.resize(0, 0);
  }

  /// contacts: by collider, and those of a collider by sample. pressures: of the step before, likewise. dents: the
  /// amplitudes of all patches then.
  void begin(const Samples& samples, const std::vector<Contact>& contacts, const ContactStep& step,
             const std::vector<Pressure>& pressures, const VectorXd& dents) {
    clear();
    distance_ = step.distance;
    width_ = step.width;
    sticks_ = step.sticks;
    numbers_.clear();
    offsets_.resize(3 * Eigen::Index(contacts.size()));
    for (const Contact& contact : contacts) {
      const double stiffness = contact.weight * firmness(samples, contact, step);
      touch_of_.push_back(stiffness > 0 ? int(touching_.size()) : -1);
      if (!(stiffness > 0)) continue;
      const bool own = contact.collider == kSkin;
      const double friction = own ? step.own_friction : step.friction[std::size_t(contact.collider)];
      Vector3d unmoved = Vector3d::Zero();
      double far = contact.point.norm();
      contact.each_sample([&](int sample, double part) {
        const Vector3d place = samples.unmoved(sample);
        unmoved += part * place;
        far += std::abs(part) * place.norm();
      });
      const auto add = [&](const Vector3d& direction, const Vector3d& from) {
        offsets_(numbers_.size()) = direction.dot(unmoved - from);
        numbers_.add_row();
        contact.each_sample([&](int sample, double part) { samples.add(sample, part * direction, numbers_); });
      };
      const Pressure last = pressure_of(pressures, contact);
      touching_.push_back(
          {contact, numbers_.size(), stiffness, stiffness * far, friction, friction * last.force, {}, {}});
      add(contact.normal, contact.point + step.distance * contact.normal);
      if (!(friction > 0)) continue;
      const Vector3d across = contact.normal.unitOrthogonal();
      const Vector3d from = contact.before + contact.motion - last.slip;
      add(across, from);
      add(contact.normal.cross(across), from);
    }
    offsets_.conservativeResize(numbers_.size());
    if (touching_.empty()) return;
    samples.rows(numbers_, scratch_, rows_);
    if constexpr (kGivesWay && std::is_same_v<Samples, PosedSamples<Model>>)
      if (samples.of.local()) begin_dents(samples, step.giving, dents);
  }

  /// The unknowns of the patches, which follow the coordinates.
  const VectorXd& unknowns() const { return dents_.unknowns(); }

  bool empty() const { return touching_.empty(); }

  /// Takes the pressures where it was linearized last for those that friction is proportional to. Returns false when
  /// there is none.
  bool next_round() {
    bool any = false;
    for (Touch& touch : touching_) {
      any |= touch.friction > 0 && (touch.held > 0 || touch.normal.force > 0);
      touch.held = touch.friction * touch.pressure();
    }
    begin_newton();
    return any;
  }

  /// To be called before Newton's method, whose course the Hessian of friction follows.
  void begin_newton() {
    for (Touch& touch : touching_) touch.slip_force.begin();
  }

  double value(const VectorXd& x) {
    for (Touch& touch : touching_) touch.slip_force.go_back();
    return evaluate(x);
  }

  /// Its Hessian is along the normals, of the patches that give way no further, and along and across the slips.
  Term<Points> linearize(const VectorXd& x) {
    gradient_.setZero(x.size());
    if (touching_.empty()) return {0, gradient_, points_, {}};
    const double energy = evaluate(x);
    double magnitude = 0;
    forces_.setZero(values_.size());
    for (const Touch& touch : touching_) {
      forces_(touch.row) = -touch.pressure();
      if (touch.normal.force > 0) magnitude += touch.magnitude;
      if (!(touch.held > 0)) continue;
      const Eigen::Vector2d slip = slip_at(touch);
      forces_.segment<2>(touch.row + 1) = touch.held / smoothed_slip(slip.norm(), sticks_).compliance * slip;
    }
    add_transposed_product(rows_, forces_, gradient_);
    double pushing = gradient_.norm();
    if (!dents_.empty()) pushing = push_patches();
    stiffen();
    return {energy, gradient_, points_, {pushing, 1e-15 * magnitude, x.norm()}};
  }
  /// Its part of the Hessian where it was linearized last.
  const Points& points() const { return points_; }

  // What follows holds where it was linearized last.

  void pressures(std::vector<Pressure>& out) const {
    out.clear();
    for (const Touch& touch : touching_)
      if (touch.normal.force > 0)
        out.push_back(
            {touch.contact.sample, touch.contact.collider, touch.contact.normal, touch.pressure(), slip_of(touch)});
  }

  /// Samples that are pushed.
  int count() const {
    return int(std::count_if(touching_.begin(), touching_.end(), [](const Touch& t) { return t.normal.force > 0; }));
  }

  /// The amplitudes of all patches.
  void dents(VectorXd& amplitudes) const { dents_.amplitudes(amplitudes); }

  /// The largest depth of a sample under a collider's surface, or in other skin, meters; 0 for none. Those with less
  /// than half of their weight do not count.
  double penetration() const {
    double deepest = 0;
    for (const Touch& touch : touching_)
      if (touch.contact.weight >= 0.5) deepest = std::max(deepest, -values_(touch.row) - distance_);
    return deepest;
  }

  /// How deep the sample of a contact, by its number, is in what it touches, meters; infinite where nothing pushes.
  double inside(std::size_t contact) const {
    const int touch = touch_of_[contact];
    return touch < 0 ? kInfinity : -values_(touching_[std::size_t(touch)].row) - distance_;
  }

  /// Calls f(contact, newtons on its sample) for all that push.
  template <class F>
  void each_push(F&& f) const {
    for (const Touch& touch : touching_) {
      const Vector3d& normal = touch.contact.normal;
      Vector3d force = -forces_(touch.row) * normal;
      if (touch.friction > 0) {
        const Vector3d across = normal.unitOrthogonal();
        force -= forces_(touch.row + 1) * across + forces_(touch.row + 2) * normal.cross(across);
      }
      if (!force.isZero(0)) f(touch.contact, force);
    }
  }

  /// Newtons on each collider (C).
  void forces(std::vector<Vector3d>& on_colliders) const {
    each_push([&](const Contact& contact, const Vector3d& force) {
      if (contact.collider != kSkin) on_colliders[std::size_t(contact.collider)] -= force;
    });
  }

 private:
  /// k of a contact, N/m. Where both sides are pushed by each other's contacts, each has half of it.
  static double firmness(const Samples& samples, const Contact& contact, const ContactStep& step) {
    const auto of = [&](int sample) { return samples.stiffness(sample, step.square); };
    double compliance = 0, others = 0;
    contact.each_sample([&](int sample, double part) {
      if (part > 0) return;
      const double stiffness = of(sample);
      others -= stiffness > 0 ? part : 0;
      compliance -= stiffness > 0 ? part / stiffness : 0;
    });
    const double own = of(contact.sample);
    if (!(others > 0)) return own;
    if (!(own > 0)) return contact.alone ? others / compliance : 0;
    return (contact.alone ? 1.0 : 0.5) / (1 / own + compliance / others);
  }

  /// Lets the skin give way by the patches beneath the contacts that are near.
  void begin_dents(const PosedSamples<Model>& posed, double giving, const VectorXd& dents) {
    const ContactSamples<Model>& samples = posed.of;
    struct Patch {
      int sample;
      double deepest;  ///< of its contacts, where the targets alone put them
    };
    std::map<int, Patch> found;
    VectorXd shape, at_shape;
    blended_shape(samples.model(), posed.weights, shape);
    multiply(rows_, shape, at_shape);
    for (const Touch& touch : touching_) {
      if (!touch.presses_patches() || touch.contact.gap > giving) continue;
      const double depth = std::max(-offsets_(touch.row) - at_shape(touch.row), width_);
      for (const int number : samples.patches(touch.contact.sample)) {
        Patch& patch = found.try_emplace(number, Patch{0, depth}).first->second;
        patch = {touch.contact.sample, std::max(patch.deepest, depth)};
      }
    }
    std::vector<int> patches;
    for (const auto& [number, patch] : found) patches.push_back(number);
    const Eigen::Index m = Eigen::Index(patches.size());
    std::vector<int> which, numbers;  // of the touches that press patches
    for (std::size_t i = 0; i < touching_.size(); ++i) {
      const Touch& touch = touching_[i];
      if (!touch.presses_patches()) continue;
      const double taken = samples.taken(touch.contact.sample);
      for (int row = touch.row; row < touch.row + (touch.friction > 0 ? 3 : 1); ++row) {
        contact_rows::scale(rows_, row, taken);
        offsets_(row) += (1 - taken) * at_shape(row);
      }
      which.push_back(int(i));
      numbers.push_back(touch.row);
    }
    if (patches.empty()) return;
    VectorXd stiffer(m), most(m);
    Eigen::Index j = 0;
    for (const auto& [number, patch] : found) {
      stiffer(j) = std::sqrt(samples.local_stiffer(patch.sample, posed.elastic));
      most(j++) = patch.deepest / std::max(samples.local()->farthest()(number), 1e-300);
    }
    MatrixXd stiffness = samples.local()->stiffness()(patches, patches);
    stiffness = stiffer.asDiagonal() * stiffness * stiffer.asDiagonal();
    const RowMajor together = samples.local()->moved_where_farthest(patches);
    RowMajor rows = RowMajor::Zero(Eigen::Index(touching_.size()), m), given;
    samples.local_rows(scratch_, numbers, patches, given);
    rows(which, Eigen::all) = given;
    points_.own_factor = stiffness.llt().matrixL();
    dents_.begin(std::move(patches), std::move(rows), std::move(stiffness), together, most, dents);
  }

  /// The energy at x, with the gaps, slips and normal forces there.
  double evaluate(const VectorXd& x) {
    double energy = 0;
    if (touching_.empty()) return energy;
    multiply(rows_, x, values_);
    values_ += offsets_;
    if (!dents_.empty()) {
      dents_.at(x.tail(unknowns().size()));
      energy = dents_.energy();
      for (std::size_t i = 0; i < touching_.size(); ++i)
        values_(touching_[i].row) += dents_.given_way()(Eigen::Index(i));
    }
    for (Touch& touch : touching_) {
      touch.normal = contact_ramp(-values_(touch.row), width_);
      energy += touch.stiffness * touch.normal.energy;
      if (touch.held > 0) energy += touch.held * smoothed_slip(slip_at(touch).norm(), sticks_).energy;
    }
    return energy;
  }

  /// Adds the forces on the patches. Returns the norm of all that push.
  double push_patches() {
    VectorXd pressures(dents_.rows().rows());
    for (std::size_t i = 0; i < touching_.size(); ++i) pressures(Eigen::Index(i)) = touching_[i].pressure();
    auto own = gradient_.tail(unknowns().size());
    own.noalias() -= dents_.rows().transpose() * pressures;
    const double pushing = gradient_.norm();
    own += dents_.resisting();
    return pushing;
  }

  /// Sets the points' stiffness.
  void stiffen() {
    sums_.clear();
    stiffness_.clear();
    const auto add = [&](double stiffness, const contact_rows::Sum& sum) {
      if (!(stiffness > 0)) return;
      stiffness_.push_back(stiffness);
      sums_.push_back(sum);
    };
    for (const Touch& touch : touching_) add(touch.stiffness * touch.normal.stiffness, {touch.row, 1, 0});
    if constexpr (kGivesWay) add_patches(add);
    for (Touch& touch : touching_) {
      if (!(touch.held > 0)) continue;
      const auto& [along, stiffness, across] = touch.slip_force.follow(slip_at(touch), sticks_);
      add(touch.held * stiffness, {touch.row + 1, along.x(), along.y()});
      add(touch.held * across, {touch.row + 1, -along.y(), along.x()});
    }
    points_.stiffness = Eigen::Map<const VectorXd>(stiffness_.data(), Eigen::Index(stiffness_.size()));
    if (!stiffness_.empty()) contact_rows::make(rows_, sums_, points_.rows);
  }

  /// What the points' stiffness has of the patches: rows of the normals, which come first, and of the patches that are
  /// hard.
  template <class Add>
  void add_patches(const Add& add) {
    dents_.each_hard([&](const auto&, double stiffness) { add(stiffness, {0, 0, 0}); });
    points_.own_rows.resize(Eigen::Index(stiffness_.size()), unknowns().size());
    if (dents_.empty()) return;
    Eigen::Index row = 0;
    for (std::size_t i = 0; i < touching_.size(); ++i)
      if (touching_[i].stiffness * touching_[i].normal.stiffness > 0)
        points_.own_rows.row(row++) = dents_.rows().row(Eigen::Index(i));
    dents_.each_hard([&](const auto& over_a, double) { points_.own_rows.row(row++) = over_a; });
  }

  struct Touch {
    Contact contact;
    int row;  ///< of the gap in rows_; those of the slip follow where there is friction
    double stiffness, magnitude, friction;
    double held;  ///< friction times the pressure of the round before
    ContactRamp normal;
    SlipForce slip_force;
    double pressure() const { return stiffness * normal.force; }
    /// Skin meets skin so widely that the modes give way by themselves. Patches would jitter between limbs.
    bool presses_patches() const { return contact.collider != kSkin; }
  };

  /// Of the one at the same place whose normal is nearest: a sample may touch several sides of a collider.
  static Pressure pressure_of(const std::vector<Pressure>& pressures, const Contact& contact) {
    using Place = std::pair<int, int>;
    const Place place(contact.collider, contact.sample);
    const auto of = [](const Pressure& pressure) { return Place(pressure.collider, pressure.sample); };
    auto at = std::lower_bound(pressures.begin(), pressures.end(), place,
                               [&](const Pressure& pressure, const Place& wanted) { return of(pressure) < wanted; });
    Pressure out{contact.sample, contact.collider, contact.normal, 0, Vector3d::Zero()};
    double nearest = 0;
    for (; at != pressures.end() && of(*at) == place; ++at)
      if (const double near = at->normal.dot(contact.normal); near > nearest) {
        nearest = near;
        out = *at;
      }
    return out;
  }

  Eigen::Vector2d slip_at(const Touch& touch) const { return values_.segment<2>(touch.row + 1); }

  /// From where friction holds it, world space.
  Vector3d slip_of(const Touch& touch) const {
    if (!(touch.friction > 0)) return Vector3d::Zero();
    const Vector3d& normal = touch.contact.normal;
    const Vector3d across = normal.unitOrthogonal();
    const Eigen::Vector2d slip = slip_at(touch);
    return std::min(1.0, sticks_ / std::max(slip.norm(), 1e-300)) * (slip(0) * across + slip(1) * normal.cross(across));
  }

  double distance_ = 0, width_ = 1, sticks_ = 1;
  std::vector<Touch> touching_;
  std::vector<int> touch_of_;  ///< of each contact: its place among those; -1: nothing pushes there
  PointRows numbers_, scratch_;
  typename Model::SkinPoints::Rows rows_;
  VectorXd offsets_, values_, forces_, gradient_;  ///< gaps (less the distance) and slips; at q = 0; what resists them
  Dents dents_;
  std::vector<contact_rows::Sum> sums_;
  std::vector<double> stiffness_;
  Points points_;
};

}  // namespace dynamorph
