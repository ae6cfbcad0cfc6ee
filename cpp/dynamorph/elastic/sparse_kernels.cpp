// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/sparse_kernels.hpp"

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

DYNAMORPH_INLINE Index least(Index a, Index b) { return a < b ? a : b; }

}  // namespace

/// Computes y for three columns at a time, as sums over their common rows. The values of x at those rows are gathered
/// first.
void multiply_blocks(const int* outer, const int* inner, const double* values, Index columns,
                     const double* __restrict x, double* __restrict gathered, double* __restrict y) {
  for (Index c = 0; c < columns; c += 3) {
    const Index rows = outer[c + 1] - outer[c];
    const int* row = inner + outer[c];
    for (Index i = 0; i < rows; i += 3)
      for (int k = 0; k < 3; ++k) gathered[i + k] = x[row[i] + k];
    const double *h0 = values + outer[c], *h1 = h0 + rows, *h2 = h1 + rows;
    Double4 sums[3] = {};
    Index i = 0;
    for (; i + 4 <= rows; i += 4) {
      const Double4 some = load(gathered + i);
      sums[0] = mul_add(sums[0], load(h0 + i), some);
      sums[1] = mul_add(sums[1], load(h1 + i), some);
      sums[2] = mul_add(sums[2], load(h2 + i), some);
    }
    double rest[3] = {};
    for (; i < rows; ++i) {
      rest[0] = mul_add(rest[0], h0[i], gathered[i]);
      rest[1] = mul_add(rest[1], h1[i], gathered[i]);
      rest[2] = mul_add(rest[2], h2[i], gathered[i]);
    }
    for (int k = 0; k < 3; ++k) y[c + k] = rest[k] + sum_of(sums[k]);
  }
}

// --- Factorization ---------------------------------------------------------------------------------------------------

namespace {

/// C (12, 3) -= A B^T with A (12, depth) and B (3, depth). `a` and `b` are the steps between their columns.
DYNAMORPH_INLINE void subtract_tile(const double* __restrict A, Index a, const double* __restrict B, Index b,
                                    Index depth, Dense C) {
  Double4 sums[3][3] = {};
  for (Index d = 0; d < depth; ++d, A += a, B += b)
    for (int j = 0; j < 3; ++j)
      for (int v = 0; v < 3; ++v) sums[j][v] = mul_add(sums[j][v], B[j], load(A + 4 * v));
  for (int j = 0; j < 3; ++j)
    for (int v = 0; v < 3; ++v) store(load(C.at(4 * v, j)) - sums[j][v], C.at(4 * v, j));
}

}  // namespace

void subtract_product(const double* A, Index a_rows, const double* B, Index b_rows, Index depth, bool symmetric,
                      Dense C) {
  for (Index i = 0; i < a_rows; i += kStrip, A += kStrip * depth) {
    const Index columns = symmetric ? least(b_rows, i + kStrip) : b_rows;
    for (Index j = 0; j < columns; j += 3)
      subtract_tile(A, kStrip, B + j / kStrip * kStrip * depth + j % kStrip, kStrip, depth, {C.at(i, j), C.stride});
  }
}

bool eliminate_columns(Dense panel, Index rows, Index first, Index last) {
  for (Index c = first; c < last; c += 3) {
    for (Index i = c; i < rows; i += kStrip)
      subtract_tile(panel.at(i, first), panel.stride, panel.at(c, first), panel.stride, c - first,
                    {panel.at(i, c), panel.stride});
    double *x = panel.at(0, c), *y = panel.at(0, c + 1), *z = panel.at(0, c + 2);
    if (!(x[c] > 0)) return false;
    const double xx = 1 / __builtin_sqrt(x[c]), xy = x[c + 1] * xx, xz = x[c + 2] * xx, y2 = y[c + 1] - xy * xy;
    if (!(y2 > 0)) return false;
    const double yy = 1 / __builtin_sqrt(y2), yz = (y[c + 2] - xy * xz) * yy, z2 = z[c + 2] - xz * xz - yz * yz;
    if (!(z2 > 0)) return false;
    const double zz = 1 / __builtin_sqrt(z2);
    for (Index i = c + 3; i < rows; ++i) {
      x[i] *= xx;
      y[i] = mul_sub(y[i], xy, x[i]) * yy;
      z[i] = mul_sub(mul_sub(z[i], xz, x[i]), yz, y[i]) * zz;
    }
    x[c] = xx, x[c + 1] = xy, x[c + 2] = xz;
    y[c + 1] = yy, y[c + 2] = yz;
    z[c + 2] = zz;
  }
  return __builtin_isfinite(*panel.at(last - 1, last - 1));
}

// --- Solution --------------------------------------------------------------------------------------------------------

