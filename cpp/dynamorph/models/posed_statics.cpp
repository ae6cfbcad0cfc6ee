// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/posed_statics.hpp"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/mesh/smooth_embedding.hpp"
#include "dynamorph/mesh/surface.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

// Moduli are relative to mu = 1: shapes do not depend on it.
constexpr double kLambda = 24;                  // Poisson's ratio .48
constexpr double kLeastVolume = 0.1;            // of a tet in bind space, so that a target can have the shape
constexpr double kBarrier = 0.2;                // of mu
constexpr double kSoftest = 0.02;               // of the firmest tet: those that are mostly outside of the skin
constexpr double kHold = 3;                     // mu per square thickness
constexpr double kAtSkin = 0.1, kAtBones = 3;   // of that, around what is bent
constexpr double kCore = 0.2, kCoreFull = 0.8;  // thicknesses below the skin: where the bones' part begins
constexpr double kLimp = 0.2;                   // of 1 - the least singular value: nothing holds from there
constexpr double kRigid = 1e3;                  // of that, where skinning cannot be inverted
constexpr double kContact = 300;                // mu per thickness: pressure by depth
constexpr double kApart = 1e-3;                 // of the size: skin that touches
constexpr double kNear = 3;                     // times that: what is watched
constexpr double kBent = 5e-3;                  // of 1 - the least singular value of the skinning: a bend by 12 degrees
constexpr double kGivesWay = 1, kHeld = 2;      // thicknesses from what is bent
constexpr double kNotInvertible = 0.3, kInvertible = 0.4;  // least singular value
constexpr int kHalvings = 14;

double least_singular_value(const Matrix3d& A) { return Eigen::JacobiSVD<Matrix3d>(A).singularValues()(2); }

/// How much of plain skinning stays, from 1 where it cannot be inverted to 0.
double plain_part(const Matrix3d& A) {
  return 1 - smooth_step((least_singular_value(A) - kNotInvertible) / (kInvertible - kNotInvertible));
}

}  // namespace

PosedStatics::PosedStatics(const PosedBody& body, const Transforms& pose)
    : body_(body),
      smooth_(smooth_embedding(body.mesh, body.skin.embedding)),
      facing_(body.skin.rest, body.triangles, body.thickness) {
  const Points& rest = body.skin.rest;
  apart_ = rest.rows() == 0 ? 0 : kApart * (rest.colwise().maxCoeff() - rest.colwise().minCoeff()).norm();
  std::vector<int> all(std::size_t(rest.rows()));
  std::iota(all.begin(), all.end(), 0);
  // What touches at rest, such as lips or an eye in its socket, is left as it is.
  facing_.find(rest, all, kNear * apart_, touches_);
  may_touch_.assign(all.size(), true);
  for (const FacingSkin::Touch& touch : touches_) may_touch_[std::size_t(touch.point)] = false;
  find_thickness();
  find_active(pose);
  if (!moves()) return;
  u_ = VectorXd::Zero(3 * Index(active_.size()));
  find_pattern();
}

void PosedStatics::find_thickness() {
  const Surface surface(body_.skin.rest, body_.triangles);
  const MatrixXd values = extend_to_nodes(body_.mesh, body_.skin.embedding, body_.thickness);
  node_thickness_ = values.col(0).cwiseMax(body_.thickness.minCoeff()).cwiseMin(body_.thickness.maxCoeff());
  core_.resize(node_thickness_.size());
  for (Index i = 0; i < core_.size(); ++i)
    core_(i) =
        smooth_step((surface.distance(body_.mesh.nodes.row(i)) / node_thickness_(i) - kCore) / (kCoreFull - kCore));
}

