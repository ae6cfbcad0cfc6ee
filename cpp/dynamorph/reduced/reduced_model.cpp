// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/reduced_model.hpp"

#include "dynamorph/reduced/modes/polynomial_kernels.hpp"

namespace dynamorph {

namespace {

void pack(const MatrixXd& symmetric, VectorXd& packed) {
  const Eigen::Index r = symmetric.rows();
  packed.resize(r * (r + 1) / 2);
  for (Eigen::Index k = 0, p = 0; k < r; ++k)
    for (Eigen::Index l = k; l < r; ++l, ++p) packed(p) = symmetric(k, l);
}

/// y = S x for a packed symmetric S.
void multiply_packed(const VectorXd& S, const VectorXd& x, VectorXd& y) {
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

std::vector<VectorXd> checked_coordinates(const SoftBody& body, const std::vector<MorphTarget>& targets,
                                          const MatrixXd& U) {
  check_targets(body, targets);
  return target_coordinates(body, targets, U);
}

TableLayout checked_layout(const std::vector<MorphTarget>& targets, const ReducedTables& tables) {
  const TableLayout layout = tables.layout();
  if (tables.lambda.size() != targets.size() || tables.mu.size() != targets.size())
    throw std::invalid_argument("tables: expected one for each of " + std::to_string(targets.size()) + " targets");
  for (size_t j = 0; j < targets.size(); ++j) {
    if (tables.lambda[j].size() != layout.distinct() || tables.mu[j].size() != layout.distinct())
      throw std::invalid_argument("tables: of '" + targets[j].name + "' do not fit " + std::to_string(layout.r) +
                                  " modes");
    if (!tables.lambda[j].allFinite() || !tables.mu[j].allFinite())
      throw std::invalid_argument("tables: of '" + targets[j].name + "' must be finite");
  }
  return layout;
}

std::variant<ModalInertia, NodalInertia> inertia_of(const std::shared_ptr<const SoftBody>& body, const MatrixXd& U) {
  if (body->own_transforms) return NodalInertia(body, U);
  return ModalInertia(*body, U);
}

/// W, checked against U (3 free, r); (3 free, 0) if there is none.
MatrixXd checked_responses(const ReducedTables& tables) {
  const MatrixXd& W = tables.responses;
  if (W.cols() == 0) return MatrixXd(tables.basis.rows(), 0);
  if (W.rows() != tables.basis.rows() || !W.allFinite())
    throw std::invalid_argument("tables: responses must be finite and have the rows of the basis");
  return W;
}

/// U and W (3 free, r + h).
MatrixXd checked_basis(const ReducedTables& tables) {
  const MatrixXd& U = tables.basis;
  const MatrixXd W = checked_responses(tables);
  MatrixXd all(U.rows(), U.cols() + W.cols());
  all << U, W;
  return all;
}

/// Shifts a table (Taylor) from v = z - z_j to z. Returns the energy at z = 0, and writes the force (r) there.
double recenter(const TableLayout& layout, const VectorXd& coordinates, VectorXd& table, VectorXd& force) {
  const Eigen::Index r = layout.r, pairs = layout.pairs();
  VectorXd packed;
  MatrixXd tangent;
  const double energy = linearize(table, layout, -coordinates, force, tangent);
  pack(tangent, packed);
  table.head(pairs) = packed;
  if (!layout.nonlinear) return energy;
  Eigen::Map<MatrixXd> K1(table.data() + layout.linear(), pairs, r);
  for (Eigen::Index m = 0, q = 0; m < r; ++m)
    for (Eigen::Index n = m; n < r; ++n, ++q)
      for (Eigen::Index p = 0; p < pairs; ++p) {
        const double entry = table(layout.quadratic(p, q));
        K1(p, m) -= 2 * coordinates(n) * entry;
        if (n != m) K1(p, n) -= 2 * coordinates(m) * entry;
      }
  return energy;
}

/// [K1 | K2] in the order of table_layout.hpp.
LaneVector<float> in_single_precision(const TableLayout& layout, const VectorXd& table) {
  if (!layout.nonlinear) return {};
  const Eigen::Index pairs = layout.pairs(), rows = whole_chunks(pairs);
  LaneVector<float> out(rows * layout.r + symmetric_size(rows), 0.0F);
  for (Eigen::Index m = 0; m < layout.r; ++m)
    for (Eigen::Index p = 0; p < pairs; ++p) out[m * rows + p] = float(table(layout.linear() + m * pairs + p));
  float* quadratic = out.data() + rows * layout.r;
  for (Eigen::Index q = 0; q < pairs; ++q)
    for (Eigen::Index p = q / kChunk * kChunk; p < pairs; ++p)
      quadratic[symmetric_index(rows, p, q)] = float(table(layout.quadratic(p, q)));
  return out;
}

}  // namespace

double linearize(const VectorXd& table, const TableLayout& layout, const VectorXd& v, VectorXd& force,
                 MatrixXd& stiffness) {
  const Eigen::Index r = layout.r, pairs = layout.pairs();
  const VectorXd constant = table.head(pairs);
  VectorXd linear = VectorXd::Zero(pairs), quadratic = linear;
  if (layout.nonlinear) {
    linear = Eigen::Map<const MatrixXd>(table.data() + layout.linear(), pairs, r) * v;
    for (Eigen::Index m = 0, q = 0; m < r; ++m)
      for (Eigen::Index n = m; n < r; ++n, ++q)
        for (Eigen::Index p = 0; p < pairs; ++p)
          quadratic(p) += (m == n ? 1 : 2) * v(m) * v(n) * table(layout.quadratic(p, q));
  }
  multiply_packed(constant + linear / 2 + quadratic / 3, v, force);
  stiffness.resize(r, r);
  const VectorXd tangent = constant + linear + quadratic;
  unpack([&](Eigen::Index p) { return tangent(p); }, stiffness);
  return packed_quadratic(constant / 2 + linear / 6 + quadratic / 12, v);
}

ReducedModel::ReducedModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets,
                           const ReducedTables& tables, Blending blending)
    : body_(std::move(body)),
      targets_(std::move(targets)),
      blending_(blending),
      basis_(checked_basis(tables)),
      coordinates_(checked_coordinates(*body_, targets_, tables.basis)),
      layout_(checked_layout(targets_, tables)),
      responses_(tables, targets_, coordinates_, blending_),
      padded_pairs_(whole_chunks(layout_.pairs())),
      inertia_(inertia_of(body_, tables.basis)),
      response_inertia_(body_, tables.basis, checked_responses(tables)) {
  check(tables.material_model);
  check(blending_);
  const Eigen::Index r = layout_.r;
  for (size_t j = 0; j < targets_.size(); ++j) {
    VectorXd table = unfolded(targets_[j].lame.lambda * tables.lambda[j] + targets_[j].lame.mu * tables.mu[j], layout_);
    if (responses_.count() > 0) {
      VectorXd stiffness;
      pack(responses_.modal_stiffness(int(j)), stiffness);
      table.head(layout_.pairs()) = stiffness;
    }
    rest_stiffness_.push_back(table.head(layout_.pairs()));
    forces_.push_back(VectorXd::Zero(r));
    energies_.push_back(0);
    if (blending_ == Blending::forces) energies_[j] = recenter(layout_, coordinates_[j], table, forces_[j]);
    stiffness_.push_back(table.head(layout_.pairs()));
    tables_.push_back(in_single_precision(layout_, table));
  }
}

void ReducedModel::blend(const VectorXd& w, const VectorXd& e, Blend& out) const {
  check_size("weights", w.size(), Eigen::Index(targets_.size()));
  check_size("elastic", e.size(), w.size());
  if (out.of == this && out.weights.size() == w.size() && out.weights == w && out.elastic == e) return;  // as before
  if (out.of != this) out.responses = {};
  out.of = this;
  const Eigen::Index r = layout_.r, pairs = layout_.pairs();
  out.weights = w;
  out.elastic = e;
  out.mass.blend(targets_, body_->sets(), w);
  out.active.clear();
  out.active_elastic.clear();
  out.stiffness.setZero(pairs);
  out.packed_damping.setZero(pairs);
  out.force.setZero(r);
  out.center.setZero(r);
  out.energy = 0;
  out.only = -1;
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (w(j) == 0) continue;
    out.only = out.active.empty() && w(j) == 1 ? int(j) : -1;
    out.active.push_back(tables_[j].data());
    out.active_elastic.push_back(e(j));
    out.stiffness += e(j) * stiffness_[j];
    out.packed_damping += e(j) * targets_[j].stiffness_damping * rest_stiffness_[j];
    if (blending_ == Blending::even) {
      out.center += w(j) * coordinates_[j];
    } else {
      out.force += e(j) * forces_[j];
      out.energy += e(j) * energies_[j];
    }
  }
  responses_.blend(w, e, out.responses);
  if (!out.damping.fits(layout_.r, dofs())) out.damping = zero();
  unpack([&](Eigen::Index p) { return out.packed_damping(p); }, out.damping.corner());
  if (responses_.count() > 0) {
    out.damping.rest() = out.responses.damping;
    out.damping.border() = out.responses.border_damping;
  }
  if (!layout_.nonlinear || out.only >= 0) return;
  out.table.resize(tables_[0].size());
  blend_tables(out.active.data(), out.active_elastic.data(), int(out.active.size()), Eigen::Index(out.table.size()),
               out.table.data());
}