namespace {

template <class Real>
DYNAMORPH_INLINE void forward(const Real* __restrict L, Index rows, Index columns, Real* __restrict x) {
  for (Index c = 0; c < columns; c += 3, L += 3 * rows) {
    const Real *a = L, *b = L + rows, *d = b + rows;
    const Real x0 = x[c] * a[c], x1 = (x[c + 1] - a[c + 1] * x0) * b[c + 1],
               x2 = (x[c + 2] - a[c + 2] * x0 - b[c + 2] * x1) * d[c + 2];
    x[c] = x0, x[c + 1] = x1, x[c + 2] = x2;
    for (Index i = c + 3; i < rows; ++i) x[i] -= mul_add(mul_add(a[i] * x0, b[i], x1), d[i], x2);
  }
}

template <class Real>
DYNAMORPH_INLINE void backward(const Real* __restrict L, Index rows, Index columns, Real* __restrict x) {
  using Vector = typename VectorOf<Real>::Type;
  constexpr Index kWidth = sizeof(Vector) / sizeof(Real);
  L += columns * rows;
  for (Index c = columns - 3; c >= 0; c -= 3) {
    L -= 3 * rows;
    const Real *a = L, *b = L + rows, *d = b + rows;
    Vector sums[3] = {};
    Index i = c + 3;
    for (; i + kWidth <= rows; i += kWidth) {
      const Vector some = load(x + i);
      sums[0] = mul_add(sums[0], load(a + i), some);
      sums[1] = mul_add(sums[1], load(b + i), some);
      sums[2] = mul_add(sums[2], load(d + i), some);
    }
    Real s[3] = {x[c], x[c + 1], x[c + 2]};
    for (; i < rows; ++i)
      s[0] = mul_sub(s[0], a[i], x[i]), s[1] = mul_sub(s[1], b[i], x[i]), s[2] = mul_sub(s[2], d[i], x[i]);
    for (int k = 0; k < 3; ++k)
      for (int l = 0; l < kWidth; ++l) s[k] -= sums[k][l];
    x[c + 2] = s[2] * d[c + 2];
    x[c + 1] = (s[1] - b[c + 2] * x[c + 2]) * b[c + 1];
    x[c] = (s[0] - a[c + 1] * x[c + 1] - a[c + 2] * x[c + 2]) * a[c];
  }
}

/// out (3, kSides) = sum over d of three values of L, `across` apart, times the row of X that row(d) points to. L
/// advances by `step` with each d.
template <class Real, class Row>
DYNAMORPH_INLINE void outer_products(const Real* L, Index step, Index across, Index depth, const Row& row, Real* out) {
  using Vector = typename VectorOf<Real>::Type;
  constexpr int kWidth = sizeof(Vector) / sizeof(Real), kVectors = kSides / kWidth;
  Vector sums[3][kVectors] = {};
  for (Index d = 0; d < depth; ++d, L += step) {
    const Real* x = row(d);
    for (int i = 0; i < 3; ++i)
      for (int v = 0; v < kVectors; ++v) sums[i][v] = mul_add(sums[i][v], L[i * across], load(x + kWidth * v));
  }
  for (int i = 0; i < 3; ++i)
    for (int v = 0; v < kVectors; ++v) store(sums[i][v], out + i * kSides + kWidth * v);
}

template <class Real>
DYNAMORPH_INLINE void forward_sides(const Real* L, const int* below, Index first, Index rows, Index columns, Real* X) {
  const Real* own = X + first * kSides;
  Real sums[3 * kSides];
  for (Index r = 0; r < rows; r += 3) {
    outer_products(L + r, rows, 1, least(r, columns), [&](Index d) { return own + d * kSides; }, sums);
    Real* x = X + (r < columns ? first + r : 3 * below[(r - columns) / 3]) * kSides;
    for (int k = 0; k < 3 * kSides; ++k) x[k] -= sums[k];
    if (r >= columns) continue;
    const Real *a = L + r * rows + r, *b = a + rows, *d = b + rows;
    for (int k = 0; k < kSides; ++k) {
      const Real x0 = x[k] * a[0], x1 = (x[kSides + k] - a[1] * x0) * b[1];
      x[2 * kSides + k] = (x[2 * kSides + k] - a[2] * x0 - b[2] * x1) * d[2];
      x[k] = x0, x[kSides + k] = x1;
    }
  }
}

template <class Real>
DYNAMORPH_INLINE void backward_sides(const Real* L, const int* below, Index first, Index rows, Index columns, Real* X) {
  Real sums[3 * kSides], more[3 * kSides];
  for (Index c = columns - 3; c >= 0; c -= 3) {
    const Real *a = L + c * rows, *b = a + rows, *d = b + rows;
    Real* x = X + (first + c) * kSides;
    outer_products(a + c + 3, 1, rows, columns - c - 3, [&](Index i) { return x + (3 + i) * kSides; }, sums);
    outer_products(
        a + columns, 1, rows, rows - columns, [&](Index i) { return X + (3 * below[i / 3] + i % 3) * kSides; }, more);
    for (int k = 0; k < 3 * kSides; ++k) x[k] -= sums[k] + more[k];
    for (int k = 0; k < kSides; ++k) {
      const Real x2 = x[2 * kSides + k] * d[c + 2], x1 = (x[kSides + k] - b[c + 2] * x2) * b[c + 1];
      x[k] = (x[k] - a[c + 1] * x1 - a[c + 2] * x2) * a[c];
      x[kSides + k] = x1, x[2 * kSides + k] = x2;
    }
  }
}

}  // namespace

void forward_double(const double* L, Index rows, Index columns, double* x) { forward(L, rows, columns, x); }
void forward_single(const float* L, Index rows, Index columns, float* x) { forward(L, rows, columns, x); }
void backward_double(const double* L, Index rows, Index columns, double* x) { backward(L, rows, columns, x); }
void backward_single(const float* L, Index rows, Index columns, float* x) { backward(L, rows, columns, x); }

void forward_sides_double(const double* L, const int* below, Index first, Index rows, Index columns, double* X) {
  forward_sides(L, below, first, rows, columns, X);
}
void forward_sides_single(const float* L, const int* below, Index first, Index rows, Index columns, float* X) {
  forward_sides(L, below, first, rows, columns, X);
}
void backward_sides_double(const double* L, const int* below, Index first, Index rows, Index columns, double* X) {
  backward_sides(L, below, first, rows, columns, X);
}
void backward_sides_single(const float* L, const int* below, Index first, Index rows, Index columns, float* X) {
  backward_sides(L, below, first, rows, columns, X);
}

}  // namespace dynamorph::DYNAMORPH_ISA