/// Nodes that skinning crushes, and those of skin that it puts into other skin.
std::vector<int> PosedStatics::find_sources(const Transforms& pose) {
  SkinFrame frame{pose, {}};
  pose_nodes(body_.weights, frame);
  std::vector<bool> is_source(std::size_t(frame.nodes.rows()));
  for (Index i = 0; i < frame.nodes.rows(); ++i)
    is_source[std::size_t(i)] = 1 - least_singular_value(transform(frame.nodes, i).leftCols<3>()) > kBent;
  const Points& rest = body_.skin.rest;
  Points places(rest.rows(), 3);
  std::vector<int> samples;
  for (int p = 0; p < rest.rows(); ++p) {
    const PointTransform T = body_.skin.transform(pose, p);
    places.row(p) = T.leftCols<3>() * rest.row(p).transpose() + T.col(3);
    if (may_touch_[std::size_t(p)]) samples.push_back(p);
  }
  facing_.find(places, samples, kNear * apart_, touches_);
  for (const FacingSkin::Touch& touch : touches_)
    for (const int node : body_.skin.embedding.nodes.row(touch.point))
      if (touch.gap < 0) is_source[std::size_t(node)] = true;
  std::vector<int> out;
  for (std::size_t i = 0; i < is_source.size(); ++i)
    if (is_source[i]) out.push_back(int(i));
  return out;
}

void PosedStatics::find_active(const Transforms& pose) {
  const Points& X = body_.mesh.nodes;
  const std::vector<int> sources = find_sources(pose);
  loose_ = VectorXd::Zero(X.rows());
  active_of_.assign(std::size_t(X.rows()), -1);
  for (Index i = 0; i < X.rows(); ++i) {
    double away = kInfinity;
    for (const int j : sources) away = std::min(away, (X.row(i) - X.row(j)).norm() / node_thickness_(j));
    loose_(i) = 1 - smooth_step((away - kGivesWay) / (kHeld - kGivesWay));
    if (!(away < kHeld)) continue;
    active_of_[std::size_t(i)] = int(active_.size());
    active_.push_back(int(i));
  }
  const double firmest = std::max(body_.stiffness.maxCoeff(), 1e-300);
  const VectorXd volume = volumes(body_.mesh);
  VectorXd around = VectorXd::Zero(X.rows());
  for (Index t = 0; t < body_.mesh.tets.rows(); ++t) {
    Part part;
    part.nodes = body_.mesh.tets.row(t);
    part.weight = volume(t) * std::max(body_.stiffness(t) / firmest, kSoftest);
    for (int k = 0; k < 4; ++k) {
      part.unknowns(k) = active_of_[std::size_t(part.nodes(k))];
      around(part.nodes(k)) += part.weight / 4;
    }
    if (part.unknowns.maxCoeff() < 0) continue;
    part.gradients = gradients_of(body_.mesh, t);
    parts_.push_back(part);
  }
  hold_ = kHold * around.array() / node_thickness_.array().square();
  is_moved_.assign(std::size_t(smooth_.rows()), false);
  for (Index p = 0; p < smooth_.rows(); ++p) {
    for (int k = 0; k < 4; ++k)
      if (active_of_[std::size_t(body_.skin.embedding.nodes(p, k))] >= 0) is_moved_[std::size_t(p)] = true;
    if (!is_moved_[std::size_t(p)]) continue;
    points_.push_back(int(p));
    if (may_touch_[std::size_t(p)]) samples_.push_back(int(p));
  }
}

void PosedStatics::find_pattern() {
  const Index size = 3 * Index(active_.size());
  std::vector<Eigen::Triplet<double>> entries;
  for (const Part& part : parts_)
    for (const int a : part.unknowns)
      for (const int b : part.unknowns)
        if (a >= 0 && b >= 0)
          for (int i = 0; i < 9; ++i) entries.emplace_back(3 * a + i % 3, 3 * b + i / 3, 0.);
  pattern_.resize(size, size);
  pattern_.setFromTriplets(entries.begin(), entries.end());
  for (const Part& part : parts_)
    for (const int a : part.unknowns)
      for (const int b : part.unknowns) {
        if (a < 0 || b < 0) {
          slots_.push_back(-1);
          continue;
        }
        const int* first = pattern_.innerIndexPtr() + pattern_.outerIndexPtr()[3 * b];
        const int* last = pattern_.innerIndexPtr() + pattern_.outerIndexPtr()[3 * b + 1];
        slots_.push_back(int(std::lower_bound(first, last, 3 * a) - pattern_.innerIndexPtr()));
      }
  locals_.resize(parts_.size());
}