void ReducedModel::expand(const Blend& blend, const VectorXd& z, Workspace& workspace) const {
  const Eigen::Index r = layout_.r, rows = padded_pairs_;
  Workspace::Orders &now = workspace.now, &anchor = workspace.anchor;
  now.v = z.head(r) - blend.center;
  if (!layout_.nonlinear && now.linear.size() == rows) return;  // always zero
  if (!layout_.nonlinear) {
    now.linear.setZero(rows);
    now.quadratic.setZero(rows);
    return;
  }
  now.pairs.setZero(rows);
  workspace.change.resize(r);  // here, so that only the first step allocates
  workspace.pair_changes.resize(rows);
  double* pair = now.pairs.data();
  for (Eigen::Index k = 0; k < r; ++k) {
    *pair++ = now.v(k) * now.v(k);
    for (Eigen::Index l = k + 1; l < r; ++l) *pair++ = 2 * now.v(k) * now.v(l);
  }
  const float* table = (blend.only >= 0 ? tables_[blend.only] : blend.table).data();
  const double elastic = blend.only >= 0 ? blend.active_elastic[0] : 1;  // of that table
  // With forces blending v is the displacement from rest. Even a small relative error of it hides the way to a target.
  const bool near = blending_ == Blending::even && workspace.anchored;
  if (!near || (now.v - anchor.v).norm() > workspace.near * now.v.norm()) {
    now.linear.setZero(rows);
    now.quadratic.setZero(rows);
    add_single_product(table, rows, now.v.data(), r, now.linear.data());
    add_symmetric_product(table + rows * r, rows, now.pairs.data(), now.quadratic.data());
    if (elastic != 1) {
      now.linear *= elastic;
      now.quadratic *= elastic;
    }
    anchor = now;
    workspace.anchored = true;
    return;
  }
  for (Eigen::Index k = 0; k < r; ++k) workspace.change[k] = float(elastic * (now.v(k) - anchor.v(k)));
  for (Eigen::Index p = 0; p < rows; ++p) workspace.pair_changes[p] = float(elastic * (now.pairs(p) - anchor.pairs(p)));
  now.linear = anchor.linear;
  now.quadratic = anchor.quadratic;
  add_short_product(table, rows, workspace.change.data(), r, now.linear.data());
  add_short_symmetric_product(table + rows * r, rows, workspace.pair_changes.data(), now.quadratic.data());
}

