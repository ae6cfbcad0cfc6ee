// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced_model.hpp"

#include <map>

#include "dynamorph/kernels.hpp"

namespace dynamorph {

namespace {

void pack(const MatrixXd& symmetric, VectorXd& packed) {
  const Eigen::Index r = symmetric.rows();
  packed.resize(r * (r + 1) / 2);
  for (Eigen::Index k = 0, p = 0; k < r; ++k)
    for (Eigen::Index l = k; l < r; ++l, ++p) packed(p) = symmetric(k, l);
}

void unpack(const VectorXd& packed, MatrixXd& symmetric) {
  const Eigen::Index r = symmetric.rows();
  for (Eigen::Index k = 0, p = 0; k < r; ++k)
    for (Eigen::Index l = k; l < r; ++l, ++p) symmetric(k, l) = symmetric(l, k) = packed(p);
}

/// y = S x for a packed symmetric S.
void packed_product(const VectorXd& S, const VectorXd& x, VectorXd& y) {
  const Eigen::Index r = x.size();
  y.setZero(r);
  for (Eigen::Index k = 0, p = 0; k < r; ++k) {
    y(k) += S(p) * x(k);
    ++p;
    for (Eigen::Index l = k + 1; l < r; ++l, ++p) {
      y(k) += S(p) * x(l);
      y(l) += S(p) * x(k);
    }
  }
}

double packed_quadratic(const VectorXd& S, const VectorXd& x) {
  double sum = 0;
  for (Eigen::Index k = 0, p = 0; k < x.size(); ++k)
    for (Eigen::Index l = k; l < x.size(); ++l, ++p) sum += (k == l ? 1 : 2) * S(p) * x(k) * x(l);
  return sum;
}

}  // namespace

ReducedModel::ReducedModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets,
                           const ReducedTables& tables, Blending blending)
    : body_(std::move(body)),
      targets_(std::move(targets)),
      blending_(blending),
      U_(tables.basis),
      layout_(tables.layout()) {
  const Eigen::Index r = U_.cols();
  if (U_.rows() != Eigen::Index(3 * body_->free_nodes.size()))
    throw std::invalid_argument("basis: expected " + std::to_string(3 * body_->free_nodes.size()) + " rows, got " +
                                std::to_string(U_.rows()));
  if (tables.lambda.size() != targets_.size() || tables.mu.size() != targets_.size())
    throw std::invalid_argument("tables: expected one for each of " + std::to_string(targets_.size()) + " targets");
  VectorXd mass = body_->volumes.rowwise().sum();
  tables_.resize(layout_.size(), Eigen::Index(targets_.size()));
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (tables.lambda[j].size() != layout_.distinct() || tables.mu[j].size() != layout_.distinct())
      throw std::invalid_argument("tables: of '" + targets_[j].name + "' do not fit " + std::to_string(r) + " modes");
    VectorXd momentum = body_->restrict_to_free(targets_[j].displacement);
    for (Eigen::Index i = 0; i < mass.size(); ++i) momentum.segment<3>(3 * i) *= mass(i);
    coordinates_.push_back(U_.transpose() * momentum);
    tables_.col(j) = unfolded(targets_[j].lame.lambda * tables.lambda[j] + targets_[j].lame.mu * tables.mu[j], layout_);
    rest_stiffness_.push_back(tables_.col(j).head(layout_.pairs()));
    forces_.push_back(VectorXd::Zero(r));
    energies_.push_back(0);
    if (blending_ == Blending::forces) recentre(int(j));
  }
  build_inertia();
}

void ReducedModel::recentre(int j) {
  // Taylor shift of the polynomial from v = z - z_j to z.
  const Eigen::Index r = dofs();
  Blend at;
  at.table = tables_.col(j);
  at.force.setZero(r);
  at.centre = coordinates_[j];
  const VectorXd origin = VectorXd::Zero(r);
  MatrixXd tangent = zero();
  energies_[j] = linearize(at, origin, forces_[j], tangent);
  VectorXd packed;
  pack(tangent, packed);
  tables_.col(j).head(layout_.pairs()) = packed;
  if (!layout_.nonlinear) return;
  const Eigen::Index pairs = layout_.pairs();
  const VectorXd c = -coordinates_[j];
  Eigen::Map<MatrixXd> K1(tables_.col(j).data() + layout_.linear(), pairs, r);
  const VectorXd K2 = tables_.col(j).tail(pairs * (pairs + 1) / 2);
  const auto entry = [&](Eigen::Index p, Eigen::Index q) {  // of the lower triangle, column after column
    if (p < q) std::swap(p, q);
    return K2(q * pairs - q * (q - 1) / 2 + (p - q));
  };
  for (Eigen::Index m = 0, q = 0; m < r; ++m)
    for (Eigen::Index n = m; n < r; ++n, ++q)
      for (Eigen::Index p = 0; p < pairs; ++p) {
        K1(p, m) += 2 * c(n) * entry(p, q);
        if (n != m) K1(p, n) += 2 * c(m) * entry(p, q);
      }
}

