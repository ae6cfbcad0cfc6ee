// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/models/full_model.hpp"

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"
#include "dynamorph/elastic/sparse_solver.hpp"

namespace dynamorph {

namespace {

constexpr Eigen::Index kBlended = 2048;  // values blended at a time, so that the sums stay in the first cache

void check_size(const char* name, Eigen::Index actual, Eigen::Index expected) {
  if (actual != expected)
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(expected) + " rows, got " +
                                std::to_string(actual));
}

}  // namespace

SoftBody::SoftBody(TetMesh mesh_, VectorXd fill_, const VectorXd& stiffness, MatrixXd shares_,
                   const std::vector<bool>& pinned, const Eigen::Ref<const MatrixXd>& weights, const VectorXd& hold)
    : mesh(std::move(mesh_)), fill(std::move(fill_)), shares(std::move(shares_)) {
  const Eigen::Index n = mesh.nodes.rows(), m = mesh.tets.rows();
  check_size("fill", fill.size(), m);
  check_size("stiffness", stiffness.size(), m);
  check_size("shares", shares.rows(), m);
  check_size("pinned", Eigen::Index(pinned.size()), n);
  check_size("weights", weights.rows(), n);
  if (!(fill.array() > 0).all() || !(stiffness.array() > 0).all())
    throw std::invalid_argument("fill, stiffness: must be positive for every tetrahedron");
  if (!((shares.array() >= 0).all() && ((shares.rowwise().sum().array() - 1).abs() < 1e-6).all()))
    throw std::invalid_argument("shares: every row must be >= 0 and sum to one");
  if (!stiffness.allFinite() || !fill.allFinite())
    throw std::invalid_argument("fill, stiffness: must be finite for every tetrahedron");
  if (hold.size() > 0) check_size("hold", hold.size(), m);
  if (!hold.allFinite() || (hold.array() < 0).any())
    throw std::invalid_argument("hold: must be finite and not negative for every tetrahedron");
  stiffness_scale = fill.cwiseProduct(stiffness);
  free_of_node.assign(n, -1);
  for (int i = 0; i < n; ++i)
    if (!pinned[i]) {
      free_of_node[i] = int(free_nodes.size());
      free_nodes.push_back(i);
    }
  if (free_nodes.empty())
    throw Error("every node of the cage is held by a bone: lower the bone pinning or raise the cage resolution");

  const Eigen::Index f = Eigen::Index(free_nodes.size());
  own_transforms = weights.cols() == 0;
  if (own_transforms) {
    skin.resize(f, f);
    skin.setIdentity();
  } else {
    MatrixXd free_weights(f, weights.cols());
    for (Eigen::Index i = 0; i < f; ++i) free_weights.row(i) = weights.row(free_nodes[i]);
    skin = normalized(free_weights);
  }
  rest = restrict_to_free(flat(mesh.nodes));
  const auto lumped = [&](const VectorXd& density) {
    MatrixXd out(f, sets());
    for (int s = 0; s < sets(); ++s) {
      const VectorXd all = lumped_volumes(mesh, density.cwiseProduct(shares.col(s)));
      for (Eigen::Index i = 0; i < f; ++i) out(i, s) = all(free_nodes[i]);
    }
    return out;
  };
  volumes = lumped(fill);
  if ((hold.array() > 0).any()) holds = lumped(stiffness_scale.cwiseProduct(hold));
  volume = volumes.sum();
  centre.setZero();
  for (Eigen::Index i = 0; i < f; ++i) centre += volumes.row(i).sum() / volume * rest.segment<3>(3 * i);
  moments.assign(skin.cols(), Eigen::Matrix4d::Zero());
  for (Eigen::Index i = 0; i < f; ++i) {
    const Eigen::Vector4d p = (rest.segment<3>(3 * i) - centre).homogeneous();
    for (SkinWeights::InnerIterator b(skin, i); b; ++b)
      moments[b.col()] += volumes.row(i).sum() * b.value() * p * p.transpose();
  }
  size = (mesh.nodes.colwise().maxCoeff() - mesh.nodes.colwise().minCoeff()).norm();
}

VectorXd SoftBody::restrict_to_free(const VectorXd& node_values) const {
  VectorXd out(3 * free_nodes.size());
  for (size_t i = 0; i < free_nodes.size(); ++i) out.segment<3>(3 * i) = node_values.segment<3>(3 * free_nodes[i]);
  return out;
}

