// SPDX-License-Identifier: GPL-3.0-or-later
// Where a skin touches itself. Balls fill the body, and each moves with its center as the skin does. What overlaps is
// found from the pose alone, without the motion of the tissue: so it is the same in every run, at any frame. With x the
// places of the samples that bones and targets alone give them, c_k and r_k those of the balls, and d_k = |x_p - c_k| -
// f_pk r_k, a sample p is at the distance
//
//   g_p = -tau log sum_k exp(-d_k / tau),
//
// from the rest of the body, along the mean n of the balls' directions. f_pk grows from 0 to 1 with the distance of
// sample and ball at rest: what touches at rest, or at a crease, is ignored, and nothing begins at a line. The other
// side are the samples q nearest to the place x_p - g_p n on its surface, with weights t_q. The contact is a plane
// between the two for the length of a step:
//
//   gap = g_p + n . (u_p - sum_q t_q u_q),        u = the displacement from x,
//
// and pushes both sides, each as it gives way, so that the forces sum to zero. Where p is pushed from q, some of q are
// pushed from p: each of the two has half of the stiffness of both in series.
//
// What the bones leave no room for, as a knee that is folded flat, is not forced. With D = -g_p, and T the thickness of
// the tissue of both sides, all contacts of two parts of the body have the weight
//
//   1 - smooth_step((max D / T - 0.36) / 0.1).
//
// If each had its own, skin would tear where some of them give up.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/contact/contact.hpp"
#include "dynamorph/contact/contact_samples.hpp"

namespace dynamorph {

/// Balls that fill a body and move with it (K). Bind space, meters.
struct BodyBalls {
  Skin centers;
  VectorXd radius;  ///< (K) > 0
};

/// A skin and the body below it during a step.
struct PosedSkin {
  const Transforms &before, &now;           ///< bones at the beginning and the end of the step
  const VectorXd& weights;                  ///< of the targets (J)
  const VectorXd &shape, &was, &predicted;  ///< coordinates of the targets' blended shape; at the beginning; at the end
  double near, margin;                      ///< meters: of a contact's gap; of g
};

/// Immutable: simulations may share it.
template <class Model>
class SelfContact {
 public:
  /// points: those of the samples that touch the balls, ascending. Throws std::invalid_argument unless all fit each
  /// other.
  SelfContact(std::shared_ptr<const ContactSamples<Model>> samples, BodyBalls balls, std::vector<int> points);

  const ContactSamples<Model>& samples() const { return *samples_; }

  /// Buffers that are kept from step to step.
  struct Scratch {
    Points centers;                ///< of the balls, world space
    std::vector<Vector3d> places;  ///< x of the points that are known
    std::vector<int> place_of;     ///< of each point, in places; -1: not known
    std::vector<std::pair<double, int>> near, others;
    std::vector<std::pair<int, int>> parts;  ///< of each contact: the two that it is between, the lower number first
  };

  /// Sets `contacts` to those of all points whose gap is less than `near` at the beginning of the step or at its
  /// predicted end, by sample.
  void find(const PosedSkin& skin, Scratch& scratch, std::vector<Contact>& contacts) const;

 private:
  /// What one bone moves most.
  struct Part {
    typename ContactSamples<Model>::Group points;  ///< numbers of points_
    std::vector<int> balls;
  };

  double fade(int point, int ball) const;
  void touch(int point, const PosedSkin& skin, const std::vector<const Part*>& parts, Scratch& scratch,
             std::vector<Contact>& contacts) const;
  bool find_other_side(int ball, const Vector3d& place, const PosedSkin& skin, Scratch& scratch,
                       Contact& contact) const;
  const Vector3d& place(int point, const PosedSkin& skin, Scratch& scratch) const;
  Vector3d ball_center(int ball, const PosedSkin& skin) const;

  std::shared_ptr<const ContactSamples<Model>> samples_;
  SkinMap<Model> balls_;
  VectorXd radius_;
  MatrixXd ball_shapes_;  ///< displacements of the centers in each target's shape (3K, J)
  std::vector<int> points_;
  Points rest_;         ///< of the points
  VectorXd thickness_;  ///< of the points
  double sharpness_;    ///< tau, meters
  std::vector<Part> parts_;
  std::vector<int> part_of_point_, part_of_ball_;
  std::vector<std::vector<int>> covers_;  ///< the points nearest to each ball
};

extern template class SelfContact<FullModel>;
extern template class SelfContact<ReducedModel>;

}  // namespace dynamorph
