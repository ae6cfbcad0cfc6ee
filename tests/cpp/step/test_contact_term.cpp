// SPDX-License-Identifier: GPL-3.0-or-later
// The term of contact: derivatives over models, pressures and forces.
#include <doctest/doctest.h>

#include "check_term.hpp"
#include "contact_skins.hpp"
#include "dynamorph/step/contact_term.hpp"
#include "scenes.hpp"

using namespace dynamorph;
using namespace scenes;

namespace {

const VectorXd kBetween = Vector3d(0.2, 0.5, 0.3);

/// The term as it is when Newton's method begins: then its Hessian is the second derivative of its energy.
template <class Model>
struct AtFirst : ContactTerm<Model> {
  auto linearize(const VectorXd& x) {
    this->begin_newton();
    return ContactTerm<Model>::linearize(x);
  }
};

template <class Model>
void check_contact(std::shared_ptr<const Model> model, std::shared_ptr<const LocalResponses> local = nullptr) {
  const ContactSamples<Model> samples(model, contact_faces_of(model->body(), 0.05), local);
  const Transforms bones = bent(0.4);
  VectorXd vertices, before = VectorXd::Zero(3 * samples.size()), shape;
  blended_shape(*model, kBetween, shape);
  samples.map().positions(bones, kBetween, shape, vertices);
  for (Eigen::Index p = 0; p < samples.size(); ++p)
    samples.points().each_corner(
        p, [&](int v, double weight) { before.segment<3>(3 * p) += weight * vertices.segment<3>(3 * v); });
  const std::vector<double> friction{0.5, 0};
  // Some samples deep, some in the transition, some free; slips of about the one at which friction is whole.
  constexpr double kWidth = 0.01;
  std::vector<Contact> contacts;
  std::vector<Pressure> pressures;
  for (int p = 1; p + 7 < int(samples.size()); p += 9) {  // skin on skin: the mean of two on the other side
    const int q = p + 4, r = p + 7;
    const Vector3d normal = random_vector(3, 1, unsigned(p)).normalized();
    const Vector3d x = before.segment<3>(3 * p) - 0.3 * before.segment<3>(3 * q) - 0.7 * before.segment<3>(3 * r);
    const double depth = kWidth * (p % 4 - 0.5);
    contacts.push_back({p,
                        kSkin,
                        x + depth * normal,
                        normal,
                        x,
                        0.004 * normal.unitOrthogonal(),
                        0.7,
                        -1,
                        -depth,
                        {{q, r, 0, 0}, {0.3, 0.7, 0, 0}}});
    pressures.push_back({p, kSkin, normal, 0.1 * (p % 7), 0.002 * normal.unitOrthogonal()});
  }
  for (int c = 0; c < 2; ++c)
    for (int p = 3 * c; p < int(samples.size()); p += 6) {
      const Vector3d normal = random_vector(3, 1, unsigned(p)).normalized(), x = before.segment<3>(3 * p);
      const double depth = kWidth * (p % 4 - 0.5);
      contacts.push_back(
          {p, c, x + depth * normal, normal, x, 0.004 * normal.unitOrthogonal() * (1 + p % 5), 0.7, -1, -depth});
      if (c == 0) pressures.push_back({p, 0, normal, 0.1 * (p % 7), 0.002 * normal.unitOrthogonal()});
    }
  const ContactStep step{friction, 0.5, 1e-4, 0, kWidth, 0.01, 0};
  const PosedSamples<Model> posed{samples, bones, kBetween, kBetween};
  const VectorXd dents = VectorXd::Zero(local ? local->size() : 0);
  AtFirst<Model> term;
  term.begin(posed, contacts, step, pressures, dents);
  typename Model::Blend blend;
  model->blend(kBetween, blend);
  typename Model::Matrix K = model->zero();
  VectorXd force;
  model->linearize(blend, shape, force, K);
  VectorXd scales = K.diagonal().cwiseAbs().cwiseSqrt().cwiseInverse(), center = shape;
  const Eigen::Index patches = term.unknowns().size();
  CHECK((patches > 0) == (local != nullptr));
  scales.conservativeResize(shape.size() + patches);
  scales.tail(patches).setConstant(scales.head(shape.size()).mean());
  center.conservativeResize(scales.size());
  center.tail(patches) = scales.tail(patches).cwiseProduct(random_vector(patches, 1e-3, 3));
  Around<AtFirst<Model>> around{term, center};
  check_term<typename Model::Matrix>(around, scales, 1e-5);

  // What presses is pushed with its stiffness, and pushes the colliders as much as the body.
  term.linearize(center);
  std::vector<Pressure> now_pressed;
  term.pressures(now_pressed);
  std::vector<Vector3d> forces(2, Vector3d::Zero());
  term.forces(forces);
  double pressed = 0;
  for (const Pressure& pressure : now_pressed) {
    CHECK(pressure.force > 0);
    if (!local) CHECK(pressure.sample % 4 != 0);  // a dent bulges around itself
    if (pressure.collider == 1) pressed += pressure.force;
  }
  CHECK(pressed > 0);
  CHECK(forces[1].norm() <= pressed);
  if (!local) CHECK(term.penetration() == doctest::Approx(2.5 * kWidth).epsilon(1e-9));
  CHECK(term.next_round());
  check_term<typename Model::Matrix>(around, scales, 1e-5);  // with the pressures that it has itself

  if (local) {  // skin on skin leaves the patches alone
    const auto on_skin = [](const Contact& contact) { return contact.collider == kSkin; };
    contacts.erase(std::partition(contacts.begin(), contacts.end(), on_skin), contacts.end());
    term.begin(posed, contacts, step, pressures, dents);
    term.linearize(shape);
    VectorXd none(local->size());
    term.dents(none);
    CHECK(none.isZero(0));
    CHECK(term.count() > 0);
  }
  contacts.resize(0);
  term.begin(posed, contacts, step, pressures, dents);
  CHECK(term.empty());
  CHECK_FALSE(term.next_round());
  CHECK(term.value(shape) == 0);
  const auto nothing = term.linearize(shape);
  CHECK(nothing.gradient.isZero(0));
  CHECK(nothing.hessian.stiffness.size() == 0);
}

}  // namespace

TEST_CASE("contact has the derivatives of its energy, over models") {
  const auto body = two_bone_bar();
  const auto all = targets(*body);
  check_contact(std::make_shared<const FullModel>(body, all, MaterialModel::stable_stvk, Blending::even));
  check_contact(reduced_model(body, all, MaterialModel::stable_stvk, Blending::even, 10));
  check_contact(ResponseScene(body, all, MaterialModel::stable_stvk, Blending::even).model);

  const auto few = reduced_model(body, all, MaterialModel::stable_stvk, Blending::even, 10);
  const ContactSkin skin = contact_skin_of(*body, 0.05);
  const FullModel full(body, all, MaterialModel::stable_stvk, Blending::even);
  check_contact(few,
                std::make_shared<LocalResponses>(
                    full, few->basis(), SkinPlaces{skin.skin.rest, skin.normals.rowwise().normalized(), skin.points},
                    skin.skin.embedding, std::vector<int>{2, 9, 17, 24, 30, 41}));
}