void PosedStatics::pose(const Transforms& bones) {
  frame_.bones = bones;
  pose_nodes(body_.weights, frame_);
  held_ = VectorXd::Zero(body_.mesh.nodes.rows());
  for (const int node : active_) {
    const Matrix3d A = transform(frame_.nodes, node).leftCols<3>();
    const double stays = 1 - smooth_step((1 - least_singular_value(A)) / kLimp);
    held_(node) = hold_(node) * (1 - loose_(node) + loose_(node) * stays * (kAtSkin + kAtBones * core_(node)) +
                                 kRigid * plain_part(A));
  }
  x_.resize(body_.mesh.nodes.rows(), 3);
  u_nodes_ = Points::Zero(x_.rows(), 3);
  const VectorXd none = VectorXd::Zero(u_.size());
  for (Index i = 0; i < x_.rows(); ++i) x_.row(i) = node_place(none, int(i));
  // The skin where skinning puts it, and how much that differs from what its nodes carry.
  const Points& rest = body_.skin.rest;
  const Points carried = smooth_ * x_, carried_at_rest = smooth_ * body_.mesh.nodes;
  places_.resize(rest.rows(), 3);
  offset_ = Points::Zero(rest.rows(), 3);
  skin_.resize(std::size_t(rest.rows()));
  for (Index p = 0; p < rest.rows(); ++p) {
    const PointTransform T = skin_[std::size_t(p)] = body_.skin.transform(bones, p);
    places_.row(p) = T.leftCols<3>() * rest.row(p).transpose() + T.col(3);
    if (!is_moved_[std::size_t(p)]) continue;
    double loose = 0;
    for (int k = 0; k < 4; ++k)
      loose += std::max(body_.skin.embedding.weights(p, k), 0.) * loose_(body_.skin.embedding.nodes(p, k));
    loose = std::min(loose, 1.);
    const Vector3d apart = T.leftCols<3>() * (rest.row(p) - carried_at_rest.row(p)).transpose();
    const Vector3d plain = places_.row(p) - carried.row(p);
    offset_.row(p) = loose * apart + (1 - loose) * plain;
  }
}

Vector3d PosedStatics::node_place(const VectorXd& u, int node) const {
  const TransformMap T = transform(frame_.nodes, node);
  return T.leftCols<3>() * (body_.mesh.nodes.row(node).transpose() + unknown(u, node)) + T.col(3);
}

void PosedStatics::place(const VectorXd& u) {
  for (const int node : active_) {
    u_nodes_.row(node) = unknown(u, node);
    x_.row(node) = node_place(u, node);
  }
  parallel_parts(Index(points_.size()), [&](Index first, Index end) {
    for (Index i = first; i < end; ++i) {
      const Index p = points_[std::size_t(i)];
      places_.row(p) = smooth_.row(p) * x_ + offset_.row(p);
    }
  });
}

void PosedStatics::find_touches() { facing_.find(places_, samples_, kNear * apart_, touches_); }

double PosedStatics::depth(const FacingSkin::Touch& touch) const {
  Vector3d from = places_.row(touch.point);
  for (int k = 0; k < 3; ++k) from -= touch.weights(k) * places_.row(body_.triangles(touch.triangle, k)).transpose();
  return apart_ - touch.normal.dot(from);
}

double PosedStatics::firmness(const FacingSkin::Touch& touch) const {
  return kContact * facing_.area()(touch.point) / body_.thickness(touch.point);
}

double PosedStatics::contact_energy() const {
  double energy = 0;
  for (const FacingSkin::Touch& touch : touches_)
    energy += 0.5 * firmness(touch) * std::pow(std::max(depth(touch), 0.), 2);
  return energy;
}

double PosedStatics::value(const VectorXd& u) {
  place(u);
  double sum = contact_energy();
  for (const int node : active_) {
    sum += 0.5 * held_(node) * (transform(frame_.nodes, node).leftCols<3>() * unknown(u, node)).squaredNorm();
  }
  for (const Part& part : parts_) {
    const auto [F, bind] = strain(part);
    sum += part.weight * (dynamorph::energy(1, stable_volume(kLambda, 1, F.determinant()), F) +
                          volume_barrier(kBarrier, kLeastVolume, bind.determinant()).value);
  }
  return sum;
}

