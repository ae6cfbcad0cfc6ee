// SPDX-License-Identifier: GPL-3.0-or-later
// What the parts of the engine cost: `make bench`, whose bench.py makes the table of it.
//
// One solid throughout: the tetrahedra in the file that the command line names, else a bar of as many degrees of
// freedom. Its long side lies along x, where a chain of bones swings it; it is pinned where the chain begins. A step is
// one Newton iteration of 1/60 s, as in the figures that we compare with. What runs on one core counts processor time,
// which other work on the machine hardly changes; the rest, marked UseRealTime, what a clock shows.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <optional>
#include <tuple>

#include "../cpp/scenes.hpp"
#include "dynamorph/elastic/dense_factor.hpp"
#include "dynamorph/pose/pose_space.hpp"
#include "dynamorph/reduced/modes/basis.hpp"
#include "dynamorph/reduced/modes/polynomial_kernels.hpp"
#include "dynamorph/reduced/reduced_model.hpp"
#include "dynamorph/step/simulation.hpp"
#include "machine_kernels.hpp"
#ifdef __linux__
#include <sched.h>
#endif

namespace {

using namespace dynamorph;
using benchmark::State;

const char* solid_file = nullptr;
constexpr int kSolidNodes = 1633;
constexpr int kFrames = 64;  ///< of a motion, which then begins again
constexpr double kStep = 1 / 60.;

/// Keeps the thread, and the threads that it starts, on the core that it is on.
class OneCore {
#ifdef __linux__
 public:
  OneCore() {
    sched_getaffinity(0, sizeof before_, &before_);
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(sched_getcpu(), &one);
    sched_setaffinity(0, sizeof one, &one);
  }
  ~OneCore() { sched_setaffinity(0, sizeof before_, &before_); }

 private:
  cpu_set_t before_;
#endif
};

// --- Scene -----------------------------------------------------------------------------------------------------------

struct Solid {
  TetMesh mesh;
  std::vector<bool> pinned;
};

/// About `nodes` nodes, four times as long as wide.
Solid bar(int nodes) {
  const int across = int(std::lround(std::cbrt(nodes / 4.))), along = nodes / (across * across);
  Solid solid{scenes::bar(along - 1, across - 1, across - 1, 1.7 / along), {}};
  for (Eigen::Index i = 0; i < solid.mesh.nodes.rows(); ++i) solid.pinned.push_back(solid.mesh.nodes(i, 0) < 1e-9);
  return solid;
}

/// The file's numbers of nodes, tetrahedra and pins (int32), then those: xyz (double), four nodes each, nodes (int32).
Solid read_solid(const char* path) {
  std::ifstream file(path, std::ios::binary);
  const auto read = [&](auto* values, size_t count) {
    file.read(reinterpret_cast<char*>(values), std::streamsize(count * sizeof *values));
  };
  std::int32_t counts[3];
  read(counts, 3);
  Solid solid;
  solid.mesh.nodes.resize(counts[0], 3);
  solid.mesh.tets.resize(counts[1], 4);
  std::vector<std::int32_t> pins(counts[2]);
  read(solid.mesh.nodes.data(), solid.mesh.nodes.size());
  read(solid.mesh.tets.data(), solid.mesh.tets.size());
  read(pins.data(), pins.size());
  if (!file) throw std::runtime_error(std::string("cannot read ") + path);
  solid.pinned.assign(counts[0], false);
  for (std::int32_t pin : pins) solid.pinned[pin] = true;
  return solid;
}

/// The solid of the whole suite, or for 0 < nodes a bar.
Solid solid(int nodes) {
  if (nodes > 0) return bar(nodes);
  return solid_file ? read_solid(solid_file) : bar(kSolidNodes);
}

/// Bones of a rig with `chain` bones that carry moving soft tissue, in the proportion of the MakeHuman body.
constexpr int kBody = 21;
int rig_bones(int chain) { return chain * 53 / kBody; }

/// Each node hangs on the three bones of the chain that are nearest, smoothly: 21 bones and 39 pairs of them. Of the
/// MakeHuman body's, 20 bones and 43 pairs count for the inertia.
std::shared_ptr<const SoftBody> skinned(const Solid& solid, int chain) {
  const Points& X = solid.mesh.nodes;
  const double begin = X.col(0).minCoeff(), length = X.col(0).maxCoeff() - begin;
  MatrixXd weights = MatrixXd::Zero(X.rows(), rig_bones(chain));
  for (Eigen::Index i = 0; i < X.rows(); ++i) {
    const double along = (X(i, 0) - begin) / length * (chain - 1), off = along - std::round(along);
    const double spline[3] = {0.5 * (0.5 - off) * (0.5 - off), 0.75 - off * off, 0.5 * (0.5 + off) * (0.5 + off)};
    for (int k = 0; k < 3; ++k) weights(i, std::clamp(int(std::round(along)) + k - 1, 0, chain - 1)) += spline[k];
  }
  const VectorXd ones = VectorXd::Ones(solid.mesh.tets.rows());
  return std::make_shared<SoftBody>(solid.mesh, ones, ones, ones, solid.pinned, weights);
}

/// A neutral target and bulges along the solid, of different stiffness.
std::vector<MorphTarget> targets(const SoftBody& body, int count) {
  const Points& X = body.mesh.nodes;
  const Eigen::RowVector3d low = X.colwise().minCoeff(), size = X.colwise().maxCoeff() - low, middle = low + size / 2;
  std::vector<MorphTarget> out;
  for (int j = 0; j < count; ++j) {
    Points shape = Points::Zero(X.rows(), 3);
    for (Eigen::Index i = 0; j > 0 && i < X.rows(); ++i) {
      const double along = ((X(i, 0) - low(0)) / size(0) - double(j) / count) / 0.15;
      shape.row(i) = 0.2 * std::exp(-along * along) * (X.row(i) - middle);
      shape(i, 0) = 0;
    }
    const double young = 1e5 * (1 + j % 3), poisson = 0.4;
    const Lame lame{young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))};
    out.push_back(
        {"target " + std::to_string(j), 0, body.expand(body.restrict_to_free(flat(shape))), lame, 1000, 1, 0.005});
  }
  return out;
}

