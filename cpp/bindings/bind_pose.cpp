// SPDX-License-Identifier: GPL-3.0-or-later
#include "arrays.hpp"
#include "bindings.hpp"
#include "dynamorph/pose/pose_space.hpp"

using namespace dynamorph;

void bind_pose(py::module_& m) {
  const auto rotations = [](const char* name, const FloatArray& local) {
    check_shape(name, local, {-1, 4, 4});
    Rotations out(local.shape(0), 4);
    const LocalTransforms transforms(local.data(), local.shape(0), 16);
    for (int bone = 0; bone < out.rows(); ++bone) rotation_of(transforms, bone, out);
    return out;
  };
  py::class_<TargetSet>(m, "TargetSet", "Targets whose weights sum to one.")
      .def(py::init([rotations](std::vector<int> bones, std::vector<std::string> names,
                                const std::vector<FloatArray>& poses, std::vector<double> radii) {
             TargetSet set{std::move(bones), std::move(names), {}, std::move(radii)};
             for (const FloatArray& pose : poses) set.poses.push_back(rotations("poses", pose));
             return set;
           }),
           "bones"_a, "names"_a, "poses"_a, "radii"_a = std::vector<double>(),
           "bones: indices of the bones; their local rotations place the targets. poses: for each target, the local "
           "transforms (B, 4, 4) of the whole skeleton. radii: for each target, the joint angle in radians at which it "
           "has faded out; 0, the default, means never. The first target gets the weight that the others lose, and its "
           "own radius is ignored.");
  // Calls answer(space, pose, (J) out) for every sample of local transforms (S, B, 4, 4).
  const auto sampled = [](const PoseSpace& space, const FloatArray& local, auto answer) {
    check_shape("local", local, {-1, -1, 4, 4});
    const py::ssize_t bones = local.shape(1);
    if (!space.bones().empty() && space.bones().back() >= bones)
      throw std::invalid_argument("local: expected at least " + std::to_string(space.bones().back() + 1) +
                                  " bones, got " + std::to_string(bones));
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> out(local.shape(0), space.targets());
    py::gil_scoped_release release;
    VectorXd at(space.targets());
    Rotations pose = Rotations::Zero(bones, 4);
    for (py::ssize_t i = 0; i < local.shape(0); ++i) {
      const LocalTransforms transforms(local.data() + i * bones * 16, bones, 16);
      for (int bone : space.bones()) rotation_of(transforms, bone, pose);
      answer(space, pose, at);
      out.row(i) = at;
    }
    return out;
  };
  const auto weights = [](const PoseSpace& space, const Rotations& pose, VectorXd& w) { space.weights(pose, w); };
  const auto distances = [](const PoseSpace& space, const Rotations& pose, VectorXd& d) { space.distances(pose, d); };
  py::class_<PoseSpace>(m, "PoseSpace", "Interpolates target weights over pose space.")
      .def(py::init<std::vector<TargetSet>>(), "sets"_a,
           "sets: their targets, one set after the other, are the columns of `weights`. Raises Error when two targets "
           "of a set have the same pose, and names both.")
      .def_property_readonly("targets", &PoseSpace::targets, "Number of targets J, of all sets.")
      .def(
          "weights",
          [sampled, weights](const PoseSpace& space, const FloatArray& local) {
            return sampled(space, local, weights);
          },
          "local"_a,
          "Weights (S, J) at the local transforms (S, B, 4, 4). The weights of each set are non-negative and sum to 1. "
          "At its "
          "own pose, a target has weight 1.")
      .def(
          "distances",
          [sampled, distances](const PoseSpace& space, const FloatArray& local) {
            return sampled(space, local, distances);
          },
          "local"_a,
          "Distances (S, J) in radians from the local transforms (S, B, 4, 4) to each target's pose: the root of the "
          "summed squares of the joint angles at the bones of its set.");
}
