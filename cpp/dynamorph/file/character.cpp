// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/file/character.hpp"

#include <nlohmann/json.hpp>

#include "dynamorph/file/tables.hpp"

namespace dynamorph::file {

namespace {

using Indices = Eigen::Matrix<std::int32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Indices below `count`.
Table<std::int32_t> indices(const Content& content, const std::string& name, std::initializer_list<Eigen::Index> shape,
                            Eigen::Index count) {
  const auto out = table<std::int32_t>(content, name, shape);
  if (out.size() > 0 && (out.minCoeff() < 0 || out.maxCoeff() >= count)) throw incomplete(name);
  return out;
}

std::vector<Matrix4> matrices(const Table<double>& rows) {
  std::vector<Matrix4> out;
  for (Eigen::Index i = 0; i < rows.rows(); ++i) out.push_back(rows.row(i).reshaped<Eigen::RowMajor>(4, 4));
  return out;
}

/// The targets with their names and materials.
std::vector<MorphTarget> targets(const Content& content, const std::vector<std::string>& names) {
  const auto materials = table<double>(content, "target_materials", {Eigen::Index(names.size()), 5});
  std::vector<MorphTarget> out;
  for (Eigen::Index j = 0; j < materials.rows(); ++j) {
    MorphTarget target;
    target.name = names[std::size_t(j)];
    try {
      target.lame = lame_of(materials(j, 0), materials(j, 1));
    } catch (const std::invalid_argument&) {
      throw incomplete("target_materials");
    }
    target.density = materials(j, 2);
    target.mass_damping = materials(j, 3);
    target.stiffness_damping = materials(j, 4);
    out.push_back(target);
  }
  return out;
}

/// Indices of a set, below `count`.
std::vector<int> placing(const nlohmann::json& set, const char* name, Eigen::Index count) {
  auto out = set.value(name, std::vector<int>());
  for (int index : out)
    if (index < 0 || index >= count) throw incomplete("its target sets");
  return out;
}

/// The sets, whose bones and channels `described` has, with the targets' poses.
std::vector<TargetSet> target_sets(const Content& content, const nlohmann::json& described, const Character& character,
                                   Eigen::Index bones) {
  std::vector<TargetSet> out(described.size());
  for (std::size_t s = 0; s < out.size(); ++s) {
    out[s].bones = placing(described[s], "bones", bones);
    out[s].channels = placing(described[s], "channels", character.target_channels.cols());
  }
  const auto J = Eigen::Index(character.targets.size());
  const auto sets = indices(content, "target_sets", {J}, Eigen::Index(out.size()));
  const auto angles = table<double>(content, "fade_out_angles", {J});
  for (Eigen::Index j = 0; j < J; ++j) {
    const RowMajor local = character.target_poses[std::size_t(j)];
    Pose pose{Rotations(bones, 4), character.target_channels.row(j)};
    for (int b = 0; b < int(bones); ++b) rotation_of(LocalTransforms(local.data(), bones, 16), b, pose.rotations);
    TargetSet& set = out[std::size_t(sets(j, 0))];
    set.names.push_back(character.targets[std::size_t(j)].name);
    set.poses.push_back(std::move(pose));
    set.radii.push_back(angles(j, 0));
  }
  return out;
}

void load_skeleton(const Content& content, Character& out, Eigen::Index B) {
  const auto parents = table<std::int32_t>(content, "parents", {B});
  for (int b = 0; b < int(B); ++b) {
    if (parents(b, 0) < -1 || parents(b, 0) >= b) throw incomplete("parents");
    out.parents.push_back(parents(b, 0));
  }
  out.rest = matrices(table<double>(content, "rest", {B, 4, 4}));
  const auto worlds = matrices(table<double>(content, "object_frames", {2, 4, 4}));
  out.rig_world = worlds[0];
  out.object_world = worlds[1];
}

void load_surface(const Content& content, Character& out, Eigen::Index B) {
  out.vertices = table<float>(content, "vertices", {-1, 3}).cast<double>();
  const Eigen::Index V = out.vertices.rows();
  out.triangles = indices(content, "triangles", {-1, 3}, V);
  out.influence_bones = indices(content, "influence_bones", {V, -1}, B + 1);
  out.influence_weights = table<float>(content, "influence_weights", {V, out.influence_bones.cols()}).cast<double>();
  out.to_bind = table<double>(content, "to_bind", {3, 3});
}

}  // namespace

Transforms Character::bones(const MatrixXd& local, const Matrix4& moved) const {
  const std::size_t B = rest.size();
  Transforms out(Eigen::Index(B) + 1, 12);
  Matrix4 from_bind = Matrix4::Identity();
  from_bind.topLeftCorner<3, 3>() = to_bind.inverse();
  const Matrix4 rig = moved * rig_world, object = moved * object_world * from_bind,
                rig_from_bind = rig.inverse() * object;
  std::vector<Matrix4> pose(B);
  for (std::size_t b = 0; b < B; ++b) {
    const int parent = parents[b];
    pose[b] = local.row(Eigen::Index(b)).reshaped<Eigen::RowMajor>(4, 4);
    pose[b] = rest[b] * pose[b];
    if (parent >= 0) pose[b] = pose[std::size_t(parent)] * rest[std::size_t(parent)].inverse() * pose[b];
    const Matrix4 skin = rig * pose[b] * rest[b].inverse() * rig_from_bind;
    out.row(Eigen::Index(b)) = skin.topRows<3>().reshaped<Eigen::RowMajor>().transpose();
  }
  out.row(Eigen::Index(B)) = object.topRows<3>().reshaped<Eigen::RowMajor>().transpose();
  return out;
}

bool has_character(const Content& content) { return content.find("vertices") != nullptr; }

Character load_character(const Content& content) {
  if (!has_character(content))
    throw Error("The file has a model alone, without surface, materials and poses: export it as Soft Skin");
  Character out;
  try {
    const auto meta = nlohmann::json::parse(content.meta);
    const auto& described = meta.at("character");
    const auto B = Eigen::Index(meta.at("bone_names").size());
    out.name = described.at("name");
    out.blending = described.at("blending") == "FORCES" ? Blending::forces : Blending::even;
    out.targets = targets(content, described.at("targets"));
    const auto J = Eigen::Index(out.targets.size());
    load_skeleton(content, out, B);
    load_surface(content, out, B);
    const auto poses = table<double>(content, "target_poses", {J, B, 4, 4});
    const auto frames = table<double>(content, "target_bones", {J, B + 1, 3, 4});
    for (Eigen::Index j = 0; j < J; ++j) {
      out.target_poses.push_back(poses.row(j).reshaped<Eigen::RowMajor>(B, 16));
      out.target_bones.push_back(frames.row(j).reshaped<Eigen::RowMajor>(B + 1, 12));
    }
    out.channels = described.value("channels", std::vector<std::string>());  // older files have none
    const auto C = Eigen::Index(out.channels.size());
    out.target_channels.resize(J, C);
    if (C > 0) out.target_channels = table<double>(content, "target_channels", {J, C});
    out.sets = target_sets(content, described.at("sets"), out, B);
    out.gravity = table<double>(content, "gravity", {3});
  } catch (const nlohmann::json::exception& error) {
    throw incomplete(error.what());
  }
  return out;
}

}  // namespace dynamorph::file
