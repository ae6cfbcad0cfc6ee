// SPDX-License-Identifier: GPL-3.0-or-later
// Shakes the soft skin of a model file for a second and prints the displacement of its surface, one vertex per line:
//   shake body.dynamorph
#include <dynamorph/file/soft_skin.hpp>
#include <dynamorph/step/simulation.hpp>
#include <iostream>

using namespace dynamorph;

int main(int, char** arguments) {
  MorphTarget relaxed{"relaxed"}, flexed{"flexed"};  // the file has their shapes; we choose their materials
  relaxed.lame = {28.6e3, 7.14e3};                   // Pa: Young's modulus 20 kPa, Poisson's ratio 0.4
  flexed.lame = {114e3, 28.6e3};
  relaxed.stiffness_damping = flexed.stiffness_damping = 0.005;  // s
  const file::SoftSkin skin = file::load_soft_skin(file::read(arguments[1]), {relaxed, flexed});

  StepOptions options;
  options.h = 1.0 / 120;            // s
  options.gravity = {0, 0, -9.81};  // m/s^2
  Simulation<ReducedModel> simulation(skin.model, options);
  Transforms bones(skin.model->body().skin.cols(), 12);  // bind space to world space
  bones.rowwise() = Eigen::RowVector<double, 12>{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
  VectorXd weights = VectorXd::Unit(2, 0);
  simulation.start(bones, bones, weights);
  for (int step = 1; step <= 120; ++step) {
    bones.col(3).setConstant(0.02 * std::sin(0.2 * step));  // m, along x
    weights << 1 - step / 120.0, step / 120.0;              // the muscle flexes
    simulation.step({bones, weights});
  }
  const Eigen::IOFormat exact(Eigen::FullPrecision, Eigen::DontAlignCols);
  std::cout << as_points(skin.surface(simulation.coordinates(), weights)).format(exact) << '\n';
}