VectorXd SoftBody::expand(const VectorXd& free_values) const {
  VectorXd out = VectorXd::Zero(3 * free_of_node.size());
  for (size_t i = 0; i < free_nodes.size(); ++i) out.segment<3>(3 * free_nodes[i]) = free_values.segment<3>(3 * i);
  return out;
}

void SetDensities::blend(const std::vector<MorphTarget>& targets, int sets, const VectorXd& w) {
  density.setZero(sets);
  damped.setZero(sets);
  for (size_t j = 0; j < targets.size(); ++j) {
    density(targets[j].set) += w(j) * targets[j].density;
    damped(targets[j].set) += w(j) * targets[j].density * targets[j].mass_damping;
  }
}

FullModel::FullModel(std::shared_ptr<const SoftBody> body, std::vector<MorphTarget> targets, Law law, Blending blending)
    : body_(std::move(body)),
      targets_(std::move(targets)),
      law_(law),
      blending_(blending),
      assembly_(body_->mesh, body_->free_of_node) {
  if (targets_.empty()) throw std::invalid_argument("targets: at least one is needed");
  VectorXd force;
  Matrix K = zero();
  for (Eigen::Index i = 0; i < dofs(); ++i) diagonal_.push_back(&K.coeffRef(i, i) - K.valuePtr());
  for (const MorphTarget& target : targets_) {
    if (target.set < 0 || target.set >= body_->sets())
      throw std::invalid_argument("targets: '" + target.name + "' is in set " + std::to_string(target.set) +
                                  ", there are " + std::to_string(body_->sets()));
    check_size("displacement", target.displacement.size(), body_->mesh.nodes.size());
    if (!target.displacement.allFinite()) throw Error("target '" + target.name + "' has a shape that is not finite");
    const double properties =
        target.lame.mu + target.lame.lambda + target.density + target.mass_damping + target.stiffness_damping;
    if (!(target.lame.mu > 0 && target.lame.lambda >= 0 && target.density > 0 && target.mass_damping >= 0 &&
          target.stiffness_damping >= 0 && std::isfinite(properties)))
      throw std::invalid_argument("targets: '" + target.name + "' needs finite stiffness and density above zero");
    const VectorXd d = body_->restrict_to_free(target.displacement);
    if (body_->expand(d) != target.displacement)
      throw std::invalid_argument("targets: '" + target.name + "' displaces pinned nodes");
    rest_displacements_.push_back(d);
    shapes_.push_back(rest_shape(body_->mesh, target.displacement,
                                 body_->stiffness_scale.cwiseProduct(body_->shares.col(target.set)), target.shifted));
    elements_.push_back(assembly_.pack(shapes_.back(), false));
    // The linear law's stiffness is StVK's at the rest shape.
    const Law law = law_ == Law::linear ? Law::stvk : law_;
    assembly_.linearize(law, {{1, target.lame, &elements_.back()}}, VectorXd::Zero(d.size()), force, K);
    for (Eigen::Index i = 0; body_->holds.size() > 0 && i < dofs(); ++i)
      K.valuePtr()[diagonal_[i]] += target.lame.mu * body_->holds(i / 3, target.set);
    rest_stiffness_.push_back(values(K));
    rest_pull_.push_back(K * d);
    if (blending_ == Blending::forces) elements_.back() = assembly_.pack(shapes_.back(), true);
  }
}

FullModel::Matrix FullModel::rest_stiffness(int target) const {
  Matrix K = zero();
  values(K) = rest_stiffness_[target];
  return K;
}

