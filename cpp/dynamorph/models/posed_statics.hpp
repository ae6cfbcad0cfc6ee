// SPDX-License-Identifier: GPL-3.0-or-later
// The energy that `shape_by_physics` minimizes (posed_shape.hpp has it), its derivatives, and Newton's method, in one
// pose after another.
#pragma once

#include <vector>

#include "dynamorph/elastic/projected_law.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/mesh/facing_skin.hpp"
#include "dynamorph/models/posed_shape.hpp"

namespace dynamorph {

/// Minimizes the energy in one pose after another. What touches stays the same within a line search, so that the energy
/// is one function there; it is found again for each iteration.
class PosedStatics {
 public:
  /// pose: the last one, which decides what moves. The body must outlive this.
  PosedStatics(const PosedBody& body, const Transforms& pose);

  bool moves() const { return !active_.empty(); }
  /// Goes on to a pose. Returns the number of iterations; converged: whether the last step was negligible.
  int solve(const Transforms& bones, int iterations, double negligible, bool& converged);
  /// The shape in the pose that was solved last.
  void write(PosedShape& shape);

  // What Newton's method asks for. u: displacements of the nodes that move (3 each), bind space.

  Eigen::Index size() const { return u_.size(); }
  void pose(const Transforms& bones);
  /// The energy, with the touches that were found where it was linearized last.
  double value(const VectorXd& u);
  /// Finds the touches at u, and there the energy, its gradient, and a Hessian without negative parts.
  void linearize(const VectorXd& u);
  double energy() const { return energy_; }
  const VectorXd& gradient() const { return gradient_; }
  const SparseMatrix& hessian() const { return hessian_; }
  std::size_t touches() const { return touches_.size(); }

 private:
  struct Part {
    Eigen::Vector4i nodes, unknowns;  ///< numbers of nodes, and among those that move; -1: it does not
    Gradients gradients;
    double weight;  ///< m^3
  };
  /// Deformation gradients of a part: in the pose, and in bind space.
  struct Strain {
    Matrix3d posed, bind;
  };
  struct Local {
    double energy;
    Forces forces;
    Tangent tangent;
  };

  std::vector<int> find_sources(const Transforms& pose);
  void find_active(const Transforms& pose);
  void find_thickness();
  void find_pattern();
  /// Places of the nodes, and with them of the skin.
  void place(const VectorXd& u);
  void find_touches();
  void find_overlap(PosedShape& shape) const;
  Strain strain(const Part& part) const;
  /// How much nearer a point is to what it touches than skin may be, meters, and the stiffness of that.
  double depth(const FacingSkin::Touch& touch) const;
  double firmness(const FacingSkin::Touch& touch) const;
  double contact_energy() const;
  void add_contacts();
  Local linearize(const Part& part) const;
  Vector3d node_place(const VectorXd& u, int node) const;
  Vector3d unknown(const VectorXd& u, int node) const {
    return active_of_[node] < 0 ? Vector3d::Zero() : Vector3d(u.segment<3>(3 * active_of_[node]));
  }

  const PosedBody& body_;
  Eigen::SparseMatrix<double, Eigen::RowMajor> smooth_;  ///< (P, n)
  FacingSkin facing_;
  double apart_;
  VectorXd node_thickness_, hold_;       ///< (n) meters; stiffness for mu = 1
  VectorXd loose_, core_;                ///< (n) from 0 where nothing moves to 1; from 0 at the skin to 1 at the bones
  std::vector<int> active_, active_of_;  ///< nodes that move; the number of each among them, or -1
  std::vector<int> points_;              ///< points of the skin that they move
  std::vector<int> samples_;             ///< those of them that may touch
  std::vector<bool> may_touch_;          ///< of all points
  std::vector<bool> is_moved_;           ///< of all points
  std::vector<Part> parts_;
  std::vector<int> slots_;  ///< 16 of each part: place of its blocks in the matrix; -1: none
  SparseMatrix pattern_, hessian_;
  VectorXd gradient_;
  double energy_ = 0;
  BlockCholesky<double> solver_;

  SkinFrame frame_;
  std::vector<PointTransform> skin_;      ///< of the points
  VectorXd u_;                            ///< of the active nodes
  VectorXd held_;                         ///< (n) the hold in this pose
  Points x_, u_nodes_, places_, offset_;  ///< of nodes; of the skin, and of it where nodes are not displaced
  std::vector<FacingSkin::Touch> touches_;
  std::vector<Local> locals_;
};

}  // namespace dynamorph
