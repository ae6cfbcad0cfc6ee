// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/mesh/tet_mesh.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

namespace {

using Eigen::Vector4d;

constexpr double lowest_weight = -0.5;
constexpr double fill_floor = 0.05;
constexpr double infinity = std::numeric_limits<double>::infinity();

/// Six times the signed volume.
double determinant(const TetMesh& mesh, Eigen::Index tet) {
  const Eigen::Vector4i t = mesh.tets.row(tet);
  const Vector3d a = mesh.nodes.row(t[0]), b = mesh.nodes.row(t[1]), c = mesh.nodes.row(t[2]), d = mesh.nodes.row(t[3]);
  return (b - a).cross(c - a).dot(d - a);
}

/// One tet, ready for queries.
struct Tet {
  Vector3d corners[4];
  Matrix3d to_weights;  // of corners 1..3, from x - corners[0]

  Tet(const TetMesh& mesh, Eigen::Index t) {
    for (int k = 0; k < 4; ++k) corners[k] = mesh.nodes.row(mesh.tets(t, k));
    Matrix3d edges;
    edges << corners[1] - corners[0], corners[2] - corners[0], corners[3] - corners[0];
    to_weights = edges.inverse();
  }

  Vector4d weights(const Vector3d& p) const {
    const Vector3d w = to_weights * (p - corners[0]);
    return {1 - w.sum(), w[0], w[1], w[2]};
  }

  Vector3d point(const Vector4d& w) const {
    return w[0] * corners[0] + w[1] * corners[1] + w[2] * corners[2] + w[3] * corners[3];
  }

  Vector3d closest(const Vector3d& p) const {
    if (weights(p).minCoeff() >= 0) return p;
    Vector3d best = corners[0];
    for (int k = 0; k < 4; ++k) {
      const Vector3d q = closest_on_triangle(p, corners[(k + 1) % 4], corners[(k + 2) % 4], corners[(k + 3) % 4]);
      if ((q - p).squaredNorm() < (best - p).squaredNorm()) best = q;
    }
    return best;
  }

  /// The weights of p, or on the way from the closest point to p the last that are all >= lowest_weight.
  Vector4d bounded_weights(const Vector3d& p, const Vector3d& closest) const {
    const Vector4d near = weights(closest), far = weights(p);
    double t = 1;
    for (int k = 0; k < 4; ++k)
      if (far[k] < lowest_weight) t = std::min(t, (lowest_weight - near[k]) / (far[k] - near[k]));
    return near + t * (far - near);
  }
};

std::vector<Tet> prepare(const TetMesh& mesh) {
  std::vector<Tet> tets;
  tets.reserve(mesh.tets.rows());
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) tets.emplace_back(mesh, t);
  return tets;
}

Bvh tree_of(const std::vector<Tet>& tets) {
  std::vector<Bvh::Box> boxes(tets.size());
  for (size_t t = 0; t < tets.size(); ++t)
    for (const Vector3d& corner : tets[t].corners) boxes[t].extend(corner);
  return Bvh(boxes);
}

/// 20 points spread evenly over a tet, as weights.
std::vector<Vector4d> sample_weights() {
  constexpr int n = 3;
  std::vector<Vector4d> samples;
  for (int i = 0; i <= n; ++i)
    for (int j = 0; i + j <= n; ++j)
      for (int k = 0; i + j + k <= n; ++k)
        samples.push_back((Vector4d(i, j, k, n - i - j - k).array() + 0.5) / (n + 2));
  return samples;
}

double distance_to_segment(const Vector3d& p, const Vector3d& a, const Vector3d& b) {
  const Vector3d ab = b - a;
  const double length2 = ab.squaredNorm();
  const double t = length2 > 0 ? std::clamp(ab.dot(p - a) / length2, 0.0, 1.0) : 0;
  return (a + t * ab - p).norm();
}

/// Laplacian of the graph of tet edges, each edge counted once for every tet that has it. Unlike the finite element
/// Laplacian its weights are positive on slivers too, so interpolated values keep to the range of the data.
SparseMatrix graph_laplacian(const TetMesh& mesh) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(mesh.tets.rows() * 24);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t)
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b)
        if (a != b) {
          entries.emplace_back(mesh.tets(t, a), mesh.tets(t, a), 1);
          entries.emplace_back(mesh.tets(t, a), mesh.tets(t, b), -1);
        }
  SparseMatrix laplacian(mesh.nodes.rows(), mesh.nodes.rows());
  laplacian.setFromTriplets(entries.begin(), entries.end());
  return laplacian;
}

