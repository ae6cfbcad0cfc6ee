// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/contact/local_responses.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "dynamorph/contact/at_rest.hpp"
#include "dynamorph/contact/choices.hpp"
#include "dynamorph/core/errors.hpp"
#include "dynamorph/elastic/dense_kernels.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr Index kLookedAt = 300;    // places whose motion is compared
constexpr double kHeldFirm = 1e-6;  // of the most compliant patch: what is held firmer than that has no response
constexpr double kAlike = 1e-9;     // patches that overlap give way nearly alike

SkinPlaces at(const SkinPlaces& places, const std::vector<int>& chosen) {
  SkinPlaces out{Points(Index(chosen.size()), 3), Points(Index(chosen.size()), 3), {}};
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    if (chosen[k] < 0 || chosen[k] >= places.rest.rows())
      throw std::invalid_argument("centers: there is no such place");
    out.rest.row(Index(k)) = places.rest.row(chosen[k]);
    out.normals.row(Index(k)) = places.normals.row(chosen[k]);
  }
  return out;
}

/// f_P (3 free, P) of the patches' weights at the places (L, P).
MatrixXd loads_on(const NodalPoints& vertices, const SkinPlaces& places, const RowMajor& pressed) {
  PointRows numbers;
  for (Index patch = 0; patch < pressed.cols(); ++patch) {
    numbers.add_row();
    for (Index p = 0; p < pressed.rows(); ++p)
      if (pressed(p, patch) > 0)
        places.points.each_corner(
            p, [&](int v, double weight) { numbers.add(v, pressed(p, patch) * weight * places.normals.row(p)); });
  }
  SparseRows rows;
  vertices.rows(numbers, rows);
  MatrixXd out(rows.parts.cols(), pressed.cols());
  VectorXd load;
  for (Index patch = 0; patch < pressed.cols(); ++patch) {
    load.setZero(out.rows());
    rows.add(patch, 1, load);
    out.col(patch) = load;
  }
  return out;
}

/// `stays_local` of what the coordinates (dofs, P) do for each patch: its mean, and the farthest of other places.
VectorXd stay_local(const ModalPoints& vertices, const SkinPlaces& places, const RowMajor& pressed,
                    const MatrixXd& coordinates) {
  VectorXd own = VectorXd::Zero(pressed.cols()), farthest = own;
  const Index stride = std::max<Index>(1, pressed.rows() / kLookedAt);
  for (Index p = 0; p < pressed.rows(); ++p) {
    RowMajor basis = RowMajor::Zero(3, coordinates.rows());
    places.points.each_corner(p,
                              [&](int v, double weight) { basis += weight * vertices.basis().middleRows<3>(3 * v); });
    const MatrixXd moved = basis * coordinates;
    own += (places.normals.row(p) * moved).cwiseProduct(pressed.row(p)).transpose();
    if (p % stride != 0) continue;
    for (Index patch = 0; patch < own.size(); ++patch)
      if (pressed(p, patch) == 0) farthest(patch) = std::max(farthest(patch), moved.col(patch).norm());
  }
  for (Index patch = 0; patch < own.size(); ++patch) {
    own(patch) /= std::max(pressed.col(patch).sum(), 1e-300);
    own(patch) = stays_local(own(patch), std::max(farthest(patch), own(patch)));
  }
  return own;
}

}  // namespace

double stays_local(double own, double farthest) {
  return smooth_step((own / std::max(farthest, 1e-300) - kOwnMotion) / (kAllOwnMotion - kOwnMotion));
}

double squared_unlikeness(const Vector3d& x, const Vector3d& normal, const Vector3d& y, const Vector3d& other_normal,
                          double size) {
  return (x - y).squaredNorm() + kTurned * kTurned * size * size * std::max(0.0, 1 - normal.dot(other_normal));
}

