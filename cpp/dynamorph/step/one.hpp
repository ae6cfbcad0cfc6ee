// SPDX-License-Identifier: GPL-3.0-or-later
// The arithmetic of newton.hpp for one character, with dense, sparse or arrow matrices.
#pragma once

#include <cmath>
#include <type_traits>

#include "dynamorph/core/types.hpp"
#include "dynamorph/elastic/dense_factor.hpp"
#include "dynamorph/elastic/sparse_solver.hpp"
#include "dynamorph/reduced/arrow_matrix.hpp"
#include "dynamorph/step/newton.hpp"

namespace dynamorph {

template <class MatrixType>
struct One {
  using Number = double;
  using Vector = VectorXd;
  using Matrix = MatrixType;
  static constexpr bool kSparse = std::is_same_v<Matrix, SparseMatrix>, kArrow = std::is_same_v<Matrix, ArrowMatrix>;
  static constexpr int kLanes = 1, kHalvings = 19;
  static constexpr double kNoise = 1e-12;  ///< relative, of an energy

  /// Solves H x = b. Returns the lanes in which H is not positive definite.
  class Solver {
   public:
    Lanes solve(const Matrix& H, const Vector& b, Vector& x) {
      if constexpr (kSparse) {
        return factor_.solve(H, b, x) ? 0 : 1;
      } else {
        if (!factor_.compute(H)) return 1;
        factor_.solve(b, x);
        return 0;
      }
    }
    /// Makes the next result independent of earlier ones.
    void forget() {
      if constexpr (kSparse) factor_.forget();
    }

   private:
    using DirectFactor = std::conditional_t<kArrow, ArrowFactor, DenseFactor>;
    std::conditional_t<kSparse, SparseSolver, DirectFactor> factor_;
  };

  static double& at(Number& x, int) { return x; }
  static double at(const Number& x, int) { return x; }
  static Number size(Number x) { return std::abs(x); }
  static void shorten(Number& x, Number most) { x = std::min(x, most); }
  static Lanes below(Number x, Number limit) { return x <= limit; }
  static Lanes finite(Number x) { return std::isfinite(x); }

  static Number dot(const Vector& a, const Vector& b) { return a.dot(b); }
  static Number norm(const Vector& a) { return a.norm(); }
  static Number largest(const Matrix& A) { return values(A).cwiseAbs().maxCoeff(); }
  static void multiply(const Matrix& A, const Vector& x, Vector& y) {
    if constexpr (kArrow)
      A.multiply(x, y);
    else
      y.noalias() = A * x;
  }
  static void subtract(const Vector& a, const Vector& b, Vector& out) { out = a - b; }
  /// Negates the given lanes; the others become zero.
  static void negate(Vector& x, Lanes lanes) { lanes ? void(x = -x) : void(x.setZero()); }
  static void move(const Vector& from, Number length, const Vector& direction, Vector& out) {
    out = from + length * direction;
  }
  /// Magnitudes of the entries of A's diagonal. For a mesh, the three entries of a node are averaged, so that they do
  /// not depend on the axes.
  static void scales(const Matrix& A, Vector& out) {
    out = A.diagonal().cwiseAbs();
    if constexpr (kSparse)
      for (Eigen::Index i = 0; i < out.size(); i += 3) out.segment<3>(i).setConstant(out.segment<3>(i).mean());
    out = out.cwiseMax(kSmallestScale * out.maxCoeff());
  }
  static void add_to_diagonal(Matrix& A, Number more, const Vector& scales) {
    if constexpr (kArrow)
      A.add_to_diagonal(more, scales);
    else
      A.diagonal() += more * scales;
  }

  template <class... Parts>
  static void sum(Vector& out, const Parts&... parts) {
    out = (... + parts);
  }
  /// The matrices must have the same pattern.
  template <class... Others>
  static void sum(Matrix& out, const Matrix& first, const Others&... others) {
    if (out.rows() != first.rows()) out = first;
    values(out) = (values(first) + ... + values(others));
  }
};

}  // namespace dynamorph