void ReducedModel::blend(const VectorXd& w, Blend& out) const {
  if (w.size() != Eigen::Index(targets_.size()))
    throw std::invalid_argument("weights: expected " + std::to_string(targets_.size()) + ", got " +
                                std::to_string(w.size()));
  if (out.weights.size() == w.size() && out.weights == w) return;  // the pose did not change
  const Eigen::Index r = dofs();
  out.weights = w;
  out.mass.blend(targets_, body_->sets(), w);
  out.table.setZero(layout_.size());
  // Runs of targets that count, so that the sum is stored once for several.
  for (Eigen::Index j = 0, end; j < w.size(); j = end + 1) {
    for (end = j; end < w.size() && w(end) != 0;) ++end;
    if (end == j) continue;
    add_product(tables_.col(j).data(), layout_.size(), w.data() + j, end - j, out.table.data());
  }
  out.force.setZero(r);
  out.centre.setZero(r);
  out.energy = 0;
  out.constant.setZero(layout_.pairs());
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (w(j) == 0) continue;
    out.constant += w(j) * targets_[j].stiffness_damping * rest_stiffness_[j];
    if (blending_ == Blending::even) {
      out.centre += w(j) * coordinates_[j];
    } else {
      out.force += w(j) * forces_[j];
      out.energy += w(j) * energies_[j];
    }
  }
  out.damping.resize(r, r);
  unpack(out.constant, out.damping);
}

void ReducedModel::expand(const Blend& blend, const VectorXd& z) const {
  const Eigen::Index r = dofs(), pairs = layout_.pairs();
  blend.v = z - blend.centre;
  blend.constant = blend.table.head(pairs);
  blend.linear.setZero(pairs);
  blend.quadratic.setZero(pairs);
  if (!layout_.nonlinear) return;
  blend.pairs.resize(pairs);
  for (Eigen::Index k = 0, p = 0; k < r; ++k)
    for (Eigen::Index l = k; l < r; ++l, ++p) blend.pairs(p) = (k == l ? 1 : 2) * blend.v(k) * blend.v(l);
  add_product(blend.table.data() + layout_.linear(), pairs, blend.v.data(), r, blend.linear.data());
  add_symmetric_product(blend.table.data() + layout_.quadratic(), pairs, blend.pairs.data(), blend.quadratic.data());
}

double ReducedModel::energy(const Blend& blend, const VectorXd& z) const {
  expand(blend, z);
  blend.constant = blend.constant / 2 + blend.linear / 6 + blend.quadratic / 12;
  return blend.energy + blend.force.dot(blend.v) + packed_quadratic(blend.constant, blend.v);
}

double ReducedModel::linearize(const Blend& blend, const VectorXd& z, VectorXd& force, Matrix& stiffness) const {
  const double E = energy(blend, z);
  blend.constant = blend.table.head(layout_.pairs()) + blend.linear / 2 + blend.quadratic / 3;
  packed_product(blend.constant, blend.v, force);
  force += blend.force;
  blend.constant = blend.table.head(layout_.pairs()) + blend.linear + blend.quadratic;
  stiffness.resize(dofs(), dofs());
  unpack(blend.constant, stiffness);
  return E;
}

