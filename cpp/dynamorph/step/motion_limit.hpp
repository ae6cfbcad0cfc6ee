// SPDX-License-Identifier: GPL-3.0-or-later
// How far a moving rig may drive the tissue. Two limits, both local and both smooth:
//
// 1. On the load. The load f of a step is what the rig's acceleration, gravity's difference from the targets' own poses
//    and force fields do to tissue at rest in bind space. It drives a complex oscillator m with the tissue's own
//    angular frequency w, and y = K^-1 m (K: the neutral stiffness) says how far the load lets the skin swing. For each
//    bone b, with k = exp((i - 0.3) h w) and ' for the step before,
//
//      m   = k m' + (1 - k) f
//      p_b = 97th percentile of |a_b (X_i, 1)| / L_i over its skin                          a_b = B_b - 2 B_b' + B_b''
//      q_b = max(97th percentile of |y_i| / L_i over its skin,  largest |e . dy| / (0.4 l) over its edges) / 0.9
//      H_b = max(min(max(q_b / |k|, p_b), max(q_b', p_b')), |k| H_b')
//      x_b = max(H_b, p_b)
//      s_b = 1 where x_b <= 0.4,  otherwise (0.4 + 0.6 tanh((x_b - 0.4) / 0.6)) / x_b
//
//    with L_i the largest distance of a point from its targets' shape, l the length of an edge, and B_b the bone. The
//    load of bone b is scaled by s_b: the tissue is driven less hard, and swings as it would.
//
//    With a real k, m would be a mean of the load over the time 1 / w. Loads that oscillate would cancel in it,
//    although they drive the tissue most. The amplitude |m| is the load itself where that lasts, it counts a velocity
//    that jumps at a key as much as one that changes within a fraction of a swing, and a position that jumps by d,
//    which is an impulse and its opposite, as d, whatever the step. A step cannot tell the two jumps apart before the
//    next one. So H holds what is still there a step later (q decays by |k| until then), and the jump p itself counts
//    at once. What the steps before have let through is corrected when s changes (`StepLoad::scaled`). H does not fall
//    faster than free swing: what brakes a swing is scaled as what has driven it.
//
// 2. On the motion itself, for what a bounded load can build up (a landing, resonance). From 0.6 L on a point is pulled
//    back, and from 0.6 of 0.4 of its length on the change of an edge,
//
//      E_p = 30 m_p w^2 ramp(|u_p - d_p|, L),    E_e = 240 W_b / n_b ramp(|e . d(u - d)| / (0.4 l), 1),
//
//    ramp(x, limit): cubic from 0.6 of the limit to the limit, then quadratic. The edges are those of the first limit
//    and 400 between them. W_b is the elastic energy of the static answer in which those of bone b reach the first
//    limit, and n_b their number, in which one between them counts by the square of its stretch over theirs.
//    Where L is painted smaller, m times as large, a point is pulled back from 0.6 m L on, with 30 / m. The load keeps
//    the unpainted L: a spot that must stay near the bones does not make all tissue of its bone sluggish.
//
// Below 0.36 of the first limit and 0.6 of the second, neither changes a bit of the motion.
#pragma once

#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <type_traits>
#include <vector>

#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/simd/lane_vector.hpp"