void FullModel::blend(const VectorXd& w, Blend& out) const {
  check_size("weights", w.size(), Eigen::Index(targets_.size()));
  if (out.weights.size() == w.size() && out.weights == w) return;  // the pose did not change
  out.weights = w;
  out.mass.blend(targets_, body_->sets(), w);
  const bool linear = law_ == Law::linear, even = blending_ == Blending::even;
  if (out.damping.nonZeros() != assembly_.pattern().nonZeros()) out.damping = assembly_.pattern();
  if (linear && out.stiffness.nonZeros() != assembly_.pattern().nonZeros()) out.stiffness = assembly_.pattern();
  const Eigen::Index size = out.damping.nonZeros();
  for_chunks(int((size + kBlended - 1) / kBlended), [&](int chunk) {
    const Eigen::Index first = chunk * kBlended, some = std::min(kBlended, size - first);
    auto damping = values(out.damping).segment(first, some);
    damping.setZero();
    if (linear) values(out.stiffness).segment(first, some).setZero();
    for (Eigen::Index j = 0; j < w.size(); ++j) {
      if (w(j) == 0) continue;
      const auto rest = rest_stiffness_[j].segment(first, some);
      damping += w(j) * targets_[j].stiffness_damping * rest;
      if (linear) values(out.stiffness).segment(first, some) += w(j) * rest;
    }
  });
  if (even) {
    out.displacement.setZero(dofs());
    for (Eigen::Index j = 0; j < w.size(); ++j)
      if (w(j) != 0) out.displacement += w(j) * rest_displacements_[j];
  }
  if (!linear) return blend_hold(w, out);
  out.energy = 0;
  if (even) {
    multiply_symmetric(out.stiffness, out.displacement, out.force);
    out.force = -out.force;
    out.energy = -0.5 * out.displacement.dot(out.force);
    return;
  }
  out.force.setZero(dofs());
  for (Eigen::Index j = 0; j < w.size(); ++j) {
    if (w(j) == 0) continue;
    out.force -= w(j) * rest_pull_[j];
    out.energy += 0.5 * w(j) * rest_displacements_[j].dot(rest_pull_[j]);
  }
}

std::vector<Assembly::Part> FullModel::parts(const Blend& blend) const {
  std::vector<Assembly::Part> out;
  for (size_t j = 0; j < targets_.size(); ++j)
    if (blend.weights(j) != 0) out.push_back({blend.weights(j), targets_[j].lame, &elements_[j]});
  return out;
}

VectorXd FullModel::given(const Blend& blend, const VectorXd& q) const {
  // Even blending: target j's displacement q - d(q) + d_j, which from its own shape is the same for all.
  return blending_ == Blending::even ? VectorXd(q - blend.displacement) : q;
}

void FullModel::blend_hold(const VectorXd& w, Blend& out) const {
  if (body_->holds.size() == 0) return;
  out.hold.setZero(dofs());
  out.hold_shapes.setZero(blending_ == Blending::even ? 0 : dofs());
  out.hold_energy = 0;
  for (Eigen::Index j = 0; j < w.size(); ++j) {
    if (w(j) == 0) continue;
    const VectorXd nodes = w(j) * targets_[j].lame.mu * body_->holds.col(targets_[j].set);
    const VectorXd own = nodes.replicate(1, 3).transpose().reshaped();
    out.hold += own;
    if (blending_ == Blending::even) continue;  // about each target's own shape, which is where x is zero
    out.hold_shapes += own.cwiseProduct(rest_displacements_[j]);
    out.hold_energy += 0.5 * own.dot(rest_displacements_[j].cwiseAbs2());
  }
}

double FullModel::hold_energy(const Blend& blend, const VectorXd& x, VectorXd& pull) const {
  pull = blend.hold.cwiseProduct(x);
  const double energy = 0.5 * x.dot(pull);
  if (blending_ == Blending::even) return energy;
  pull -= blend.hold_shapes;
  return energy - x.dot(blend.hold_shapes) + blend.hold_energy;
}

double FullModel::energy(const Blend& blend, const VectorXd& q) const {
  if (law_ == Law::linear) return blend.energy + q.dot(0.5 * (blend.stiffness * q) + blend.force);
  const VectorXd x = given(blend, q);
  VectorXd pull;
  const double held = body_->holds.size() > 0 ? hold_energy(blend, x, pull) : 0;
  return assembly_.energy(law_, parts(blend), x) + held;
}

double FullModel::linearize(const Blend& blend, const VectorXd& q, VectorXd& force, Matrix& stiffness) const {
  if (stiffness.nonZeros() != assembly_.pattern().nonZeros()) stiffness = assembly_.pattern();
  if (law_ != Law::linear) {
    const VectorXd x = given(blend, q);
    const double energy = assembly_.linearize(law_, parts(blend), x, force, stiffness);
    if (body_->holds.size() == 0) return energy;
    VectorXd pull;
    const double held = hold_energy(blend, x, pull);
    force += pull;
    for (Eigen::Index i = 0; i < dofs(); ++i) stiffness.valuePtr()[diagonal_[i]] += blend.hold(i);
    return energy + held;
  }
  values(stiffness) = values(blend.stiffness);
  multiply_symmetric(blend.stiffness, q, force);
  force += blend.force;
  return blend.energy + 0.5 * q.dot(force + blend.force);
}

