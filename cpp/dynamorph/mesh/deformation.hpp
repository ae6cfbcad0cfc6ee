// SPDX-License-Identifier: GPL-3.0-or-later
// How far displacements u move a skin, and how much they stretch it and turn it over: what torn or inverted skin shows.
//
//   d_v = |u_v|                                of a vertex, which counts by its third of the triangles around it
//   s_e = |(x_a + u_a) - (x_b + u_b)| / l_e    of an edge ab, which counts by its length l_e at rest
//   n_t . N_t < 0                              a triangle is flipped when its normal turns by more than 90 degrees
#pragma once

#include <vector>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// One edge per row: the indices of its ends.
using EdgeEnds = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 2, Eigen::RowMajor>;

/// What displacements do to a skin in each of F frames. Vertices around which no triangle has an area do not count,
/// except in `farthest`.
struct Deformation {
  VectorXd largest;     ///< d (F), meters
  VectorXd percentile;  ///< the 99.9th percentile of d (F), meters
  VectorXd shortest;    ///< the 0.1th percentile of s (F), in the mesh where it is lowest; 1 without edges
  VectorXd longest;     ///< the 99.9th percentile of s (F), in the mesh where it is highest; 1 without edges
  VectorXd flipped;     ///< share of the skin's area (F)
  VectorXd farthest;    ///< the largest d of each vertex (V) in all frames, meters
};

/// rest (V, 3), meters; triangles (T, 3); edges: some of each mesh, because a small mesh that is torn is visible too.
/// coordinates (F, r) and modes (r, 3V), meters: u = coordinates modes. Only a few frames are in memory at a time.
/// Throws std::invalid_argument on wrong sizes or indices, edges without a length, and displacements that are not
/// finite.
Deformation measure_deformation(const Points& rest, const Triangles& triangles, const std::vector<EdgeEnds>& edges,
                                const Eigen::Ref<const RowMajor>& coordinates, const Eigen::Ref<const RowMajor>& modes,
                                const ProgressFn& progress = {});

struct Weighted {
  double value, weight;
};

/// The smallest value up to which the values have at least this share, 0..1, of all weights. The weights must not be
/// negative. There must be a value; the order of the values changes.
double quantile(std::vector<Weighted>& values, double share);

}  // namespace dynamorph
