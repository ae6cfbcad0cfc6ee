// SPDX-License-Identifier: GPL-3.0-or-later
// A soft skin comes out of a model file as it went in, and nothing that does not fit together comes out.
#include <doctest/doctest.h>

#include "dynamorph/file/soft_skin.hpp"
#include "dynamorph/step/simulation.hpp"
#include "scenes.hpp"

using namespace dynamorph;

namespace {

using Shape = std::vector<std::int64_t>;

template <class Number>
file::Array stored(const std::vector<Number>& numbers, const char* dtype, const Shape& shape) {
  const auto* bytes = reinterpret_cast<const unsigned char*>(numbers.data());
  return {dtype, shape, {bytes, bytes + sizeof(Number) * numbers.size()}};
}

/// A matrix, rows first, of the given shape.
template <class Number = double>
file::Array stored(const MatrixXd& m, const Shape& shape) {
  const MatrixXd rows = m.transpose();
  return stored(std::vector<Number>(rows.data(), rows.data() + rows.size()), sizeof(Number) == 8 ? "F64" : "F32",
                shape);
}

struct Scene {
  std::shared_ptr<const SoftBody> body = scenes::two_bone_bar();
  std::vector<MorphTarget> targets = scenes::targets(*body);
  FullModel full{body, targets, MaterialModel::stvk, Blending::even};
  ReducedTables tables = reduce(full, make_basis(full, 8).U);
  ReducedModel model{body, targets, tables, Blending::even};

  /// The bar as a model that embeds one vertex, half way between the first and the last corner of the last tet.
  file::Content content() const {
    const std::int64_t n = body->mesh.nodes.rows(), m = body->mesh.tets.rows(), J = std::int64_t(targets.size());
    const std::int64_t r = model.dofs(), size = tables.layout().distinct();
    const auto last = body->mesh.tets.row(m - 1);
    MatrixXd displacements(J, 3 * n), lambda(J, size), mu(J, size);
    std::vector<std::uint8_t> pinned;
    for (int node : body->free_of_node) pinned.push_back(node < 0);
    for (int j = 0; j < J; ++j) {
      displacements.row(j) = targets[j].displacement;
      lambda.row(j) = tables.lambda[j];
      mu.row(j) = tables.mu[j];
    }
    MatrixXd weights = MatrixXd::Zero(n, 2);
    weights.col(0).setOnes();  // of the pinned nodes, whose own are not kept
    for (std::size_t i = 0; i < body->free_nodes.size(); ++i) weights.row(body->free_nodes[i]) = body->skin.row(i);
    const std::int64_t columns = tables.basis.rows();
    return {
        {{"nodes", stored(MatrixXd(body->mesh.nodes), {n, 3})},
         {"tets",
          stored(std::vector<std::int32_t>(body->mesh.tets.data(), body->mesh.tets.data() + 4 * m), "I32", {m, 4})},
         {"fill", stored(MatrixXd(body->fill), {m})},
         {"stiffness", stored(MatrixXd(VectorXd::Ones(m)), {m})},
         {"region_weights", stored(body->region_weights, {m, 1})},
         {"pinned", stored(pinned, "BOOL", {n})},
         {"node_weights", stored(weights, {n, 2})},
         {"embedding_nodes", stored(std::vector<std::int32_t>{last(0), last(1), last(2), last(3)}, "I32", {1, 4})},
         {"embedding_weights", stored(MatrixXd(Eigen::RowVector4d(0.5, 0, 0, 0.5)), {1, 4})},
         {"displacements", stored(displacements, {J, n, 3})},
         {"target_sets", stored(std::vector<std::int32_t>(std::size_t(J), 0), "I32", {J})},
         {"residual_shapes", stored(MatrixXd::Constant(J, 3, 0.25), {J, 1, 3})},
         {"to_bind", stored(MatrixXd(2 * Matrix3d::Identity()), {3, 3})},
         {"basis", stored(tables.basis, {columns, r})},
         {"table_lambda", stored(lambda, {J, size})},
         {"table_mu", stored(mu, {J, size})},
         {"hold_strength", stored(MatrixXd(0, 0), {0, 0})},
         {"responses", stored(MatrixXd(0, 0), {0, 0})}},
        R"({"settings": {"material_model": "STVK", "solver": "REDUCED", "method": "DYNAMIC"}, "bone_names": ["root"]})"};
  }
};

file::Array& array(file::Content& content, const std::string& name) {
  for (auto& [own, array] : content.arrays)
    if (own == name) return array;
  throw std::logic_error(name);
}

}  // namespace

TEST_CASE("a soft skin from a file steps as the one that was stored") {
  const Scene scene;
  const file::SoftSkin skin = file::load_soft_skin(scene.content(), scene.targets);
  CHECK(skin.bone_names == std::vector<std::string>{"root"});
  const auto stored = std::make_shared<ReducedModel>(scene.model);
  MovingBody<ReducedModel> first(stored, {}), second(skin.model, {});
  const VectorXd w = Vector3d(0.2, 0.5, 0.3);
  for (auto* moving : {&first, &second}) {
    Simulation<ReducedModel> simulation(*moving);
    moving->start({scenes::bent(0), w}, scenes::bent(0.02));
    for (int i = 1; i < 20; ++i) simulation.step({scenes::bent(0.02 * i), w});
  }
  CHECK((first.coordinates() - second.coordinates()).norm() <= 1e-9 * first.coordinates().norm());

  VectorXd u;
  stored->displacement(second.coordinates(), u);
  const Points nodes = as_points(scene.body->expand(u));
  const auto last = scene.body->mesh.tets.row(scene.body->mesh.tets.rows() - 1);
  const Eigen::RowVector3d bind = 0.5 * (nodes.row(last(0)) + nodes.row(last(3)));
  const Eigen::RowVector3d expected = 0.5 * bind + Eigen::RowVector3d::Constant(0.25);
  CHECK((skin.surface(second.coordinates(), w).transpose() - expected).norm() < 1e-12);
}

