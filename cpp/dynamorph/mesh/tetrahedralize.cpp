// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/tetrahedralize.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <vector>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/mesh/surface.hpp"
#include "tetgen.h"

namespace dynamorph {

namespace {

/// The message to the artist when TetGen gives up for `reason`.
std::string advice(const std::string& reason) {
  const auto says = [&](const char* words) { return reason.find(words) != std::string::npos; };
  if (says("Out of memory")) return "The mesher ran out of memory. Lower the cage resolution.";
  if (says("self-intersection"))
    return "The cage intersects itself. Remove the intersections, or use the automatic cage.";
  if (says("coplanar") || says("collinear") || says("identical")) return "The cage is flat. Give it thickness.";
  if (says("small input feature"))
    return "The cage has details too small to mesh. Merge its vertices by distance, or change the cage resolution.";
  return "The cage could not be filled with tetrahedra (" + reason +
         "). Make it closed, or change the cage resolution a little.";
}

/// `in` is filled in place, because a tetgenio owns its arrays but cannot be copied.
void load(tetgenio& in, const Points& points, const Triangles& triangles) {
  in.numberofpoints = int(points.rows());
  in.pointlist = new REAL[points.size()];
  std::copy_n(points.data(), points.size(), in.pointlist);
  in.numberoffacets = int(triangles.rows());
  in.facetlist = new tetgenio::facet[triangles.rows()];
  for (int t = 0; t < triangles.rows(); ++t) {
    tetgenio::facet& facet = in.facetlist[t];
    tetgenio::init(&facet);
    facet.numberofpolygons = 1;
    facet.polygonlist = new tetgenio::polygon[1];
    tetgenio::init(facet.polygonlist);
    facet.polygonlist->numberofvertices = 3;
    facet.polygonlist->vertexlist = new int[3]{triangles(t, 0), triangles(t, 1), triangles(t, 2)};
  }
}

/// The mesh without tets of zero volume. This leaves no gap between their neighbors.
TetMesh without_flat(const TetMesh& mesh) {
  constexpr double kFlat = 1e-9;  // relative to the cube of the longest edge
  const VectorXd volume = volumes(mesh);
  std::vector<int> kept;
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) {
    double longest = 0;
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < a; ++b)
        longest = std::max(longest, (mesh.nodes.row(mesh.tets(t, a)) - mesh.nodes.row(mesh.tets(t, b))).norm());
    if (volume[t] > kFlat * std::pow(longest, 3)) kept.push_back(int(t));
  }
  std::vector<int> number(mesh.nodes.rows(), -1), nodes;
  for (int t : kept)
    for (int node : mesh.tets.row(t)) number[node] = 0;
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i)
    if (number[i] == 0) {
      number[i] = int(nodes.size());
      nodes.push_back(int(i));
    }
  TetMesh clean{Points(nodes.size(), 3), Tets(kept.size(), 4)};
  for (size_t i = 0; i < nodes.size(); ++i) clean.nodes.row(i) = mesh.nodes.row(nodes[i]);
  for (size_t t = 0; t < kept.size(); ++t)
    for (int k = 0; k < 4; ++k) clean.tets(t, k) = number[mesh.tets(kept[t], k)];
  return clean;
}