/// A swinging chain of bones, which goes on beyond the soft tissue, and what its targets weigh meanwhile.
struct Swing {
  std::vector<Transforms> bones;
  std::vector<Rotations> pose;
  std::vector<VectorXd> weights;  ///< all of them active
};

Swing swing(const SoftBody& body, int targets) {
  const Eigen::Index bones = body.skin.cols();
  const int chain = 1 + *std::max_element(body.skin.innerIndexPtr(), body.skin.innerIndexPtr() + body.skin.nonZeros());
  const Points& X = body.mesh.nodes;
  const double begin = X.col(0).minCoeff(), spacing = (X.col(0).maxCoeff() - begin) / double(std::max(chain, 2));
  Swing out;
  for (int k = 0; k < kFrames; ++k) {
    const double phase = 2 * kPi * k / kFrames;
    Transforms frame(bones, 12);
    Rotations local(bones, 4);
    Vector3d joint(begin, 0, 0);
    double before = 0;
    for (Eigen::Index b = 0; b < bones; ++b) {
      const double turned = 0.2 * std::sin(phase + 3.0 * double(b) / chain);
      Eigen::Matrix<double, 3, 4, Eigen::RowMajor> bone;
      bone.leftCols<3>() = Eigen::AngleAxisd(turned, Vector3d::UnitZ()).matrix();
      bone.col(3) = joint - bone.leftCols<3>() * Vector3d(begin + spacing * double(b), 0, 0);
      frame.row(b) = Eigen::Map<const Eigen::Matrix<double, 1, 12>>(bone.data());
      joint += spacing * bone.col(0);
      local.row(b) << std::cos((turned - before) / 2), 0, 0, std::sin((turned - before) / 2);
      before = turned;
    }
    out.bones.push_back(frame);
    out.pose.push_back(local);
    out.weights.emplace_back(VectorXd::NullaryExpr(targets, [&](Eigen::Index j) {
                               return 1 + 0.5 * std::sin(phase + double(j));
                             }).normalized());
    out.weights.back() /= out.weights.back().sum();
  }
  return out;
}

/// Targets at poses of the chain, each where it is turned further than the one before.
PoseSpace pose_space(Eigen::Index bones, int targets) {
  TargetSet set;
  for (int b = 1; b < std::min<int>(int(bones), 4); ++b) set.bones.push_back(b);
  for (int j = 0; j < targets; ++j) {
    Rotations pose(bones, 4);
    for (int b = 0; b < bones; ++b) pose.row(b) << std::cos(0.1 * j), 0, 0, std::sin(0.1 * j);
    set.names.push_back("target " + std::to_string(j));
    set.poses.push_back({pose});
  }
  return PoseSpace({set});
}

struct Case {
  int targets = 1, r = 19;
  MaterialModel material_model = MaterialModel::stvk;
  int chain = 4, nodes = 0;
};

