// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/assembly.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <numeric>
#include <tuple>

#include "dynamorph/core/parallel.hpp"

namespace dynamorph {

// --- Plan ------------------------------------------------------------------------------------------------------------

namespace {

constexpr int kChunkGroups = 128;  // per chunk; the chunk's store, 150 kB, stays in the L2 cache
constexpr int kSlice = 1024;       // blocks summed per task

/// The tetrahedra in the order of a Morton curve through the mesh.
std::vector<int> along_curve(const TetMesh& mesh) {
  const Eigen::RowVector3d low = mesh.nodes.colwise().minCoeff();
  const double size = (mesh.nodes.rowwise() - low).maxCoeff();
  std::vector<std::pair<std::uint32_t, int>> keys;
  for (int e = 0; e < int(mesh.tets.rows()); ++e) {
    Eigen::RowVector3d center = -low;
    for (int a = 0; a < 4; ++a) center += 0.25 * mesh.nodes.row(mesh.tets(e, a));
    std::uint32_t key = 0;
    for (int bit = 9; bit >= 0; --bit)
      for (int c = 0; c < 3; ++c) key = 2 * key + (std::uint32_t(center(c) / size * 1023) >> bit & 1);
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
    TetGroup& group = groups_.emplace_back();
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

/// Every chunk's store begins with a place for the pinned nodes' blocks, which are not needed. The blocks of its
/// tetrahedra follow.
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

double Assembly::sum_chunks(MaterialModel material_model, const std::vector<Part>& parts, const VectorXd& x,
                            double* stores) const {
  const bool stable = material_model == MaterialModel::stable_stvk, tangent = stores != nullptr;
  const auto& energy_of = stable ? stable_energy : stvk_energy;
  const auto& tangent_of = stable ? stable_tangent : stvk_tangent;
  std::vector<WeightedPart> weighted;
  for (const Part& part : parts) {
    const double lambda = part.weight * part.lame.lambda, mu = part.weight * part.lame.mu;
    weighted.push_back({stable ? lambda + mu : lambda, stable ? 0 : mu, stable ? mu : 0, part.elements->groups.data(),
                        part.elements->origins.empty() ? nullptr : part.elements->origins.data()});
  }
  VectorXd padded(3 * free_ + 3);
  padded << x, 0, 0, 0;
  std::vector<double> energies(chunks_.size());
  parallel_for(int(chunks_.size()), [&](int c) {
    const Chunk& chunk = chunks_[c];
    energies[c] =
        tangent ? tangent_of(groups_.data(), chunk.first, chunk.last, weighted.data(), weighted.size(), padded.data(),
                             stores + chunk.store)
                : energy_of(groups_.data(), chunk.first, chunk.last, weighted.data(), weighted.size(), padded.data());
  });
  return std::accumulate(energies.begin(), energies.end(), 0.0);
}

double Assembly::energy(MaterialModel material_model, const std::vector<Part>& parts, const VectorXd& x) const {
  return sum_chunks(material_model, parts, x, nullptr);
}

double Assembly::linearize(MaterialModel material_model, const std::vector<Part>& parts, const VectorXd& x,
                           VectorXd& force, SparseMatrix& stiffness) const {
  std::vector<double> stores(stores_size_);
  const double energy = sum_chunks(material_model, parts, x, stores.data());
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
