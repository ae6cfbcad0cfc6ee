// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/integrator.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "dynamorph/sparse_solver.hpp"

namespace dynamorph {

namespace {

constexpr int kStaticIterations = 200;  // paid once, and gravity on a soft body is far to go

struct Coefficients {
  std::array<double, 4> past;      ///< of x^
  double c;                        ///< inertia is 1/(h c)^2
  std::array<double, 3> velocity;  ///< h u' = sum velocity[m] u(n+1-m)
};

Coefficients coefficients(Scheme scheme) {
  if (scheme == Scheme::euler) return {{2, -1, 0, 0}, 1, {1, -1, 0}};
  return {{24 / 9., -22 / 9., 8 / 9., -1 / 9.}, 2 / 3., {1.5, -2, 0.5}};
}

/// Solves H x = b by Cholesky; false when H is not positive definite.
class DenseSolver {
 public:
  bool solve(const MatrixXd& H, const VectorXd& b, VectorXd& x) {
    llt_.compute(H);
    if (llt_.info() != Eigen::Success) return false;
    x = llt_.solve(b);
    return true;
  }

 private:
  Eigen::LLT<MatrixXd> llt_;
};

template <class Matrix>
using TangentSolver = std::conditional_t<std::is_same_v<Matrix, MatrixXd>, DenseSolver, SparseSolver>;

void scale_rows(const VectorXd& mass, VectorXd& x) {
  for (Eigen::Index i = 0; i < mass.size(); ++i) x.segment<3>(3 * i) *= mass(i);
}

}  // namespace

template <class Model>
class Simulation<Model>::Solver : public TangentSolver<typename Model::Matrix> {};

template <class Model>
Simulation<Model>::Simulation(std::shared_ptr<const Model> model, StepOptions options)
    : model_(std::move(model)), options_(options), solver_(std::make_shared<Solver>()) {
  if (!(options_.h > 0) || !std::isfinite(options_.h))
    throw std::invalid_argument("h: the step must be a positive number of seconds");
  if (!options_.gravity.allFinite()) throw std::invalid_argument("gravity: must be finite");
  inertia_ = damped_ = stiffness_ = tangent_ = quadratic_.H = model_->zero();
}

template <class Model>
void Simulation<Model>::pose(const Transforms& bones, const VectorXd& weights) {
  if (bones.rows() != model_->body().skin.cols())
    throw std::invalid_argument("bones: expected " + std::to_string(model_->body().skin.cols()) + " transforms, got " +
                                std::to_string(bones.rows()));
  if (!bones.allFinite() || !weights.allFinite())
    throw Error("the rig has a transform that is not a number: check its drivers and constraints at this frame");
  frame_.bones = bones;
  pose_nodes(model_->body().skin, frame_);
  model_->blend(weights, blend_);
  mass_ = model_->body().volumes * blend_.mass.density;
}

template <class Model>
void Simulation<Model>::check_weights(const VectorXd& weights) const {
  const auto& targets = model_->targets();
  if (weights.size() != Eigen::Index(targets.size()))
    throw std::invalid_argument("weights: expected " + std::to_string(targets.size()) + ", got " +
                                std::to_string(weights.size()));
  VectorXd sums = VectorXd::Zero(model_->body().sets());
  for (Eigen::Index j = 0; j < weights.size(); ++j) sums(targets[j].set) += weights(j);
  if (!((weights.array() >= 0).all() && ((sums.array() - 1).abs() < 1e-6).all()))
    throw std::invalid_argument("weights: every target set's must be >= 0 and sum to one");
}

template <class Model>
void Simulation<Model>::resist(const VectorXd& external) {
  const Eigen::Index size = model_->body().rest.size();
  if (external.size() > 0 && external.size() != size)
    throw std::invalid_argument("external: expected " + std::to_string(size) + " values, got " +
                                std::to_string(external.size()));
  nodal_.resize(size);
  for (Eigen::Index i = 0; i < mass_.size(); ++i) nodal_.segment<3>(3 * i) = -mass_(i) * options_.gravity;
  if (!external.allFinite()) throw std::invalid_argument("external: forces must be finite");
  if (external.size() > 0) nodal_ -= external;
}

template <class Model>
void Simulation<Model>::pull_to_coordinates() {
  pull_back(frame_, nodal_);
  model_->project(nodal_, quadratic_.g);
  if (held_.size() > 0) quadratic_.g += held_ * blend_.weights;
}

template <class Model>
void Simulation<Model>::hold_targets(const std::vector<Transforms>& bones) {
  const auto& targets = model_->targets();
  if (bones.size() != targets.size())
    throw std::invalid_argument("bones: expected one skin frame for each of " + std::to_string(targets.size()) +
                                " targets, got " + std::to_string(bones.size()));
  MatrixXd held(model_->dofs(), targets.size());
  held_.resize(0, 0);
  for (size_t j = 0; j < targets.size(); ++j) {
    // The target alone, not even with the other sets': f_g^(j) = rho_j (A^(j))^T M1 g.
    VectorXd alone = VectorXd::Zero(targets.size());
    alone(j) = 1;
    pose(bones[j], alone);
    resist(VectorXd());
    pull_to_coordinates();
    held.col(j) = -quadratic_.g;
  }
  held_ = held;
}

template <class Model>
StepReport Simulation<Model>::solve_static(const Transforms& bones, const VectorXd& weights, VectorXd& q,
                                           const VectorXd& external) {
  check_weights(weights);
  pose(bones, weights);
  if (q.size() != model_->dofs()) {
    // The blended targets are close to the answer, and often are it.
    q.setZero(model_->dofs());
    for (Eigen::Index j = 0; j < weights.size(); ++j)
      if (weights(j) != 0) q += weights(j) * model_->target(int(j));
  }
  resist(external);
  pull_to_coordinates();
  values(quadratic_.H).setZero();
  quadratic_.origin = VectorXd::Zero(model_->dofs());
  quadratic_.round_off = 1e-15 * quadratic_.g.norm();
  if (!q.allFinite()) throw std::invalid_argument("q: coordinates must be finite");
  return minimize(q, kStaticIterations);
}

template <class Model>
StepReport Simulation<Model>::start(const Transforms& now, const Transforms& next, const VectorXd& weights) {
  if (next.rows() != now.rows() || !next.allFinite())
    throw std::invalid_argument("next: expected " + std::to_string(now.rows()) + " finite transforms, got " +
                                std::to_string(next.rows()));
  VectorXd q;
  const StepReport report = solve_static(now, weights, q);
  state_.q = {q, q};
  model_->displacement(q, displacement_[0]);
  displacement_[1] = displacement_[0];
  const VectorXd u = displacement_[0] + model_->body().rest;
  SkinFrame past;
  for (int k = 0; k < 4; ++k) {
    past.bones = extrapolate_back(now, next, k);
    pose_nodes(model_->body().skin, past);
    to_world(past, u, state_.x[k]);
  }
  return report;
}

template <class Model>
void Simulation<Model>::set_state(const State& state) {
  for (const VectorXd& q : state.q)
    if (q.size() != model_->dofs()) throw std::invalid_argument("state: is of another model");
  for (const VectorXd& x : state.x)
    if (x.size() != model_->body().rest.size()) throw std::invalid_argument("state: is of another model");
  state_ = state;
  for (int m = 0; m < 2; ++m) model_->displacement(state_.q[m], displacement_[m]);
}

template <class Model>
bool Simulation<Model>::carry_past() {
  if (options_.teleport <= 0) return false;
  const VectorXd course = 2 * state_.x[0] - state_.x[1];  // where the flesh would be had nothing jumped
  if ((lag_ - course).squaredNorm() < options_.teleport * options_.teleport * double(mass_.size())) return false;
  const Eigen::Map<const Eigen::Matrix3Xd> expected(course.data(), 3, mass_.size()), now(lag_.data(), 3, mass_.size());
  const Eigen::Matrix4d jump = Eigen::umeyama(expected, now, false);
  for (VectorXd& x : state_.x) {
    Eigen::Map<Eigen::Matrix3Xd> points(x.data(), 3, x.size() / 3);
    points = ((jump.topLeftCorner<3, 3>() * points).colwise() + jump.topRightCorner<3, 1>()).eval();
  }
  return true;
}

template <class Model>
StepReport Simulation<Model>::step(const Transforms& bones, const VectorXd& weights, const VectorXd& external) {
  if (state_.q[0].size() == 0) throw std::invalid_argument("step: start() comes first");
  check_weights(weights);
  pose(bones, weights);

  const Coefficients c = coefficients(options_.scheme);
  const double h = options_.h, inertial = 1 / (h * h * c.c * c.c);
  // Inertia about constant bind-pose velocity, exactly over the nodes; the model's own inertia acts on the change.
  VectorXd q = 2 * state_.q[0] - state_.q[1];
  nodal_ = 2 * displacement_[0] - displacement_[1] + model_->body().rest;
  to_world(frame_, nodal_, lag_);
  const bool teleported = carry_past();
  // Far from the world's origin posed positions lose digits, and inertia multiplies the loss.
  const double farthest = lag_.cwiseAbs().maxCoeff();
  for (int m = 0; m < 4; ++m)
    if (c.past[m] != 0) lag_ -= c.past[m] * state_.x[m];
  resist(external);
  for (Eigen::Index i = 0; i < mass_.size(); ++i)
    nodal_.segment<3>(3 * i) += inertial * mass_(i) * lag_.segment<3>(3 * i);
  pull_to_coordinates();
  model_->inertia(frame_, blend_.mass.density, inertia_);

  // Damping: C u' with u' = (v0 q + v1 q(n) + v2 q(n-1)) / h, constant symmetric positive C.
  if (model_->body().sets() == 1)
    values(damped_) = blend_.mass.damped(0) / blend_.mass.density(0) * values(inertia_);
  else
    model_->inertia(frame_, blend_.mass.damped, damped_);
  values(damped_) += values(blend_.damping);
  values(quadratic_.H) = inertial * values(inertia_) + (c.velocity[0] / h) * values(damped_);
  quadratic_.g += damped_ * ((c.velocity[1] * state_.q[0] + c.velocity[2] * state_.q[1]) / h);
  quadratic_.g += (c.velocity[0] / h) * (damped_ * q);
  quadratic_.origin = q;
  quadratic_.round_off = 1e-14 * inertial * farthest * std::sqrt(mass_.sum() * values(inertia_).cwiseAbs().maxCoeff());

  StepReport report = minimize(q, options_.max_iterations);
  report.teleported = teleported;

  std::swap(state_.q[0], state_.q[1]);
  state_.q[0] = q;
  std::swap(displacement_[0], displacement_[1]);
  model_->displacement(q, displacement_[0]);
  nodal_ = displacement_[0] + model_->body().rest;
  std::rotate(state_.x.rbegin(), state_.x.rbegin() + 1, state_.x.rend());
  to_world(frame_, nodal_, state_.x[0]);
  return report;
}

template <class Model>
void Simulation<Model>::require_pose() const {
  if (state_.q[0].size() == 0 || mass_.size() == 0)
    throw std::invalid_argument("energy: start() comes first, or after setting a state a step");
}

template <class Model>
void Simulation<Model>::descend(Matrix& H) {
  // Indefinite under compression, or without inertia where a bone has collapsed.
  const double unit = 1e-4 * values(H).cwiseAbs().maxCoeff();
  double shift = 0;
  while (!solver_->solve(H, gradient_, direction_)) {
    const double more = shift == 0 ? unit : 4 * shift;
    if (!(more > 0) || !(more < 1e12 * unit))
      throw Error("a step failed because a force is not finite: check the rig and the materials at this frame");
    H.diagonal().array() += more - shift;
    shift = more;
  }
  direction_ = -direction_;
}

template <class Model>
StepReport Simulation<Model>::minimize(VectorXd& q, int max_iterations) {
  const Quadratic& quadratic = quadratic_;
  StepReport report;
  elastic_ = model_->linearize(blend_, q, force_, stiffness_);
  for (;; ++report.iterations) {
    if (options_.keep_going && !options_.keep_going()) throw Cancelled();
    gradient_ = quadratic.H * (q - quadratic.origin);
    const double scale = gradient_.norm() + quadratic.g.norm() + force_.norm();
    gradient_ += quadratic.g + force_;
    // Terms as large as the stiffness times the displacement cancel in the elastic force.
    const double displacement = q.norm() + quadratic.origin.norm() + 0.1 * model_->body().size;
    const double round_off = quadratic.round_off + 1e-14 * values(stiffness_).cwiseAbs().maxCoeff() * displacement;
    if (!std::isfinite(scale))
      throw Error("a step failed because a force is not finite: check the rig and the materials at this frame");
    report.residual = gradient_.norm() / (scale + round_off / options_.tolerance);
    report.energy = elastic_;
    if (report.residual <= options_.tolerance || scale == 0) return report;
    if (report.iterations == max_iterations) break;
    values(tangent_) = values(quadratic.H) + values(stiffness_);
    descend(tangent_);
    if (!search(q, round_off * displacement)) break;
  }
  report.converged = report.residual <= 100 * options_.tolerance;
  return report;
}

template <class Model>
bool Simulation<Model>::search(VectorXd& q, double energy_round_off) {
  const Quadratic& quadratic = quadratic_;
  const double slope = gradient_.dot(direction_), norm = gradient_.norm();
  const auto potential = [&](const VectorXd& at, double elastic) {
    trial_ = at - quadratic.origin;
    return trial_.dot(0.5 * (quadratic.H * trial_) + quadratic.g) + elastic;
  };
  const double start = potential(q, elastic_);
  const double terms = std::abs(elastic_) + std::abs(start - elastic_);
  const double slack = 1e-12 * terms + energy_round_off;
  const auto descends = [&](double length, double reached) { return reached <= start + 1e-4 * length * slope + slack; };

  // The whole step is nearly always taken, so its force and tangent are evaluated at once. Where the potential's digits
  // run out, the gradient decides.
  const VectorXd from = q;
  q = from + direction_;
  elastic_ = model_->linearize(blend_, q, force_, stiffness_);
  const double reached = potential(q, elastic_);
  const double gradient_there = (quadratic.H * trial_ + quadratic.g + force_).norm();
  if (descends(1, reached) || (gradient_there < 0.5 * norm && reached <= start + 1e-6 * terms + slack)) return true;
  for (double length = 0.5; length > 1e-6; length /= 2) {
    q = from + length * direction_;
    if (!descends(length, potential(q, model_->energy(blend_, q)))) continue;
    elastic_ = model_->linearize(blend_, q, force_, stiffness_);
    return true;
  }
  q = from;
  return false;
}

template <class Model>
double Simulation<Model>::elastic_energy() const {
  require_pose();
  return model_->energy(blend_, state_.q[0]);
}

template <class Model>
double Simulation<Model>::kinetic_energy() const {
  require_pose();
  const VectorXd v = (1.5 * state_.x[0] - 2 * state_.x[1] + 0.5 * state_.x[2]) / options_.h;
  VectorXd momentum = v;
  scale_rows(mass_, momentum);
  return 0.5 * v.dot(momentum);
}

template class Simulation<FullModel>;
template class Simulation<ReducedModel>;

}  // namespace dynamorph
