// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/refine.hpp"

#include <map>

namespace dynamorph {

bool refine(std::vector<Vector3d>& points, std::vector<Triangle>& triangles, double longest, std::size_t limit) {
  std::map<Edge, int> middles;
  std::vector<Triangle> left = triangles, done;
  while (!left.empty()) {
    const Triangle t = left.back();
    left.pop_back();
    int edge = 0;
    double length = 0;
    for (int k = 0; k < 3; ++k) {
      const double side = (points[t[(k + 1) % 3]] - points[t[k]]).norm();
      if (side > length) length = side, edge = k;
    }
    if (length <= longest) {
      done.push_back(t);
      continue;
    }
    if (left.size() + done.size() + 2 > limit) return false;
    const int a = t[edge], b = t[(edge + 1) % 3], c = t[(edge + 2) % 3];
    const auto [middle, is_new] = middles.emplace(undirected(a, b), int(points.size()));
    if (is_new) points.push_back((points[a] + points[b]) / 2);
    left.push_back({a, middle->second, c});
    left.push_back({middle->second, b, c});
  }
  triangles = std::move(done);
  return true;
}

}  // namespace dynamorph