double LocalResponses::unlike(int patch, const Vector3d& rest, const Vector3d& normal) const {
  return std::sqrt(
      squared_unlikeness(parts_.centers.rest.row(patch), parts_.centers.normals.row(patch), rest, normal, parts_.size));
}

void LocalResponses::patches_at(const Vector3d& rest, const Vector3d& normal,
                                std::vector<std::pair<int, double>>& out) const {
  out.clear();
  double sum = 0;
  std::pair<int, double> nearest{-1, kInfinity};
  for (int patch = 0; patch < int(parts_.centers.rest.rows()); ++patch) {
    const double away = unlike(patch, rest, normal);
    if (away < nearest.second) nearest = {patch, away};
    if (!(away < parts_.reach)) continue;
    out.push_back({patch, std::pow(1 - away / parts_.reach, 2)});
    sum += out.back().second;
  }
  if (out.empty() && nearest.first >= 0) out.push_back({nearest.first, sum = 1});
  for (auto& [patch, weight] : out) weight /= sum;
}

LocalResponses::LocalResponses(ResponseParts parts) : parts_(std::move(parts)) {
  const Index patches = size();
  check_size("centers", parts_.centers.rest.rows(), patches);
  check_size("normals", parts_.centers.normals.rows(), patches);
  check_size("stiffness", parts_.stiffness.rows(), patches);
  check_size("stiffness", parts_.stiffness.cols(), patches);
  check_size("farthest", parts_.farthest.size(), patches);
  check_size("farthest_node", Index(parts_.farthest_node.size()), patches);
  for (const int node : parts_.farthest_node)
    if (node < 0 || node >= parts_.shapes.rows() / 3)
      throw std::invalid_argument("farthest_node: there is no such node");
}

LocalResponses::LocalResponses(const FullModel& model, const MatrixXd& basis, const SkinPlaces& places,
                               const Embedding& embedding, const std::vector<int>& centers) {
  parts_.centers = at(places, centers);
  parts_.size = model.body().size;
  parts_.shear.resize(model.body().sets());
  if (centers.empty()) throw std::invalid_argument("centers: at least one is needed");
  check_size("normals", places.normals.rows(), places.rest.rows());
  check_size("corners", places.points.size(), places.rest.rows());
  check_points(places.points, embedding.nodes.rows());
  check_size("basis", basis.rows(), model.dofs());
  if (embedding.nodes.size() > 0 &&
      (embedding.nodes.minCoeff() < 0 || embedding.nodes.maxCoeff() >= model.body().mesh.nodes.rows()))
    throw std::invalid_argument("embedding: it belongs to another mesh");
  const VectorXd neutral = neutral_weights(model.body(), model.targets());
  for (std::size_t j = 0; j < model.targets().size(); ++j)
    if (neutral(Index(j)) == 1) parts_.shear(model.targets()[j].set) = model.targets()[j].lame.mu;
  parts_.reach = reach_of(places, centers);

  const RowMajor pressed = weights_of(places);
  const MatrixXd loads = loads_on(model.skin_points(embedding), places, pressed);
  const SparseMatrix K = lasting_stiffness(model, neutral);
  MatrixXd answers = loads;
  BlockCholesky<double> factor;
  if (factor.factorize(K))
    factor.solve_in_place(answers);
  else
    answers.setZero();
  const MatrixXd KB = K * basis;
  const Eigen::SparseMatrix<double> pushes = loads.sparseView();
  MatrixXd taken = (basis.transpose() * KB).ldlt().solve(basis.transpose() * pushes);  // by the coordinates alone
  taken = (taken * stay_local(ModalPoints(model.body(), embedding, basis), places, pressed, taken).asDiagonal()).eval();
  MatrixXd R(answers.rows(), answers.cols());
  multiply_dense(basis.data(), basis.rows(), basis.cols(), taken.data(), taken.cols(), R.data());
  R = answers - R;
  parts_.stiffness = R.transpose() * pushes;  // a patch is pressed at few nodes
  parts_.stiffness -= (R.transpose() * KB) * taken;
  parts_.stiffness = (0.5 * (parts_.stiffness + parts_.stiffness.transpose())).eval();
  normalize(model.body().volumes.rowwise().sum(), answers.cwiseProduct(loads).colwise().sum(), R);
  parts_.shapes = R;
  parts_.farthest.resize(R.cols());
  for (Index patch = 0; patch < R.cols(); ++patch) {
    Index node;
    parts_.farthest(patch) = as_points(VectorXd(R.col(patch))).rowwise().norm().maxCoeff(&node);
    parts_.farthest_node.push_back(int(node));
  }
  if (!parts_.shapes.allFinite() || !parts_.stiffness.allFinite())
    throw std::invalid_argument("basis: the responses to it are not finite");
}

