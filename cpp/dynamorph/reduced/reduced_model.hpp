// SPDX-License-Identifier: GPL-3.0-or-later
// The soft skin in a subspace, u = U z + W y, with the interface of FullModel: tabulated modes U and, for whole bodies,
// linear responses W.
#pragma once

#include <algorithm>
#include <variant>

#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/models/skin.hpp"
#include "dynamorph/models/soft_body.hpp"
#include "dynamorph/pose/inertial_target.hpp"
#include "dynamorph/reduced/inertia/modal_inertia.hpp"
#include "dynamorph/reduced/inertia/nodal_inertia.hpp"
#include "dynamorph/reduced/inertia/response_inertia.hpp"
#include "dynamorph/reduced/modes/polynomials.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"
#include "dynamorph/reduced/responses/arrow_matrix.hpp"
#include "dynamorph/reduced/responses/responses.hpp"

namespace dynamorph {

/// Energy of one table (TableLayout) at v, with its force (r) and tangent (r, r). It works in double and follows the
/// formulas of polynomials.hpp literally. Tests compare ReducedModel's own evaluation with it.
double linearize(const VectorXd& table, const TableLayout& layout, const VectorXd& v, VectorXd& force,
                 MatrixXd& stiffness);

class ReducedModel {
 public:
  using Matrix = ArrowMatrix;
  using SkinPoints = ModalPoints;
  struct Inertia {
    Matrix mass;     ///< (U, W)^T A^T M A (U, W)
    Matrix damped;   ///< the same with M times mass damping
    VectorXd force;  ///< of the inertial target
    ModalInertia::Result modes;
    NodalInertia::Scratch nodes;
    ResponseInertia::Scratch responses;
  };

  struct Blend {
    const ReducedModel* of = nullptr;  ///< the model that made it
    VectorXd weights, elastic;         ///< w, e
    SetDensities mass;
    Matrix damping;           ///< sum_j e_j beta_j K_j
    VectorXd stiffness;       ///< K0, packed
    LaneVector<float> table;  ///< sum_j e_j table_j, unless a single target has all the weight
    int only = -1;            ///< that target
    VectorXd force;           ///< f at v = 0
    double energy = 0;        ///< E at v = 0
    VectorXd center;          ///< v = z - center
    Responses::Blend responses;
    VectorXd packed_damping;
    std::vector<const float*> active;
    std::vector<double> active_elastic;  ///< e of those
  };

  /// What evaluations in one pose need beside their results. Nothing is allocated after the first time.
  struct Workspace {
    /// To be called in every new pose, before Newton's method. Single precision loses 1e-7 of a change, which must stay
    /// well below the tolerance: near where the tangent's orders were summed in double precision, only what has changed
    /// is summed, in single precision. Without it all sums are in double precision.
    void begin(double tolerance) {
      near = std::min(0.03, 1e5 * tolerance);
      anchored = false;
    }

    /// v, its pairs, and the orders of the packed tangent.
    struct Orders {
      VectorXd v, pairs, linear, quadratic;
    };
    double near = 0;        ///< changes of v, relative to it, that are summed in single precision
    bool anchored = false;  ///< whether `anchor` is of this pose
    Orders anchor, now;     ///< where they were last summed in double precision, and where they are wanted
    LaneVector<float> change, pair_changes;
    VectorXd unused_force;  ///< results that the energy does not need
    Matrix unused_stiffness;
    Responses::Workspace responses;
  };

  ReducedModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, const ReducedTables& tables,
               Blending blending);

  const SoftBody& body() const { return *body_; }
  const std::shared_ptr<const SoftBody>& shared_body() const { return body_; }
  const std::vector<MorphTarget>& targets() const { return targets_; }
  const MatrixXd& basis() const { return basis_; }  ///< (U, W)
  int dofs() const { return int(basis_.cols()); }
  int modes() const { return int(layout_.r); }  ///< the first coordinates; those of the responses follow
  /// Norm of the coordinates when the whole body moves by one meter, as far as the modes can.
  double meter() const { return std::sqrt(body_->volume); }

  void blend(const VectorXd& w, const VectorXd& e, Blend& out) const;
  /// With each target as stiff as its material.
  void blend(const VectorXd& w, Blend& out) const { blend(w, w, out); }
  double energy(const Blend& blend, const VectorXd& z, Workspace& workspace) const;
  double linearize(const Blend& blend, const VectorXd& z, Workspace& workspace, VectorXd& force,
                   Matrix& stiffness) const;
  /// With a workspace of its own.
  double energy(const Blend& blend, const VectorXd& z) const {
    Workspace workspace;
    return energy(blend, z, workspace);
  }
  double linearize(const Blend& blend, const VectorXd& z, VectorXd& force, Matrix& stiffness) const {
    Workspace workspace;
    return linearize(blend, z, workspace, force, stiffness);
  }
  void inertia(const InertialTarget& inertial, const SetDensities& densities, Inertia& out) const;
  void rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities, Inertia& scratch,
                   VectorXd& force) const;
  void displacement(const VectorXd& z, VectorXd& u) const;
  void project_force(const VectorXd& f, VectorXd& out) const;
  SkinPoints skin_points(const Embedding& embedding) const { return {*body_, embedding, basis_}; }
  VectorXd target(int j) const;
  Matrix zero() const { return Matrix(layout_.r, responses_.count()); }

 private:
  /// Computes the packed orders of the tangent at v. A step that converges loses nothing by single precision, because
  /// it ends near where they were summed in double precision.
  void expand(const Blend& blend, const VectorXd& z, Workspace& workspace) const;

  std::shared_ptr<const SoftBody> body_;
  std::vector<MorphTarget> targets_;
  Blending blending_;
  MatrixXd basis_;
  std::vector<VectorXd> coordinates_;  ///< z_j (r)
  TableLayout layout_;
  Responses responses_;
  Eigen::Index padded_pairs_;
  /// Per target with its material, about z_j (even) or 0 (forces). K0 is in double. [K1 | K2] is in single precision,
  /// in the order in which a step reads it: this halves the bytes and keeps forces to 1e-7 of the largest.
  std::vector<VectorXd> stiffness_;
  std::vector<LaneVector<float>> tables_;
  std::vector<VectorXd> rest_stiffness_;  ///< packed K_j at z_j
  std::vector<VectorXd> forces_;          ///< forces blending: at z = 0
  std::vector<double> energies_;
  std::variant<ModalInertia, NodalInertia> inertia_;
  ResponseInertia response_inertia_;
};

}  // namespace dynamorph