/// Part of the samples of a tet that the surface contains.
double filled(const Tet& tet, const Surface& surface, const std::vector<Vector4d>& samples) {
  const Vector3d center = tet.point(Vector4d::Constant(0.25));
  double radius = 0;
  for (const Vector3d& corner : tet.corners) radius = std::max(radius, (corner - center).norm());
  const double clearance = surface.distance(center);
  const bool center_inside = surface.contains(center);
  if (clearance > radius) return center_inside;  // the skin does not pass through it
  const auto inside = [&](const Vector4d& weights) {
    const Vector3d p = tet.point(weights);
    return (p - center).norm() < clearance ? center_inside : surface.contains(p);
  };
  return double(std::count_if(samples.begin(), samples.end(), inside)) / double(samples.size());
}

}  // namespace

TetMesh make_tet_mesh(Points nodes, Tets tets) {
  TetMesh mesh{std::move(nodes), std::move(tets)};
  if (!mesh.nodes.allFinite()) throw std::invalid_argument("nodes: expected finite coordinates");
  if (mesh.tets.size() && (mesh.tets.minCoeff() < 0 || mesh.tets.maxCoeff() >= mesh.nodes.rows()))
    throw std::invalid_argument("tets: expected node indices from 0 to " + std::to_string(mesh.nodes.rows() - 1));
  std::vector<bool> used(mesh.nodes.rows(), false);
  for (Eigen::Index t = 0; t < mesh.tets.rows(); ++t) {
    if (!(determinant(mesh, t) > 0))
      throw std::invalid_argument("tets: tet " + std::to_string(t) + " is flat or inside out");
    for (int node : mesh.tets.row(t)) used[node] = true;
  }
  const auto unused = std::find(used.begin(), used.end(), false);
  if (unused != used.end())
    throw std::invalid_argument("nodes: node " + std::to_string(unused - used.begin()) + " belongs to no tet");
  return mesh;
}

VectorXd volumes(const TetMesh& mesh) {
  VectorXd v(mesh.tets.rows());
  for (Eigen::Index t = 0; t < v.size(); ++t) v[t] = determinant(mesh, t) / 6;
  return v;
}

Embedding embed(const TetMesh& mesh, const Points& points, const MayCarry& may_carry) {
  if (!points.allFinite()) throw Error("The surface has a NaN or infinite coordinate. Fix or delete that vertex.");
  if (mesh.tets.rows() == 0) throw std::invalid_argument("mesh: expected at least one tet");
  const std::vector<Tet> tets = prepare(mesh);
  const Bvh tree = tree_of(tets);
  Embedding e{Tets(points.rows(), 4), {points.rows(), 4}, VectorXd(points.rows())};
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Vector3d p = points.row(i);
    double best = infinity;
    int nearest = -1;
    Vector3d closest = p;
    const auto search = [&](bool any) {
      best = infinity;
      tree.nearest(p, best, [&](int t) {
        const Vector3d q = tets[t].closest(p);
        if ((q - p).squaredNorm() >= best || !(any || may_carry(i, t))) return;
        best = (q - p).squaredNorm();
        closest = q;
        nearest = t;
      });
      return best < infinity;
    };
    search(true);
    if (may_carry && !may_carry(i, nearest) && !search(false)) search(true);
    e.nodes.row(i) = mesh.tets.row(nearest);
    e.weights.row(i) = tets[nearest].bounded_weights(p, closest);
    e.distances[i] = std::sqrt(best);
  }
  return e;
}

