// SPDX-License-Identifier: GPL-3.0-or-later
// The engine for a web page: one soft skin of the export format Soft Skin, posed by sliders, shaken, poked and skinned.
// Plain C functions for JavaScript; those that can fail return whether they did, and dm_error() says why. The same
// program compiled for this machine prints the fixed motion that the page's must equal.
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/file/character.hpp"
#include "dynamorph/file/soft_skin.hpp"
#include "dynamorph/step/simulation.hpp"

using namespace dynamorph;
using file::Matrix4;

#define EXPORT extern "C" __attribute__((used, visibility("default")))

namespace {

using FloatMatrix = Eigen::MatrixXf;

constexpr int kSubsteps = 3;           // of a frame of 1/60 s
constexpr double kTeleport = 18;       // body sizes per second: more is a cut, not a motion
constexpr double kPokeTime = 0.1;      // s
constexpr double kPokeDepth = 0.12;    // of the size of the body
constexpr double kFingerRadius = 0.1;  // of the size of the body

/// A target that a slider passes.
struct Key {
  double value;
  int target;
};

/// Where a slider is between two targets, and how far on the way from one to the other.
struct Between {
  std::size_t one, two;
  double part;
};

/// A finger that presses the skin.
struct Poke {
  Grabs<ReducedModel> grabs;
  int steps = 0;  ///< that are left
};

struct Playground {
  explicit Playground(const unsigned char* bytes, std::size_t size);
  void build(double stiffness);
  std::optional<Between> between(std::size_t slider) const;
  MatrixXd local() const;
  VectorXd channels() const;
  void place();
  void advance();
  void skin(bool dynamic);
  void poke(const Vector3d& eye, const Vector3d& ray);
  double frequency() const;