PosedStatics::Strain PosedStatics::strain(const Part& part) const {
  Eigen::Matrix<double, 3, 4> x, u;
  for (int k = 0; k < 4; ++k) {
    x.col(k) = x_.row(part.nodes(k));
    u.col(k) = u_nodes_.row(part.nodes(k));
  }
  return {x * part.gradients.transpose(), Matrix3d::Identity() + u * part.gradients.transpose()};
}

PosedStatics::Local PosedStatics::linearize(const Part& part) const {
  const auto [F, bind] = strain(part);
  const VolumeLaw volume = stable_volume(kLambda, 1, F.determinant());
  const VolumeLaw barrier = volume_barrier(kBarrier, kLeastVolume, bind.determinant());
  Local out{part.weight * (dynamorph::energy(1, volume, F) + barrier.value), Forces::Zero(), Tangent::Zero()};
  dynamorph::linearize(1, volume, F, part.gradients, part.weight, out.forces, out.tangent);
  Matrix3d A[4];
  for (int k = 0; k < 4; ++k) A[k] = transform(frame_.nodes, part.nodes(k)).leftCols<3>();
  for (int a = 0; a < 4; ++a) {
    out.forces.col(a) = (A[a].transpose() * out.forces.col(a)).eval();
    for (int b = 0; b < 4; ++b)
      out.tangent.block<3, 3>(3 * a, 3 * b) = (A[a].transpose() * out.tangent.block<3, 3>(3 * a, 3 * b) * A[b]).eval();
  }
  dynamorph::linearize(0, barrier, bind, part.gradients, part.weight, out.forces, out.tangent);
  return out;
}

void PosedStatics::linearize(const VectorXd& u) {
  place(u);
  find_touches();
  parallel_parts(Index(parts_.size()), [&](Index first, Index end) {
    for (Index t = first; t < end; ++t) locals_[std::size_t(t)] = linearize(parts_[std::size_t(t)]);
  });
  hessian_ = pattern_;
  gradient_ = VectorXd::Zero(u.size());
  energy_ = contact_energy();
  double* values = hessian_.valuePtr();
  for (std::size_t t = 0; t < parts_.size(); ++t) {
    const Local& local = locals_[t];
    const Eigen::Vector4i& unknowns = parts_[t].unknowns;
    energy_ += local.energy;
    for (int a = 0; a < 4; ++a) {
      if (unknowns(a) < 0) continue;
      gradient_.segment<3>(3 * unknowns(a)) += local.forces.col(a);
      for (int b = 0; b < 4; ++b) {
        if (unknowns(b) < 0) continue;
        const int* outer = hessian_.outerIndexPtr() + 3 * unknowns(b);
        double* slot = values + slots_[16 * t + std::size_t(4 * a + b)];
        for (int j = 0; j < 3; ++j)
          for (int i = 0; i < 3; ++i) slot[j * (outer[1] - outer[0]) + i] += local.tangent(3 * a + i, 3 * b + j);
      }
    }
  }
  for (const int node : active_) {
    const Matrix3d A = transform(frame_.nodes, node).leftCols<3>(), K = held_(node) * A.transpose() * A;
    const Vector3d at = unknown(u, node);
    energy_ += 0.5 * at.dot(K * at);
    const int first = 3 * active_of_[std::size_t(node)];
    gradient_.segment<3>(first) += K * at;
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i) hessian_.coeffRef(first + i, first + j) += K(i, j);
  }
  add_contacts();
}

