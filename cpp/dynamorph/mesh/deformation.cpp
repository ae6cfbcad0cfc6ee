// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/deformation.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <stdexcept>
#include <string>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

namespace {

using Eigen::Index;

constexpr double kLow = 0.001, kHigh = 0.999;  // shares below which the percentiles are
constexpr Index kAtOnce = 4;                   // frames per task: they share one reading of the modes

/// The skin at rest, with which all frames are compared.
class Rest {
 public:
  Rest(const Points& points, const Triangles& triangles, const std::vector<EdgeEnds>& edges);

  /// Writes frame f of `out` from distances d (V) and moved points x + u (V, 3). scratch: any.
  void measure(const VectorXd& d, const Points& moved, Index f, std::vector<Weighted>& scratch, Deformation& out) const;

 private:
  const Triangles& triangles_;
  const std::vector<EdgeEnds>& edges_;
  Points normals_;                 ///< as long as the triangles' areas (T, 3)
  VectorXd areas_;                 ///< of the vertices (V)
  double area_ = 0;                ///< of the whole skin
  std::vector<VectorXd> lengths_;  ///< of each mesh's edges
};

Rest::Rest(const Points& points, const Triangles& triangles, const std::vector<EdgeEnds>& edges)
    : triangles_(triangles), edges_(edges), normals_(triangles.rows(), 3), areas_(VectorXd::Zero(points.rows())) {
  check_triangles(points, triangles);
  for (Index t = 0; t < triangles.rows(); ++t) {
    normals_.row(t) = area_vector(points, triangles, t);
    const double area = normals_.row(t).norm();
    for (int v : triangles.row(t)) areas_[v] += area / 3;
    area_ += area;
  }
  if (!std::isfinite(area_)) throw std::invalid_argument("rest: its area must be finite");
  for (const EdgeEnds& ends : edges) {
    if (ends.rows() == 0) throw std::invalid_argument("edges: expected at least one for each mesh");
    if (ends.minCoeff() < 0 || ends.maxCoeff() >= points.rows())
      throw std::invalid_argument("edges: expected vertex indices from 0 to " + std::to_string(points.rows() - 1) +
                                  ", got " + std::to_string(ends.minCoeff()) + " to " +
                                  std::to_string(ends.maxCoeff()));
    VectorXd& lengths = lengths_.emplace_back(ends.rows());
    for (Index e = 0; e < ends.rows(); ++e) {
      lengths[e] = (points.row(ends(e, 0)) - points.row(ends(e, 1))).norm();
      if (!(lengths[e] > 0 && std::isfinite(lengths[e])))
        throw std::invalid_argument("edges: expected finite lengths above zero at rest, got " +
                                    std::to_string(lengths[e]) + " m");
    }
  }
}

void Rest::measure(const VectorXd& d, const Points& moved, Index f, std::vector<Weighted>& scratch,
                   Deformation& out) const {
  scratch.clear();
  for (Index v = 0; v < d.size(); ++v)
    if (areas_[v] > 0) scratch.push_back({d[v], areas_[v]});
  if (!scratch.empty()) {
    out.percentile[f] = quantile(scratch, kHigh);
    for (const Weighted& each : scratch) out.largest[f] = std::max(out.largest[f], each.value);
  }

  if (!edges_.empty()) out.shortest[f] = kInfinity, out.longest[f] = 0;
  for (size_t mesh = 0; mesh < edges_.size(); ++mesh) {
    const EdgeEnds& ends = edges_[mesh];
    const VectorXd& lengths = lengths_[mesh];
    scratch.clear();
    for (Index e = 0; e < ends.rows(); ++e)
      scratch.push_back({(moved.row(ends(e, 0)) - moved.row(ends(e, 1))).norm() / lengths[e], lengths[e]});
    out.shortest[f] = std::min(out.shortest[f], quantile(scratch, kLow));
    out.longest[f] = std::max(out.longest[f], quantile(scratch, kHigh));
  }

  double flipped = 0;
  for (Index t = 0; t < triangles_.rows(); ++t)
    if (area_vector(moved, triangles_, t).dot(normals_.row(t)) < 0) flipped += normals_.row(t).norm();
  if (area_ > 0) out.flipped[f] = flipped / area_;
}

/// A B for few rows A, in stretches of columns of B that stay in the cache. Eigen's product of matrices first copies B
/// into another order, which takes longer than such a product.
RowMajor few_rows(const Eigen::Ref<const RowMajor>& A, const Eigen::Ref<const RowMajor>& B) {
  constexpr Index kStretch = 512;
  RowMajor out(A.rows(), B.cols());
  for (Index first = 0; first < B.cols(); first += kStretch) {
    const Index count = std::min(kStretch, B.cols() - first);
    for (Index i = 0; i < A.rows(); ++i)
      out.row(i).segment(first, count).noalias() = A.row(i) * B.middleCols(first, count);
  }
  return out;
}

}  // namespace

