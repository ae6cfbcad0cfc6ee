// SPDX-License-Identifier: GPL-3.0-or-later
// Where a skin touches itself. Balls fill the body, and each moves with its center as the skin does. What overlaps is
// found from the pose alone, without the motion of the tissue: so it is the same in every run, at any frame. With x the
// places of the samples that bones and targets alone give them, c_k and r_k those of the balls, and d_k = |x_p - c_k| -
// f_pk r_k, a sample p is at the distance
//
//   g_p = -tau log sum_k exp(-d_k / tau),
//
// from the rest of the body, along the mean n of the balls' directions, less f_pk times what the balls miss of the skin
// that it meets, which is g of that skin at rest. f_pk grows from 0 to 1 with how far one must go from the sample, at
// rest, on a way through the body to the ball: at a joint or a crease nothing touches, and nothing begins at a line.
// What is near through the air alone has no such way, and touches. The way leads over balls, each of which holds the
// center of the next one or has its own held by that. Nothing pushes at rest: where g_p is less than tau there, all r_k
// near p are less by the difference. The other side are the samples q nearest to the place x_p - g_p n on its surface,
// with weights t_q. The contact is a plane between the two for the length of a step:
//
//   gap = g_p + n . (u_p - sum_q t_q u_q),        u = the displacement from x,
//
// and pushes both sides, each as it gives way, so that the forces sum to zero. Where p is pushed from q, some of q are
// pushed from p: each of the two has half of the stiffness of both in series.
//
// What the bones leave no room for is not forced. With D = -g_p, T the thickness of the tissue of both sides, and A, B
// the transforms of the bones of two parts, all contacts between these have the weight
//
//   1 - smooth_step((max D / T - 0.38) / 0.1),      times smooth_step((det (A + B) / 2 - 0.25) / 0.15)
//
// if they share skin: linear blend skinning crushes that to det (A + B) / 2 of its volume, which is 0.46 in a joint
// that is folded by 95 degrees, and 0.21 by 125. If each contact had its own weight, skin would tear where some give
// up.
//
// Two bodies touch each other in the same way: the samples of one meet the balls of the other, all of them, whatever is
// near at rest. Clothes lie on a body: what the samples of clothes meet is the skin that is below them when a step
// begins, wherever they have slid, and balls that are far from it through the body. Clothes that are in the body at
// rest stay as deep as they are. The other way around nothing is searched for, since what clothes are around is not in
// them.
#pragma once

#include <array>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "dynamorph/contact/contact.hpp"
#include "dynamorph/contact/contact_samples.hpp"

namespace dynamorph {

/// Balls that fill a body and move with it (K), and the points of its skin that touch them (P). Bind space, meters.
struct BodyParts {
  Skin centers;
  VectorXd radius;          ///< (K) > 0
  std::vector<int> points;  ///< numbers of the samples (P), ascending
  std::vector<int> of_balls,
      of_points;  ///< numbers of the parts that they belong to (K), (P); within one, nothing touches
  std::vector<std::array<int, 2>> joints;  ///< parts that share skin
};

/// A skin and the body below it during a step.
struct PosedSkin {
  const Transforms &before, &now;           ///< bones at the beginning and the end of the step
  const VectorXd& weights;                  ///< of the targets (J)
  const VectorXd &shape, &was, &predicted;  ///< coordinates of the targets' blended shape; at the beginning; at the end
  double near, margin;                      ///< meters: of a contact's gap; of g
};

/// The balls that are near a place at rest, ascending, and f of each.
using NearBalls = std::vector<std::pair<int, double>>;

/// Of two bodies that touch each other: the first are clothes that lie on the second. For each of the points of the
/// clothes (P):
struct Worn {
  int clothes, body;                     ///< numbers of bodies
  std::vector<NearBalls> near;           ///< of the body
  std::vector<OtherSide> below;          ///< samples of the body at rest
  std::vector<std::vector<int>> beside;  ///< of each sample of the body: those around it at rest, and itself
  std::vector<int> parts;                ///< of the body, that they lie on
  VectorXd deep;                         ///< their gap at rest where that is below zero, otherwise zero, meters
};

/// Immutable: simulations may share it.
template <class Model>
class SelfContact {
 public:
  /// Throws std::invalid_argument unless all fit each other.
  SelfContact(std::shared_ptr<const ContactSamples<Model>> samples, BodyParts body);

  const ContactSamples<Model>& samples() const { return *samples_; }

  /// This skin as clothes on another one at rest. to_body: from its bind space to that of the body.
  Worn wear(int clothes, int body, const SelfContact& other, const PointTransform& to_body) const;

  /// A vertex of the skin, world space: x; with the tissue where it was, and where it is predicted, at the end of the
  /// step; at its beginning; and how its transform turns then and now.
  struct PosedVertex {
    Vector3d unmoved, kept, predicted, before;
    Matrix3d turned_before, turned;
  };

