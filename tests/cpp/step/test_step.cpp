// SPDX-License-Identifier: GPL-3.0-or-later
// What a time step costs in memory.
#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <atomic>
#include <cstdlib>

#include "dynamorph/pose/pose_space.hpp"
#include "dynamorph/step/simulation.hpp"
#include "scenes.hpp"

using namespace dynamorph;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SANITIZED
#endif
#endif

#ifdef __GLIBC__

static std::atomic<int> allocations{0};

// Every allocation of the program passes here: operator new and Eigen call malloc.
#ifdef SANITIZED  // which have a malloc of their own
extern "C" int __sanitizer_install_malloc_and_free_hooks(void (*)(const volatile void*, size_t),
                                                         void (*)(const volatile void*));
static const int hooked = __sanitizer_install_malloc_and_free_hooks([](const volatile void*, size_t) { ++allocations; },
                                                                    [](const volatile void*) {});
#else
extern "C" void* __libc_malloc(size_t size);
extern "C" void* malloc(size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
#endif

TEST_CASE("a step of a reduced model allocates nothing, whatever the law, the pose and the way they change") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  for (MaterialModel material_model : {MaterialModel::linear, MaterialModel::stvk, MaterialModel::stable_stvk})
    for (Blending blending : {Blending::forces, Blending::even}) {
      const auto model = scenes::reduced_model(body, targets, material_model, blending, 12);
      StepOptions options{1 / 240., Integrator::bdf2, Vector3d(0, 0, -9.81)};
      options.teleport = 10;
      MovingBody<ReducedModel> moving(model, options);
      Simulation<ReducedModel> simulation(moving);
      VectorXd w(3);
      w << 1, 0, 1;
      Transforms rig = scenes::bent(0);
      const Transforms next = scenes::bent(0.01);
      moving.balance_targets({rig, rig, rig});
      allocations = 0;
      moving.start({rig, w}, next);
      CHECK(allocations > 0);  // they are seen
      for (int i = 1; i <= 20; ++i) {
        w(1) = i % 5 == 0 ? 0 : 0.02 * i;  // one target alone, and a blend
        w(0) = 1 - w(1);
        rig = scenes::bent(0.01 * i);
        allocations = 0;
        CHECK(simulation.step({rig, w}).converged);
        if (i > 6) CHECK(allocations == 0);  // once it has seen what there is to allocate for
      }
    }
}

TEST_CASE("a step of a model with responses allocates nothing") {
  const auto body = scenes::two_bone_bar(2);
  for (MaterialModel material_model : {MaterialModel::linear, MaterialModel::stvk, MaterialModel::stable_stvk})
    for (Blending blending : {Blending::forces, Blending::even}) {
      const scenes::ResponseScene scene(body, scenes::targets(*body, 1), material_model, blending);
      MovingBody<ReducedModel> moving(scene.model, {1 / 240., Integrator::bdf2, Vector3d(0, 0, -9.81)});
      Simulation<ReducedModel> simulation(moving);
      VectorXd w(3);
      w << 1, 0, 1;
      Transforms rig = scenes::bent(0);
      moving.start({rig, w}, scenes::bent(0.01));
      for (int i = 1; i <= 20; ++i) {
        w(1) = i % 5 == 0 ? 0 : 0.02 * i;
        w(0) = 1 - w(1);
        rig = scenes::bent(0.01 * i);
        allocations = 0;
        CHECK(simulation.step({rig, w}).converged);
        if (i > 6) CHECK(allocations == 0);
      }
    }
}

TEST_CASE("weights and distances in pose space allocate nothing, with radii or without") {
  Pose rest{Rotations(1, 4), VectorXd::Zero(1)}, bent = rest, turned = rest;
  rest.rotations << 1, 0, 0, 0;
  bent.rotations << std::sqrt(0.5), std::sqrt(0.5), 0, 0;
  turned.rotations << std::sqrt(0.5), 0, std::sqrt(0.5), 0;
  turned.channels << 1;
  const PoseSpace space({{{0}, {"rest", "bent", "turned"}, {rest, bent, turned}, {0, 1, 2}, {0}}});
  VectorXd out(3);
  allocations = 0;
  space.weights(bent, out);
  space.distances(turned, out);
  CHECK(allocations == 0);
}

#endif