Deformation measure_deformation(const Points& rest, const Triangles& triangles, const std::vector<EdgeEnds>& edges,
                                const Eigen::Ref<const RowMajor>& coordinates, const Eigen::Ref<const RowMajor>& modes,
                                const ProgressFn& progress) {
  const Rest at_rest(rest, triangles, edges);
  check_size("modes", modes.rows(), coordinates.cols());
  if (modes.cols() != rest.size()) throw std::invalid_argument("modes: expected one displacement per vertex of `rest`");
  const Index frames = coordinates.rows();
  const VectorXd none = VectorXd::Zero(frames), whole = VectorXd::Ones(frames);
  Deformation out{none, none, whole, whole, none, VectorXd::Zero(rest.rows())};
  std::mutex mutex;
  run_tasks(int((frames + kAtOnce - 1) / kAtOnce), progress, [&](int task, const ProgressFn& done) {
    const Index first = task * kAtOnce, count = std::min(kAtOnce, frames - first);
    const RowMajor u = few_rows(coordinates.middleRows(first, count), modes);
    if (!u.allFinite()) throw std::invalid_argument("coordinates, modes: the displacements must be finite");
    VectorXd farthest = VectorXd::Zero(rest.rows());
    std::vector<Weighted> scratch;
    for (Index k = 0; k < count; ++k) {
      const Eigen::Map<const Points> displacement(u.row(k).data(), rest.rows(), 3);
      const VectorXd d = displacement.rowwise().norm();
      farthest = farthest.cwiseMax(d);
      at_rest.measure(d, rest + displacement, first + k, scratch, out);
    }
    const std::lock_guard lock(mutex);
    out.farthest = out.farthest.cwiseMax(farthest);  // the same in whatever order the tasks end
    report(done, 1);
  });
  return out;
}

double quantile(std::vector<Weighted>& values, double share) {
  const auto less = [](const Weighted& a, const Weighted& b) { return a.value < b.value; };
  const auto sum = [](auto first, auto last) {
    double weight = 0;
    for (; first != last; ++first) weight += first->weight;
    return weight;
  };
  auto first = values.begin(), last = values.end();
  double left = share * sum(first, last);  // weight up to the quantile, without the values that are ruled out below it
  // The first cut is near the end that the share is near: where all weigh the same, beyond it lies twice what is
  // needed.
  const double cut = share < 0.5 ? 2 * share : 2 * share - 1;
  auto middle = first + std::clamp<Index>(Index(cut * double(values.size())), 1, std::max<Index>(last - first - 1, 1));
  for (; last - first > 1; middle = first + (last - first) / 2) {
    std::nth_element(first, middle, last, less);
    const double lower = sum(first, middle);
    if (left <= lower) {
      last = middle;
    } else {
      left -= lower;
      first = middle;
    }
  }
  return first->value;
}

}  // namespace dynamorph
