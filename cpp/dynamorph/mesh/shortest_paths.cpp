// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/shortest_paths.hpp"

namespace dynamorph {

ShortestPaths::ShortestPaths(const InteriorGraph& graph) : graph_(graph), length_(graph.size(), kInfinity) {}

void ShortestPaths::start(int from) {
  for (int i : touched_) length_[i] = kInfinity;
  touched_ = {from};
  next_ = {};
  next_.emplace(0.0, from);
  length_[from] = 0;
  from_ = from;
}

// Dijkstra's method. It stops once the point is reached, and resumes for the next point.
double ShortestPaths::to(int point, double bound) {
  while (!next_.empty() && next_.top().first <= bound && next_.top().first < length_[point]) {
    const auto [length, i] = next_.top();
    next_.pop();
    if (length > length_[i]) continue;
    for (const InteriorGraph::Step& step : graph_.steps(i)) {
      const double longer = length + step.length;
      if (!(longer < length_[step.to])) continue;
      if (length_[step.to] == kInfinity) touched_.push_back(step.to);
      length_[step.to] = longer;
      next_.emplace(longer, step.to);
    }
  }
  return length_[point] <= bound ? length_[point] : kInfinity;
}

}  // namespace dynamorph