RowMajor LocalResponses::moved_where_farthest(const std::vector<int>& patches) const {
  const Index m = Index(patches.size());
  RowMajor out = RowMajor::Identity(m, m);
  for (Index i = 0; i < m; ++i) {
    const int patch = patches[std::size_t(i)], row = 3 * parts_.farthest_node[std::size_t(patch)];
    const double square = parts_.farthest(patch) * parts_.farthest(patch);
    if (!(square > 0)) continue;
    for (Index j = 0; j < m; ++j)
      out(i, j) =
          parts_.shapes.block<3, 1>(row, patch).dot(parts_.shapes.block<3, 1>(row, patches[std::size_t(j)])) / square;
  }
  return out;
}

double LocalResponses::reach_of(const SkinPlaces& places, const std::vector<int>& centers) const {
  std::vector<double> nearest;
  std::vector<bool> is_center(std::size_t(places.rest.rows()), false);
  for (const int center : centers) is_center[std::size_t(center)] = true;
  // Where all places are centers, the next one counts: a place that two are as near to must not depend on round-off.
  const bool only_centers = std::count(is_center.begin(), is_center.end(), false) == 0;
  for (Index p = 0; p < places.rest.rows(); ++p) {
    if (is_center[std::size_t(p)] && !only_centers) continue;
    nearest.push_back(kInfinity);
    for (std::size_t patch = 0; patch < centers.size(); ++patch)
      if (centers[patch] != p)
        nearest.back() = std::min(nearest.back(), unlike(int(patch), places.rest.row(p), places.normals.row(p)));
  }
  std::nth_element(nearest.begin(), nearest.begin() + Index(nearest.size() / 2), nearest.end());
  return kPatchReach * nearest[nearest.size() / 2];
}

RowMajor LocalResponses::weights_of(const SkinPlaces& places) const {
  RowMajor out = RowMajor::Zero(places.rest.rows(), parts_.centers.rest.rows());
  std::vector<std::pair<int, double>> found;
  for (Index p = 0; p < out.rows(); ++p) {
    patches_at(places.rest.row(p), places.normals.row(p), found);
    for (const auto& [patch, weight] : found) out(p, patch) = weight;
  }
  return out;
}

void LocalResponses::normalize(const VectorXd& volume, const VectorXd& compliance, MatrixXd& R) {
  for (Index patch = 0; patch < R.cols(); ++patch) {
    double square = 0;
    for (Index i = 0; i < volume.size(); ++i) square += volume(i) * R.col(patch).segment<3>(3 * i).squaredNorm();
    const bool gives_way = compliance(patch) > kHeldFirm * compliance.maxCoeff() && square > 0;
    const double scale = gives_way ? 1 / std::sqrt(square) : 0;
    R.col(patch) *= scale;
    parts_.stiffness.row(patch) *= scale;
    parts_.stiffness.col(patch) *= scale;
    if (!gives_way) parts_.stiffness(patch, patch) = 1;  // it does nothing
  }
  parts_.stiffness.diagonal() *= 1 + kAlike;
}

}  // namespace dynamorph
