// SPDX-License-Identifier: GPL-3.0-or-later
// What a soft skin file adds to a model comes out as it went in, and nothing that does not fit together comes out.
#include <doctest/doctest.h>

#include <cstring>

#include "dynamorph/file/character.hpp"

using namespace dynamorph;

namespace {

using Shape = std::vector<std::int64_t>;

template <class Number>
file::Array stored(const char* dtype, const Shape& shape, const std::vector<Number>& numbers) {
  file::Array array{dtype, shape, {}};
  array.bytes.resize(sizeof(Number) * numbers.size());
  std::memcpy(array.bytes.data(), numbers.data(), array.bytes.size());
  return array;
}

/// Row-major transforms of so many bones: the identity, moved up by `height`.
std::vector<double> moved(int count, double height, int rows = 4) {
  std::vector<double> out;
  for (int b = 0; b < count; ++b)
    for (int k = 0; k < 4 * rows; ++k) out.push_back(k == 11 ? height : double(k % 5 == 0));
  return out;
}

/// Two bones, the second a meter above the first, a triangle, and two targets; flexed, the second bone turns about x.
file::Content content() {
  std::vector<double> rest = moved(1, 0), upper = moved(1, 1), poses = moved(3, 0), flexed = moved(1, 0);
  rest.insert(rest.end(), upper.begin(), upper.end());
  flexed[5] = flexed[10] = 0;
  flexed[6] = -1;
  flexed[9] = 1;
  poses.insert(poses.end(), flexed.begin(), flexed.end());
  return {{{"vertices", stored<float>("F32", {3, 3}, {0, 0, 0, 1, 0, 0, 0, 1, 2})},
           {"triangles", stored<std::int32_t>("I32", {1, 3}, {0, 1, 2})},
           {"to_bind", stored<double>("F64", {3, 3}, {2, 0, 0, 0, 2, 0, 0, 0, 2})},
           {"influence_bones", stored<std::int32_t>("I32", {3, 2}, {0, 1, 0, 1, 1, 0})},
           {"influence_weights", stored<float>("F32", {3, 2}, {1, 0, 0.5f, 0.5f, 1, 0})},
           {"target_sets", stored<std::int32_t>("I32", {2}, {0, 0})},
           {"target_materials", stored<double>("F64", {2, 5}, {2e4, 0.4, 1000, 1, 0.005, 8e4, 0.25, 1100, 2, 0.002})},
           {"target_poses", stored<double>("F64", {2, 2, 4, 4}, poses)},
           {"target_bones", stored<double>("F64", {2, 3, 3, 4}, moved(6, 3, 3))},
           {"fade_out_angles", stored<double>("F64", {2}, {0, 0.5})},
           {"parents", stored<std::int32_t>("I32", {2}, {-1, 0})},
           {"rest", stored<double>("F64", {2, 4, 4}, rest)},
           {"object_frames", stored<double>("F64", {2, 4, 4}, moved(2, 0))},
           {"gravity", stored<double>("F64", {3}, {0, 0, -9.81})}},
          R"({"bone_names": ["lower", "upper"], "character": {"name": "Arm", "blending": "FORCES",
              "targets": ["Neutral", "Flexed"], "sets": [{"name": "Arm", "bones": [1]}]}})"};
}

file::Array& array_of(file::Content& content, const std::string& name) {
  for (auto& [known, array] : content.arrays)
    if (known == name) return array;
  throw std::out_of_range(name);
}

}  // namespace

TEST_CASE("a character comes out as it went in") {
  const file::Character character = file::load_character(content());
  CHECK(character.name == "Arm");
  CHECK(character.blending == Blending::forces);
  CHECK(character.vertices(2, 2) == 2);
  CHECK(character.triangles(0, 2) == 2);
  CHECK(character.influence_weights(1, 1) == 0.5);
  REQUIRE(character.targets.size() == 2);
  CHECK(character.targets[1].name == "Flexed");
  CHECK(character.targets[1].lame.mu == doctest::Approx(8e4 / 2.5));
  CHECK(character.targets[1].density == 1100);
  CHECK(character.targets[1].stiffness_damping == 0.002);
  CHECK(character.target_bones[1](2, 11) == 3);
  CHECK(character.gravity.z() == -9.81);
}

