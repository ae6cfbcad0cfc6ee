// SPDX-License-Identifier: GPL-3.0-or-later
// The same motion with every compiler, on every system and processor, from the basis to the last step; and with one
// compiler and one instruction set the same bytes, which tests/golden/motion.py keeps for each version.
#include <doctest/doctest.h>

#include <cstdint>
#include <cstdio>

#include "dynamorph/simd/dispatch.hpp"
#include "dynamorph/step/simulation.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

#if defined(_WIN32)
constexpr const char* kSystem = "windows";
#elif defined(__APPLE__)
constexpr const char* kSystem = "macos";
#else
constexpr const char* kSystem = "linux";
#endif
#if defined(__aarch64__) || defined(_M_ARM64)
constexpr const char* kProcessor = "arm64";
#else
constexpr const char* kProcessor = "x64";
#endif
#if defined(__clang__)
constexpr const char* kCompiler = "clang";
constexpr int kVersion[] = {__clang_major__, __clang_minor__};
#else
constexpr const char* kCompiler = "gcc";
constexpr int kVersion[] = {__GNUC__, __GNUC_MINOR__};
#endif

/// FNV-1a of bytes.
struct Hash {
  std::uint64_t value = 0xcbf29ce484222325u;
  void add(const VectorXd& of) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(of.data());
    for (Index i = 0; i < of.size() * Index(sizeof(double)); ++i) value = (value ^ bytes[i]) * 0x100000001b3u;
  }
};

/// Where the bar's last node is displaced to in bind space, mm, while the second bone bends and stops. hash: gets all
/// coordinates of all steps.
template <class Model>
MatrixXd motion(std::shared_ptr<const Model> model, Hash& hash) {
  MovingBody<Model> moving(model, {1 / 120., Integrator::bdf2, Vector3d(0, 0, -1)});
  Simulation<Model> simulation(moving);
  VectorXd weights(3), u;
  weights << 1, 0, 0;
  MatrixXd tip(3, 4);
  moving.start({scenes::bent(0), weights}, scenes::bent(0));
  for (int i = 1; i <= 40; ++i) {
    const double bend = std::min(i / 20., 1.);
    weights << 1 - bend, 0.75 * bend, 0.25 * bend;
    CHECK(simulation.step({scenes::bent(0.3 * bend), weights}).converged);
    hash.add(moving.coordinates());
    if (i % 10) continue;
    model->displacement(moving.coordinates(), u);
    tip.col(i / 10 - 1) = 1e3 * u.tail<3>();
  }
  return tip;
}

void compare(const char* name, const MatrixXd& found, const double (&golden)[12]) {
  const MatrixXd expected = Eigen::Map<const MatrixXd>(golden, 3, 4);
  const double difference = (found - expected).cwiseAbs().maxCoeff() / expected.cwiseAbs().maxCoeff();
  std::printf("golden motion, %s: largest difference %.1e\n", name, difference);  // platforms_page.py reads it
  CHECK_MESSAGE(difference < 1e-5,
                name << ":\n"
                     << found.transpose().format(Eigen::IOFormat(Eigen::FullPrecision, 0, ", ", ",\n")));
}

}  // namespace

TEST_CASE("golden motion") {
  const auto body = scenes::two_bone_bar();
  const auto targets = scenes::targets(*body);
  Hash hash;
  compare("full",
          motion(std::make_shared<const FullModel>(body, targets, MaterialModel::stable_stvk, Blending::even), hash),
          {4.2907784900, -4.1432353815, -10.5704437700, 2.0342396184, -14.1891218249, 23.0424371488, 6.1583872997,
           -5.2701949233, -2.8805689556, 6.7380758993, 2.2699952010, -19.8078284228});
  compare("reduced", motion(scenes::reduced_model(body, targets, MaterialModel::stable_stvk, Blending::even, 12), hash),
          {3.8258928999, -3.5102558841, -5.6998408980, 1.4571716838, -13.2107248959, 24.5016644824, 6.7674225985,
           -3.2465900831, -9.3447091312, 6.7074515960, 1.9153922736, -17.0582826787});
  const scenes::ResponseScene responses(body, targets, MaterialModel::stable_stvk, Blending::even);
  compare("responses", motion(responses.model, hash),
          {5.3634223159, -12.7082282870, -13.7148552961, 4.3396507784, -21.7155667994, 20.1627377762, 6.2176358306,
           -8.2864695924, -0.9062509036, 5.8611776593, 3.0037209100, -14.1837051614});
  std::printf("golden bytes, %s-%s, %s %d.%d, %s: %016llx\n", kSystem, kProcessor, kCompiler, kVersion[0], kVersion[1],
              name_of(instruction_set()), static_cast<unsigned long long>(hash.value));
}
