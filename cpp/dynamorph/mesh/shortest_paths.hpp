// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <queue>
#include <utility>
#include <vector>

#include "dynamorph/mesh/interior_graph.hpp"

namespace dynamorph {

/// The shortest paths from one point of the skin, computed only as far as they are asked for.
class ShortestPaths {
 public:
  explicit ShortestPaths(const InteriorGraph& graph);
  void start(int from);
  int from() const { return from_; }
  /// Length of the path to a point, meters; infinite when it is longer than `bound`.
  double to(int point, double bound);

 private:
  using Reached = std::pair<double, int>;
  const InteriorGraph& graph_;
  int from_ = -1;
  std::vector<double> length_;
  std::vector<int> touched_;
  std::priority_queue<Reached, std::vector<Reached>, std::greater<>> next_;
};

}  // namespace dynamorph
