// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/assembly.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <numeric>
#include <tuple>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/simd/multiversion.hpp"

namespace dynamorph {

// --- Plan ------------------------------------------------------------------------------------------------------------

namespace {

constexpr int kGroupSize = Assembly::kGroupSize;
constexpr int kChunkGroups = 128;  // of a chunk: their store, 150 kB, stays in the second cache
constexpr int kDiagonal = 12;      // numbers stored of a diagonal block: 3x3, column-major, and the node's force
constexpr int kOffDiagonal = 9;
constexpr int kSlice = 1024;  // blocks added up at a time
constexpr int kPairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/// Tetrahedra along a Morton curve through the mesh.
std::vector<int> along_curve(const TetMesh& mesh) {
  const Eigen::RowVector3d low = mesh.nodes.colwise().minCoeff();
  const double size = (mesh.nodes.rowwise() - low).maxCoeff();
  std::vector<std::pair<std::uint32_t, int>> keys;
  for (int e = 0; e < int(mesh.tets.rows()); ++e) {
    Eigen::RowVector3d centre = -low;
    for (int a = 0; a < 4; ++a) centre += 0.25 * mesh.nodes.row(mesh.tets(e, a));
    std::uint32_t key = 0;
    for (int bit = 9; bit >= 0; --bit)
      for (int c = 0; c < 3; ++c) key = 2 * key + (std::uint32_t(centre(c) / size * 1023) >> bit & 1);
    keys.emplace_back(key, e);
  }
  std::sort(keys.begin(), keys.end());
  std::vector<int> order;
  for (const auto& key : keys) order.push_back(key.second);
  return order;
}

}  // namespace

Assembly::Assembly(const TetMesh& mesh, const std::vector<int>& free_of_node) {
  free_ = int(std::count_if(free_of_node.begin(), free_of_node.end(), [](int i) { return i >= 0; }));
  group_tets(mesh, free_of_node);
  place_blocks();
  build_pattern();
}

void Assembly::group_tets(const TetMesh& mesh, const std::vector<int>& free_of_node) {
  const std::vector<int> curve = along_curve(mesh);
  for (size_t first = 0; first < curve.size(); first += kGroupSize) {
    Group& group = groups_.emplace_back();
    for (size_t l = 0; l < kGroupSize; ++l) {
      group.tets[l] = first + l < curve.size() ? curve[first + l] : -1;
      std::array<std::pair<int, int>, 4> nodes;
      for (int a = 0; a < 4; ++a) {
        const int i = group.tets[l] < 0 ? -1 : free_of_node[mesh.tets(group.tets[l], a)];
        nodes[a] = {i < 0 ? free_ : i, a};
      }
      std::sort(nodes.begin(), nodes.end());
      for (int a = 0; a < 4; ++a) {
        group.nodes[a][l] = 3 * nodes[a].first;
        group.order[a][l] = nodes[a].second;
      }
    }
  }
}

/// Every chunk's store has a place for what nobody needs, the held nodes' blocks, and then the blocks of its
/// tetrahedra.
void Assembly::place_blocks() {
  struct Place {
    int column, row, at;
    bool operator<(const Place& other) const { return std::tie(column, row) < std::tie(other.column, other.row); }
    bool operator==(const Place& other) const { return column == other.column && row == other.row; }
  };
  std::vector<Place> all;
  for (int j = 0; j < free_; ++j) all.push_back({j, j, -1});
  for (int first = 0; first < int(groups_.size()); first += kChunkGroups) {
    const int last = std::min(first + kChunkGroups, int(groups_.size()));
    const auto for_each_block = [&](const auto& visit) {
      for (int g = first; g < last; ++g)
        for (int l = 0; l < kGroupSize; ++l)
          for (int k = 0; k < 10; ++k) {
            const int a = k < 4 ? k : kPairs[k - 4][0], b = k < 4 ? k : kPairs[k - 4][1];
            visit(groups_[g].nodes[b][l] / 3, groups_[g].nodes[a][l] / 3, groups_[g].blocks[k][l]);
          }
    };
    std::vector<Place> places;
    for_each_block([&](int column, int row, int&) {
      if (column < free_) places.push_back({column, row, 0});
    });
    std::sort(places.begin(), places.end());
    places.erase(std::unique(places.begin(), places.end()), places.end());
    int size = kDiagonal;
    for (Place& place : places) {
      place.at = size;
      size += place.row == place.column ? kDiagonal : kOffDiagonal;
    }
    for_each_block([&](int column, int row, int& block) {
      block = column < free_ ? std::lower_bound(places.begin(), places.end(), Place{column, row, 0})->at : 0;
    });
    chunks_.push_back({first, last, stores_size_});
    for (Place& place : places) all.push_back({place.column, place.row, stores_size_ + place.at});
    stores_size_ += size;
  }
  std::stable_sort(all.begin(), all.end());
  for (const Place& place : all) {
    if (blocks_.empty() || blocks_.back().column != place.column || blocks_.back().row != place.row)
      blocks_.push_back({place.row, place.column, int(addends_.size()), int(addends_.size()), 0, 0, 0, 0});
    if (place.at >= 0) addends_.push_back(place.at);
    blocks_.back().last = int(addends_.size());
  }
}

void Assembly::build_pattern() {
  std::vector<std::vector<int>> rows(free_);
  for (const Block& block : blocks_) {
    rows[block.column].push_back(block.row);
    if (block.row != block.column) rows[block.row].push_back(block.column);
  }
  pattern_.resize(3 * free_, 3 * free_);
  Eigen::VectorXi sizes(3 * free_);
  for (int j = 0; j < free_; ++j) {
    std::sort(rows[j].begin(), rows[j].end());
    sizes.segment<3>(3 * j).setConstant(3 * int(rows[j].size()));
  }
  pattern_.reserve(sizes);
  for (int column = 0; column < 3 * free_; ++column)
    for (int i : rows[column / 3])
      for (int r = 0; r < 3; ++r) pattern_.insert(3 * i + r, column) = 0;
  pattern_.makeCompressed();
  const auto place = [&](int row, int column, int& at, int& stride) {
    const std::vector<int>& list = rows[column];
    stride = 3 * int(list.size());
    at = pattern_.outerIndexPtr()[3 * column] + 3 * int(std::lower_bound(list.begin(), list.end(), row) - list.begin());
  };
  for (Block& block : blocks_) {
    place(block.row, block.column, block.upper, block.upper_stride);
    place(block.column, block.row, block.lower, block.lower_stride);
  }
}

Assembly::Elements Assembly::pack(const RestShape& shape, bool absolute) const {
  Elements out;
  out.groups.resize(groups_.size());
  out.origins.resize(absolute ? groups_.size() : 0);
  for (size_t g = 0; g < groups_.size(); ++g)
    for (int l = 0; l < kGroupSize; ++l) {
      const bool empty = groups_[g].tets[l] < 0;
      const Element& element = shape.elements[empty ? 0 : groups_[g].tets[l]];
      out.groups[g].volumes[l] = empty ? 0 : element.weight;
      for (int a = 0; a < 3; ++a)
        for (int c = 0; c < 3; ++c) {
          out.groups[g].gradients[a][c][l] = element.gradients(c, groups_[g].order[a + 1][l]);
          if (absolute) out.origins[g].values[a][c][l] = element.origin(a, c) - (a == c);
        }
    }
  return out;
}

// --- Elements --------------------------------------------------------------------------------------------------------

namespace {

using Lane = double __attribute__((vector_size(kGroupSize * sizeof(double)), may_alias));

/// A part with its moduli times its weight: the stable law is StVK with (lambda + mu, 0) and a remainder kappa (tr E -
/// det F + 1).
struct WeightedPart {
  double lambda, mu, kappa;
  const Assembly::Elements::Group* groups;
  const Assembly::Elements::Origins* origins;
};

/// The sums over the parts, times volume and weight: blocks (1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3) of the
/// stiffness, column-major, and the forces on nodes 1 to 3.
struct Sums {
  Lane blocks[6][3][3];
  Lane forces[3][3];
  Lane energy;
};

DYNAMORPH_INLINE void cross(const Lane (&a)[3], const Lane (&b)[3], Lane (&out)[3]) {
  for (int i = 0; i < 3; ++i) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/// out = A x, A by rows.
DYNAMORPH_INLINE void multiply(const Lane (&A)[3][3], const Lane (&x)[3], Lane (&out)[3]) {
  for (int i = 0; i < 3; ++i) out[i] = A[i][0] * x[0] + A[i][1] * x[1] + A[i][2] * x[2];
}

/// One part at deformation gradients F = I + G (by rows); see element_stiffness() for the formulas.
template <bool kStable, bool kTangent>
DYNAMORPH_INLINE void add_part(const Lane (&G)[3][3], const Lane (&g)[3][3], const Lane& lambda, const Lane& mu,
                               const Lane& kappa, Sums& sums) {
  Lane E[3][3], F[3][3];
  for (int c = 0; c < 3; ++c)
    for (int d = 0; d <= c; ++d) {
      E[c][d] = 0.5 * (G[c][d] + G[d][c] + (G[0][c] * G[0][d] + G[1][c] * G[1][d] + G[2][c] * G[2][d]));
      E[d][c] = E[c][d];
    }
  const Lane trace = E[0][0] + E[1][1] + E[2][2];
  sums.energy += 0.5 * lambda * trace * trace;
  if (!kStable)
    sums.energy += mu * (E[0][0] * E[0][0] + E[1][1] * E[1][1] + E[2][2] * E[2][2] +
                         2 * (E[1][0] * E[1][0] + E[2][0] * E[2][0] + E[2][1] * E[2][1]));
  if (kStable) {
    Lane normal[3];
    cross(G[1], G[2], normal);
    const Lane inner = G[0][0] * G[1][1] - G[0][1] * G[1][0] + G[1][1] * G[2][2] - G[1][2] * G[2][1] +
                       G[2][2] * G[0][0] - G[2][0] * G[0][2];
    Lane square = {};
    for (int i = 0; i < 3; ++i) square += G[i][0] * G[i][0] + G[i][1] * G[i][1] + G[i][2] * G[i][2];
    // tr E - det F + 1 without what cancels: |G|^2 / 2 less the second and the third invariant of G.
    sums.energy += kappa * (0.5 * square - inner - (G[0][0] * normal[0] + G[0][1] * normal[1] + G[0][2] * normal[2]));
  }
  if (!kTangent) return;

  Lane S[3][3];
  for (int c = 0; c < 3; ++c)
    for (int d = 0; d < 3; ++d) {
      F[c][d] = c == d ? 1 + G[c][d] : G[c][d];
      S[c][d] = kStable ? Lane{} : 2 * mu * E[c][d];
      if (c == d) S[c][d] += lambda * trace;
    }
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
      for (int j = 0; j < 3; ++j) squares[i][j] = mu * (F[i][0] * F[j][0] + F[i][1] * F[j][1] + F[i][2] * F[j][2]);
  if (kStable) {
    Lane cofactor[3][3];
    for (int i = 0; i < 3; ++i) cross(F[(i + 1) % 3], F[(i + 2) % 3], cofactor[i]);
    for (int a = 0; a < 3; ++a) {
      Lane volumetric[3];
      multiply(cofactor, g[a], volumetric);
      for (int i = 0; i < 3; ++i) sums.forces[a][i] += kappa * (h[a][i] - volumetric[i]);
    }
  }
  for (int k = 0; k < 6; ++k) {
    const int a = k < 3 ? k : kPairs[k][0] - 1, b = k < 3 ? k : kPairs[k][1] - 1;
    const Lane gg = g[a][0] * g[b][0] + g[a][1] * g[b][1] + g[a][2] * g[b][2];
    Lane geometric = g[a][0] * s[b][0] + g[a][1] * s[b][1] + g[a][2] * s[b][2];
    if (kStable) geometric += kappa * gg;
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
        sum += h[a][r] * column;
        if (!kStable) sum += h[b][r] * other + gg * squares[r][c];
        if (r == c) sum += geometric;
        if (kStable && a != b && r != c) {
          const int axis = 3 - r - c;
          sum += (r + 1) % 3 == c ? -turn[axis] : turn[axis];
        }
      }
    }
  }
}

/// Adds the elements' blocks and forces to the store, node 0's from the others' sums.
DYNAMORPH_INLINE void add_to_store(const Assembly::Group& group, const Sums& sums, double* __restrict store) {
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

/// All parts of groups first .. last - 1 at displacements x, added to the store; returns the energy.
template <bool kStable, bool kTangent>
DYNAMORPH_INLINE double add_groups(const Assembly::Group* groups, int first, int last, const WeightedPart* parts,
                                   size_t count, const double* x, double* store) {
  Lane energy = {};
  for (int k = first; k < last; ++k) {
    const Assembly::Group& group = groups[k];
    Lane edges[3][3];
    for (int a = 0; a < 3; ++a)
      for (int i = 0; i < 3; ++i)
        for (int l = 0; l < kGroupSize; ++l) edges[a][i][l] = x[group.nodes[a + 1][l] + i] - x[group.nodes[0][l] + i];
    Sums sums = {};
    for (size_t p = 0; p < count; ++p) {
      const WeightedPart& part = parts[p];
      const Lane(&g)[3][3] = reinterpret_cast<const Lane(&)[3][3]>(part.groups[k].gradients);
      const Lane& volume = reinterpret_cast<const Lane&>(part.groups[k].volumes);
      Lane G[3][3];
      for (int i = 0; i < 3; ++i)
        for (int c = 0; c < 3; ++c) {
          G[i][c] = edges[0][i] * g[0][c] + edges[1][i] * g[1][c] + edges[2][i] * g[2][c];
          if (part.origins) G[i][c] += reinterpret_cast<const Lane&>(part.origins[k].values[i][c]);
        }
      add_part<kStable, kTangent>(G, g, part.lambda * volume, part.mu * volume, part.kappa * volume, sums);
    }
    energy += sums.energy;
    if (kTangent) add_to_store(group, sums, store);
  }
  return energy[0] + energy[1] + (energy[2] + energy[3]);
}

using GroupsFunction = double(const Assembly::Group*, int, int, const WeightedPart*, size_t, const double*, double*);

DYNAMORPH_MULTIVERSION
double stvk_energy(const Assembly::Group* groups, int first, int last, const WeightedPart* parts, size_t count,
                   const double* x, double* store) {
  return add_groups<false, false>(groups, first, last, parts, count, x, store);
}

DYNAMORPH_MULTIVERSION
double stvk_tangent(const Assembly::Group* groups, int first, int last, const WeightedPart* parts, size_t count,
                    const double* x, double* store) {
  return add_groups<false, true>(groups, first, last, parts, count, x, store);
}

DYNAMORPH_MULTIVERSION
double stable_energy(const Assembly::Group* groups, int first, int last, const WeightedPart* parts, size_t count,
                     const double* x, double* store) {
  return add_groups<true, false>(groups, first, last, parts, count, x, store);
}

DYNAMORPH_MULTIVERSION
double stable_tangent(const Assembly::Group* groups, int first, int last, const WeightedPart* parts, size_t count,
                      const double* x, double* store) {
  return add_groups<true, true>(groups, first, last, parts, count, x, store);
}

}  // namespace

double Assembly::sum_chunks(Law law, const std::vector<Part>& parts, const VectorXd& x, double* stores) const {
  const bool stable = law == Law::stable_stvk, tangent = stores != nullptr;
  GroupsFunction* const add = stable    ? (tangent ? stable_tangent : stable_energy)
                              : tangent ? stvk_tangent
                                        : stvk_energy;
  std::vector<WeightedPart> weighted;
  for (const Part& part : parts) {
    const double lambda = part.weight * part.lame.lambda, mu = part.weight * part.lame.mu;
    weighted.push_back({stable ? lambda + mu : lambda, stable ? 0 : mu, stable ? mu : 0, part.elements->groups.data(),
                        part.elements->origins.empty() ? nullptr : part.elements->origins.data()});
  }
  VectorXd held(3 * free_ + 3);
  held << x, 0, 0, 0;
  std::vector<double> energies(chunks_.size());
  parallel_for(int(chunks_.size()), [&](int c) {
    energies[c] = add(groups_.data(), chunks_[c].first, chunks_[c].last, weighted.data(), weighted.size(), held.data(),
                      tangent ? stores + chunks_[c].store : nullptr);
  });
  return std::accumulate(energies.begin(), energies.end(), 0.0);
}

double Assembly::energy(Law law, const std::vector<Part>& parts, const VectorXd& x) const {
  return sum_chunks(law, parts, x, nullptr);
}

double Assembly::linearize(Law law, const std::vector<Part>& parts, const VectorXd& x, VectorXd& force,
                           SparseMatrix& stiffness) const {
  std::vector<double> stores(stores_size_);
  const double energy = sum_chunks(law, parts, x, stores.data());
  force.resize(3 * free_);
  const int count = int(blocks_.size());
  parallel_for((count + kSlice - 1) / kSlice, [&](int slice) {
    for (int k = slice * kSlice; k < std::min(count, (slice + 1) * kSlice); ++k) {
      const Block& block = blocks_[k];
      const bool diagonal = block.row == block.column;
      double sum[kDiagonal] = {};
      for (int at = block.first; at < block.last; ++at)
        for (int i = 0; i < (diagonal ? kDiagonal : kOffDiagonal); ++i) sum[i] += stores[addends_[at] + i];
      for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) {
          stiffness.valuePtr()[block.upper + c * block.upper_stride + r] = sum[3 * c + r];
          if (!diagonal) stiffness.valuePtr()[block.lower + r * block.lower_stride + c] = sum[3 * c + r];
        }
      if (diagonal) force.segment<3>(3 * block.row) << sum[9], sum[10], sum[11];
    }
  });
  return energy;
}

}  // namespace dynamorph
