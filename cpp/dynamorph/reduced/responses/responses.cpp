// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/responses/responses.hpp"

#include <cmath>

#include "dynamorph/reduced/modes/polynomial_kernels.hpp"

namespace dynamorph {

using Eigen::Index;

namespace {

constexpr double kExact = 0.7;     // of what the modes can pay: up to here they pay all
constexpr double kNothing = 1e12;  // times that: the coupling has vanished

/// theta and its derivatives by P / pay, which is above kExact.
struct Limit {
  double value, first, second;
};

Limit limit(double ratio) {
  // theta^2 = g(ratio) / ratio, g = kExact + range x / sqrt(1 + x^2), with two continuous derivatives
  constexpr double range = 1 - kExact;
  const double x = (ratio - kExact) / range, root = std::sqrt(1 + x * x);
  const double g = kExact + range * x / root, g1 = 1 / (root * root * root), g2 = -3 * x * g1 / (root * root * range);
  const double square = g / ratio, square1 = (g1 - square) / ratio, square2 = (g2 - 2 * square1) / ratio;
  const double value = std::sqrt(square), first = square1 / (2 * value);
  return {value, first, (square2 - 2 * first * first) / (2 * value)};
}

/// Adds e S x to slopes (rows, r), and writes e S : y (r, r).
void couple_with(const LaneVector<float>& S, double e, const VectorXd& x, const VectorXd& padded,
                 Responses::Workspace& s, MatrixXd& slopes, MatrixXd& bend) {
  const Index r = x.size();
  VectorXd& products = s.products;
  products.resize(r * (r + 1) / 2);
  bend.resize(r, r);
  if (e != 1) {
    s.elastic_x = e * x;
    s.elastic_padded = e * padded;
  }
  couple(S.data(), padded.size(), r, (e != 1 ? s.elastic_x : x).data(), (e != 1 ? s.elastic_padded : padded).data(),
         slopes.data(), products.data());
  const double* product = products.data();
  for_pairs(r, [&](Index k, Index l) { bend(k, l) = bend(l, k) = *product++; });
}

/// matrix += factor (a b^T + b a^T)
template <class Matrix>
void add_outer(double factor, const VectorXd& a, const VectorXd& b, Matrix&& matrix) {
  matrix.noalias() += factor * a * b.transpose();
  matrix.noalias() += factor * b * a.transpose();
}

}  // namespace

Responses::Responses(const ReducedTables& tables, const std::vector<MorphTarget>& targets,
                     const std::vector<VectorXd>& coordinates, Blending blending)
    : r_(tables.basis.cols()),
      count_(tables.responses.cols()),
      rows_(whole_chunks(count_)),
      even_(blending == Blending::even),
      relaxed_(false) {
  if (count_ == 0) return;
  const Index pairs = tables.layout().nonlinear ? r_ * (r_ + 1) / 2 : 0, size = count_ * (1 + pairs);
  const size_t count = targets.size();
  if (tables.response_lambda.size() != count || tables.response_mu.size() != count || tables.relaxation.size() != count)
    throw std::invalid_argument("tables: expected responses for each of " + std::to_string(count) + " targets");
  for (size_t j = 0; j < count; ++j) {
    const VectorXd &lambda = tables.response_lambda[j], &mu = tables.response_mu[j];
    const MatrixXd& A = tables.relaxation[j];
    if (lambda.size() != size || mu.size() != size || !lambda.allFinite() || !mu.allFinite() || A.rows() != count_ ||
        A.cols() != r_ || !A.allFinite())
      throw std::invalid_argument("tables: the responses of '" + targets[j].name + "' do not fit");
    const Lame lame = targets[j].lame;
    const VectorXd table = lame.lambda * lambda + lame.mu * mu;
    Target& target = targets_.emplace_back();
    target.damping = targets[j].stiffness_damping;
    target.coordinates = coordinates[j];
    target.stiffness = table.head(count_);
    target.border = target.stiffness.asDiagonal() * A;
    relaxed_ |= !A.isZero(0);
    target.modal = A.transpose() * target.border;
    Index at = 0;
    for_pairs(r_, [&](Index k, Index l) {
      target.modal(k, l) += lame.lambda * tables.lambda[j](at) + lame.mu * tables.mu[j](at);
      target.modal(l, k) = target.modal(k, l);
      ++at;
    });
    if (pairs == 0) continue;
    target.coupling.assign(rows_ * pairs, 0.0F);
    const Eigen::Map<const MatrixXd> S(table.data() + count_, count_, pairs);
    for (Index p = 0; p < pairs; ++p)
      for (Index i = 0; i < count_; ++i) target.coupling[p * rows_ + i] = float(S(i, p));
    if (even_) continue;
    target.coupling_slopes.setZero(rows_, r_);
    Workspace scratch;
    MatrixXd bend;
    couple_with(target.coupling, 1, -coordinates[j], VectorXd::Zero(rows_), scratch, target.coupling_slopes, bend);
    target.coupling_force = -0.5 * (target.coupling_slopes.topRows(count_) * coordinates[j]);
  }
}

void Responses::blend(const VectorXd& w, const VectorXd& e, Blend& out) const {
  if (count_ == 0) return;
  const bool is_new = out.border.rows() != count_;  // otherwise what is always zero is zero already
  out.stiffness.setZero(count_);
  out.damping.setZero(count_);
  out.shape.setZero(r_);
  if (relaxed_ || is_new) {
    out.border.setZero(count_, r_);
    out.border_damping.setZero(count_, r_);
  }
  out.border_force.setZero(count_);
  out.modal.setZero(r_, r_);
  out.modal_force.setZero(r_);
  out.modal_energy = 0;
  if (!even_ || is_new) out.coupling_slopes.setZero(rows_, r_);
  out.coupling_force.setZero(count_);
  out.only = -1;
  out.active.clear();
  out.active_elastic.clear();
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (w(j) == 0) continue;
    const Target& target = targets_[j];
    out.only = out.active.empty() && w(j) == 1 ? int(j) : -1;
    out.active.push_back(target.coupling.data());
    out.active_elastic.push_back(e(j));
    out.stiffness += e(j) * target.stiffness;
    out.damping += e(j) * target.damping * target.stiffness;
    out.modal += e(j) * target.modal;
    if (relaxed_) {
      out.border += e(j) * target.border;
      out.border_damping += e(j) * target.damping * target.border;
    }
    if (even_) {
      out.shape += w(j) * target.coordinates;
      continue;
    }
    if (relaxed_) out.border_force.noalias() -= e(j) * (target.border * target.coordinates);
    out.shape_force.noalias() = target.modal * target.coordinates;
    out.modal_force -= e(j) * out.shape_force;
    out.modal_energy += 0.5 * e(j) * target.coordinates.dot(out.shape_force);
    if (target.coupling.empty()) continue;
    out.coupling_slopes += e(j) * target.coupling_slopes;
    out.coupling_force += e(j) * target.coupling_force;
  }
  if (relaxed_ || is_new) out.relaxation = out.stiffness.cwiseInverse().asDiagonal() * out.border;
  if (out.only >= 0) return;
  out.coupling.resize(targets_[0].coupling.size());
  blend_tables(out.active.data(), out.active_elastic.data(), int(out.active.size()), Index(out.coupling.size()),
               out.coupling.data());
}

