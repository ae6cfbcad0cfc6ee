// SPDX-License-Identifier: GPL-3.0-or-later
// What the limits of a motion (motion_limit.hpp) are made of: which points and edges of the skin say how far loads on
// the bones carry the tissue, by static answers at the neutral targets.
#pragma once

#include <set>
#include <utility>
#include <vector>

#include "dynamorph/mesh/surface.hpp"
#include "dynamorph/step/motion_limit.hpp"

namespace dynamorph {

/// The soft skin: where it is, how large, and which edges it has.
struct SoftSkin {
  VectorXd areas;  ///< (P); 0 for points that do not count
  double size;     ///< diagonal of its box
  std::vector<Edge> edges;
};

/// The edges of a bone; none of one that has no edge of its own, or hardly any tissue.
struct CriticalEdges {
  std::vector<int> own;  ///< where it has weight: places in skin.edges
  VectorXd strain;       ///< of each of these: the largest stretch by a load over that of the critical one, at most 1
  std::set<int> edges;   ///< that its loads stretch most: places in skin.edges
  /// That are pulled back too, each with its largest stretch over that of those.
  std::vector<std::pair<int, double>> between;
  /// Twice that of the static answer in which they reach their limit, the least of the loads.
  double energy = kInfinity;
  bool any() const { return energy < kInfinity; }
};

/// Solves K x = b, in any thread.
class NeutralFactor {
 public:
  bool compute(const SparseMatrix& K) { return nodal_.factorize(K); }
  bool compute(const ArrowMatrix& K) { return modal_.compute(K); }
  void solve(const SparseMatrix&, const VectorXd& b, VectorXd& x) const {
    std::vector<float> scratch;
    nodal_.solve(b, x, scratch);
  }
  void solve(const ArrowMatrix&, const VectorXd& b, VectorXd& x) const {
    ArrowFactor(modal_).solve(b, x);  // small, and has its own scratch
  }
  BlockCholesky<float> nodal() && { return std::move(nodal_); }

 private:
  BlockCholesky<float> nodal_;
  ArrowFactor modal_;
};

/// The tissue at the neutral targets.
template <class Model>
struct Neutral {
  const Model& model;
  VectorXd weights;  ///< (J)
  VectorXd mass;     ///< of the free nodes
  typename Model::Matrix K;
  NeutralFactor factor;

  /// Throws Error if the tissue has no stiffness at rest.
  explicit Neutral(const Model& of);

  /// The static answer (dofs) to a load on the free nodes (3 free).
  VectorXd answer(const VectorXd& nodal) const {
    VectorXd load;
    model.project_force(nodal, load);
    return solved(load);
  }
  /// The same to a load on the coordinates (dofs).
  VectorXd solved(const VectorXd& load) const {
    VectorXd q;
    factor.solve(K, load, q);
    return q;
  }
};

/// All that the limits are made of.
struct Tissue {
  double square_frequency;  ///< w^2
  SoftSkin skin;
  std::vector<int> chosen;           ///< points of the skin that say how far a load carries it
  VectorXd area;                     ///< of the skin that is nearest to each of them
  std::vector<int> pulled;           ///< points that are pulled back: the same, and more where L is painted smaller
  VectorXd pulled_mass;              ///< of the nodes that are nearest to each of these
  std::vector<CriticalEdges> edges;  ///< of each bone (G)
};

template <class Model>
Tissue tissue_of(const Neutral<Model>& neutral, const SkinLimits& limits);

/// What of it stays in use.
LimitedTissue looked_at(const Tissue& tissue);

/// (free, G): the bones' parts of the free nodes.
SkinWeights carried_by_bones(const SoftBody& body, const SkinLimits& limits);

/// Sorts numbers, each of which stays once.
void make_unique(std::vector<int>& numbers);

/// Those of the points of an embedding, without distances.
Embedding of_points(const Embedding& all, const std::vector<int>& chosen);

extern template struct Neutral<FullModel>;
extern template struct Neutral<ReducedModel>;
extern template Tissue tissue_of(const Neutral<FullModel>&, const SkinLimits&);
extern template Tissue tissue_of(const Neutral<ReducedModel>&, const SkinLimits&);

}  // namespace dynamorph