SparseMatrix Embedding::matrix(Eigen::Index node_count) const {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(weights.size());
  for (Eigen::Index i = 0; i < nodes.rows(); ++i)
    for (int k = 0; k < 4; ++k) entries.emplace_back(i, nodes(i, k), weights(i, k));
  SparseMatrix matrix(nodes.rows(), node_count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

VectorXd fill_fractions(const TetMesh& mesh, const Points& vertices, const Triangles& triangles,
                        const ProgressFn& progress) {
  constexpr Eigen::Index kBlock = 256;  // of tets
  const ClosedSurface closed = close_surface(vertices, triangles);
  const Surface surface(closed.vertices, closed.triangles);
  const std::vector<Vector4d> samples = sample_weights();
  const Eigen::Index tets = mesh.tets.rows();
  VectorXd fractions(tets);
  in_parallel(int((tets + kBlock - 1) / kBlock), progress, [&](int block, const ProgressFn& done) {
    for (Eigen::Index t = block * kBlock; t < std::min(tets, (block + 1) * kBlock); ++t)
      fractions[t] = std::max(fill_floor, filled(Tet(mesh, t), surface, samples));
    report(done, 1);
  });
  return fractions;
}

MatrixXd extend_to_nodes(const TetMesh& mesh, const Embedding& embedding, const MatrixXd& values) {
  const SparseMatrix e = embedding.matrix(mesh.nodes.rows());
  const SparseMatrix fit = e.transpose() * e, smooth = graph_laplacian(mesh);
  const double scale = fit.diagonal().sum() / smooth.diagonal().sum();
  SparseMatrix unit(mesh.nodes.rows(), mesh.nodes.rows());
  unit.setIdentity();
  // The last term only decides on a piece of mesh without surface points: zero there.
  const SparseMatrix system = fit + 1e-2 * scale * smooth + 1e-12 * unit;
  const Eigen::SimplicialLDLT<SparseMatrix> solver(system);
  if (solver.info() != Eigen::Success)
    throw Error("Surface values could not be extended into the cage. Change the cage resolution a little.");
  return solver.solve(e.transpose() * values);
}

Points points_on_bones(const Points& cage, const Triangles& triangles, const Points& skin, const Triangles& faces,
                       const Points& heads, const Points& tails, double ratio) {
  if (heads.rows() != tails.rows()) throw std::invalid_argument("tails: expected as many as heads");
  const Surface surface(cage, triangles), body(skin, faces);
  double spacing = 0;
  for (Eigen::Index t = 0; t < triangles.rows(); ++t)
    spacing += (cage.row(triangles(t, 0)) - cage.row(triangles(t, 1))).norm() / double(triangles.rows());
  const double room = 0.4 * spacing;  // nodes nearer to the cage or to each other make slivers
  std::vector<Vector3d> kept;
  const auto keep = [&](const Vector3d& p) {
    const auto crowds = [&](const Vector3d& other) { return (other - p).norm() < room; };
    const bool fits =
        std::none_of(kept.begin(), kept.end(), crowds) && surface.contains(p) && surface.distance(p) >= room;
    if (fits) kept.push_back(p);
    return fits;
  };
  for (Eigen::Index b = 0; b < heads.rows(); ++b) {
    const Vector3d head = heads.row(b), along = Vector3d(tails.row(b)) - head;
    const Eigen::Quaterniond frame = Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), along);
    const int pieces = std::max(1, int(std::round(along.norm() / spacing)));
    for (int i = 0; i <= pieces; ++i) {
      const Vector3d p = head + along * i / pieces;
      // Well within what is held, and away from the cage too.
      const double radius =
          surface.contains(p) ? ratio * std::min(0.75 * surface.distance(p), 0.9 * body.distance(p)) : 0;
      bool around = false;
      for (int corner = 0; corner < 3 && std::sqrt(3) * radius >= room; ++corner) {
        const double angle = M_PI / 3 * (2 * corner + i % 2);  // each triangle turned against the last
        around |= keep(p + radius * (frame * Vector3d(std::cos(angle), std::sin(angle), 0)));
      }
      if (!around) keep(p);
    }
  }
  Points out(kept.size(), 3);
  for (size_t i = 0; i < kept.size(); ++i) out.row(i) = kept[i];
  return out;
}

std::vector<bool> pinned(const TetMesh& mesh, const Points& vertices, const Triangles& triangles, const Points& heads,
                         const Points& tails, double ratio) {
  if (heads.rows() != tails.rows()) throw std::invalid_argument("tails: expected as many as heads");
  const ClosedSurface closed = close_surface(vertices, triangles);
  const Surface body(closed.vertices, closed.triangles);
  const Surface skin(closed.vertices, closed.triangles.topRows(closed.authored));
  std::vector<bool> held(mesh.nodes.rows());
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
    const Vector3d p = mesh.nodes.row(i);
    double to_bone = infinity;
    for (Eigen::Index b = 0; b < heads.rows(); ++b)
      to_bone = std::min(to_bone, distance_to_segment(p, heads.row(b), tails.row(b)));
    // Written so that no bones (an infinite distance) hold nothing.
    held[i] = (1 - ratio) * to_bone < ratio * skin.distance(p) && body.contains(p);
  }
  return held;
}

}  // namespace dynamorph
