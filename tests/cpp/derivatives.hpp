// SPDX-License-Identifier: GPL-3.0-or-later
// What tests of energies have in common: random vectors, and the one check by finite differences.
#pragma once

#include <doctest/doctest.h>

#include <random>

#include "dynamorph/elastic/elasticity.hpp"
#include "dynamorph/models/morph_target.hpp"
#include "dynamorph/step/hessian.hpp"

namespace scenes {

using namespace dynamorph;

constexpr MaterialModel kMaterialModels[] = {MaterialModel::linear, MaterialModel::stvk, MaterialModel::stable_stvk};
constexpr Blending kBlendings[] = {Blending::forces, Blending::even};

inline VectorXd random_vector(Eigen::Index size, double amplitude, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> uniform(-amplitude, amplitude);
  VectorXd x(size);
  for (double& value : x) value = uniform(generator);
  return x;
}

inline MatrixXd random_matrix(Eigen::Index rows, Eigen::Index columns, unsigned seed) {
  return random_vector(rows * columns, 1, seed).reshaped(rows, columns);
}

/// f = dE/dx and K = df/dx along random directions, fourth-order central differences.
/// `evaluate(x, f, Kd, d)` returns E and writes f and K d.
template <class Evaluate>
void check_derivatives(const Evaluate& evaluate, const VectorXd& x, double h) {
  for (unsigned seed = 0; seed < 3; ++seed) {
    const VectorXd d = random_vector(x.size(), 1, 100 + seed).normalized();
    VectorXd f, Kd, ignored, f1, f_1, f2, f_2;
    evaluate(x, f, Kd, d);
    const double e1 = evaluate(x + h * d, f1, ignored, d), e_1 = evaluate(x - h * d, f_1, ignored, d);
    const double e2 = evaluate(x + 2 * h * d, f2, ignored, d), e_2 = evaluate(x - 2 * h * d, f_2, ignored, d);
    const double slope = (8 * (e1 - e_1) - (e2 - e_2)) / (12 * h);
    const VectorXd curve = (8 * (f1 - f_1) - (f2 - f_2)) / (12 * h);
    CHECK(std::abs(slope - f.dot(d)) <= 1e-6 * (std::abs(slope) + f.norm()));
    CHECK((curve - Kd).norm() <= 1e-6 * Kd.norm());
  }
}

/// A model's linearize at one set of target weights, for check_derivatives.
template <class Model>
auto evaluator(const Model& model, const typename Model::Blend& blend) {
  return [&model, &blend](const VectorXd& q, VectorXd& f, VectorXd& Kd, const VectorXd& d) {
    typename Model::Matrix K = model.zero();
    const double e = model.linearize(blend, q, f, K);
    CHECK(std::abs(e - model.energy(blend, q)) <= 1e-9 * (1e-12 + std::abs(e)));
    multiply(K, d, Kd);
    return e;
  };
}

}  // namespace scenes