/// volume_limit <= 0 means no limit.
TetMesh run_tetgen(tetgenio& in, double volume_limit, int most_nodes) {
  // p: fill a surface, Q: quiet, F: write no files (TetGen writes self-intersections), Y: add nothing on the surface,
  // q: radius-edge ratio / dihedral angle, S: most nodes to add, o: flip and smooth tets with wider dihedral angles
  // (TetGen's own 165 leaves fifteen times as many angles under 5 degrees).
  char switches[96];
  std::snprintf(switches, sizeof switches, "pQFYq1.5/8o/150S%d", most_nodes);
  std::string command = switches;
  if (volume_limit > 0) {
    std::snprintf(switches, sizeof switches, "a%.12f", volume_limit);  // TetGen cannot read exponents
    command += switches;
  }
  tetgenio out;
  try {
    ::tetrahedralize(command.data(), &in, &out);
  } catch (const std::runtime_error& error) {
    throw Error(advice(error.what()));
  } catch (int code) {  // the original TetGen throws these; the sdist's edition replaces most, but not all
    throw Error(advice(code == 1 ? "Out of memory" : "TetGen error " + std::to_string(code)));
  }
  if (out.numberoftetrahedra == 0) throw Error(advice("no tetrahedra inside"));
  TetMesh mesh{Eigen::Map<Points>(out.pointlist, out.numberofpoints, 3),
               Eigen::Map<Tets>(out.tetrahedronlist, out.numberoftetrahedra, 4)};
  const VectorXd volume = volumes(mesh);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t)
    if (volume[t] < 0) std::swap(mesh.tets(t, 2), mesh.tets(t, 3));
  return without_flat(mesh);
}

/// Starts with the fewest nodes that give good tets, then limits the volume of tets until there are about as many nodes
/// as wanted. The number of nodes added is proportional to limit^-1.4 (measured).
TetMesh fill(tetgenio& in, int target_nodes, int most_nodes) {
  constexpr double kCloseEnough = 0.05;
  constexpr int kTries = 6;
  TetMesh best = run_tetgen(in, 0, most_nodes);
  const int fewest = int(best.nodes.rows());
  double limit = volumes(best).sum() / (2.0 * target_nodes);
  const auto error = [&](const TetMesh& mesh) { return std::abs(mesh.nodes.rows() / double(target_nodes) - 1); };
  for (int i = 0; i < kTries && fewest < target_nodes && error(best) > kCloseEnough; ++i) {
    TetMesh mesh = run_tetgen(in, limit, most_nodes);
    const double added = std::max<double>(mesh.nodes.rows() - fewest, 1);
    limit *= std::clamp(std::pow(added / (target_nodes - fewest), 0.7), 0.3, 3.0);
    if (error(mesh) < error(best)) best = std::move(mesh);
  }
  return best;
}

}  // namespace

TetMesh tetrahedralize(const Points& vertices, const Triangles& triangles, int target_nodes, const Points& inner) {
  if (target_nodes < 4)
    throw std::invalid_argument("target_nodes: expected at least 4, got " + std::to_string(target_nodes));
  check_triangles(vertices, triangles);
  if (triangles.rows() == 0) throw Error("The cage has no faces. Choose a closed mesh.");
  if (!vertices.allFinite())
    throw Error("The cage has a NaN or infinite coordinate. Delete that vertex.");  // TetGen would hang
  const Eigen::AlignedBox3d box = Surface(vertices, triangles).box();
  const double size = box.diagonal().norm();
  if (!(size > 0)) throw Error("The cage is a single point. Scale it.");
  // Points without facets are kept as nodes. (TetGen's own list of extra points, -i, crashes with -Y.)
  Points unit(vertices.rows() + inner.rows(), 3);
  unit << vertices, inner;
  unit = ((unit.rowwise() - box.min().transpose()) / size).eval();  // TetGen's tolerances and 'a' need unit size

  tetgenio in;
  load(in, unit, triangles);
  const int most_nodes = 4 * target_nodes;
  TetMesh mesh = fill(in, target_nodes, most_nodes);
  if (mesh.nodes.rows() > most_nodes)
    throw Error("The cage needs " + std::to_string(mesh.nodes.rows()) + " nodes, many more than the " +
                std::to_string(target_nodes) + " asked for. Raise the resolution, or simplify the cage mesh.");
  mesh.nodes = (mesh.nodes * size).rowwise() + box.min().transpose();
  return make_tet_mesh(std::move(mesh.nodes), std::move(mesh.tets));
}

}  // namespace dynamorph