namespace dynamorph {

/// The trade between lively motion, far displacements and squeezed edges; docs/limit.md tables it.
struct LimitConstants {
  double stretch = 0.4;     ///< of an edge's length: its limit
  int edges_between = 400;  ///< are pulled back beside the most stretched one of each of a bone's loads
};

/// How far P points of the skin may be from their targets' shape. Bind space, meters.
struct SkinLimits {
  Points rest;          ///< X (P, 3)
  Embedding embedding;  ///< (P)
  Triangles triangles;  ///< of the soft skin; points without one do not count
  MatrixXd weights;     ///< (P, G): skin weights of the bones
  VectorXd distances;   ///< L (P) > 0; infinite for no limit
  /// (T, G): each transform's part in the bones, where the body's transforms (T) are its nodes' own; otherwise (0, 0).
  MatrixXd groups;
  VectorXd painted;  ///< (P) in (0, 1]: factors on L where points are pulled back; empty for ones
  LimitConstants constants = {};
};

/// Edges of the skin, as pairs of its points, that say how far loads on a bone stretch it.
struct BoneEdges {
  std::vector<Edge> critical;  ///< that its loads stretch most
  std::vector<Edge> between;   ///< that are pulled back beside those
  double stiffness = 0;        ///< with which each of these is, J: twice the factor of E_e
};

/// What the limits look at in a skin of P points, for which static answers are found: that takes a while.
struct LimitedTissue {
  double square_frequency = 0;   ///< w^2
  std::vector<int> chosen;       ///< points that say how far a load carries the skin
  VectorXd area;                 ///< of the skin that is nearest to each of them
  std::vector<int> pulled;       ///< points that are pulled back: the same, and more where L is painted smaller
  VectorXd pulled_mass;          ///< of the nodes that are nearest to each of these
  std::vector<BoneEdges> edges;  ///< of each bone (G)
};

using MatrixX2d = Eigen::Matrix<double, Eigen::Dynamic, 2>;

/// Rows (k, dofs) in single precision, which is enough to compare lengths with limits.
class SingleRows {
 public:
  explicit SingleRows(const Eigen::Ref<const MatrixXd>& rows);
  /// out = rows x (k, and zeros up to whole blocks). scratch: x in single precision.
  void multiply(const VectorXd& x, std::vector<float>& scratch, VectorXd& out) const;
  /// The same for two columns, in little more time.
  void multiply(const MatrixX2d& x, std::vector<float>& scratch, MatrixX2d& out) const;
  Eigen::Index size() const { return size_; }

 private:
  Eigen::Index size_, padded_;
  LaneVector<float> table_;  ///< of multiply_row_blocks
};

/// Rows J of static answers J K^-1 f over the nodes of a mesh.
class NodalAnswers {
 public:
  NodalAnswers(BlockCholesky<float> factor, SparseRows rows) : factor_(std::move(factor)), rows_(std::move(rows)) {}
  void multiply(const MatrixX2d& loads, std::vector<float>& scratch, MatrixX2d& out) const;
  Eigen::Index size() const { return rows_.rows(); }

 private:
  BlockCholesky<float> factor_;
  SparseRows rows_;
};

/// A bone, by its numbers in a static answer.
struct LimitedBone {
  std::vector<std::pair<int, double>> points;  ///< with their weights in the percentile
  double above = 0;                            ///< the weight of those beyond it
  Vector3d center = Vector3d::Zero();          ///< of their box
  double radius = 0, least_distance = 0;       ///< the largest distance from there, and the smallest L
  int first_edge = 0, last_edge = 0;           ///< numbers from the first to before the last
  VectorXd share;                              ///< of its tissue in each target set; adds up to one
};

/// What is pulled back: a point by its offset from its targets' shape (three numbers, meters), or an edge by its
/// stretch (one, relative to its limit).
struct Pull {
  int first, count;         ///< its numbers
  double limit, stiffness;  /// J per square of a number
};

/// What the limit on the load remembers. Empty where it has not acted yet.
struct DrivenLoad {
  MatrixX2d swing;                 ///< m (dofs): its real and its imaginary part
  VectorXd reach, held;            ///< max(q, p) and H (G)
  std::array<VectorXd, 3> excess;  ///< x (G), at the last step and the two before
};

/// The limits of a model's motion. Immutable: simulations may share it.
template <class Model>
class MotionLimit {
 public:
  /// tissue: that of such a limit of this model and skin, whatever its distances, or none, to find it. Throws
  /// std::invalid_argument unless all of it fits each other and the model, and Error if there is no stiffness at rest.
  MotionLimit(std::shared_ptr<const Model> model, const SkinLimits& limits, std::optional<LimitedTissue> tissue = {});