TEST_CASE("its poses place its targets") {
  const file::Character character = file::load_character(content());
  const PoseSpace space(character.sets);
  Pose pose{Rotations(2, 4)};
  const RowMajor flexed = character.target_poses[1];
  for (int b = 0; b < 2; ++b) rotation_of(LocalTransforms(flexed.data(), 2, 16), b, pose.rotations);
  VectorXd weights(2);
  space.weights(pose, weights);
  CHECK(weights(1) == doctest::Approx(1));
  CHECK(character.sets[0].radii[1] == 0.5);
}

TEST_CASE("channels place its targets too") {
  file::Content with_channels = content();
  with_channels.arrays.push_back({"target_channels", stored<double>("F64", {2, 1}, {0, 2})});
  with_channels.meta = R"({"bone_names": ["lower", "upper"], "character": {"name": "Arm", "blending": "FORCES",
      "targets": ["Neutral", "Flexed"], "channels": ["Tension"],
      "sets": [{"name": "Arm", "bones": [], "channels": [0]}]}})";
  const file::Character character = file::load_character(with_channels);
  CHECK(character.channels == std::vector<std::string>{"Tension"});
  VectorXd weights(2);
  PoseSpace(character.sets).weights({Rotations::Zero(2, 4), VectorXd::Constant(1, 1.9)}, weights);
  CHECK(weights(1) == doctest::Approx(0.95));
  array_of(with_channels, "target_channels").shape = {1, 2};
  CHECK_THROWS_AS(file::load_character(with_channels), Error);
}

TEST_CASE("bones carry bind space to the world, children with their parents") {
  const file::Character character = file::load_character(content());
  file::Matrix4 raised = file::Matrix4::Identity();
  raised(2, 3) = 5;
  const Transforms bones = character.bones(character.target_poses[1], raised);
  const auto place = [&bones](int bone, const Vector3d& x) {
    const Eigen::Matrix<double, 3, 4, Eigen::RowMajor> frame = bones.row(bone).reshaped<Eigen::RowMajor>(3, 4);
    return Vector3d(frame * x.homogeneous());
  };
  CHECK((place(0, {0, 0, 2}) - Vector3d(0, 0, 6)).norm() < 1e-12);   // bind space is twice as large
  CHECK((place(1, {0, 0, 4}) - Vector3d(0, -1, 6)).norm() < 1e-12);  // a meter above the joint, turned by 90 degrees
  CHECK((place(2, {2, 0, 0}) - Vector3d(1, 0, 5)).norm() < 1e-12);   // the object itself
}

TEST_CASE("nothing that does not fit together is loaded") {
  for (const char* name : {"vertices", "influence_bones", "target_materials", "target_poses", "rest", "gravity"}) {
    file::Content cut = content();
    array_of(cut, name).shape[0] = 1;
    CHECK_THROWS_AS(file::load_character(cut), Error);
  }
  for (const char* name : {"triangles", "influence_bones", "target_sets", "parents"}) {
    file::Content wild = content();
    const std::int32_t far = 7;
    std::memcpy(array_of(wild, name).bytes.data(), &far, sizeof far);
    CHECK_THROWS_AS(file::load_character(wild), Error);
  }
  file::Content other = content();
  other.meta = R"({"bone_names": ["lower", "upper"]})";
  CHECK_THROWS_AS(file::load_character(other), Error);
  file::Content model_alone = content();
  model_alone.arrays.erase(model_alone.arrays.begin());
  CHECK(!file::has_character(model_alone));
  CHECK_THROWS_WITH_AS(file::load_character(model_alone),
                       "The file has a model alone, without surface, materials and poses: export it as Soft Skin",
                       Error);
}
