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
                                const std::vector<FloatArray>& poses, std::vector<double> radii,
                                std::vector<int> channels, const std::vector<VectorXd>& values) {
             if (!values.empty() && values.size() != poses.size())
               throw std::invalid_argument("values: expected one row for each of " + std::to_string(poses.size()) +
                                           " targets, got " + std::to_string(values.size()));
             TargetSet set{std::move(bones), std::move(names), {}, std::move(radii), std::move(channels)};
             for (size_t j = 0; j < poses.size(); ++j)
               set.poses.push_back({rotations("poses", poses[j]), values.empty() ? VectorXd() : values[j]});
             return set;
           }),
           "bones"_a, "names"_a, "poses"_a, "radii"_a = std::vector<double>(), "channels"_a = std::vector<int>(),
           "values"_a = std::vector<VectorXd>(),
           "bones: indices of the bones; their local rotations place the targets. poses: for each target, the local "
           "transforms (B, 4, 4) of the whole skeleton. radii: for each target, the joint angle in radians at which it "
           "has faded out; 0, the default, means never. The first target gets the weight that the others lose, and its "
           "own radius is ignored. channels: indices of the channels that place the targets too; values: for each "
           "target, "
           "the values (C) of all channels.");
  // Calls answer(space, pose, (J) out) for every sample of local transforms (S, B, 4, 4) and of channels (S, C).
  const auto sampled = [](const PoseSpace& space, const FloatArray& local, const FloatArray& channels, auto answer) {
    check_shape("local", local, {-1, -1, 4, 4});
    const py::ssize_t samples = local.shape(0), bones = local.shape(1);
    if (!space.bones().empty() && space.bones().back() >= bones)
      throw std::invalid_argument("local: expected at least " + std::to_string(space.bones().back() + 1) +
                                  " bones, got " + std::to_string(bones));
    if (channels.size() > 0 || space.channels() > 0) {
      check_shape("channels", channels, {samples, -1});
      if (channels.shape(1) < space.channels())
        throw std::invalid_argument("channels: expected at least " + std::to_string(space.channels()) + ", got " +
                                    std::to_string(channels.shape(1)));
    }
    const py::ssize_t count = channels.size() > 0 ? channels.shape(1) : 0;
    const Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> values(
        channels.data(), count > 0 ? samples : 0, count);
    if (values.size() > 0 && !(values.cwiseAbs().maxCoeff() < 1e100))  // whose square still is a number
      throw std::invalid_argument("channels: expected finite numbers");
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> out(samples, space.targets());
    py::gil_scoped_release release;
    VectorXd at(space.targets());
    Pose pose{Rotations::Zero(bones, 4), VectorXd::Zero(count)};
    for (py::ssize_t i = 0; i < samples; ++i) {
      const LocalTransforms transforms(local.data() + i * bones * 16, bones, 16);
      for (int bone : space.bones()) rotation_of(transforms, bone, pose.rotations);
      if (count > 0) pose.channels = values.row(i);
      answer(space, pose, at);
      out.row(i) = at;
    }
    return out;
  };
  const auto weights = [](const PoseSpace& space, const Pose& pose, VectorXd& w) { space.weights(pose, w); };
  const auto distances = [](const PoseSpace& space, const Pose& pose, VectorXd& d) { space.distances(pose, d); };
  const FloatArray none(std::vector<py::ssize_t>{0, 0});
  py::class_<PoseSpace>(m, "PoseSpace", "Interpolates target weights over pose space.")
      .def(py::init<std::vector<TargetSet>>(), "sets"_a,
           "sets: their targets, one set after the other, are the columns of `weights`. Raises Error when two targets "
           "of a set have the same pose, and names both.")
      .def_property_readonly("targets", &PoseSpace::targets, "Number of targets J, of all sets.")
      .def(
          "weights",
          [sampled, weights](const PoseSpace& space, const FloatArray& local, const FloatArray& channels) {
            return sampled(space, local, channels, weights);
          },
          "local"_a, "channels"_a = none,
          "Weights (S, J) at the local transforms (S, B, 4, 4) and, where channels place targets, their values (S, C). "
          "The weights of each set are non-negative and sum to 1. At its own pose, a target has weight 1.")
      .def(
          "distances",
          [sampled, distances](const PoseSpace& space, const FloatArray& local, const FloatArray& channels) {
            return sampled(space, local, channels, distances);
          },
          "local"_a, "channels"_a = none,
          "Distances (S, J) in radians from the local transforms (S, B, 4, 4) and channels (S, C) to each target's "
          "pose: the root of the summed squares of the joint angles at the bones of its set, and of the ways along its "
          "channels, where that between the farthest values of a channel counts as a right angle.");
}
