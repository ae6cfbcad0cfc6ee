// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/responses.hpp"

#include "dynamorph/reduced/modes/polynomial_kernels.hpp"

namespace dynamorph {

using Eigen::Index;

Responses::Responses(const ReducedTables& tables, const std::vector<MorphTarget>& targets,
                     const std::vector<VectorXd>& coordinates)
    : r_(tables.basis.cols()),
      count_(tables.responses.cols()),
      rows_(whole_chunks(count_)),
      coordinates_(coordinates),
      reach_(tables.reach) {
  if (count_ == 0) return;
  const Index pairs = tables.layout().nonlinear ? r_ * (r_ + 1) / 2 : 0, size = count_ * (1 + pairs);
  if (tables.response_lambda.size() != targets.size() || tables.response_mu.size() != targets.size())
    throw std::invalid_argument("tables: expected responses for each of " + std::to_string(targets.size()) +
                                " targets");
  if (reach_.size() != r_ || !(reach_.array() > 0).all())
    throw std::invalid_argument("tables: reach must have " + std::to_string(r_) + " positive values");
  for (size_t j = 0; j < targets.size(); ++j) {
    const VectorXd &lambda = tables.response_lambda[j], &mu = tables.response_mu[j];
    if (lambda.size() != size || mu.size() != size || !lambda.allFinite() || !mu.allFinite())
      throw std::invalid_argument("tables: the responses of '" + targets[j].name + "' do not fit");
    const VectorXd table = targets[j].lame.lambda * lambda + targets[j].lame.mu * mu;
    stiffness_.push_back(table.head(count_));
    stiffness_damping_.push_back(targets[j].stiffness_damping);
    LaneVector<float>& coupling = coupling_.emplace_back(rows_ * pairs, 0.0F);
    const Eigen::Map<const MatrixXd> S(table.data() + count_, count_, pairs);
    for (Index p = 0; p < pairs; ++p)
      for (Index i = 0; i < count_; ++i) coupling[p * rows_ + i] = float(S(i, p));
  }
}

void Responses::blend(const VectorXd& w, Blend& out) const {
  if (count_ == 0) return;
  out.stiffness.setZero(count_);
  out.damping.setZero(count_);
  out.shape.setZero(r_);
  out.only = -1;
  out.active.clear();
  out.active_weights.clear();
  for (size_t j = 0; j < stiffness_.size(); ++j) {
    if (w(j) == 0) continue;
    out.only = out.active.empty() && w(j) == 1 ? int(j) : -1;
    out.active.push_back(coupling_[j].data());
    out.active_weights.push_back(w(j));
    out.stiffness += w(j) * stiffness_[j];
    out.damping += w(j) * stiffness_damping_[j] * stiffness_[j];
    out.shape += w(j) * coordinates_[j];
  }
  if (out.only >= 0) return;
  out.coupling.resize(coupling_[0].size());
  blend_tables(out.active.data(), out.active_weights.data(), int(out.active.size()), Index(out.coupling.size()),
               out.coupling.data());
}

double Responses::add(const Blend& blend, const VectorXd& q, VectorXd& force, ArrowMatrix& stiffness) const {
  if (count_ == 0) return 0;
  const auto y = q.tail(count_);
  const VectorXd& D = blend.stiffness;
  force.tail(count_) = D.cwiseProduct(y);
  stiffness.rest() = D;
  double energy = 0.5 * y.dot(force.tail(count_));
  const LaneVector<float>& S = blend.only >= 0 ? coupling_[blend.only] : blend.coupling;
  if (S.empty()) return energy;

  VectorXd& v = blend.from_shape;
  v = q.head(r_) - blend.shape;
  // p = 1/2 S(v, v), J = dp/dv (h, r), and bend = d2(y.p)/dv2 (r, r).
  blend.slopes.setZero(rows_, r_);
  blend.products.resize(r_ * (r_ + 1) / 2);
  blend.padded.setZero(rows_);
  blend.padded.head(count_) = y;
  couple(S.data(), rows_, r_, v.data(), blend.padded.data(), blend.slopes.data(), blend.products.data());
  blend.bend.resize(r_, r_);
  const double* product = blend.products.data();
  for_pairs(r_, [&](Index k, Index l) { blend.bend(k, l) = blend.bend(l, k) = *product++; });
  auto J = blend.slopes.topRows(count_);
  blend.curved.noalias() = 0.5 * (J * v);

  // The fade with its derivatives by s, and ds/dz.
  blend.away = 2 * v.cwiseQuotient(reach_.cwiseAbs2());
  const double s = 0.5 * blend.away.dot(v), fade = 1 / (1 + s * s);
  const double first = -2 * s * fade * fade, second = (8 * s * s * fade - 2) * fade * fade;

  const double work = y.dot(blend.curved);
  blend.along.noalias() = J.transpose() * y;
  energy += fade * work;
  force.head(r_) += fade * blend.along + first * work * blend.away;
  force.tail(count_) += fade * blend.curved;
  auto corner = stiffness.corner();
  corner += fade * blend.bend;
  corner.noalias() += (second * work) * blend.away * blend.away.transpose();
  corner.noalias() += first * blend.away * blend.along.transpose();
  corner.noalias() += first * blend.along * blend.away.transpose();
  corner.diagonal() += (2 * first * work) * reach_.cwiseAbs2().cwiseInverse();
  stiffness.border() = fade * J;
  stiffness.border().noalias() += first * blend.curved * blend.away.transpose();
  return energy;
}

}  // namespace dynamorph
