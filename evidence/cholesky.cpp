// SPDX-License-Identifier: GPL-3.0-or-later
// The engine's sparse Cholesky against those of libraries, on the stiffness of bars: docs/decisions/0007.
//
// All run on one thread (OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1, for CHOLMOD) and count processor time. The pattern
// is analyzed before. CHOLMOD is measured where it is installed (libsuitesparse-dev).
#include <benchmark/benchmark.h>

#include <Eigen/SparseCholesky>
#include <map>
#include <random>
#ifdef WITH_CHOLMOD
#include <Eigen/CholmodSupport>
#endif
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include "../cpp/scenes.hpp"
#include "dynamorph/elastic/sparse_cholesky.hpp"

namespace {

using namespace dynamorph;
using benchmark::State;

/// The stiffness of a bar with about so many free nodes, four times as long as wide, pinned at one end.
const SparseMatrix& stiffness(int nodes) {
  static std::map<int, SparseMatrix> made;
  SparseMatrix& K = made[nodes];
  if (K.size() > 0) return K;
  const int across = int(std::lround(std::cbrt(nodes / 4.))), along = nodes / (across * across);
  const TetMesh mesh = scenes::bar(along, across - 1, across - 1, 1.0 / along);
  const VectorXd ones = VectorXd::Ones(mesh.tets.rows());
  std::vector<bool> pinned;
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) pinned.push_back(mesh.nodes(i, 0) < 1e-9);
  const auto body = std::make_shared<SoftBody>(mesh, ones, ones, ones, pinned, MatrixXd::Ones(mesh.nodes.rows(), 1));
  const MorphTarget neutral{"neutral", 0, VectorXd::Zero(mesh.nodes.size()), {1e5, 5e4}, 1000, 0, 0};
  return K = FullModel(body, {neutral}, MaterialModel::stvk, Blending::even).rest_stiffness(0);
}

MatrixXd loads(Eigen::Index dofs, Eigen::Index count) {
  std::mt19937 random(1);
  return MatrixXd::NullaryExpr(dofs, count, [&] { return double(random()) / (1u << 31) - 1; });
}

// --- Solvers, each by the same three functions -----------------------------------------------------------------------

template <class Real>
struct Own {
  BlockCholesky<Real> factor;
  std::vector<Real> scratch;
  void analyze(const SparseMatrix& K) { factor.factorize(K); }
  bool factorize(const SparseMatrix& K) { return factor.factorize(K); }
  void solve(MatrixXd& X) {
    if (X.cols() > 1) return factor.solve_in_place(X);
    VectorXd x = X.col(0);
    factor.solve(x, x, scratch);
    X.col(0) = x;
  }
};

template <class Library>
struct Other {
  Library factor;
  void analyze(const SparseMatrix& K) { factor.analyzePattern(K); }
  bool factorize(const SparseMatrix& K) {
    factor.factorize(K);
    return factor.info() == Eigen::Success;
  }
  void solve(MatrixXd& X) { X = factor.solve(X); }
};

using OwnDouble = Own<double>;
using OwnSingle = Own<float>;
using EigenLLT = Other<Eigen::SimplicialLLT<SparseMatrix>>;
using EigenLDLT = Other<Eigen::SimplicialLDLT<SparseMatrix>>;

double megabytes_in_use() {
#ifdef __GLIBC__
  const auto used = mallinfo2();
  return double(used.uordblks + used.hblkhd) / 1e6;
#else
  return 0;
#endif
}

// --- What is measured ------------------------------------------------------------------------------------------------

template <class Solver>
void factorize(State& state) {
  const SparseMatrix& K = stiffness(int(state.range(0)));
  const double before = megabytes_in_use();
  Solver solver;
  solver.analyze(K);
  for (auto _ : state)
    if (!solver.factorize(K)) state.SkipWithError("the stiffness is not positive definite");
  state.counters["dofs"] = double(K.rows());
  state.counters["MB"] = megabytes_in_use() - before;
}

/// One with a factor, which is kept until another size is asked for: the largest takes Eigen half a minute.
template <class Solver>
Solver& factored(int nodes) {
  static std::pair<int, std::unique_ptr<Solver>> kept;
  if (kept.first != nodes) {
    kept = {nodes, std::make_unique<Solver>()};
    kept.second->analyze(stiffness(nodes));
    kept.second->factorize(stiffness(nodes));
  }
  return *kept.second;
}

template <class Solver>
void solve(State& state) {
  const SparseMatrix& K = stiffness(int(state.range(1)));
  Solver& solver = factored<Solver>(int(state.range(1)));
  const MatrixXd B = loads(K.rows(), state.range(0));
  MatrixXd X;
  for (auto _ : state) {
    X = B;
    solver.solve(X);
    benchmark::ClobberMemory();
  }
  state.counters["dofs"] = double(K.rows());
  state.counters["residual"] = (K * X - B).norm() / B.norm();
}

const std::vector<std::int64_t> kNodes{200, 400, 1633, 3240, 16000};
const std::vector<std::int64_t> kSides{1, 8, 200};  // a step's, as many as the engine solves at once, a basis's

void unit(benchmark::internal::Benchmark* row) { row->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime(); }

#define MEASURE(Solver)                                                                        \
  BENCHMARK_TEMPLATE(factorize, Solver)->ArgName("nodes")->ArgsProduct({kNodes})->Apply(unit); \
  BENCHMARK_TEMPLATE(solve, Solver)->ArgNames({"sides", "nodes"})->ArgsProduct({kSides, kNodes})->Apply(unit)

MEASURE(OwnDouble);
MEASURE(OwnSingle);
MEASURE(EigenLLT);
MEASURE(EigenLDLT);
#ifdef WITH_CHOLMOD
using Cholmod = Other<Eigen::CholmodSupernodalLLT<SparseMatrix>>;
MEASURE(Cholmod);
#endif

}  // namespace

BENCHMARK_MAIN();