double Responses::add(const Blend& blend, const VectorXd& q, double modes, Workspace& s, VectorXd& force,
                      ArrowMatrix& stiffness) const {
  if (count_ == 0) return 0;
  const auto y = q.tail(count_);
  s.x = q.head(r_) - blend.shape;
  s.b = blend.border_force;
  if (relaxed_) add_product(blend.border.data(), count_, s.x.data(), r_, s.b.data());
  s.relaxed = s.b.cwiseQuotient(blend.stiffness);
  s.shifted = y + s.relaxed;

  // E and E_2 with their derivatives, where y relaxes.
  const double lent = 0.5 * s.b.dot(s.relaxed);
  s.linear = blend.modal_force;
  s.linear.noalias() += blend.modal * s.x;
  const double linear = 0.5 * s.x.dot(s.linear + blend.modal_force) + blend.modal_energy;
  s.energy = force.head(r_);
  s.energy2 = stiffness.corner();

  force.tail(count_) = blend.stiffness.cwiseProduct(y) + s.b;
  stiffness.rest() = blend.stiffness;
  if (relaxed_) add_dots(blend.border.data(), count_, r_, y.data(), force.data());
  const double energy = y.dot(s.b) + 0.5 * y.dot(blend.stiffness.cwiseProduct(y));
  const LaneVector<float>& S = blend.only >= 0 ? targets_[blend.only].coupling : blend.coupling;
  if (S.empty()) {
    stiffness.border() = blend.border;
    return energy;
  }
  return energy + add_coupling(blend, S, {modes - lent, linear - lent}, s, force, stiffness);
}

