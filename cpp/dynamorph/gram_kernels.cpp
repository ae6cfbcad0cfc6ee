// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/gram_kernels.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__)
#define DYNAMORPH_MULTIVERSION __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define DYNAMORPH_MULTIVERSION
#endif

namespace dynamorph {

namespace {

using Vector4 = double __attribute__((vector_size(32), aligned(8), may_alias));
constexpr Eigen::Index kPanel = kTile;  // three vectors
constexpr Eigen::Index kDepth = 128;    // of a panel: 12 kB, so that two stay in the first cache

/// C (4, kPanel, rows `stride` apart) += A^T B for `depth` rows of two panels; A from its column `first`.
inline __attribute__((always_inline)) void tile(const double* __restrict A, const double* __restrict B,
                                                Eigen::Index depth, double* __restrict C, Eigen::Index stride) {
  Vector4 sums[4][3] = {};
  for (Eigen::Index d = 0; d < depth; ++d, A += kPanel, B += kPanel) {
    const Vector4* b = reinterpret_cast<const Vector4*>(B);
    for (int i = 0; i < 4; ++i)
      for (int v = 0; v < 3; ++v) sums[i][v] += A[i] * b[v];
  }
  for (int i = 0; i < 4; ++i)
    for (int v = 0; v < 3; ++v) *reinterpret_cast<Vector4*>(C + i * stride + 4 * v) += sums[i][v];
}

/// Columns of a row-major matrix in panels of kPanel, each row after row, padded with zeros.
void pack_panels(const double* A, Eigen::Index columns, Eigen::Index depth, std::vector<double>& panels) {
  const Eigen::Index count = (columns + kPanel - 1) / kPanel;
  panels.assign(count * depth * kPanel, 0);
  for (Eigen::Index p = 0; p < count; ++p)
    for (Eigen::Index d = 0; d < depth; ++d)
      std::copy_n(A + d * columns + p * kPanel, std::min(kPanel, columns - p * kPanel),
                  panels.data() + (p * depth + d) * kPanel);
}

/// Sums of tiles over panels; C has whole panels of rows and columns.
DYNAMORPH_MULTIVERSION
void multiply_panels(const double* A, Eigen::Index rows, const double* B, Eigen::Index columns, Eigen::Index depth,
                     bool symmetric, double* C) {
  for (Eigen::Index i = 0; i < rows; ++i)
    for (Eigen::Index j = symmetric ? i : 0; j < columns; ++j)
      for (Eigen::Index sub = 0; sub < kPanel; sub += 4)
        tile(A + i * depth * kPanel + sub, B + j * depth * kPanel, depth,
             C + (i * kPanel + sub) * columns * kPanel + j * kPanel, columns * kPanel);
}

inline __attribute__((always_inline)) void pair_strains(const double* __restrict G, Eigen::Index r, Eigen::Index k,
                                                        double* __restrict trace, double* __restrict strain,
                                                        Eigen::Index stride) {
  const double half = std::sqrt(0.5);
  double own[9];
  for (int c = 0; c < 9; ++c) own[c] = G[c * r + k];
  for (Eigen::Index l = 0; l < r - k; ++l) {
    const double* other = G + k + l;
    double products[3] = {};
    for (int a = 0; a < 3; ++a)
      for (int i = 0; i < 3; ++i) products[a] += own[3 * a + i] * other[(3 * a + i) * r];
    trace[l] = products[0] + products[1] + products[2];
    if (!strain) continue;
    for (int a = 0; a < 3; ++a) {
      const int b = (a + 1) % 3;
      double shear = 0;
      for (int i = 0; i < 3; ++i)
        shear += own[3 * a + i] * other[(3 * b + i) * r] + own[3 * b + i] * other[(3 * a + i) * r];
      strain[a * stride + l] = products[a];
      strain[(3 + a) * stride + l] = half * shear;
    }
  }
}

DYNAMORPH_MULTIVERSION
void strains(const double* G, Eigen::Index r, Eigen::Index k, double* trace, double* strain, Eigen::Index stride) {
  if (strain)
    pair_strains(G, r, k, trace, strain, stride);
  else
    pair_strains(G, r, k, trace, nullptr, 0);
}

DYNAMORPH_MULTIVERSION
void crosses(const double* __restrict G, Eigen::Index r, Eigen::Index k, double* __restrict cross,
             Eigen::Index stride) {
  double own[9];
  for (int c = 0; c < 9; ++c) own[c] = G[c * r + k];
  for (Eigen::Index l = 0; l < r - k; ++l) {
    const double* other = G + k + l;
    for (int i = 0; i < 3; ++i)
      for (int c = 0; c < 3; ++c) {
        const int j = 3 * ((i + 1) % 3), h = 3 * ((i + 2) % 3), a = (c + 1) % 3, b = (c + 2) % 3;
        cross[(3 * i + c) * stride + l] = own[j + a] * other[(h + b) * r] - own[j + b] * other[(h + a) * r] +
                                          other[(j + a) * r] * own[h + b] - other[(j + b) * r] * own[h + a];
      }
  }
}

}  // namespace

void add_transposed_product(const double* A, Eigen::Index m, const double* B, Eigen::Index n, Eigen::Index depth,
                            bool symmetric, double* C) {
  std::vector<double> packed_a, packed_b;
  for (Eigen::Index d = 0; d < depth; d += kDepth) {
    const Eigen::Index some = std::min(kDepth, depth - d);
    pack_panels(B + d * n, n, some, packed_b);
    if (!symmetric) pack_panels(A + d * m, m, some, packed_a);
    multiply_panels((symmetric ? packed_b : packed_a).data(), padded(m) / kPanel, packed_b.data(), padded(n) / kPanel,
                    some, symmetric, C);
  }
}

void strain_of_pairs(const double* G, Eigen::Index r, Eigen::Index k, double* trace, double* strain,
                     Eigen::Index stride) {
  strains(G, r, k, trace, strain, stride);
}

void crosses_of_pairs(const double* G, Eigen::Index r, Eigen::Index k, double* cross, Eigen::Index stride) {
  crosses(G, r, k, cross, stride);
}

}  // namespace dynamorph
