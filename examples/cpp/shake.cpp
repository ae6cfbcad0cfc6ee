// SPDX-License-Identifier: GPL-3.0-or-later
// Shakes the soft skin of a model file for a second, while each set of targets goes from its first to its last, and
// prints the displacement of the surface, one vertex per line:
//   shake body.dynamorph
#include <dynamorph/file/soft_skin.hpp>
#include <dynamorph/step/simulation.hpp>
#include <iostream>

using namespace dynamorph;

namespace {

VectorXd shake(const file::Content& content) {
  std::vector<MorphTarget> targets(std::size_t(file::target_count(content)));
  for (MorphTarget& target : targets) {  // the file has their shapes; we choose their materials
    target.lame = lame_of(80e3, 0.4);    // Pa: Young's modulus; Poisson's ratio
    target.stiffness_damping = 0.005;    // s
  }
  if (!targets.empty()) targets[0].lame = lame_of(20e3, 0.4);  // relaxed
  const file::SoftSkin skin = file::load_soft_skin(content, targets);

  StepOptions options;
  options.h = 1.0 / 120;            // s
  options.gravity = {0, 0, -9.81};  // m/s^2
  MovingBody<ReducedModel> moving(skin.model, options);
  Simulation<ReducedModel> simulation(moving);
  Transforms bones(skin.model->body().skin.cols(), 12);  // bind space to world space
  bones.rowwise() = Eigen::RowVector<double, 12>{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
  const std::vector<MorphTarget>& known = skin.model->targets();
  VectorXd first = VectorXd::Zero(Eigen::Index(known.size())), last = first;
  for (std::size_t j = 0; j < known.size(); ++j) {
    first(j) = j == 0 || known[j - 1].set != known[j].set;
    last(j) = j + 1 == known.size() || known[j + 1].set != known[j].set;
  }
  moving.start({bones, first}, bones);
  for (int step = 1; step <= 120; ++step) {
    bones.col(3).setConstant(0.02 * std::sin(0.2 * step));  // m, along x
    const double done = step / 120.0;
    const VectorXd weights = (1 - done) * first + done * last;
    simulation.step({bones, weights});
  }
  return skin.surface(moving.coordinates(), last);
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 2) {
    std::cerr << "usage: shake MODEL\n"
                 "MODEL: a file that `dynamic_morph_targets build --cache-dir` or the Python package wrote\n";
    return 2;
  }
  try {
    const Eigen::IOFormat exact(Eigen::FullPrecision, Eigen::DontAlignCols);
    std::cout << as_points(shake(file::read(arguments[1]))).format(exact) << '\n';
  } catch (const std::exception& error) {
    std::cerr << "shake: " << error.what() << '\n';
    return 1;
  }
}
