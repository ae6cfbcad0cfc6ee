// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/dense_kernels.hpp"

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

/// Adds to the rows from i on of the `width` columns of A from j on; `width` is at most four. Sums over the
/// rows of J stay in registers.
template <int kVectors>
DYNAMORPH_INLINE void add_block(const double* J, const double* d, Index k, Index n, Index i, Index j, Index width,
                                double* A) {
  Double4 sums[4][kVectors] = {};
  for (Index row = 0; row < k; ++row, J += n)
    for (Index c = 0; c < width; ++c) {
      const double factor = d[row] * J[j + c];
      for (int v = 0; v < kVectors; ++v) sums[c][v] = mul_add(sums[c][v], factor, load(J + i + 4 * v));
    }
  for (Index c = 0; c < width; ++c)
    for (int v = 0; v < kVectors; ++v) {
      double* to = A + (j + c) * n + i + 4 * v;
      store(load(to) + sums[c][v], to);
    }
}

/// Writes 4 kVectors rows of C = A B from row i on, in the `width` columns from j on; `width` is at most four.
template <int kVectors>
DYNAMORPH_INLINE void multiply_block(const double* A, Index m, Index k, const double* B, Index i, Index j, Index width,
                                     double* C) {
  Double4 sums[4][kVectors] = {};
  for (Index p = 0; p < k; ++p)
    for (int v = 0; v < kVectors; ++v) {
      const Double4 entries = load(A + p * m + i + 4 * v);
      for (Index c = 0; c < width; ++c) sums[c][v] = mul_add(sums[c][v], B[(j + c) * k + p], entries);
    }
  for (Index c = 0; c < width; ++c)
    for (int v = 0; v < kVectors; ++v) store(sums[c][v], C + (j + c) * m + i + 4 * v);
}

/// Subtracts from kRows rows and kColumns columns of A, from (i, j) on, those of B^T diag(d) B, but above the diagonal.
template <int kRows, int kColumns>
DYNAMORPH_INLINE void subtract_block(const double* B, const double* d, Index k, Index n, Index i, Index j, double* A) {
  const double *left = B + i * k, *right = B + j * k;
  Double4 sums[kRows][kColumns] = {};
  Index p = 0;
  for (; p + 4 <= k; p += 4) {
    Double4 scaled[kColumns];
    for (int c = 0; c < kColumns; ++c) scaled[c] = load(d + p) * load(right + c * k + p);
    for (int row = 0; row < kRows; ++row) {
      const Double4 entries = load(left + row * k + p);
      for (int c = 0; c < kColumns; ++c) sums[row][c] = mul_add(sums[row][c], entries, scaled[c]);
    }
  }
  for (int row = 0; row < kRows; ++row)
    for (int c = 0; c < kColumns && j + c <= i + row; ++c) {
      double sum = sum_of(sums[row][c]);
      for (Index last = p; last < k; ++last) sum = mul_add(sum, left[row * k + last], d[last] * right[c * k + last]);
      A[(j + c) * n + i + row] -= sum;
    }
}

}  // namespace

void multiply_dense(const double* __restrict A, Index m, Index k, const double* __restrict B, Index n,
                    double* __restrict C) {
  for (Index j = 0; j < n; j += 4) {
    const Index width = n - j < 4 ? n - j : 4;
    Index i = 0;
    for (; width == 4 && i + 8 <= m; i += 8) multiply_block<2>(A, m, k, B, i, j, 4, C);
    for (; i + 4 <= m; i += 4) multiply_block<1>(A, m, k, B, i, j, width, C);
    for (; i < m; ++i)
      for (Index c = j; c < j + width; ++c) {
        double sum = 0;
        for (Index p = 0; p < k; ++p) sum = mul_add(sum, B[c * k + p], A[p * m + i]);
        C[c * m + i] = sum;
      }
  }
}

void subtract_squares(const double* __restrict B, const double* __restrict d, Index k, Index n, double* __restrict A) {
  Index j = 0;
  for (; j + 2 <= n; j += 2) {
    Index i = j;
    for (; i + 4 <= n; i += 4) subtract_block<4, 2>(B, d, k, n, i, j, A);
    for (; i < n; ++i) subtract_block<1, 2>(B, d, k, n, i, j, A);
  }
  if (j < n) subtract_block<1, 1>(B, d, k, n, j, j, A);
}

void add_squares(const double* __restrict J, const double* __restrict d, Index k, Index n, double* __restrict A) {
  for (Index j = 0; j < n; j += 4) {
    const Index width = n - j < 4 ? n - j : 4;
    Index i = j;
    for (; width == 4 && i + 8 <= n; i += 8) add_block<2>(J, d, k, n, i, j, 4, A);
    for (; i + 4 <= n; i += 4) add_block<1>(J, d, k, n, i, j, width, A);
    for (; i < n; ++i)
      for (Index c = 0; c < width; ++c)
        for (Index row = 0; row < k; ++row)
          A[(j + c) * n + i] = mul_add(A[(j + c) * n + i], d[row] * J[row * n + j + c], J[row * n + i]);
  }
}

/// Subtracts from each column what the earlier columns contribute. Rows are processed in whole vectors, starting with
/// the vector that holds the diagonal.
bool decompose_dense(double* __restrict V, Index n, double* __restrict inverse) {
  const Index stride = whole_vectors(n);
  for (Index j = 0; j < n; ++j) {
    double* column = V + j * stride;
    const Index first = j / 4 * 4;
    Index k = 0;
    for (; k + 4 <= j; k += 4) {
      const double *v0 = V + k * stride, *v1 = v0 + stride, *v2 = v1 + stride, *v3 = v2 + stride;
      const double x0 = v0[j] * inverse[k], x1 = v1[j] * inverse[k + 1];
      const double x2 = v2[j] * inverse[k + 2], x3 = v3[j] * inverse[k + 3];
      for (Index i = first; i < stride; i += 4) {
        const Double4 others = mul_add(load(v3 + i) * x3, x2, load(v2 + i));
        store(mul_sub(mul_sub(load(column + i), x0, load(v0 + i)), x1, load(v1 + i)) - others, column + i);
      }
    }
    for (; k < j; ++k) {
      const double x = V[k * stride + j] * inverse[k];
      for (Index i = first; i < stride; i += 4)
        store(mul_sub(load(column + i), x, load(V + k * stride + i)), column + i);
    }
    if (!(column[j] > 0) || !__builtin_isfinite(column[j])) return false;
    inverse[j] = 1 / column[j];
    for (Index i = first; i <= j; ++i) column[i] = 0;
  }
  return true;
}

void substitute_dense(const double* __restrict V, const double* __restrict inverse, Index n, double* __restrict x) {
  const Index stride = whole_vectors(n);
  for (Index j = 0; j < n; ++j) {
    const double pivot = x[j] * inverse[j];
    for (Index i = j / 4 * 4; i < stride; i += 4) store(mul_sub(load(x + i), pivot, load(V + j * stride + i)), x + i);
  }
  for (Index j = n - 1; j >= 0; --j) {
    Double4 sum = {};
    for (Index i = j / 4 * 4; i < stride; i += 4) sum = mul_add(sum, load(V + j * stride + i), load(x + i));
    x[j] = (x[j] - sum_of(sum)) * inverse[j];
  }
}

}  // namespace dynamorph::DYNAMORPH_ISA