void ReducedModel::build_inertia() {
  const SoftBody& body = *body_;
  const Eigen::Index r = dofs(), pairs = layout_.pairs(), bones = body.skin.cols();
  std::map<std::pair<int, int>, double> shared;
  const VectorXd volumes = body.volumes.rowwise().sum();
  for (Eigen::Index i = 0; i < body.skin.rows(); ++i)
    for (SkinWeights::InnerIterator b(body.skin, i); b; ++b)
      for (SkinWeights::InnerIterator c(body.skin, i); c; ++c)
        if (b.col() < c.col()) shared[{int(b.col()), int(c.col())}] += volumes(i) * b.value() * c.value();
  std::map<std::pair<int, int>, Eigen::Index> column;
  for (const auto& [pair, volume] : shared) {
    column[pair] = 6 * Eigen::Index(bone_pairs_.size());
    bone_pairs_.push_back({pair.first, pair.second, volume / volumes.sum()});
  }
  for (int s = 0; s < body.sets(); ++s) {
    InertiaTables& out = inertia_.emplace_back();
    out.mass.setZero(pairs);
    MatrixXd by_bone = MatrixXd::Zero(pairs, 6 * bones);
    MatrixXd by_pair = MatrixXd::Zero(pairs, 6 * Eigen::Index(bone_pairs_.size()));
    Eigen::Matrix<double, Eigen::Dynamic, 6> node(pairs, 6);  // U^T S U for each entry of a symmetric S
    for (Eigen::Index i = 0; i < body.skin.rows(); ++i) {
      const double volume = body.volumes(i, s);
      if (volume == 0) continue;
      for (Eigen::Index k = 0, p = 0; k < r; ++k)
        for (Eigen::Index l = k; l < r; ++l, ++p) {
          const Vector3d a = U_.block<3, 1>(3 * i, k), b = U_.block<3, 1>(3 * i, l);
          node.row(p) << a.x() * b.x(), a.y() * b.y(), a.z() * b.z(), a.x() * b.y() + a.y() * b.x(),
              a.y() * b.z() + a.z() * b.y(), a.z() * b.x() + a.x() * b.z();
        }
      node *= volume;
      out.mass += node.leftCols<3>().rowwise().sum();
      for (SkinWeights::InnerIterator b(body.skin, i); b; ++b) {
        by_bone.middleCols<6>(6 * b.col()) += b.value() * node;
        for (SkinWeights::InnerIterator c(body.skin, i); c; ++c)
          if (b.col() < c.col())
            by_pair.middleCols<6>(column.at({int(b.col()), int(c.col())})) += b.value() * c.value() * node;
      }
    }
    out.bones = by_bone.cast<float>();
    out.pairs = by_pair.cast<float>();
  }
}

void ReducedModel::inertia(const SkinFrame& frame, const VectorXd& density, Matrix& out) const {
  const auto rotation = [&](Eigen::Index b) { return Matrix3d(transform(frame.bones, b).leftCols<3>()); };
  const auto entries = [](const Matrix3d& S) {
    return std::array<double, 6>{S(0, 0), S(1, 1), S(2, 2), S(0, 1), S(1, 2), S(2, 0)};
  };
  out.resize(dofs(), dofs());
  VectorXd packed = VectorXd::Zero(layout_.pairs());
  for (size_t s = 0; s < inertia_.size(); ++s) {
    const InertiaTables& tables = inertia_[s];
    packed += density(s) * tables.mass;
    for (Eigen::Index b = 0; b < frame.bones.rows(); ++b) {
      const Matrix3d R = rotation(b);
      const Matrix3d strain = R.transpose() * R - Matrix3d::Identity();
      if (strain.cwiseAbs().maxCoeff() < 1e-6) continue;  // rigid, to Blender's single precision
      auto x = entries(density(s) * strain);
      add_product(tables.bones.col(6 * b).data(), packed.size(), x.data(), 6, packed.data());
    }
    for (size_t p = 0; p < bone_pairs_.size(); ++p) {
      const Matrix3d difference = rotation(bone_pairs_[p].first) - rotation(bone_pairs_[p].second);
      const Matrix3d square = difference.transpose() * difference;
      if (bone_pairs_[p].share * square.trace() < 1e-9) continue;  // hardly bent, or hardly any flesh: below round-off
      const auto x = entries(-density(s) * square);
      add_product(tables.pairs.col(6 * p).data(), packed.size(), x.data(), 6, packed.data());
    }
  }
  unpack(packed, out);
}

void ReducedModel::displacement(const VectorXd& z, VectorXd& u) const {
  u.setZero(U_.rows());
  add_product(U_.data(), U_.rows(), z.data(), z.size(), u.data());
}

void ReducedModel::project(const VectorXd& f, VectorXd& out) const {
  out.resize(dofs());
  transposed_product(U_, f.data(), out.data());
}

}  // namespace dynamorph
