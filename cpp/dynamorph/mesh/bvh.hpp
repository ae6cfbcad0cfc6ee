// SPDX-License-Identifier: GPL-3.0-or-later
// A tree of bounding boxes over triangles or tets.
#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// Built once from the boxes of some items. The items' own geometry stays with the caller.
class Bvh {
 public:
  using Box = Eigen::AlignedBox3d;

  /// Covers items order[begin..end). The left child follows its parent in `nodes`; a leaf has right == 0.
  struct Node {
    Box box;
    int begin, end, right;
    bool leaf() const { return right == 0; }
  };

  explicit Bvh(const std::vector<Box>& boxes) : order(boxes.size()) {
    std::iota(order.begin(), order.end(), 0);
    nodes.reserve(2 * boxes.size());
    if (!boxes.empty()) build(boxes, 0, int(boxes.size()));
  }

  /// Follows the items to where they are now; the tree stays as it was built. box(item) is an item's new box.
  template <class BoxOf>
  void refit(const BoxOf& box) {
    for (int index = int(nodes.size()) - 1; index >= 0; --index) {  // children come after their parents
      Node& node = nodes[index];
      node.box = node.leaf() ? Box() : nodes[index + 1].box.merged(nodes[node.right].box);
      for (int i = node.begin; node.leaf() && i < node.end; ++i) node.box.extend(box(order[i]));
    }
  }

  /// Calls visit(item) for the items that may lie nearer to p than sqrt(best), nearest boxes first. visit lowers `best`
  /// (squared distance) when its item is nearer.
  template <class Visit>
  void nearest(const Vector3d& p, const double& best, Visit visit) const {
    if (!nodes.empty()) nearest(0, p, best, visit);
  }

  /// Calls visit(item) for every item with a box that the line from p meets before distance `best`, in units of
  /// `direction`. visit lowers `best` when the line meets its item sooner.
  template <class Visit>
  void along(const Vector3d& p, const Vector3d& direction, const double& best, Visit visit) const {
    if (!nodes.empty()) along(0, p, direction, best, visit, nullptr);
  }

  /// The same for items that move: `moved` is this tree, refitted to where they get to.
  template <class Visit>
  void along(const Vector3d& p, const Vector3d& direction, const double& best, const Bvh& moved, Visit visit) const {
    if (!nodes.empty()) along(0, p, direction, best, visit, &moved);
  }

  std::vector<Node> nodes;
  std::vector<int> order;

 private:
  static constexpr int kLeafSize = 1;

  void build(const std::vector<Box>& boxes, int begin, int end) {
    const size_t self = nodes.size();
    Box box, centers;
    for (int i = begin; i < end; ++i) {
      box.extend(boxes[order[i]]);
      centers.extend(boxes[order[i]].center());
    }
    nodes.push_back({box, begin, end, 0});
    if (end - begin <= kLeafSize) return;
    // Splits at the median, not the middle: the tree is balanced however uneven the mesh is, so the recursion stays
    // shallow.
    int axis;
    centers.sizes().maxCoeff(&axis);
    const int middle = (begin + end) / 2;
    std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end, [&](int a, int b) {
      const double x = boxes[a].center()[axis], y = boxes[b].center()[axis];
      return x != y ? x < y : a < b;  // ties by index, for the same tree with every standard library
    });
    build(boxes, begin, middle);
    nodes[self].right = int(nodes.size());
    build(boxes, middle, end);
  }

  template <class Visit>
  void nearest(int index, const Vector3d& p, const double& best, Visit& visit) const {
    const Node& node = nodes[index];
    if (node.leaf()) {
      for (int i = node.begin; i < node.end; ++i) visit(order[i]);
      return;
    }
    int near = index + 1, far = node.right;
    double near_distance = nodes[near].box.squaredExteriorDistance(p);
    double far_distance = nodes[far].box.squaredExteriorDistance(p);
    if (far_distance < near_distance) {
      std::swap(near, far);
      std::swap(near_distance, far_distance);
    }
    if (near_distance < best) nearest(near, p, best, visit);
    if (far_distance < best) nearest(far, p, best, visit);
  }

  template <class Visit>
  void along(int index, const Vector3d& p, const Vector3d& direction, const double& best, Visit& visit,
             const Bvh* moved) const {
    const Node& node = nodes[index];
    const Box box = moved ? node.box.merged(moved->nodes[index].box) : node.box;
    double enter = 0, leave = best;
    for (int axis = 0; axis < 3; ++axis) {
      const double low = box.min()[axis] - p[axis], high = box.max()[axis] - p[axis];
      if (direction[axis] == 0 && low <= 0 && high >= 0) continue;  // avoids 0 / 0 on the side of a box
      enter = std::max(enter, std::min(low / direction[axis], high / direction[axis]));
      leave = std::min(leave, std::max(low / direction[axis], high / direction[axis]));
    }
    if (enter > leave) return;
    if (node.leaf()) {
      for (int i = node.begin; i < node.end; ++i) visit(order[i]);
      return;
    }
    along(index + 1, p, direction, best, visit, moved);
    along(node.right, p, direction, best, visit, moved);
  }
};

}  // namespace dynamorph
