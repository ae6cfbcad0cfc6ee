// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/free_motion.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstdio>
#include <map>

#include "dynamorph/core/disjoint_sets.hpp"
#include "dynamorph/core/errors.hpp"

namespace dynamorph {

namespace {

using Eigen::Index;

constexpr double kNear = 1e-6;         // of the body's size; nodes this near to a point or a line are on it
constexpr double kUnresisted = 1e-13;  // squared, of a motion of size one
constexpr int kMostParts = 64;         // that hang together only by edges and corners; more take too long to solve

/// The parts of a body that move as a whole when nothing resists. Their numbers are those of the sets: 1 + t for tet t;
/// 0 stands for what cannot move.
class Parts {
 public:
  explicit Parts(const SoftBody& body)
      : body_(body), sets_(1 + body.mesh.tets.rows()), touching_(body.mesh.nodes.rows()) {
    for (const auto& [a, b] : face_neighbors(body.mesh.tets)) sets_.join(1 + a, 1 + b);
    for (bool joined = true; joined;) {
      joined = false;
      find_contacts();
      for (const auto& [pair, nodes] : contacts_)
        if (deciding(nodes).size() == 3) {
          sets_.join(pair.first, pair.second);
          joined = true;
        }
    }
  }

  void check() {
    const std::vector<int> loose = loose_parts();
    if (loose.empty()) return;
    std::vector<Free> free;
    for (int part : loose) {
      const std::vector<int> at = deciding(contacts_of(part));
      if (at.size() < 3) free.push_back({part, at});
    }
    if (!free.empty()) throw Error(advice(free));
    if (int(loose.size()) <= kMostParts && can_fold(loose))
      throw Error("The cage can fold: " + std::to_string(loose.size()) +
                  " of its parts hang together only by edges or corners of tetrahedra. Use more nodes, or pin or "
                  "hold them.");
  }

 private:
  /// A part, and the nodes (none, one, or two) that decide where it is attached.
  struct Free {
    int part;
    std::vector<int> at;
  };
  using Pair = std::pair<int, int>;

  Vector3d point(int node) const { return body_.mesh.nodes.row(node); }

  /// Finds the nodes that any two parts share.
  void find_contacts() {
    for (std::vector<int>& parts : touching_) parts.clear();
    for (int t = 0; t < body_.mesh.tets.rows(); ++t)
      for (int node : body_.mesh.tets.row(t)) touching_[node].push_back(sets_.root(1 + t));
    contacts_.clear();
    for (int node = 0; node < int(touching_.size()); ++node) {
      std::vector<int>& parts = touching_[node];
      const int free = body_.free_of_node[node];
      if (free < 0 || (body_.hold_stiffness.size() > 0 && body_.hold_stiffness.row(free).any()))
        parts.push_back(sets_.root(0));
      std::sort(parts.begin(), parts.end());
      parts.erase(std::unique(parts.begin(), parts.end()), parts.end());
      for (size_t a = 0; a < parts.size(); ++a)
        for (size_t b = a + 1; b < parts.size(); ++b) contacts_[{parts[a], parts[b]}].push_back(node);
    }
  }

  std::vector<int> loose_parts() {
    std::vector<int> loose;
    for (const std::vector<int>& parts : touching_) loose.insert(loose.end(), parts.begin(), parts.end());
    std::sort(loose.begin(), loose.end());
    loose.erase(std::unique(loose.begin(), loose.end()), loose.end());
    loose.erase(std::remove(loose.begin(), loose.end(), sets_.root(0)), loose.end());
    return loose;
  }

  std::vector<int> contacts_of(int part) const {
    std::vector<int> out;
    for (const auto& [pair, nodes] : contacts_)
      if (pair.first == part || pair.second == part) out.insert(out.end(), nodes.begin(), nodes.end());
    return out;
  }

  /// A few of the nodes: a rigid motion that leaves these in place leaves all in place. Three, or two if all are on a
  /// line, or one if all are at one point.
  std::vector<int> deciding(const std::vector<int>& nodes) const {
    std::vector<int> out;
    Vector3d along = Vector3d::Zero();
    const auto distance = [&](int node) {
      const Vector3d from = point(node) - point(out[0]);
      return (from - along * along.dot(from)).norm();
    };
    while (out.size() < std::min<size_t>(nodes.size(), 3)) {
      if (out.size() == 2) along = (point(out[1]) - point(out[0])).normalized();
      const int next = out.empty() ? nodes[0] : *std::max_element(nodes.begin(), nodes.end(), [&](int a, int b) {
        return distance(a) < distance(b);
      });
      if (!out.empty() && distance(next) <= kNear * body_.size) break;
      out.push_back(next);
    }
    return out;
  }