  file::Content content;
  file::Character character;
  PoseSpace space;
  file::SoftSkin model;
  StepOptions options;
  std::unique_ptr<MovingBody<ReducedModel>> body;
  std::unique_ptr<Simulation<ReducedModel>> simulation;
  std::vector<std::vector<Key>> sliders;  ///< for each target set
  std::vector<int> slider_of;             ///< that moves each bone
  std::vector<double> values, goals;      ///< of the sliders
  Vector3d offset = Vector3d::Zero();     ///< by which the whole character is moved
  bool single = false;                    ///< the neutral targets alone count
  bool rounded = false;                   ///< bones and weights are, to digits that all C libraries agree on
  Poke finger;
  Transforms bones;
  VectorXd weights;
  Points rest;                  ///< the surface in bind space
  FloatMatrix modes, residual;  ///< of the surface, bind space
  std::vector<float> posed;     ///< positions (3V), normals (3V), and how far the tissue is off its shape (V)
  std::string description;
};

std::unique_ptr<Playground> play;
std::string failure;

Playground::Playground(const unsigned char* bytes, std::size_t size)
    : content(file::unpack(bytes, size)), character(file::load_character(content)), space(character.sets) {
  const auto B = Eigen::Index(character.rest.size());
  sliders.resize(character.sets.size());
  values.resize(sliders.size());
  goals.resize(sliders.size());
  slider_of.assign(std::size_t(B), 0);
  for (std::size_t s = 0; s < sliders.size(); ++s)
    for (int bone : character.sets[s].bones) slider_of[std::size_t(bone)] = int(s);
  options.h = 1.0 / (60 * kSubsteps);
  options.gravity = character.gravity;
  build(1);
  rest = character.vertices * character.to_bind.transpose();
  const auto in_bind_space = [this](const MatrixXd& local) {
    FloatMatrix out(local.rows(), local.cols());
    for (Eigen::Index v = 0; v < rest.rows(); ++v)
      out.middleRows<3>(3 * v) = (character.to_bind * local.middleRows<3>(3 * v)).cast<float>();
    return out;
  };
  modes = in_bind_space(model.modes);
  residual = in_bind_space(model.residual_shapes);
  posed.resize(std::size_t(7 * rest.rows()));
  std::vector<std::string> names;
  for (const MorphTarget& target : character.targets) names.push_back(target.name);
  description = nlohmann::json{
      {"name", character.name},
      {"targets", names},
      {"sets", sliders.size()},
      {"vertices", rest.rows()},
      {"triangles", character.triangles.rows()},
      {"coordinates", model.model->dofs()},
      {"frequency",
       frequency()}}.dump();
}

/// The model with the authored stiffness times a factor, and the same damping ratios. The motion goes on.
void Playground::build(double stiffness) {
  std::vector<MorphTarget> targets = character.targets;
  for (MorphTarget& target : targets) {
    target.lame.lambda *= stiffness;
    target.lame.mu *= stiffness;
    target.mass_damping *= std::sqrt(stiffness);
    target.stiffness_damping /= std::sqrt(stiffness);
  }
  model = file::load_soft_skin(content, targets, character.blending);
  options.teleport = kTeleport * model.model->body().size * options.h;
  auto next = std::make_unique<MovingBody<ReducedModel>>(model.model, options);
  if (!options.gravity.isZero()) next->balance_targets(character.target_bones);
  finger = {};
  place();
  next->start({bones, weights}, bones);
  if (body) next->set_state(body->state());
  simulation = std::make_unique<Simulation<ReducedModel>>(*next);
  body = std::move(next);
}

std::optional<Between> Playground::between(std::size_t slider) const {
  const std::vector<Key>& keys = sliders[slider];
  if (keys.size() < 2) return std::nullopt;
  std::size_t k = 0;
  while (k + 2 < keys.size() && values[slider] > keys[k + 1].value) ++k;
  const double t = std::clamp((values[slider] - keys[k].value) / (keys[k + 1].value - keys[k].value), 0.0, 1.0);
  return Between{std::size_t(keys[k].target), std::size_t(keys[k + 1].target), t};
}

/// Where the sliders put the bones: each turns along the shortest way from target to target. The character stays where
/// it is, though the poses may be of a shot in which it moves.
MatrixXd Playground::local() const {
  MatrixXd out = character.target_poses[0];
  for (std::size_t s = 0; s < sliders.size(); ++s) {
    const auto at = between(s);
    for (Eigen::Index b = 0; at && b < out.rows(); ++b) {
      if (slider_of[std::size_t(b)] != int(s) || character.parents[std::size_t(b)] < 0) continue;
      const Matrix4 one = character.target_poses[at->one].row(b).reshaped<Eigen::RowMajor>(4, 4);
      const Matrix4 two = character.target_poses[at->two].row(b).reshaped<Eigen::RowMajor>(4, 4);
      const Eigen::Quaterniond q(Matrix3d(one.topLeftCorner<3, 3>())), r(Matrix3d(two.topLeftCorner<3, 3>()));
      Matrix4 turned = out.row(b).reshaped<Eigen::RowMajor>(4, 4);
      turned.topLeftCorner<3, 3>() = q.slerp(at->part, r).toRotationMatrix();
      out.row(b) = turned.reshaped<Eigen::RowMajor>().transpose();
    }
  }
  return out;
}

/// Where the sliders put the channels.
VectorXd Playground::channels() const {
  VectorXd out = character.target_channels.row(0);
  for (std::size_t s = 0; s < sliders.size(); ++s)
    if (const auto at = between(s))
      for (int c : character.sets[s].channels) {
        const double one = character.target_channels(Eigen::Index(at->one), c);
        out(c) = one + at->part * (character.target_channels(Eigen::Index(at->two), c) - one);
      }
  return out;
}

/// Decimals, which C libraries agree on. Blender's numbers are often halfway between such of binary digits.
double nine_decimals(double x) { return std::round(x * 1e9) / 1e9; }

/// Sets the bones and the target weights.
void Playground::place() {
  const RowMajor pose = local();
  Matrix4 moved = Matrix4::Identity();
  moved.topRightCorner<3, 1>() = offset;
  bones = character.bones(pose, moved);
  if (rounded) bones = bones.unaryExpr(&nine_decimals).eval();
  weights = neutral_weights(model.model->body(), model.model->targets());
  if (single) return;
  Pose placing{Rotations(pose.rows(), 4), channels()};
  for (int bone : space.bones()) rotation_of(LocalTransforms(pose.data(), pose.rows(), 16), bone, placing.rotations);
  space.weights(placing, weights);
  if (rounded) weights = weights.unaryExpr(&nine_decimals).eval();
}

/// One step on the way to the goals.
void Playground::advance() {
  place();
  const Grabs<ReducedModel>* grabs = finger.steps > 0 ? &finger.grabs : nullptr;
  if (finger.steps > 0) --finger.steps;
  simulation->step({bones, weights, nullptr, grabs});
}

/// Lowest natural frequency of the neutral targets, Hz.
double Playground::frequency() const {
  const ReducedModel& reduced = *model.model;
  const VectorXd neutral = neutral_weights(reduced.body(), reduced.targets());
  ReducedModel::Blend blend;
  reduced.blend(neutral, blend);
  VectorXd q, force;
  blended_shape(reduced, neutral, q);
  ReducedModel::Matrix stiffness;
  reduced.linearize(blend, q, force, stiffness);
  // The coordinates are orthonormal in the mass for unit density.
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(stiffness.dense(), Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(solver.eigenvalues()[0], 0.0) / reduced.targets()[0].density) / (2 * kPi);
}

/// Presses the first vertex that the ray meets, along the ray.
void Playground::poke(const Vector3d& eye, const Vector3d& ray) {
  const double size = model.model->body().size;
  const Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>> x(posed.data(), rest.rows(), 3);
  Eigen::Index hit = -1;
  double nearest = kInfinity;
  for (Eigen::Index v = 0; v < x.rows(); ++v) {
    const Vector3d to = x.row(v).transpose().cast<double>() - eye;
    const double along = to.dot(ray), aside = (to - along * ray).norm();
    // Skin in front counts first, as long as the ray passes close by.
    const double cost = along + 20 * aside;
    if (aside < 0.05 * size && cost < nearest) nearest = cost, hit = v;
  }
  if (hit < 0) return;
  Skin skin;
  skin.rest = rest.row(hit);
  skin.embedding.nodes = model.embedding.nodes.row(hit);
  skin.embedding.weights = model.embedding.weights.row(hit);
  skin.weights.resize(1, bones.rows());
  for (Eigen::Index k = 0; k < character.influence_bones.cols(); ++k)
    skin.weights.coeffRef(0, character.influence_bones(hit, k)) += character.influence_weights(hit, k);
  finger.grabs.skin = std::make_shared<const SkinMap<ReducedModel>>(model.model, skin);
  const double stiffness = 30 * model.model->targets()[0].lame.mu * kFingerRadius * size;
  finger.grabs.springs = {{0, x.row(hit).transpose().cast<double>() + kPokeDepth * size * ray, stiffness}};
  finger.steps = int(kPokeTime / options.h);
}

/// The surface as it is drawn; dynamic: with the soft tissue, or else plain skinning.
void Playground::skin(bool dynamic) {
  const Eigen::Index V = rest.rows();
  Eigen::VectorXf moved = rest.cast<float>().reshaped<Eigen::RowMajor>(), own = Eigen::VectorXf::Zero(3 * V);
  if (dynamic) {
    VectorXd shape;
    blended_shape(*model.model, weights, shape);
    own.noalias() = modes * (body->coordinates() - shape).cast<float>();
    moved.noalias() += modes * shape.cast<float>() + residual * weights.cast<float>() + own;
  }
  const Eigen::Matrix<float, Eigen::Dynamic, 12, Eigen::RowMajor> frames = bones.cast<float>();
  float *x = posed.data(), *normals = x + 3 * V, *motion = x + 6 * V;
  for (Eigen::Index v = 0; v < V; ++v) {
    Eigen::Matrix<float, 1, 12> row = Eigen::Matrix<float, 1, 12>::Zero();
    for (Eigen::Index k = 0; k < character.influence_bones.cols(); ++k)
      if (const float weight = float(character.influence_weights(v, k)); weight > 0)
        row += weight * frames.row(character.influence_bones(v, k));
    const Eigen::Map<const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>> frame(row.data());
    Eigen::Map<Eigen::Vector3f>(x + 3 * v) = frame * moved.segment<3>(3 * v).homogeneous();
    motion[v] = own.segment<3>(3 * v).norm() / float(model.model->body().size);
  }
  std::fill(normals, normals + 3 * V, 0.0f);
  for (Eigen::Index t = 0; t < character.triangles.rows(); ++t) {
    const auto corners = character.triangles.row(t);
    const auto at = [x](int corner) { return Eigen::Map<const Eigen::Vector3f>(x + 3 * corner); };
    const Eigen::Vector3f normal = (at(corners[1]) - at(corners[0])).cross(at(corners[2]) - at(corners[0]));
    for (int corner : corners) Eigen::Map<Eigen::Vector3f>(normals + 3 * corner) += normal;
  }
}

template <class Work>
int guarded(const Work& work) {
  try {
    work();
    return 0;
  } catch (const std::exception& error) {
    failure = error.what();
    return 1;
  }
}

/// FNV-1a of the coordinates to nine digits of the largest: the C libraries of two systems differ in the last bits.
std::string hash_of(const VectorXd& coordinates) {
  const double digit = 1e-9 * coordinates.cwiseAbs().maxCoeff();
  std::uint64_t bits = 1469598103934665603u;
  for (double each : coordinates) {
    const auto digits = std::uint64_t(std::llround(each / digit));
    for (int shift = 0; shift < 64; shift += 8) bits = (bits ^ (digits >> shift & 255)) * 1099511628211u;
  }
  std::string out;
  for (int shift = 60; shift >= 0; shift -= 4) out += "0123456789abcdef"[bits >> shift & 15];
  return out;
}

/// Goes up and down between 0 and 1 in so many steps, without a function whose last bit depends on the system.
double wave(int step, int period) {
  const int half = period / 2, at = step % period;
  return double(at < half ? at : period - at) / half;
}

}  // namespace

