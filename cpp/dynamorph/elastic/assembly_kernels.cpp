// SPDX-License-Identifier: GPL-3.0-or-later
// The element laws. With F = I + G, Green's strain E = 1/2 (F^T F - I) is computed as 1/2 (G + G^T + G^T G), which
// avoids cancellation near rest. With S = lambda tr(E) I + 2 mu E:
//
//   psi        = 1/2 lambda tr(E)^2 + mu E:E + kappa (tr E - det F + 1)                             J/m^3
//   f_a        = V (F S g_a + kappa (F - cof F) g_a)                                                N, on node a
//   K_ab       = V ((g_a.S g_b + kappa g_a.g_b) I + lambda F g_a (F g_b)^T                          N/m, 3 x 3
//                   + mu (F g_b (F g_a)^T + (g_a.g_b) F F^T) + kappa [F (g_a x g_b)]_x)
//
// StVK has kappa = 0. The stable law has StVK's moduli at rest. It uses (lambda + mu, 0, kappa = mu), so the terms in
// mu vanish and those in kappa remain. The tangent of the linear law is StVK's tangent at rest. [c]_x is the matrix of
// the cross product c x.
#include "dynamorph/elastic/assembly_kernels.hpp"

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph::DYNAMORPH_ISA {

namespace {

using Lane = Double4;
static_assert(sizeof(Lane) == kGroupSize * sizeof(double), "one lane per tetrahedron");

/// Sums over the parts, times volume and weight. blocks: (1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3) of the
/// stiffness, column-major. forces: on nodes 1 to 3.
struct Sums {
  Lane blocks[6][3][3];
  Lane forces[3][3];
  Lane energy;
};

DYNAMORPH_INLINE Lane dot(const Lane& a0, const Lane& a1, const Lane& a2, const Lane& b0, const Lane& b1,
                          const Lane& b2) {
  return mul_add(mul_add(a0 * b0, a1, b1), a2, b2);
}
DYNAMORPH_INLINE Lane dot(const Lane (&a)[3], const Lane (&b)[3]) { return dot(a[0], a[1], a[2], b[0], b[1], b[2]); }

DYNAMORPH_INLINE void cross(const Lane (&a)[3], const Lane (&b)[3], Lane (&out)[3]) {
  for (int i = 0; i < 3; ++i) out[i] = mul_sub(a[(i + 1) % 3] * b[(i + 2) % 3], a[(i + 2) % 3], b[(i + 1) % 3]);
}

/// out = A x, with A stored by rows.
DYNAMORPH_INLINE void multiply(const Lane (&A)[3][3], const Lane (&x)[3], Lane (&out)[3]) {
  for (int i = 0; i < 3; ++i) out[i] = dot(A[i], x);
}

/// Adds one part at G, which is stored by rows. lambda, mu and kappa are multiplied by the volume. g: gradients of
/// nodes 1 to 3.
template <bool kStable, bool kTangent>
DYNAMORPH_INLINE void add_part(const Lane (&G)[3][3], const Lane (&g)[3][3], const Lane& lambda, const Lane& mu,
                               const Lane& kappa, Sums& sums) {
  Lane E[3][3], F[3][3];
  for (int c = 0; c < 3; ++c)
    for (int d = 0; d <= c; ++d) {
      E[c][d] = 0.5 * (G[c][d] + G[d][c] + dot(G[0][c], G[1][c], G[2][c], G[0][d], G[1][d], G[2][d]));
      E[d][c] = E[c][d];
    }
  // psi
  const Lane trace = E[0][0] + E[1][1] + E[2][2];
  sums.energy = mul_add(sums.energy, 0.5 * lambda * trace, trace);
  if (!kStable)
    sums.energy = mul_add(sums.energy, mu,
                          mul_add(dot(E[0][0], E[1][1], E[2][2], E[0][0], E[1][1], E[2][2]), 2.0,
                                  dot(E[1][0], E[2][0], E[2][1], E[1][0], E[2][0], E[2][1])));
  if (kStable) {
    Lane normal[3];
    cross(G[1], G[2], normal);
    const Lane inner = mul_sub(G[0][0] * G[1][1], G[0][1], G[1][0]) + mul_sub(G[1][1] * G[2][2], G[1][2], G[2][1]) +
                       mul_sub(G[2][2] * G[0][0], G[2][0], G[0][2]);
    const Lane square = dot(G[0], G[0]) + dot(G[1], G[1]) + dot(G[2], G[2]);
    // tr E - det F + 1 without cancellation: |G|^2 / 2 minus the second and third invariants of G.
    sums.energy = mul_add(sums.energy, kappa, 0.5 * square - inner - dot(G[0], normal));
  }
  if (!kTangent) return;

  Lane S[3][3];
  for (int c = 0; c < 3; ++c)
    for (int d = 0; d < 3; ++d) {
      F[c][d] = c == d ? 1.0 + G[c][d] : G[c][d];
      S[c][d] = kStable ? Lane{} : 2.0 * mu * E[c][d];
      if (c == d) S[c][d] = mul_add(S[c][d], lambda, trace);
    }
  // f_a
  Lane h[3][3], s[3][3];  // F g_a, S g_a
  for (int a = 0; a < 3; ++a) {
    multiply(F, g[a], h[a]);
    multiply(S, g[a], s[a]);
    Lane force[3];
    multiply(F, s[a], force);
    for (int i = 0; i < 3; ++i) sums.forces[a][i] += force[i];
  }
  Lane squares[3][3];  // mu F F^T
  if (!kStable)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) squares[i][j] = mu * dot(F[i], F[j]);
  if (kStable) {
    Lane cofactor[3][3];
    for (int i = 0; i < 3; ++i) cross(F[(i + 1) % 3], F[(i + 2) % 3], cofactor[i]);
    for (int a = 0; a < 3; ++a) {
      Lane volumetric[3];
      multiply(cofactor, g[a], volumetric);
      for (int i = 0; i < 3; ++i) sums.forces[a][i] = mul_add(sums.forces[a][i], kappa, h[a][i] - volumetric[i]);
    }
  }
  // K_ab
  for (int k = 0; k < 6; ++k) {
    const int a = k < 3 ? k : kPairs[k][0] - 1, b = k < 3 ? k : kPairs[k][1] - 1;
    const Lane gg = dot(g[a], g[b]);
    Lane geometric = dot(g[a], s[b]);
    if (kStable) geometric = mul_add(geometric, kappa, gg);
    Lane turn[3];  // kappa F (g_a x g_b)
    if (kStable && a != b) {
      Lane normal[3];
      cross(g[a], g[b], normal);
      multiply(F, normal, turn);
      for (int i = 0; i < 3; ++i) turn[i] *= kappa;
    }
    for (int c = 0; c < 3; ++c) {
      const Lane column = lambda * h[b][c], other = mu * h[a][c];
      for (int r = 0; r < 3; ++r) {
        Lane& sum = sums.blocks[k][c][r];
        sum = mul_add(sum, h[a][r], column);
        if (!kStable) sum = mul_add(mul_add(sum, h[b][r], other), gg, squares[r][c]);
        if (r == c) sum += geometric;
        if (kStable && a != b && r != c) {
          const int axis = 3 - r - c;
          sum += (r + 1) % 3 == c ? -turn[axis] : turn[axis];
        }
      }
    }
  }
}

/// Adds the elements' blocks and forces to the store. Those of node 0 follow from the sums of the others.
DYNAMORPH_INLINE void add_to_store(const TetGroup& group, const Sums& sums, double* __restrict store) {
  Lane out[10][kDiagonal];
  for (int i = 0; i < 9; ++i) {
    const int c = i / 3, r = i % 3;
    const auto entry = [&](int k) -> const Lane& { return sums.blocks[k][c][r]; };
    const auto transposed = [&](int k) -> const Lane& { return sums.blocks[k][r][c]; };
    for (int k = 0; k < 3; ++k) out[1 + k][i] = entry(k);
    for (int k = 3; k < 6; ++k) out[4 + k][i] = entry(k);
    out[4][i] = -(entry(0) + transposed(3) + transposed(4));
    out[5][i] = -(entry(1) + entry(3) + transposed(5));
    out[6][i] = -(entry(2) + entry(4) + entry(5));
    out[0][i] = -(out[4][i] + out[5][i] + out[6][i]);
  }
  for (int i = 0; i < 3; ++i) {
    for (int a = 0; a < 3; ++a) out[1 + a][9 + i] = sums.forces[a][i];
    out[0][9 + i] = -(sums.forces[0][i] + sums.forces[1][i] + sums.forces[2][i]);
  }
  for (int l = 0; l < kGroupSize; ++l)
    for (int k = 0; k < 10; ++k) {
      double* to = store + group.blocks[k][l];
      for (int i = 0; i < (k < 4 ? kDiagonal : kOffDiagonal); ++i) to[i] += out[k][i][l];
    }
}

/// Adds all parts of groups first .. last - 1 at displacements x to the store. Returns the energy.
template <bool kStable, bool kTangent>
DYNAMORPH_INLINE double add_groups(const TetGroup* groups, int first, int last, const WeightedPart* parts, size_t count,
                                   const double* x, double* store) {
  Lane energy = {};
  for (int k = first; k < last; ++k) {
    const TetGroup& group = groups[k];
    Lane edges[3][3];
    for (int a = 0; a < 3; ++a)
      for (int i = 0; i < 3; ++i)
        for (int l = 0; l < kGroupSize; ++l) edges[a][i][l] = x[group.nodes[a + 1][l] + i] - x[group.nodes[0][l] + i];
    Sums sums = {};
    for (size_t p = 0; p < count; ++p) {
      const WeightedPart& part = parts[p];
      const Lane volume = load(part.groups[k].volumes);
      Lane g[3][3], G[3][3];
      for (int a = 0; a < 3; ++a)
        for (int c = 0; c < 3; ++c) g[a][c] = load(part.groups[k].gradients[a][c]);
      for (int i = 0; i < 3; ++i)
        for (int c = 0; c < 3; ++c) {
          G[i][c] = dot(edges[0][i], edges[1][i], edges[2][i], g[0][c], g[1][c], g[2][c]);
          if (part.origins) G[i][c] += load(part.origins[k].values[i][c]);
        }
      add_part<kStable, kTangent>(G, g, part.lambda * volume, part.mu * volume, part.kappa * volume, sums);
    }
    energy += sums.energy;
    if (kTangent) add_to_store(group, sums, store);
  }
  return sum_of(energy);
}

}  // namespace

double stvk_energy(const TetGroup* groups, int first, int last, const WeightedPart* parts, size_t count,
                   const double* x) {
  return add_groups<false, false>(groups, first, last, parts, count, x, nullptr);
}

double stable_energy(const TetGroup* groups, int first, int last, const WeightedPart* parts, size_t count,
                     const double* x) {
  return add_groups<true, false>(groups, first, last, parts, count, x, nullptr);
}

double stvk_tangent(const TetGroup* groups, int first, int last, const WeightedPart* parts, size_t count,
                    const double* x, double* store) {
  return add_groups<false, true>(groups, first, last, parts, count, x, store);
}

double stable_tangent(const TetGroup* groups, int first, int last, const WeightedPart* parts, size_t count,
                      const double* x, double* store) {
  return add_groups<true, true>(groups, first, last, parts, count, x, store);
}

}  // namespace dynamorph::DYNAMORPH_ISA