double Responses::add_coupling(const Blend& blend, const LaneVector<float>& S, Payers payers, Workspace& s,
                               VectorXd& force, ArrowMatrix& stiffness) const {
  s.padded.setZero(rows_);
  s.padded.head(count_) = s.shifted;
  s.slopes = blend.coupling_slopes;
  couple_with(S, blend.elastic_of_coupling(), s.x, s.padded, s, s.slopes, s.bend);
  const auto J = s.slopes.topRows(count_);  // dc/dz
  s.moved.setZero(rows_);
  add_product(s.slopes.data(), rows_, s.x.data(), r_, s.moved.data());
  if (!even_) add_product(blend.coupling_slopes.data(), rows_, s.x.data(), r_, s.moved.data());
  s.c = blend.coupling_force + 0.5 * s.moved.head(count_);
  s.answer = s.c.cwiseQuotient(blend.stiffness);

  // y' . c with its derivatives by z
  const double work = s.shifted.dot(s.c);
  s.work.setZero(r_);
  add_dots(s.slopes.data(), rows_, r_, s.padded.data(), s.work.data());
  if (relaxed_) {
    add_dots(blend.border.data(), count_, r_, s.answer.data(), s.work.data());
    s.cross.setZero(r_, r_);
    for (Index k = 0; k < r_; ++k)
      add_dots(blend.relaxation.data(), count_, r_, J.col(k).data(), s.cross.col(k).data());
    s.bend += s.cross;
    s.bend += s.cross.transpose();
  }
  const double P = 0.5 * s.c.dot(s.answer), E = payers.energy, sum = E + payers.linear;
  auto corner = stiffness.corner();
  if (P * sum <= kExact * E * E && E >= 0) {
    force.head(r_) += s.work;
    force.tail(count_) += s.c;
    corner += s.bend;
    stiffness.border() = blend.border + J;
    return work;
  }
  const double ratio = P * sum / (E * E);
  if (!(E > 0 && ratio < kNothing)) {
    stiffness.border() = blend.border;
    return 0;
  }
  const Limit theta = limit(ratio);
  differentiate_ratio(blend, S, payers, ratio, s);
  force.head(r_) += theta.value * s.work + (theta.first * work) * s.ratio;
  force.tail(count_) += theta.value * s.c;
  corner += theta.value * s.bend + (theta.first * work) * s.ratio2;
  corner.noalias() += (theta.second * work) * s.ratio * s.ratio.transpose();
  add_outer(theta.first, s.work, s.ratio, corner);
  stiffness.border() = blend.border + theta.value * J;
  stiffness.border().noalias() += theta.first * s.c * s.ratio.transpose();
  return theta.value * work;
}

/// Writes the derivatives of P / pay by z to ratio and ratio2 of the workspace.
void Responses::differentiate_ratio(const Blend& blend, const LaneVector<float>& S, Payers payers, double ratio,
                                    Workspace& s) const {
  const double E = payers.energy, E2 = payers.linear, sum = E + E2, pay = E * E / sum;
  const double by_E = E * (E + 2 * E2) / (sum * sum), by_E2 = -E * E / (sum * sum);
  s.linear2 = blend.modal;
  if (relaxed_) {  // of the parts at y = 0 to those where y relaxes
    s.cross.noalias() = blend.border.transpose() * blend.relaxation;
    s.energy2 -= s.cross;
    s.linear2 -= s.cross;
    s.energy.noalias() -= blend.border.transpose() * s.relaxed;
    s.linear.noalias() -= blend.border.transpose() * s.relaxed;
  }
  s.pay = by_E * s.energy + by_E2 * s.linear;
  s.between = E2 * s.energy - E * s.linear;

  const auto J = s.slopes.topRows(count_);
  s.ratio.noalias() = J.transpose() * s.answer;
  s.ratio = (s.ratio - ratio * s.pay) / pay;
  s.padded.head(count_) = s.answer;
  s.unused_slopes.setZero(rows_, r_);
  couple_with(S, blend.elastic_of_coupling(), s.x, s.padded, s, s.unused_slopes, s.ratio2);
  s.scaled.noalias() = blend.stiffness.cwiseInverse().asDiagonal() * J;
  s.ratio2.noalias() += J.transpose() * s.scaled;
  s.ratio2 -= ratio * (by_E * s.energy2 + by_E2 * s.linear2);
  s.ratio2.noalias() -= (2 * ratio / (sum * sum * sum)) * s.between * s.between.transpose();
  add_outer(-1, s.ratio, s.pay, s.ratio2);
  s.ratio2 /= pay;
}

}  // namespace dynamorph