EXPORT void* dm_alloc(int size) { return ::operator new(std::size_t(size)); }
EXPORT void dm_free(void* memory) { ::operator delete(memory); }
EXPORT const char* dm_error() { return failure.c_str(); }
EXPORT int dm_load(const unsigned char* bytes, int size) {
  return guarded([&] {
    set_threads(1);
    play = std::make_unique<Playground>(bytes, std::size_t(size));
  });
}
/// JSON: name, targets, sets, vertices, triangles, coordinates, and frequency, the lowest one in Hz.
EXPORT const char* dm_describe() { return play->description.c_str(); }
/// The slider of a set passes a target at a value; values ascend.
EXPORT void dm_add_key(int set, double value, int target) {
  play->sliders[std::size_t(set)].push_back({value, target});
}
EXPORT void dm_set_slider(int set, double value) { play->goals[std::size_t(set)] = value; }
EXPORT void dm_set_single(int on) { play->single = on != 0; }
EXPORT int dm_set_stiffness(double factor) {
  return guarded([&] { play->build(factor); });
}
/// A frame of 1/60 s, at whose end the character is moved by an offset in meters.
EXPORT int dm_step(double x, double y, double z) {
  return guarded([&] {
    const std::vector<double> from = play->values;
    const Vector3d start = play->offset, goal(x, y, z);
    for (int step = 1; step <= kSubsteps; ++step) {
      const double t = double(step) / kSubsteps;
      for (std::size_t s = 0; s < from.size(); ++s) play->values[s] = from[s] + t * (play->goals[s] - from[s]);
      play->offset = start + t * (goal - start);
      play->advance();
    }
  });
}
EXPORT int dm_poke(double ex, double ey, double ez, double x, double y, double z) {
  return guarded([&] { play->poke({ex, ey, ez}, Vector3d(x, y, z).normalized()); });
}
EXPORT void dm_skin(int dynamic) { play->skin(dynamic != 0); }
EXPORT const float* dm_surface() { return play->posed.data(); }
EXPORT const std::int32_t* dm_triangles() { return play->character.triangles.data(); }
EXPORT const double* dm_weights() { return play->weights.data(); }
EXPORT const double* dm_coordinates() { return play->body->coordinates().data(); }
EXPORT const char* dm_hash() {
  static std::string hash;
  hash = hash_of(play->body->coordinates());
  return hash.c_str();
}
/// The fixed motion, after loading and adding keys: so many frames up and down all sliders, shaken all the while. The
/// engine keeps bones in single precision, where the last bit of a sine would become the eighth digit.
EXPORT int dm_fixed_motion(int frames) {
  play->rounded = true;
  for (int f = 1; f <= frames; ++f) {
    for (std::size_t s = 0; s < play->sliders.size(); ++s) {
      const std::vector<Key>& keys = play->sliders[s];
      if (!keys.empty()) {
        const double from = keys.front().value, to = keys.back().value;
        dm_set_slider(int(s), from + (to - from) * wave(f, 120 + 40 * int(s)));
      }
    }
    if (dm_step(0.02 * wave(f, 14), 0, 0.02 * wave(f, 20))) return 1;
  }
  return 0;
}