void FullModel::inertia(const Motion& motion, const SetDensities& densities, Inertia& out) const {
  out.force.setZero(dofs());
  out.frame.bones = *motion.bones[0];
  pose_nodes(body_->skin, out.frame);
  for (int n = 0; n < Motion::kPoses; ++n) {
    if (motion.share.col(n).isZero(0)) continue;
    if (n > 0) {
      out.past.bones = *motion.bones[n];
      pose_nodes(body_->skin, out.past);
    }
    const double sum = motion.share.col(n).sum();
    out.bind = sum * body_->rest;
    for (int m = 0; m < Motion::kMoments; ++m)
      if (motion.share(m, n) != 0) out.bind += motion.share(m, n) * *motion.q[m];
    to_world(n > 0 ? out.past : out.frame, sum, out.bind, out.posed);
    out.force += out.posed;
  }
  if (out.mass.nonZeros() != assembly_.pattern().nonZeros()) out.mass = out.damped = assembly_.pattern();
  values(out.mass).setZero();
  values(out.damped).setZero();
  for (size_t i = 0; i < body_->free_nodes.size(); ++i) {
    const auto A = transform(out.frame.nodes, Eigen::Index(i)).leftCols<3>();
    const Matrix3d square = A.transpose() * A;
    const double mass = body_->volumes.row(i).dot(densities.density);
    const double damped = body_->volumes.row(i).dot(densities.damped);
    for (int c = 0; c < 3; ++c)
      for (int r = 0; r < 3; ++r) {
        out.mass.coeffRef(3 * i + r, 3 * i + c) = mass * square(r, c);
        out.damped.coeffRef(3 * i + r, 3 * i + c) = damped * square(r, c);
      }
    out.force.segment<3>(3 * i) = mass * (out.force.segment<3>(3 * i) - motion.lift);
  }
  pull_back(out.frame, out.force);
}

MatrixXd extend_shapes(const SoftBody& body, const Embedding& embedding, const MatrixXd& surfaces) {
  // Unit material: the shape of the fill-in does not depend on the stiffness. The pull is 1e4 times the mean nodal
  // stiffness per vertex, so the surface is met to about 1e-4 where the cage can carry it.
  MorphTarget neutral;
  neutral.displacement = VectorXd::Zero(3 * body.mesh.nodes.rows());
  neutral.lame = {1, 1};
  auto whole = std::make_shared<SoftBody>(body);
  whole->shares.setOnes(body.mesh.tets.rows(), 1);
  whole->holds.resize(0, 0);  // what is held is held in the target's shape, which is sought
  const FullModel model(whole, {neutral}, Law::linear, Blending::forces);
  SparseMatrix A = model.rest_stiffness(0);
  const double pull = 1e4 * A.diagonal().mean();

  check_size("surfaces", surfaces.rows(), 3 * embedding.nodes.rows());
  if (!surfaces.allFinite()) throw Error("a target's shape is not finite: repair its shape key");
  const SparseMatrix E = embedding.matrix(body.mesh.nodes.rows());
  std::vector<Eigen::Triplet<double>> entries;
  for (int node = 0; node < E.outerSize(); ++node)
    for (SparseMatrix::InnerIterator it(E, node); it; ++it)
      if (body.free_of_node[node] >= 0)
        for (int c = 0; c < 3; ++c)
          entries.emplace_back(3 * int(it.row()) + c, 3 * body.free_of_node[node] + c, it.value());
  SparseMatrix B(surfaces.rows(), model.dofs());
  B.setFromTriplets(entries.begin(), entries.end());
  A += pull * SparseMatrix(B.transpose() * B);
  BlockCholesky<double> solver;
  if (!solver.factorize(A)) throw Error("a target's shape could not be carried into the cage: rebuild it");
  MatrixXd solution = pull * (B.transpose() * surfaces);
  solver.solve_in_place(solution);
  MatrixXd out(3 * body.mesh.nodes.rows(), surfaces.cols());
  for (Eigen::Index j = 0; j < out.cols(); ++j) out.col(j) = body.expand(solution.col(j));
  return out;
}

}  // namespace dynamorph