const FullModel& full_model(int targets, MaterialModel material_model, int chain, int nodes) {
  static std::map<std::tuple<int, MaterialModel, int, int>, FullModel> made;
  const auto key = std::make_tuple(targets, material_model, chain, nodes);
  auto found = made.find(key);
  if (found == made.end()) {
    const auto body = skinned(solid(nodes), chain);
    found = made.emplace(key, FullModel(body, ::targets(*body, targets), material_model, Blending::even)).first;
  }
  return found->second;
}

/// The first r of the modes that are made once for all r: the most important come first.
MatrixXd modes(const FullModel& model, int r) {
  static std::map<const SoftBody*, MatrixXd> made;
  MatrixXd& U = made[&model.body()];
  if (U.cols() < r) U = make_basis(model, std::max(r, model.body().free_nodes.size() < 2000 ? 60 : 20)).U;
  return U.leftCols(r);
}

std::shared_ptr<const ReducedModel> reduced_model(const Case& c) {
  static std::map<std::tuple<int, int, MaterialModel, int, int>, std::shared_ptr<const ReducedModel>> made;
  auto& model = made[std::make_tuple(c.targets, c.r, c.material_model, c.chain, c.nodes)];
  if (!model) {
    const FullModel& full = full_model(c.targets, c.material_model, c.chain, c.nodes);
    const ReducedTables tables = reduce(full, modes(full, c.r));
    model = std::make_shared<const ReducedModel>(full.shared_body(), full.targets(), tables, Blending::even);
  }
  return model;
}

StepOptions one_iteration() {
  StepOptions options;
  options.h = kStep;
  options.max_iterations = 1;
  return options;
}

StepOptions to_convergence() {
  StepOptions options;
  options.h = kStep;
  return options;
}

template <class Model>
void measure_steps(State& state, const std::shared_ptr<const Model>& model, const StepOptions& options) {
  const Swing rig = swing(model->body(), int(model->targets().size()));
  MovingBody<Model> moving(model, options);
  Simulation<Model> simulation(moving);
  moving.start({rig.bones[0], rig.weights[0]}, rig.bones[1]);
  int k = 0, iterations = 0;
  for (auto _ : state) {
    k = (k + 1) % kFrames;
    iterations += simulation.step({rig.bones[k], rig.weights[k]}).iterations;
  }
  state.counters["iterations"] = benchmark::Counter(iterations, benchmark::Counter::kAvgIterations);
  state.counters["dofs"] = double(3 * model->body().mesh.nodes.rows());
}

// --- The machine -----------------------------------------------------------------------------------------------------

void operations(State& state) {
  const OneCore pinned;
  const bool single = state.range(0) == 4;
  constexpr int kRounds = 100000;
  for (auto _ : state) benchmark::DoNotOptimize(single ? operate_on_floats(kRounds) : operate_on_doubles(kRounds));
  const double lanes = 32. / double(state.range(0));
  state.counters["per_second"] =
      benchmark::Counter(2 * lanes * kChains * kRounds, benchmark::Counter::kIsIterationInvariantRate);
}
BENCHMARK(operations)->ArgName("bytes")->Arg(4)->Arg(8);

void bandwidth(State& state) {
  const OneCore pinned;
  const size_t bytes = size_t(state.range(0)) << 10;
  std::vector<double> data(bytes / 8 + 8, 1.0);
  const double* aligned = data.data() + (64 - reinterpret_cast<std::uintptr_t>(data.data()) % 64) / 8;
  for (auto _ : state) benchmark::DoNotOptimize(read_through(aligned, bytes / 8));
  state.counters["per_second"] = benchmark::Counter(double(bytes), benchmark::Counter::kIsIterationInvariantRate);
}
BENCHMARK(bandwidth)->ArgName("kB")->ArgsProduct({{16, 256, 3072, 8192, 24576, 262144}});

// --- Precompute ------------------------------------------------------------------------------------------------------