  const Model& model() const { return *model_; }
  const LimitedTissue& tissue() const { return tissue_; }
  Eigen::Index bones() const { return Eigen::Index(bones_.size()); }        ///< G
  double frequency() const { return std::sqrt(tissue_.square_frequency); }  ///< w, of the neutral tissue, 1/s
  Eigen::Index numbers() const { return answers_->size(); }                 ///< of a static answer that are looked at

  /// Nothing is allocated after the first time.
  struct Scratch {
    std::vector<float> single;
    MatrixX2d swings;                             ///< y
    VectorXd answers, stiffness;                  ///< |y|; of each target set, relative to its neutral target
    std::vector<std::pair<double, double>> heap;  ///< values of a bone's points, and weights
    VectorXd held, jump;                          ///< H as it would be without a jump, and p (G)
    MatrixXd moved;                               ///< the bones' second difference (G, 12)
  };

  /// A step of h seconds under a load f (dofs) at elastic weights (J) of the targets. stiffer: how many times as stiff
  /// as its material the tissue is, on average. acceleration: the second difference of the body's transforms (T).
  void drive(const VectorXd& load, const VectorXd& elastic, double stiffer, const Transforms& acceleration, double h,
             const DrivenLoad& before, Scratch& scratch, DrivenLoad& out) const;
  /// The same under a load that has lasted, as in a static solution.
  void drive_long(const VectorXd& load, const VectorXd& elastic, Scratch& scratch, DrivenLoad& out) const;

  /// s (T) of the body's transforms from x (G).
  void scales(const VectorXd& excess, VectorXd& out) const;

  const std::vector<Pull>& pulls() const { return pulls_; }
  const PointRows& pull_numbers() const { return pull_numbers_; }  ///< over `pull_points`
  const typename Model::SkinPoints& pull_points() const { return pull_points_; }
  /// All of the pulls' numbers, and perhaps zeros, at coordinates about the targets' shape, to about 1e-6.
  void pull_values(const VectorXd& from_shape, Scratch& scratch, VectorXd& out) const;

 private:
  static constexpr bool kNodal = std::is_same_v<typename Model::Matrix, SparseMatrix>;
  using Answers = std::conditional_t<kNodal, NodalAnswers, SingleRows>;

  /// q (G) of m: 1 where it lets a bone's skin swing as far as a load may.
  void reach(const MatrixX2d& swing, const VectorXd& elastic, Scratch& scratch, VectorXd& out) const;
  /// p (G), or 0 where that is at most `least` (G).
  void jumped(const Transforms& acceleration, const VectorXd& least, Scratch& scratch, VectorXd& out) const;
  /// Of the lengths of the answers at a bone's points.
  double percentile(const LimitedBone& bone, Scratch& scratch) const;

  std::shared_ptr<const Model> model_;
  LimitedTissue tissue_;
  std::vector<LimitedBone> bones_;
  Points sampled_rest_;             ///< of the chosen points, whose three numbers each come first
  VectorXd sampled_distances_;      ///< L
  MatrixXd groups_, group_shares_;  ///< (T, G); columns of the second add up to one
  VectorXd neutral_stiffness_;      ///< mu of each set's neutral target
  std::unique_ptr<Answers> answers_;
  std::vector<Pull> pulls_;
  PointRows pull_numbers_;
  typename Model::SkinPoints pull_points_;
  std::conditional_t<kNodal, SparseRows, std::optional<SingleRows>> pull_rows_;
};

/// s of x.
double load_scale(double excess);

/// The ramp of the second limit at a distance r from the shape, for a stiffness of one: its energy, and the stiffness
/// along and across the pull.
struct Ramp {
  double energy, along, across;
};
Ramp ramp(double r, double limit);

extern template class MotionLimit<FullModel>;
extern template class MotionLimit<ReducedModel>;

}  // namespace dynamorph