  /// Buffers that are kept from step to step.
  struct Scratch {
    Points centers;                                    ///< of the balls, world space
    std::vector<Matrix3d> turns;                       ///< of each part's bone
    std::vector<double> scales;                        ///< the length to which that makes one of one meter
    std::vector<Vector3d> places;                      ///< x of the points that are known
    std::vector<int> place_of;                         ///< of each point, in places; -1: not known
    std::vector<std::pair<double, int>> near, others;  ///< distances, and balls or points
    std::vector<Eigen::AlignedBox3d> boxes, clusters;  ///< where the balls of each part reach, and of each cluster
    std::vector<PosedVertex> vertices;                 ///< of the skin, those that are known
    std::vector<int> vertex_of;                        ///< of each vertex of the skin, in vertices; -1: not known
  };

  /// One of the bodies in a step.
  struct Body {
    const SelfContact& of;
    PosedSkin skin;
    Scratch& scratch;
    int first_sample;  ///< of it among those of all bodies
    bool jumps;        ///< by so much that it touches no other body in this step
  };

  /// Sets `contacts` to those of all points whose gap is less than `near` at the beginning of the step or at its
  /// predicted end, by sample.
  void find(const PosedSkin& skin, Scratch& scratch, std::vector<Contact>& contacts) const;

  /// The same where several bodies touch each other; none touches itself. Samples are numbered over all bodies.
  static void find_between(const std::vector<Body>& bodies, const std::vector<Worn>& worn,
                           std::vector<Contact>& contacts);

 private:
  struct Part {
    typename ContactSamples<Model>::Group points;  ///< numbers of points
    std::vector<std::vector<int>> clusters;        ///< its balls, those that are near to each other together
    std::size_t first_cluster = 0;                 ///< its first one among those of all parts
    Eigen::Index bone = 0;                         ///< that moves its points most
  };
  struct Nearest {
    double gap;
    Vector3d normal;
    int ball;
    double touched;  ///< f of the ball
  };

  struct Found {
    Contact contact;
    std::pair<int, int> parts;  ///< that touch
    double depth, room;         ///< D and T, meters
  };

  void find_parts();
  void find_covers();
  void find_ways();
  void find_beyond();
  /// Poses the balls of a body, and forgets what was known of its points.
  static void begin(const Body& body);
  Vector3d normal(Eigen::Index point) const;  ///< at rest
  /// Of the skin at rest, with so much tissue, meters.
  NearBalls near_at_rest(const Vector3d& place, const Vector3d& normal, double thickness) const;
  static const PosedVertex& vertex(const Body& body, int vertex);
  /// The place of a point of a body in the targets' shapes, world space.
  static Vector3d place(const Body& body, int point);
  /// Adds the contacts of a body's points with the balls of another one, or of itself; worn: if it lies on that.
  static void search(const Body& body, const Body& other, const Worn* worn, std::vector<Found>& found);
  static Vector3d kept(const Body& body, int sample);
  /// A point of clothes above these samples of the body, where bones and targets alone put both; without a ball (-1) if
  /// these face nowhere. deep: as much in it as it may be.
  static Nearest above(const Body& clothes, int point, const Body& body, const OtherSide& others, double deep);
  /// Samples of the body that are nearest to a point of clothes where its tissue was, found from those below it at
  /// rest.
  static OtherSide followed(const Body& clothes, int point, const Body& body, const Worn& worn);
  /// Adds those of clothes with the skin that they lie on.
  static void lie(const Body& clothes, const Body& body, const Worn& worn, std::vector<Found>& found);
  /// What is nearer to a point of the body than the margin of the balls of these parts of the other; without a ball
  /// (-1) if nothing is.
  static Nearest nearest(const Body& body, int point, const Body& other, const Worn* worn,
                         const std::vector<int>& parts);
  /// Adds the contact of a point of the body with these samples of the other. parts: of both.
  static void touch(const Body& body, int point, const Body& other, const Nearest& nearest, const OtherSide& others,
                    const std::pair<int, int>& parts, std::vector<Found>& found);
  static OtherSide other_side(const Body& body, int point, const Body& other, Nearest& nearest);
  /// What skinning leaves of a joint: 1 where two parts share no skin.
  static double folded(const Body& body, const Body& other, const std::pair<int, int>& parts);
  /// Sets the weights of contacts between a body and another one, or itself, and adds them.
  static void weigh(const Body& body, const Body& other, const std::vector<Found>& found,
                    std::vector<Contact>& contacts);

  std::shared_ptr<const ContactSamples<Model>> samples_;
  SkinMap<Model> balls_;
  BodyParts body_;        ///< but for the centers
  MatrixXd ball_shapes_;  ///< displacements of the centers in each target's shape (3K, J)
  Points rest_;           ///< of the points
  VectorXd thickness_;    ///< of the points
  double sharpness_;      ///< tau, meters
  std::vector<Part> parts_;
  std::set<std::pair<int, int>> joints_;  ///< the lower number first
  std::vector<std::vector<int>> covers_;  ///< the points nearest to each ball, on the skin around it
  std::vector<std::vector<int>> beside_;  ///< the balls that a way through the body leads on to from each of them
  VectorXd beyond_;                       ///< g of the points at rest from the balls below them: what these miss (P)
  VectorXd covered_;                      ///< radius of the balls that would miss none of the points they cover (K)
  std::vector<NearBalls> near_;           ///< to each point
};

extern template class SelfContact<FullModel>;
extern template class SelfContact<ReducedModel>;

}  // namespace dynamorph