#if !defined(__EMSCRIPTEN__)
#include <cstdio>
#include <fstream>
#include <iterator>

/// Adds the keys of a slider of models.json. Throws std::invalid_argument for a target that the model lacks.
static void add_keys(int set, const nlohmann::json& slider) {
  const std::vector<MorphTarget>& targets = play->character.targets;
  for (const auto& key : slider["keys"]) {
    const auto named = [&key](const MorphTarget& target) { return target.name == key[1]; };
    const auto found = std::find_if(targets.begin(), targets.end(), named);
    if (found == targets.end()) throw std::invalid_argument("The model has no target " + key[1].dump());
    dm_add_key(set, key[0], int(found - targets.begin()));
  }
}

/// playground MODEL FRAMES SLIDERS: prints the hash of the fixed motion, then its last coordinates. SLIDERS: those of a
/// model of models.json.
int main(int count, char** arguments) {
  if (count != 4) return std::fprintf(stderr, "playground MODEL FRAMES SLIDERS\n"), 2;
  std::ifstream stream(arguments[1], std::ios::binary);
  const std::vector<unsigned char> bytes((std::istreambuf_iterator<char>(stream)), {});
  const auto add_sliders = [&] {
    int set = 0;
    for (const auto& slider : nlohmann::json::parse(arguments[3])) add_keys(set++, slider);
  };
  if (dm_load(bytes.data(), int(bytes.size())) || guarded(add_sliders) || dm_fixed_motion(std::atoi(arguments[2])))
    return std::fprintf(stderr, "%s\n", dm_error()), 1;
  std::printf("%s\n", dm_hash());
  for (double each : play->body->coordinates()) std::printf("%.17g\n", each);
}
#endif
