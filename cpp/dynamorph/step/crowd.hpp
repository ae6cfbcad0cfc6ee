// SPDX-License-Identifier: GPL-3.0-or-later
// Steps many characters of one reduced model together: eight at a time, one in each lane of every instruction, so that
// the model's tables are read once for eight. The step is that of Simulation. Where the rig jumps to another place, or
// no step descends, Simulation steps the character alone.
#pragma once

#include <memory>
#include <vector>

#include "dynamorph/step/eight.hpp"
#include "dynamorph/step/simulation.hpp"
#include "dynamorph/step/terms.hpp"

namespace dynamorph {

struct CrowdReport {
  int iterations = 0;     ///< of Newton's method, for all characters together
  int alone = 0;          ///< characters that were stepped alone
  bool converged = true;  ///< whether all of them did
};

class Crowd {
 public:
  /// `size` characters, at most a million. options.keep_going is called before every step, and by Simulation for a
  /// character stepped alone.
  Crowd(std::shared_ptr<const ReducedModel> model, StepOptions options, int size);

  /// As in Simulation, for all characters.
  void balance_targets(const std::vector<Transforms>& bones);

  /// As in Simulation, for one character after another. now, next (size, B, 12) and weights (size, J) are row-major.
  CrowdReport start(const double* now, const double* next, const double* weights);

  /// Takes one step of every character to bones (size, B, 12) and weights (size, J), row-major. If it refuses those, no
  /// character has moved. After any other exception, start() must be called first again. The last digits of a
  /// character's motion depend on its seven neighbors, because small terms of the inertia are left out for all eight or
  /// for none.
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
  /// Like the members of Simulation with these names.
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
  void add(CrowdReport& report, int character, const Step& step);  ///< a character that is started or stepped alone
  void step_eight(int eight, const double* bones, const double* weights, CrowdReport& report);
  void gather(int eight, const double* bones, const double* weights);
  Lanes jumps(const Eight& eight) const;  ///< lanes in which the rig jumps off its course farther than options.teleport
  void load(const Eight& eight);
  Lanes minimize(Lanes moving, CrowdReport& report);  ///< returns the lanes that need to be stepped alone

  int size_;
  Simulation<ReducedModel> alone_;
  std::vector<Eight> eights_;
  Scratch scratch_;
};

}  // namespace dynamorph
