// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/SparseCholesky>

#include "dynamorph/types.hpp"

namespace dynamorph {

/// Solves H x = b for tangents that change little from one to the next, where factoring is by far the most work:
/// conjugate gradients, preconditioned with the factor of an earlier tangent. Factors anew when they converge slowly or
/// meet negative curvature; where they meet none, what they find is a descent direction even if H is indefinite.
class SparseSolver {
 public:
  bool solve(const SparseMatrix& H, const VectorXd& b, VectorXd& x) {
    if (!analysed_) llt_.analyzePattern(H);
    const bool stale = analysed_ && llt_.info() == Eigen::Success;
    analysed_ = true;
    if (stale && iterate(H, b, x)) return true;
    llt_.factorize(H);
    if (llt_.info() != Eigen::Success) return false;
    x = llt_.solve(b);
    return true;
  }

 private:
  static constexpr int kIterations = 20;     // cost less than a factorisation on meshes of a thousand nodes
  static constexpr double kAccuracy = 1e-3;  // Newton's method needs no more far from the solution, and little near it

  bool iterate(const SparseMatrix& H, const VectorXd& b, VectorXd& x) {
    x.setZero(b.size());
    residual_ = b;
    direction_ = preconditioned_ = llt_.solve(residual_);
    double product = residual_.dot(preconditioned_);
    const double enough = kAccuracy * kAccuracy * b.squaredNorm();
    for (int i = 0; i < kIterations; ++i) {
      image_ = H.selfadjointView<Eigen::Lower>() * direction_;
      const double curvature = direction_.dot(image_);
      if (!(curvature > 0)) return false;
      x += product / curvature * direction_;
      residual_ -= product / curvature * image_;
      if (residual_.squaredNorm() <= enough) return true;
      preconditioned_ = llt_.solve(residual_);
      const double next = residual_.dot(preconditioned_);
      direction_ = preconditioned_ + next / product * direction_;
      product = next;
    }
    return false;
  }

  Eigen::SimplicialLLT<SparseMatrix> llt_;
  bool analysed_ = false;
  VectorXd residual_, preconditioned_, direction_, image_;
};

}  // namespace dynamorph