TEST_CASE("responses from a file move as those that were stored") {
  const Scene scene;
  const scenes::ResponseScene other(scene.body, scene.targets, MaterialModel::stvk, Blending::even, 8, 12);
  const Eigen::Index J = 3, size = other.tables.response_mu[0].size();
  file::Content content = scene.content();
  array(content, "basis") = stored(other.tables.basis, {other.tables.basis.rows(), 8});
  for (const auto& [lame, tables, responses] :
       {std::tuple("lambda", &other.tables.lambda, &other.tables.response_lambda),
        std::tuple("mu", &other.tables.mu, &other.tables.response_mu)}) {
    MatrixXd modes(J, other.tables.layout().distinct()), rows(J, size);
    for (Eigen::Index j = 0; j < J; ++j)
      modes.row(j) = (*tables)[std::size_t(j)], rows.row(j) = (*responses)[std::size_t(j)];
    array(content, std::string("table_") + lame) = stored(modes, {J, modes.cols()});
    content.arrays.emplace_back(std::string("response_") + lame, stored(MatrixXd(rows.leftCols(12)), {J, 12}));
    content.arrays.emplace_back(std::string("coupling_") + lame,
                                stored<float>(MatrixXd(rows.rightCols(size - 12)), {J, size - 12}));
  }
  array(content, "responses") = stored(other.tables.responses, {other.tables.responses.rows(), 12});
  MatrixXd relaxation(J, 12 * 8);
  for (Eigen::Index j = 0; j < J; ++j)
    relaxation.row(j) = other.tables.relaxation[std::size_t(j)].reshaped<Eigen::RowMajor>();
  content.arrays.emplace_back("relaxation", stored(relaxation, {J, 12, 8}));

  const auto motion = [](const auto& model) {
    MovingBody<ReducedModel> moving(model, {});
    Simulation<ReducedModel> simulation(moving);
    const VectorXd w = Vector3d(0.2, 0.5, 0.3);
    moving.start({scenes::bent(0), w}, scenes::bent(0.02));
    for (int i = 1; i < 20; ++i) simulation.step({scenes::bent(0.02 * i), w});
    return moving.coordinates();
  };
  const VectorXd expected = motion(other.model);
  CHECK(expected.size() == 20);
  const file::SoftSkin skin = file::load_soft_skin(content, scene.targets);
  CHECK(skin.modes.cols() == 20);
  CHECK((motion(skin.model) - expected).norm() <= 1e-6 * expected.norm());
  for (const char* name : {"response_lambda", "coupling_mu", "relaxation"}) {
    file::Content spoiled = content;
    array(spoiled, name).shape.back() -= 1;
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
    spoiled = content;
    std::memset(array(spoiled, name).bytes.data(), 0xff, 8);
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
  }
}

TEST_CASE("what does not fit together is refused") {
  const Scene scene;
  const file::Content whole = scene.content();
  REQUIRE_NOTHROW(file::load_soft_skin(whole, scene.targets));
  CHECK_THROWS_AS(file::load_soft_skin(whole, {}), std::invalid_argument);
  for (std::size_t k = 0; k < whole.arrays.size(); ++k) {
    CAPTURE(whole.arrays[k].first);
    file::Content spoiled = whole;
    spoiled.arrays.erase(spoiled.arrays.begin() + std::ptrdiff_t(k));
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
    if (whole.arrays[k].second.bytes.empty()) continue;  // the model does not have what it holds
    spoiled = whole;
    spoiled.arrays[k].second.dtype = "U16";
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
    spoiled = whole;
    spoiled.arrays[k].second.shape.push_back(1);
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
    spoiled = whole;
    if (spoiled.arrays[k].second.dtype == "BOOL") continue;
    std::memset(spoiled.arrays[k].second.bytes.data(), 0xff, 8);  // not a number; an index that is none
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
  }
  file::Content spoiled = whole;
  array(spoiled, "basis") = {"F64", {array(spoiled, "basis").shape[0], 0}, {}};
  CHECK_THROWS_WITH_AS(file::load_soft_skin(spoiled, scene.targets),
                       "The model has no modes to step: only its cage is built", Error);
  for (const char* meta : {"", "[]", "{}", R"({"settings": 1})", R"({"settings": {"solver": "REDUCED"}})"}) {
    spoiled = whole;
    spoiled.meta = meta;
    CHECK_THROWS_AS(file::load_soft_skin(spoiled, scene.targets), Error);
  }
  spoiled.meta = R"({"settings": {"material_model": "STVK", "solver": "FULL", "method": "DYNAMIC"}, "bone_names": []})";
  CHECK_THROWS_WITH_AS(file::load_soft_skin(spoiled, scene.targets),
                       "The model has no modes to step: build it with the solver Reduced", Error);
}

TEST_CASE("a file that cannot be read says so") {
  CHECK_THROWS_WITH_AS(file::read("nowhere/model.dynamorph"), "The model file 'nowhere/model.dynamorph' cannot be read",
                       Error);
  CHECK_THROWS_AS(file::read("."), Error);
}