  /// Whether the parts can move against each other: whether v + omega x X of each can agree where they touch. Both are
  /// in units of the body's size.
  bool can_fold(const std::vector<int>& loose) {
    MatrixXd resistance = MatrixXd::Zero(6 * Index(loose.size()), 6 * Index(loose.size()));
    Eigen::Matrix<double, 3, Eigen::Dynamic> apart(3, resistance.cols());
    for (const auto& [pair, nodes] : contacts_)
      for (int node : deciding(nodes)) {
        apart.setZero();
        for (int part : {pair.first, pair.second}) {
          const auto found = std::lower_bound(loose.begin(), loose.end(), part);
          if (found == loose.end() || *found != part) continue;
          const double sign = part == pair.first ? 1 : -1;
          const Vector3d x = (point(node) - body_.center) / body_.size;
          auto motion = apart.middleCols<6>(6 * (found - loose.begin()));
          motion.leftCols<3>() = sign * Matrix3d::Identity();
          for (int axis = 0; axis < 3; ++axis) motion.col(3 + axis) = sign * Vector3d::Unit(axis).cross(x);
        }
        resistance.noalias() += apart.transpose() * apart;
      }
    return Eigen::SelfAdjointEigenSolver<MatrixXd>(resistance, Eigen::EigenvaluesOnly).eigenvalues()(0) < kUnresisted;
  }

  std::string text(const Vector3d& v, double negligible) const {
    char out[96];
    const Vector3d rounded = (v.array().abs() <= negligible).select(0, v);
    std::snprintf(out, sizeof out, "(%.3g, %.3g, %.3g)", rounded.x(), rounded.y(), rounded.z());
    return out;
  }

  /// Says what the least attached part can do; among equals, the largest.
  std::string advice(const std::vector<Free>& free) const {
    std::map<int, int> nodes;  // of each part
    for (const std::vector<int>& parts : touching_)
      for (int part : parts) ++nodes[part];
    const Free& worst = *std::min_element(free.begin(), free.end(), [&](const Free& a, const Free& b) {
      return a.at.size() != b.at.size() ? a.at.size() < b.at.size() : nodes[a.part] > nodes[b.part];
    });
    const int count = nodes[worst.part];
    const bool whole = count == int(touching_.size());
    Vector3d middle = Vector3d::Zero();
    for (size_t node = 0; node < touching_.size(); ++node)
      if (std::binary_search(touching_[node].begin(), touching_[node].end(), worst.part))
        middle += point(int(node)) / count;
    const double negligible = kNear * body_.size;
    const std::string subject = "A part of the cage, " + std::to_string(count) + " of its " +
                                std::to_string(touching_.size()) + " nodes, around " + text(middle, negligible) +
                                " m, ";
    const std::string hold = ", or hold the body.";
    if (worst.at.empty()) {
      if (whole) return "Nothing holds this body: no node is pinned or held. Pin some" + hold;
      const auto unattached = std::count_if(free.begin(), free.end(), [](const Free& f) { return f.at.empty(); });
      return subject + "is attached to nothing" +
             (unattached > 1 ? ", nor are " + std::to_string(unattached - 1) + " others" : "") +
             ". Pin nodes of each part" + hold;
    }
    const Vector3d from = point(worst.at[0]);
    std::string turn =
        "about the point " + text(from, negligible) + " m, the only place where it is attached. Pin other nodes";
    if (worst.at.size() == 2) {
      Vector3d along = (point(worst.at[1]) - from).normalized();
      Index longest;
      along.cwiseAbs().maxCoeff(&longest);
      if (along(longest) < 0) along = -along;
      turn = "about an axis through " + text(from, negligible) + " m along " + text(along, kNear) +
             ", because it is attached only along this line. Pin nodes beside it";
    }
    return (whole ? "This body " : subject) + "can turn " + turn + hold;
  }

  const SoftBody& body_;
  DisjointSets sets_;
  std::vector<std::vector<int>> touching_;     ///< the parts at each node, ascending
  std::map<Pair, std::vector<int>> contacts_;  ///< the nodes that two parts share
};

}  // namespace

void check_no_free_motion(const SoftBody& body) { Parts(body).check(); }

}  // namespace dynamorph
