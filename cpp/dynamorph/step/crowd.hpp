// SPDX-License-Identifier: GPL-3.0-or-later
// Many characters of one reduced model, stepped together: eight at a time, one a lane of every instruction, so that the
// model's tables are read once for eight. The step is Simulation's; where the rig is cut, or no step descends, a
// character is stepped alone, by Simulation.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/step/eight.hpp"
#include "dynamorph/step/simulation.hpp"
#include "dynamorph/step/terms.hpp"

namespace dynamorph {

struct CrowdReport {
  int iterations = 0;     ///< of Newton's method, of all characters
  int alone = 0;          ///< characters that were stepped alone
  bool converged = true;  ///< all of them
};

class Crowd {
 public:
  /// `size` characters. options.keep_going is asked before every step, and as Simulation does of who is stepped alone.
  Crowd(std::shared_ptr<const ReducedModel> model, StepOptions options, int size);

  /// As Simulation's: of all characters.
  void hold_targets(const std::vector<Transforms>& bones);

  /// As Simulation's, for one character after another: now, next (size, B, 12) and weights (size, J), row-major.
  CrowdReport start(const double* now, const double* next, const double* weights);

  /// One step of every character to bones (size, B, 12) and weights (size, J), row-major. Nobody has moved when those
  /// are refused; after any other exception start() must come first again. What a character does depends on its seven
  /// neighbours in the last digits: small terms of the inertia are left out for eight or for none.
  CrowdReport step(const double* bones, const double* weights);

  int size() const { return size_; }
  const ReducedModel& model() const { return alone_.model(); }
  const StepOptions& options() const { return alone_.options(); }
  VectorXd coordinates(int character) const;

 private:
  /// Eight characters: coordinates (r) and the transforms of the used bones (12 each), now and at the last three steps.
  struct Eight {
    std::array<LaneVector<DoubleW>, InertialTarget::kMoments> q, bones;
  };
  /// As Simulation's members of these names.
  struct Scratch {
    ReducedModel::EightBlend blend;
    LaneVector<DoubleW> bones;  ///< at the end of the step (12 used)
    LaneVector<DoubleW> q, velocity;
    ModalInertia::EightInertia inertia;
    QuadraticTerm<EightLanes> quadratic;
    ElasticTerm<ReducedModel, EightLanes, ReducedModel::EightBlend> elastic;
    NewtonScratch<EightLanes> newton;
  };

  State lane(const Eight& eight, int lane) const;
  void set_lane(Eight& eight, int lane, const State& state) const;
  void check(const double* bones, const double* weights) const;
  template <class Step>
  void add(CrowdReport& report, int character, const Step& step);  ///< one that is started or stepped alone
  void step_eight(int eight, const double* bones, const double* weights, CrowdReport& report);
  void gather(int eight, const double* bones, const double* weights);
  Lanes jumps(const Eight& eight) const;  ///< lanes whose rig jumps off its course further than options.teleport
  void load(const Eight& eight);
  Lanes minimize(Lanes moving, CrowdReport& report);  ///< of these, the lanes that need to be stepped alone

  int size_;
  Simulation<ReducedModel> alone_;
  std::vector<Eight> eights_;
  Scratch scratch_;
};

}  // namespace dynamorph