double ReducedModel::energy(const Blend& blend, const VectorXd& z, Workspace& workspace) const {
  return linearize(blend, z, workspace, workspace.unused_force, workspace.unused_stiffness);
}

double ReducedModel::linearize(const Blend& blend, const VectorXd& z, Workspace& workspace, VectorXd& force,
                               Matrix& stiffness) const {
  expand(blend, z, workspace);
  const Workspace::Orders& now = workspace.now;
  const Eigen::Index r = layout_.r;
  force.resize(dofs());
  if (!stiffness.fits(layout_.r, dofs())) stiffness = zero();
  const double energy = contract_orders(blend.stiffness.data(), now.linear.data(), now.quadratic.data(), now.v.data(),
                                        r, force.data(), stiffness.corner().data());
  force.head(r) += blend.force;
  const double modes = blend.energy + blend.force.dot(now.v) + energy;
  return modes + responses_.add(blend.responses, z, modes, workspace.responses, force, stiffness);
}

void ReducedModel::inertia(const InertialTarget& inertial, const SetDensities& densities, Inertia& out) const {
  ModalInertia::Result& modes = out.modes;
  if (const auto* nodal = std::get_if<NodalInertia>(&inertia_))
    nodal->evaluate(inertial, densities, out.nodes, modes.mass, modes.damped, modes.force);
  else
    std::get<ModalInertia>(inertia_).evaluate(inertial, densities, modes);
  if (!out.mass.fits(layout_.r, dofs())) out.mass = out.damped = zero();
  out.mass.corner() = modes.mass;
  out.damped.corner() = modes.damped;
  out.force.resize(dofs());
  out.force.head(layout_.r) = modes.force;
  response_inertia_.evaluate(inertial, densities, out.responses, out.mass, out.damped, out.force);
}

void ReducedModel::rigid_force(const Transforms& now, const Transforms& moved, const SetDensities& densities,
                               Inertia& scratch, VectorXd& force) const {
  force.resize(dofs());
  if (const auto* nodal = std::get_if<NodalInertia>(&inertia_))
    nodal->rigid_force(now, moved, densities, scratch.nodes, force.head(layout_.r));
  else
    std::get<ModalInertia>(inertia_).rigid_force(now, moved, densities, scratch.modes, force.head(layout_.r));
  response_inertia_.rigid_force(now, moved, densities, scratch.responses, force);
}

VectorXd ReducedModel::target(int j) const {
  VectorXd out = VectorXd::Zero(dofs());
  out.head(layout_.r) = coordinates_[j];
  return out;
}

void ReducedModel::displacement(const VectorXd& z, VectorXd& u) const {
  u.setZero(basis_.rows());
  add_product(basis_.data(), basis_.rows(), z.data(), z.size(), u.data());
}

void ReducedModel::project_force(const VectorXd& f, VectorXd& out) const {
  out.setZero(dofs());
  add_dots(basis_.data(), basis_.rows(), basis_.cols(), f.data(), out.data());
}

}  // namespace dynamorph
