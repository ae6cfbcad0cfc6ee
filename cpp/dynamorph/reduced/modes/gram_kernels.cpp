// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/gram_kernels.hpp"

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

/// C (4, kTile) += A^T B for `depth` rows of two panels. A points to the first of its four columns.
DYNAMORPH_INLINE void quarter_tile(const double* __restrict A, const double* __restrict B, Index depth,
                                   double* __restrict C) {
  Double4 sums[4][3] = {};
  for (Index d = 0; d < depth; ++d, A += kTile, B += kTile) {
    for (int i = 0; i < 4; ++i)
      for (int v = 0; v < 3; ++v) sums[i][v] = mul_add(sums[i][v], A[i], load(B + 4 * v));
  }
  for (int i = 0; i < 4; ++i)
    for (int v = 0; v < 3; ++v) store(load(C + i * kTile + 4 * v) + sums[i][v], C + i * kTile + 4 * v);
}

DYNAMORPH_INLINE double column_dot(const double* column, int a, const double* other, Index r, int b) {
  return mul_add(mul_add(column[3 * a] * other[3 * b * r], column[3 * a + 1], other[(3 * b + 1) * r]),
                 column[3 * a + 2], other[(3 * b + 2) * r]);
}

}  // namespace

void multiply_panels(const double* A, const double* B, Index count, Index depth, double* C) {
  for (Index j = 0; j < count; ++j, B += kDepth * kTile, C += kTile * kTile)
    for (Index i = 0; i < kTile; i += 4) quarter_tile(A + i, B, depth, C + i * kTile);
}

void trace_row(const double* __restrict G, Index r, bool pairs, double scale, double* __restrict row) {
  for (Index k = 0; k < r; ++k) row[k] = scale * (G[k] + G[4 * r + k] + G[8 * r + k]);
  if (!pairs) return;
  row += r;
  for (Index k = 0; k < r; row += r - k, ++k) {
    double column[9];
    for (int c = 0; c < 9; ++c) column[c] = 0.5 * scale * G[c * r + k];
    for (Index l = 0; l < r - k; ++l) {
      const double* other = G + k + l;
      row[l] =
          column_dot(column, 0, other, r, 0) + column_dot(column, 1, other, r, 1) + column_dot(column, 2, other, r, 2);
    }
  }
}

void deviator_rows(const double* __restrict G, Index r, bool pairs, double scale, double* __restrict rows,
                   Index stride) {
  const double two = scale * __builtin_sqrt(1.0 / 2), six = scale * __builtin_sqrt(1.0 / 6);
  const auto put = [=](double* at, double xx, double yy, double zz, double xy, double yz, double zx) {
    at[0] = two * (xx - yy);
    at[stride] = six * (xx + yy - 2 * zz);
    at[2 * stride] = two * xy;
    at[3 * stride] = two * yz;
    at[4 * stride] = two * zx;
  };
  for (Index k = 0; k < r; ++k) {
    const auto at = [=](int c) { return G[c * r + k]; };
    put(rows + k, at(0), at(4), at(8), at(1) + at(3), at(5) + at(7), at(6) + at(2));
  }
  if (!pairs) return;
  rows += r;
  for (Index k = 0; k < r; rows += r - k, ++k) {
    double column[9];
    for (int c = 0; c < 9; ++c) column[c] = 0.5 * G[c * r + k];
    for (Index l = 0; l < r - k; ++l) {
      const auto product = [&](int a, int b) { return column_dot(column, a, G + k + l, r, b); };
      put(rows + l, product(0, 0), product(1, 1), product(2, 2), product(0, 1) + product(1, 0),
          product(1, 2) + product(2, 1), product(2, 0) + product(0, 2));
    }
  }
}

void crosses_of_pairs(const double* __restrict G, Index r, double* __restrict cross) {
  const Index stride = r * (r + 1) / 2;
  for (Index k = 0; k < r; cross += r - k, ++k) {
    double column[9];
    for (int c = 0; c < 9; ++c) column[c] = G[c * r + k];
    DYNAMORPH_INDEPENDENT  // rows of the result do not overlap
        for (Index l = 0; l < r - k; ++l) {
      const double* other = G + k + l;
      const auto put = [&](int i, int c) {
        const int j = 3 * ((i + 1) % 3), h = 3 * ((i + 2) % 3), a = (c + 1) % 3, b = (c + 2) % 3;
        const double one = mul_sub(column[j + a] * other[(h + b) * r], column[j + b], other[(h + a) * r]);
        cross[(3 * i + c) * stride + l] =
            mul_sub(mul_add(one, other[(j + a) * r], column[h + b]), other[(j + b) * r], column[h + a]);
      };
      put(0, 0), put(0, 1), put(0, 2);
      put(1, 0), put(1, 1), put(1, 2);
      put(2, 0), put(2, 1), put(2, 2);
    }
  }
}

void curvatures_of_pairs(const double* __restrict G, const double* __restrict stresses, Index r, double lambda,
                         double mu, const double* __restrict gradients, double* __restrict out) {
  const Index stride = r * (r + 1) / 2;
  constexpr int packed[3][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}};
  for (Index k = 0; k < r; out += r - k, ++k) {
    double A[9], S[6];
    for (int c = 0; c < 9; ++c) A[c] = G[c * r + k];
    for (int c = 0; c < 6; ++c) S[c] = stresses[c * r + k];
    DYNAMORPH_INDEPENDENT  // rows of the result do not overlap
        for (Index l = 0; l < r - k; ++l) {
      const double *B = G + k + l, *T = stresses + k + l;
      const auto product = [&](int a, int b) { return column_dot(A, a, B, r, b); };
      const double xx = product(0, 0), yy = product(1, 1), zz = product(2, 2), pressure = lambda * (xx + yy + zz);
      const double xy = mu * (product(0, 1) + product(1, 0)), yz = mu * (product(1, 2) + product(2, 1)),
                   zx = mu * (product(2, 0) + product(0, 2));
      const auto moved = [&](int i, int j) {  // A T + B S
        const auto term = [&](int m) {
          return mul_add(A[3 * m + i] * T[packed[m][j] * r], B[(3 * m + i) * r], S[packed[m][j]]);
        };
        return term(0) + term(1) + term(2);
      };
      const auto put = [&](int i, double x, double y, double z) {
        x += moved(i, 0), y += moved(i, 1), z += moved(i, 2);
        const auto node = [&](int a) {
          const double* g = gradients + 3 * a;
          out[(3 * a + i) * stride + l] = mul_add(mul_add(x * g[0], y, g[1]), z, g[2]);
        };
        node(0), node(1), node(2), node(3);
      };
      put(0, pressure + 2 * mu * xx, xy, zx);
      put(1, xy, pressure + 2 * mu * yy, yz);
      put(2, zx, yz, pressure + 2 * mu * zz);
    }
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
