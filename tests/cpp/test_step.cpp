// SPDX-License-Identifier: GPL-3.0-or-later
// What a time step costs in memory.
#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <cstdlib>

#include "dynamorph/basis.hpp"
#include "dynamorph/integrator.hpp"
#include "scenes.hpp"

using namespace dynamorph;

#ifdef __GLIBC__

static int allocations = 0;

// Every allocation of the program passes here: operator new and Eigen call malloc.
extern "C" void* __libc_malloc(size_t size);
extern "C" void* malloc(size_t size) {
  ++allocations;
  return __libc_malloc(size);
}

TEST_CASE("a step of a reduced model allocates nothing, whatever the law, the pose and the way they change") {
  const auto body = scenes::two_bone_bar(2);
  const auto targets = scenes::targets(*body, 1);
  for (Law law : {Law::linear, Law::stvk, Law::stable_stvk})
    for (Blending blending : {Blending::forces, Blending::even}) {
      const FullModel full(body, targets, law, blending);
      const auto model = std::make_shared<ReducedModel>(body, targets, reduce(full, make_basis(full, 12).U), blending);
      StepOptions options{1 / 240., Scheme::bdf2, Vector3d(0, 0, -9.81)};
      options.teleport = 10;
      Simulation<ReducedModel> simulation(model, options);
      VectorXd w(3);
      w << 1, 0, 1;
      Transforms rig = scenes::bent(0);
      const Transforms next = scenes::bent(0.01);
      simulation.hold_targets({rig, rig, rig});
      allocations = 0;
      simulation.start(rig, next, w);
      CHECK(allocations > 0);  // they are seen
      for (int i = 1; i <= 20; ++i) {
        w(1) = i % 5 == 0 ? 0 : 0.02 * i;  // one target alone, and a blend
        w(0) = 1 - w(1);
        rig = scenes::bent(0.01 * i);
        allocations = 0;
        CHECK(simulation.step(rig, w).converged);
        if (i > 6) CHECK(allocations == 0);  // once it has seen what there is to allocate for
      }
    }
}

#endif
