// SPDX-License-Identifier: GPL-3.0-or-later
// The arithmetic of newton.hpp for eight characters of a reduced model, one per lane. Matrices are packed upper
// triangles.
#pragma once

#include <algorithm>
#include <cmath>

#include "dynamorph/reduced/eight_kernels.hpp"
#include "dynamorph/simd/lane_vector.hpp"
#include "dynamorph/step/newton.hpp"

namespace dynamorph {

struct EightLanes {
  using Number = DoubleW;
  using Vector = LaneVector<DoubleW>;
  using Matrix = LaneVector<DoubleW>;
  static constexpr int kLanes = dynamorph::kLanes;
  static constexpr int kHalvings = 4;     // a character that needs more is stepped alone
  static constexpr double kNoise = 1e-6;  // relative, of an energy from tables in single precision

  /// Solves H x = b. Returns the lanes in which H is not positive definite.
  class Solver {
   public:
    Lanes solve(const Matrix& H, const Vector& b, Vector& x) {
      const Index r = Index(b.size());
      factor_ = H;
      inverse_.resize(r);
      factorize(factor_.data(), r, inverse_.data());
      Lanes definite = (1U << kLanes) - 1;
      for (const DoubleW& d : inverse_)
        for (int lane = 0; lane < kLanes; ++lane)
          if (!(d[lane] > 0 && d[lane] < HUGE_VAL)) definite &= ~(1U << lane);
      x = b;
      substitute(factor_.data(), inverse_.data(), r, x.data());
      return ~definite;
    }

   private:
    Vector factor_, inverse_;
  };

  static double& at(Number& x, int lane) { return x[lane]; }
  static double at(const Number& x, int lane) { return x[lane]; }
  static Number size(const Number& x) {
    return per_lane(x, [](double own) { return std::abs(own); });
  }
  static Number root(const Number& x) {
    return per_lane(x, [](double own) { return std::sqrt(own); });
  }
  static void shorten(Number& x, const Number& most) {
    for (int lane = 0; lane < kLanes; ++lane) x[lane] = std::min(x[lane], most[lane]);
  }
  static void widen(Number& x, const Number& y) {
    for (int lane = 0; lane < kLanes; ++lane) x[lane] = std::max(x[lane], std::abs(y[lane]));
  }
  static Lanes below(const Number& x, const Number& limit) {
    Lanes out = 0;
    for (int lane = 0; lane < kLanes; ++lane) out |= Lanes(x[lane] <= limit[lane]) << lane;
    return out;
  }
  static Lanes finite(const Number& x) {
    Lanes out = 0;
    for (int lane = 0; lane < kLanes; ++lane) out |= Lanes(std::isfinite(x[lane])) << lane;
    return out;
  }

  static Number dot(const Vector& a, const Vector& b) {
    Number out;
    dynamorph::dot(a.data(), b.data(), Index(a.size()), out);
    return out;
  }
  static Number norm(const Vector& a) { return root(dot(a, a)); }
  static Number largest(const Vector& a) {
    Number most{};
    for (const Number& own : a) widen(most, own);
    return most;
  }
  static void multiply(const Matrix& A, const Vector& x, Vector& y) {
    y.resize(x.size());
    packed_product(A.data(), x.data(), Index(x.size()), y.data());
  }
  static void subtract(const Vector& a, const Vector& b, Vector& out) {
    out.resize(a.size());
    for (size_t k = 0; k < a.size(); ++k) out[k] = a[k] - b[k];
  }
  /// Negates the given lanes; the others become zero.
  static void negate(Vector& x, Lanes lanes) {
    Number sign{};
    for (int lane = 0; lane < kLanes; ++lane) sign[lane] = lanes >> lane & 1 ? -1 : 0;
    for (Number& own : x) own = own * sign;
    if (lanes + 1 == 1U << kLanes) return;
    for (Number& own : x)  // NaN times zero is still NaN
      for (int lane = 0; lane < kLanes; ++lane)
        if (!(lanes >> lane & 1)) own[lane] = 0;
  }
  static void move(const Vector& from, const Number& length, const Vector& direction, Vector& out) {
    out.resize(from.size());
    for (size_t k = 0; k < from.size(); ++k) out[k] = from[k] + length * direction[k];
  }
  /// Magnitudes of the entries of A's diagonal.
  static void scales(const Matrix& A, Vector& out) {
    Number most{};
    out.clear();
    for (size_t p = 0, row = order(A); row > 0; p += row, --row) {
      out.push_back(size(A[p]));
      widen(most, A[p]);
    }
    for (Number& own : out)
      for (int lane = 0; lane < kLanes; ++lane) own[lane] = std::max(own[lane], kSmallestScale * most[lane]);
  }
  static void add_to_diagonal(Matrix& A, const Number& more, const Vector& scales) {
    for (size_t k = 0, p = 0; k < scales.size(); p += scales.size() - k, ++k) A[p] += more * scales[k];
  }
  template <class... Others>
  static void sum(Vector& out, const Vector& first, const Others&... others) {
    out.resize(first.size());
    for (size_t k = 0; k < first.size(); ++k) out[k] = (first[k] + ... + others[k]);
  }

 private:
  template <class Function>
  DYNAMORPH_INLINE static Number per_lane(const Number& x, const Function& function) {
    Number out;
    for (int lane = 0; lane < kLanes; ++lane) out[lane] = function(x[lane]);
    return out;
  }
  /// Number of rows of a packed matrix.
  static size_t order(const Matrix& A) {
    return size_t(std::lround((std::sqrt(1.0 + 8.0 * double(A.size())) - 1) / 2));
  }
};

}  // namespace dynamorph
