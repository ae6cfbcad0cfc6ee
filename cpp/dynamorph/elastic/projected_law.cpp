// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/projected_law.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <cmath>

namespace dynamorph {

namespace {

/// F = U diag(s) V^T with rotations U and V: the least s has the sign of det F.
struct Rotations {
  Matrix3d U = Matrix3d::Identity(), V = Matrix3d::Identity();
  Vector3d s = Vector3d::Ones();

  explicit Rotations(const Matrix3d& F) {
    const Eigen::JacobiSVD<Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
    if (svd.info() != Eigen::Success) return;  // F is not finite, nor is its energy
    U = svd.matrixU();
    V = svd.matrixV();
    s = svd.singularValues();
    for (Matrix3d* turn : {&U, &V})
      if (turn->determinant() < 0) {
        turn->col(2) *= -1;
        s(2) *= -1;
      }
  }
};

/// The second derivative along stretches, without its negative part.
Matrix3d stretches(double c, const VolumeLaw& f, const Vector3d& s) {
  const Vector3d area(s(1) * s(2), s(2) * s(0), s(0) * s(1));  // of det F by each s
  Matrix3d A = f.curvature * area * area.transpose();
  for (int i = 0; i < 3; ++i) {
    A(i, i) += c;
    for (int j = 0; j < 3; ++j)
      if (i != j) A(i, j) += f.slope * s(3 - i - j);
  }
  Eigen::SelfAdjointEigenSolver<Matrix3d> eigen(A);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).asDiagonal() * eigen.eigenvectors().transpose();
}

}  // namespace

VolumeLaw stable_volume(double lambda, double mu, double J) {
  const double from = J - (1 + mu / lambda);
  return {0.5 * lambda * from * from, lambda * from, lambda};
}

VolumeLaw volume_barrier(double k, double least, double J) {
  if (!(J > least)) return {kInfinity, 0, 0};
  const double left = J - least, whole = 1 - least;
  return {k * (-std::log(left / whole) + (J - 1) / whole), k * (1 / whole - 1 / left), k / (left * left)};
}

double energy(double c, const VolumeLaw& f, const Matrix3d& F) { return 0.5 * c * (F.squaredNorm() - 3) + f.value; }

void linearize(double c, const VolumeLaw& f, const Matrix3d& F, const Gradients& gradients, double volume,
               Forces& forces, Tangent& tangent) {
  Matrix3d cofactor;
  cofactor << F.col(1).cross(F.col(2)), F.col(2).cross(F.col(0)), F.col(0).cross(F.col(1));
  forces += volume * (c * F + f.slope * cofactor) * gradients;

  const Rotations F_is(F);
  const Matrix3d along = stretches(c, f, F_is.s);
  Matrix3d alike = Matrix3d::Zero(), crossed = Matrix3d::Zero();  // of (i, j) with itself, and with (j, i)
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    const double twist = std::max(c + f.slope * F_is.s(k), 0.0), flip = std::max(c - f.slope * F_is.s(k), 0.0);
    alike(i, j) = alike(j, i) = 0.5 * (twist + flip);
    crossed(i, j) = crossed(j, i) = 0.5 * (flip - twist);
  }
  const Gradients g = F_is.V.transpose() * gradients;
  for (int a = 0; a < 4; ++a)
    for (int b = 0; b <= a; ++b) {
      Matrix3d block =
          along.cwiseProduct(g.col(a) * g.col(b).transpose()) + crossed.cwiseProduct(g.col(b) * g.col(a).transpose());
      block.diagonal() += alike * g.col(a).cwiseProduct(g.col(b));
      block = volume * (F_is.U * block * F_is.U.transpose()).eval();
      tangent.block<3, 3>(3 * a, 3 * b) += block;
      if (a != b) tangent.block<3, 3>(3 * b, 3 * a) += block.transpose();
    }
}

}  // namespace dynamorph