void polynomials(State& state) {
  const OneCore pinned;
  const FullModel& model = full_model(1, MaterialModel::stvk, 4, 0);
  const MatrixXd U = modes(model, int(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(reduce(model, U));
}
BENCHMARK(polynomials)->ArgName("r")->ArgsProduct({{8, 12, 19, 30, 40, 60}})->Iterations(1)->MeasureProcessCPUTime();

/// Modes, derivatives, PCA, polynomials and inertia tensors, on all cores.
void precompute(State& state) {
  const FullModel& model = full_model(6, MaterialModel::stvk, 4, 0);
  for (auto _ : state) {
    const ReducedTables tables = reduce(model, make_basis(model, 19).U);
    benchmark::DoNotOptimize(ReducedModel(model.shared_body(), model.targets(), tables, Blending::even));
  }
}
BENCHMARK(precompute)->Iterations(1)->UseRealTime();

// --- Reduced steps ---------------------------------------------------------------------------------------------------

void sizes(benchmark::internal::Benchmark* benchmark) {
  benchmark->ArgNames({"targets", "r"});
  for (int r : {8, 12, 19, 30, 40, 60}) benchmark->Args({1, r});
  for (int r : {12, 19, 30, 60}) benchmark->Args({6, r});
  for (int j : {2, 3, 12}) benchmark->Args({j, 19});
}

Case sized(const State& state) { return {int(state.range(0)), int(state.range(1))}; }

void step(State& state) {
  const OneCore pinned;
  measure_steps(state, reduced_model(sized(state)), one_iteration());
}
BENCHMARK(step)->Apply(sizes);

/// As many iterations as it takes.
void converged_step(State& state) {
  const OneCore pinned;
  measure_steps(state, reduced_model(sized(state)), to_convergence());
}
BENCHMARK(converged_step)->Apply(sizes);

void blend(State& state) {
  const OneCore pinned;
  const auto model = reduced_model(sized(state));
  const Swing rig = swing(model->body(), int(state.range(0)));
  ReducedModel::Blend blended;
  int k = 0;
  for (auto _ : state) model->blend(moving.weights[k++ % kFrames], blended);
}
BENCHMARK(blend)->Apply(sizes);

/// Force, tangent and energy.
void linearize(State& state) {
  const OneCore pinned;
  const auto model = reduced_model(sized(state));
  const VectorXd z = 0.1 * model->target(int(state.range(0)) - 1) + VectorXd::Constant(model->dofs(), 1e-3);
  ReducedModel::Blend blended;
  model->blend(swing(model->body(), int(state.range(0))).weights[0], blended);
  VectorXd force;
  ReducedModel::Matrix tangent;
  ReducedModel::Workspace workspace;
  for (auto _ : state) {
    workspace.begin(0);
    benchmark::DoNotOptimize(model->linearize(blended, z, workspace, force, tangent));
  }
  const double coefficients = double(TableLayout{model->dofs(), true}.size());
  state.counters["coefficients"] = coefficients;
  state.counters["bytes"] = coefficients * sizeof(decltype(blended.table)::value_type);
}
BENCHMARK(linearize)->Apply(sizes);

/// What the figures that we compare with call a step: force, tangent, solve and update at a constant mass, and of
/// several targets the blend for a new pose.
void iterate(State& state, const Case& c) {
  const OneCore pinned;
  const auto model = reduced_model(c);
  const Swing rig = swing(model->body(), int(state.range(0)));
  VectorXd z, force, direction;
  std::vector<VectorXd> rest;  // the blended targets, frame by frame
  for (const VectorXd& w : moving.weights) {
    rest.push_back(VectorXd::Constant(model->dofs(), 1e-3));
    for (Eigen::Index j = 0; j < w.size(); ++j) rest.back() += w(j) * model->target(int(j));
  }
  const VectorXd inertia = VectorXd::Constant(model->dofs(), 1000 / (kStep * kStep));
  ReducedModel::Matrix tangent;
  ReducedModel::Blend blended;
  ArrowFactor factor;
  ReducedModel::Workspace workspace;
  int k = 0;
  for (auto _ : state) {
    k = (k + 1) % kFrames;
    model->blend(moving.weights[k], blended);
    workspace.begin(0);
    benchmark::DoNotOptimize(model->linearize(blended, rest[k], workspace, force, tangent));
    tangent.add_to_diagonal(1, inertia);
    if (!factor.compute(tangent)) state.SkipWithError("the tangent is not positive definite");
    factor.solve(force, direction);
    z = rest[k] - direction;
  }
}
void iteration(State& state) { iterate(state, sized(state)); }
BENCHMARK(iteration)->Apply(sizes);

void linear_iteration(State& state) { iterate(state, {int(state.range(0)), 19, MaterialModel::linear}); }
BENCHMARK(linear_iteration)->ArgName("targets")->Arg(1)->Arg(6);

void linear_step(State& state) {
  const OneCore pinned;
  measure_steps(state, reduced_model({int(state.range(0)), 19, MaterialModel::linear}), one_iteration());
}
BENCHMARK(linear_step)->ArgName("targets")->Arg(1)->Arg(6);

/// One solve for Newton's direction in 20 modes and 100 responses, with so many rows of points of the skin beside the
/// tangent.
void solve_with_points(State& state) {
  const OneCore pinned;
  ArrowMatrix H(20, 100);
  values(H).setRandom();
  H.corner() = (H.corner() + MatrixXd(H.corner().transpose())).eval();
  H.add_to_diagonal(1, VectorXd::Constant(H.rows(), 200));
  const DensePoints points{RowMajor::Random(state.range(0), H.rows()), VectorXd::Constant(state.range(0), 30)};
  const VectorXd b = VectorXd::Random(H.rows());
  VectorXd x;
  ArrowSolver solver;
  for (auto _ : state)
    if (!solver.solve(H, {&points}, b, x)) state.SkipWithError("the tangent is not positive definite");
}
BENCHMARK(solve_with_points)->ArgName("rows")->ArgsProduct({{0, 5, 10, 20, 50, 100, 200}});

// --- Full steps ------------------------------------------------------------------------------------------------------

void full_step(State& state, MaterialModel material_model, bool all_cores) {
  std::optional<OneCore> pinned;
  if (!all_cores) pinned.emplace();
  const FullModel& model = full_model(6, material_model, 4, 0);
  const std::shared_ptr<const FullModel> shared(&model, [](const FullModel*) {});  // lives as long as the program
  measure_steps(state, shared, one_iteration());
}
BENCHMARK_CAPTURE(full_step, linear, MaterialModel::linear, false)->Iterations(32);
BENCHMARK_CAPTURE(full_step, stvk, MaterialModel::stvk, false)->Iterations(16);
BENCHMARK_CAPTURE(full_step, stvk_all_cores, MaterialModel::stvk, true)->Iterations(16)->UseRealTime();

// --- The rig: skin frame, inertia and target weights -----------------------------------------------------------------

void pose_weights(State& state) {
  const OneCore pinned;
  const int count = int(state.range(1));
  const auto body = skinned(bar(500), int(state.range(0)));
  const PoseSpace space = pose_space(body->skin.cols(), count);
  const Swing rig = swing(*body, count);
  VectorXd weights(count);
  int k = 0;
  for (auto _ : state) space.weights(moving.pose[k++ % kFrames], weights);
}
BENCHMARK(pose_weights)->ArgNames({"chain", "targets"})->Args({kBody, 3})->Args({kBody, 6});

/// What a moving rig costs a step of r = 20, whatever the law: the targets' weights at its pose, and the inertia.
void rig(State& state) {
  const OneCore pinned;
  const auto model = reduced_model({3, 20, MaterialModel::linear, int(state.range(0)), int(state.range(1))});
  const PoseSpace space = pose_space(model->body().skin.cols(), 3);
  const Swing rig = swing(model->body(), 3);
  const VectorXd z = VectorXd::Constant(20, 1e-3);
  InertialTarget inertial;
  inertial.q.fill(&z);
  inertial.coefficients = StepRule(one_iteration()).coefficients();
  ReducedModel::Blend blended;
  ReducedModel::Inertia inertia;
  VectorXd weights(3);
  int k = 0;
  for (auto _ : state) {
    k = (k + 1) % kFrames;
    for (int n = 0; n < InertialTarget::kPoses; ++n) inertial.bones[n] = &moving.bones[(k + kFrames - n) % kFrames];
    space.weights(moving.pose[k], weights);
    blended.mass.blend(model->targets(), 1, weights);
    model->inertia(inertial, blended.mass, inertia);
  }
  state.counters["nodes"] = double(model->body().mesh.nodes.rows());
  state.counters["bones"] = double(model->body().skin.cols());
}
BENCHMARK(rig)
    ->ArgNames({"chain", "nodes"})
    ->ArgsProduct({{kBody}, {500, 2000, 8000}})
    ->ArgsProduct({{2, 8, 14, 42}, {2000}});

// --- Surface ---------------------------------------------------------------------------------------------------------

/// Phi z for `vertices` and r modes, Phi in single precision: blocks of rows, each stored column after column, so that
/// the sums stay in the first cache.
void surface(State& state) {
  const OneCore pinned;
  constexpr Eigen::Index kBlock = 384;
  const Eigen::Index r = state.range(1), blocks = (3 * state.range(0) + kBlock - 1) / kBlock;
  const Eigen::MatrixXf modes = Eigen::MatrixXf::Random(kBlock, r * blocks);
  const VectorXd z = VectorXd::Random(r);
  VectorXd out(kBlock * blocks);
  for (auto _ : state) {
    out.setZero();
    for (Eigen::Index b = 0; b < blocks; ++b)
      add_single_product(modes.data() + b * kBlock * r, kBlock, z.data(), r, out.data() + b * kBlock);
    benchmark::ClobberMemory();
  }
  state.counters["bytes"] = double(modes.size()) * sizeof(float);
}
BENCHMARK(surface)->ArgNames({"vertices", "r"})->Args({13000, 20});

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (argc > 1) solid_file = argv[1];
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