/// Their stiffness acts on the nodes of the tets alone, which are most of what carries the skin, so that the matrix
/// stays sparse. The gradient is exact.
void PosedStatics::add_contacts() {
  std::vector<Eigen::Triplet<double>> entries;
  const Embedding& tets = body_.skin.embedding;
  std::vector<std::pair<int, Vector3d>> row;
  for (const FacingSkin::Touch& touch : touches_) {
    const double deep = depth(touch), stiffness = firmness(touch);
    if (!(deep > 0)) continue;
    row.clear();
    const auto add = [&](int point, double share) {
      if (!is_moved_[std::size_t(point)]) return;
      const Vector3d along = share * touch.normal;
      for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(smooth_, point); it; ++it) {
        const int active = active_of_[std::size_t(it.col())];
        if (active < 0) continue;
        const Matrix3d A = transform(frame_.nodes, it.col()).leftCols<3>();
        gradient_.segment<3>(3 * active) -= stiffness * deep * it.value() * (A.transpose() * along);
      }
      for (int k = 0; k < 4; ++k) {
        const int active = active_of_[std::size_t(tets.nodes(point, k))];
        if (active < 0) continue;
        const Matrix3d A = transform(frame_.nodes, tets.nodes(point, k)).leftCols<3>();
        row.emplace_back(active, tets.weights(point, k) * (A.transpose() * along));
      }
    };
    add(touch.point, 1);
    for (int k = 0; k < 3; ++k) add(body_.triangles(touch.triangle, k), -touch.weights(k));
    for (const auto& [a, left] : row)
      for (const auto& [b, right] : row)
        for (int i = 0; i < 9; ++i)
          entries.emplace_back(3 * a + i % 3, 3 * b + i / 3, stiffness * left(i % 3) * right(i / 3));
  }
  if (entries.empty()) return;
  SparseMatrix contacts(hessian_.rows(), hessian_.cols());
  contacts.setFromTriplets(entries.begin(), entries.end());
  hessian_ = SparseMatrix(hessian_ + contacts);
}

int PosedStatics::solve(const Transforms& bones, int iterations, double negligible, bool& converged) {
  pose(bones);
  converged = false;
  VectorXd direction, next;
  for (int iteration = 1; iteration <= iterations; ++iteration) {
    linearize(u_);
    if (!solver_.factorize(hessian_)) {
      hessian_.diagonal().array() += 1e-3 * hessian_.diagonal().mean();
      if (!solver_.factorize(hessian_)) return iteration;
    }
    direction = -solver_.solve(gradient_);
    const double slope = gradient_.dot(direction), start = energy_;
    double length = 1;
    for (int halving = 0; halving < kHalvings; ++halving, length /= 2) {
      next = u_ + length * direction;
      if (value(next) <= start + 1e-4 * length * slope) break;
    }
    if (!(value(next) <= start)) return iteration;  // round-off leaves no descent
    u_ = next;
    double farthest = 0;
    for (std::size_t i = 0; i < active_.size(); ++i)
      farthest = std::max(farthest, length * direction.segment<3>(3 * Index(i)).norm() / node_thickness_(active_[i]));
    converged = farthest <= negligible;
    if (converged) return iteration;
  }
  return iterations;
}

/// The deepest point that is inside of the body if it goes a little outward.
void PosedStatics::find_overlap(PosedShape& shape) const {
  std::vector<FacingSkin::Touch> inside;
  std::copy_if(touches_.begin(), touches_.end(), std::back_inserter(inside), [](const auto& t) { return t.gap < 0; });
  if (inside.empty()) return;
  const Surface skin(places_, body_.triangles);
  for (const FacingSkin::Touch& touch : inside) {
    const Vector3d outward = places_.row(touch.point).transpose() + 0.1 * apart_ * touch.outward;
    if (!(-touch.gap > shape.overlap) || !skin.contains(outward)) continue;
    shape.overlap = -touch.gap;
    shape.overlaps = touch.point;
  }
}

void PosedStatics::write(PosedShape& shape) {
  place(u_);
  find_touches();
  find_overlap(shape);
  for (const Part& part : parts_) shape.least_volume = std::min(shape.least_volume, strain(part).bind.determinant());
  for (const int p : points_) {
    const Matrix3d A = skin_[std::size_t(p)].leftCols<3>();
    shape.plain(p) = plain_part(A);
    if (shape.plain(p) == 1) continue;
    const Vector3d back = A.inverse() * (places_.row(p).transpose() - skin_[std::size_t(p)].col(3));
    shape.skin.row(p) = (1 - shape.plain(p)) * (back - body_.skin.rest.row(p).transpose());
  }
}

}  // namespace dynamorph
