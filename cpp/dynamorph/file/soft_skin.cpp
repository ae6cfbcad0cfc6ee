// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/file/soft_skin.hpp"

#include <map>
#include <nlohmann/json.hpp>

#include "dynamorph/file/tables.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph::file {

namespace {

/// Whether an array is empty because the model does not have what it holds.
bool is_empty(const Content& content, const std::string& name) {
  const Array* array = content.find(name);
  if (!array) throw incomplete(name);
  return array->bytes.empty();
}

std::shared_ptr<const SoftBody> soft_body(const Content& content) {
  const auto nodes = table<double>(content, "nodes", {-1, 3});
  const auto tets = table<std::int32_t>(content, "tets", {-1, 4});
  const Eigen::Index n = nodes.rows(), m = tets.rows();
  const auto pins = table<std::uint8_t>(content, "pinned", {n});
  std::vector<bool> pinned;
  for (Eigen::Index i = 0; i < n; ++i) pinned.push_back(pins(i, 0) != 0);
  const auto weights = table<double>(content, "node_weights", {n, -1});
  if (weights.cols() == 0) throw incomplete("node_weights");
  VectorXd hold;
  if (!is_empty(content, "hold_strength")) hold = table<double>(content, "hold_strength", {m});
  try {
    return std::make_shared<SoftBody>(
        make_tet_mesh(nodes, tets), table<double>(content, "fill", {m}), table<double>(content, "stiffness", {m}),
        table<double>(content, "region_weights", {m, -1}), pinned, MatrixXd(weights), hold);
  } catch (const std::invalid_argument& error) {
    throw incomplete(error.what());
  }
}

/// How the model was built, according to its description.
struct Built {
  MaterialModel material_model;
  bool shifted;
  std::vector<std::string> bone_names;
};

Built built(const std::string& meta) {
  static const std::map<std::string, MaterialModel> models{
      {"LINEAR", MaterialModel::linear}, {"STVK", MaterialModel::stvk}, {"STABLE_STVK", MaterialModel::stable_stvk}};
  try {
    const auto description = nlohmann::json::parse(meta);
    const auto& settings = description.at("settings");
    if (settings.at("method") == "STATIC" || settings.at("solver") != "REDUCED")
      throw Error("The model has no modes to step: build it with the solver Reduced");
    const auto material_model = models.find(settings.at("material_model").get<std::string>());
    if (material_model == models.end()) throw incomplete("its material model is unknown");
    return {material_model->second, settings.at("method") == "SHAPE", description.at("bone_names")};
  } catch (const nlohmann::json::exception& error) {
    throw incomplete(error.what());
  }
}

Embedding stored_embedding(const Content& content, Eigen::Index nodes) {
  Embedding out;
  out.nodes = table<std::int32_t>(content, "embedding_nodes", {-1, 4});
  out.weights = table<double>(content, "embedding_weights", {out.nodes.rows(), 4});
  if (out.nodes.size() > 0 && (out.nodes.minCoeff() < 0 || out.nodes.maxCoeff() >= nodes))
    throw incomplete("embedding_nodes");
  return out;
}

/// The modes at the surface (3V, dofs), local space: those of the embedded points, turned by the inverse of `to_bind`.
MatrixXd surface_modes(const Content& content, const ReducedModel& model, const Embedding& embedding) {
  const Matrix3d from_bind = table<double>(content, "to_bind", {3, 3}).inverse();
  if (!from_bind.allFinite()) throw incomplete("to_bind");
  MatrixXd modes = model.skin_points(embedding).basis();
  for (Eigen::Index v = 0; v < embedding.nodes.rows(); ++v)
    modes.middleRows<3>(3 * v) = (from_bind * modes.middleRows<3>(3 * v)).eval();
  return modes;
}

/// One Lame parameter's table of the responses of each target: their stiffness, then their coupling, which is in an
/// array of its own and in single precision.
std::vector<VectorXd> response_tables(const Content& content, const std::string& lame, Eigen::Index targets,
                                      Eigen::Index size) {
  MatrixXd rows = table<double>(content, "response_" + lame, {targets, -1});
  const auto coupling = table<float>(content, "coupling_" + lame, {targets, -1});
  rows.conservativeResize(Eigen::NoChange, rows.cols() + coupling.cols());
  rows.rightCols(coupling.cols()) = coupling.cast<double>();
  if (rows.cols() != size) throw incomplete("response_" + lame);
  std::vector<VectorXd> out;
  for (Eigen::Index j = 0; j < targets; ++j) out.push_back(rows.row(j));
  return out;
}

/// The responses (ReducedTables) of a model that has some.
void add_responses(const Content& content, ReducedTables& tables, Eigen::Index targets) {
  if (is_empty(content, "responses")) return;
  const TableLayout layout = tables.layout();
  tables.responses = table<double>(content, "responses", {tables.basis.rows(), -1});
  const Eigen::Index h = tables.responses.cols();
  const auto relaxation = table<double>(content, "relaxation", {targets, h, layout.r});
  for (Eigen::Index j = 0; j < targets; ++j)
    tables.relaxation.push_back(relaxation.row(j).reshaped<Eigen::RowMajor>(h, layout.r));
  const Eigen::Index size = h * (1 + (layout.nonlinear ? layout.pairs() : 0));
  tables.response_lambda = response_tables(content, "lambda", targets, size);
  tables.response_mu = response_tables(content, "mu", targets, size);
}

}  // namespace

int target_count(const Content& content) { return int(table<std::int32_t>(content, "target_sets", {-1}).rows()); }

SoftSkin load_soft_skin(const Content& content, std::vector<MorphTarget> targets, Blending blending) {
  const Built how = built(content.meta);
  if (is_empty(content, "basis")) throw Error("The model has no modes to step: only its cage is built");
  const auto body = soft_body(content);
  const auto J = Eigen::Index(targets.size()), V = table<std::int32_t>(content, "embedding_nodes", {-1, 4}).rows();
  const auto shapes = table<double>(content, "displacements", {-1, body->mesh.nodes.rows(), 3});
  if (J != shapes.rows())
    throw std::invalid_argument("targets: expected " + std::to_string(shapes.rows()) + ", got " + std::to_string(J));
  ReducedTables tables;
  tables.material_model = how.material_model;
  tables.basis = table<double>(content, "basis", {3 * Eigen::Index(body->free_nodes.size()), -1});
  const Eigen::Index size = tables.layout().distinct();
  const auto lambda = table<double>(content, "table_lambda", {J, size});
  const auto mu = table<double>(content, "table_mu", {J, size});
  const auto sets = table<std::int32_t>(content, "target_sets", {J});
  if ((sets.array() < 0 || sets.array() >= body->sets()).any()) throw incomplete("target_sets");
  for (Eigen::Index j = 0; j < J; ++j) {
    MorphTarget& target = targets[std::size_t(j)];
    target.displacement = shapes.row(j);
    target.shifted = how.shifted;
    target.set = sets(j, 0);
    tables.lambda.push_back(lambda.row(j));
    tables.mu.push_back(mu.row(j));
  }
  add_responses(content, tables, J);
  auto model = std::make_shared<ReducedModel>(body, std::move(targets), tables, blending);
  Embedding embedding = stored_embedding(content, body->mesh.nodes.rows());
  MatrixXd modes = surface_modes(content, *model, embedding);
  return {std::move(model), how.bone_names, std::move(embedding), std::move(modes),
          table<double>(content, "residual_shapes", {J, V, 3}).transpose()};
}

}  // namespace dynamorph::file
