// SPDX-License-Identifier: GPL-3.0-or-later
// Isotropic laws of a constant-strain tetrahedron with a positive semidefinite tangent, for static problems far from
// rest, where Newton's method would otherwise run toward a maximum:
//
//   psi(F) = c / 2 (|F|^2 - 3) + f(det F)
//
// Smith, de Goes and Kim (Stable Neo-Hookean Flesh Simulation, ACM TOG 37(2), 2018; Analytic Eigensystems for Isotropic
// Distortion Energies, ACM TOG 38(1), 2019) give the eigenvalues of its second derivative: with F = U diag(s) V^T, of
// the three pairs of twists and flips c + f' s_k and c - f' s_k, and of the stretches those of a 3x3 matrix. Those
// below zero are left out.
#pragma once

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

using Forces = Eigen::Matrix<double, 3, 4>;     ///< on a tet's nodes
using Tangent = Eigen::Matrix<double, 12, 12>;  ///< derivative of those, node by node

/// f, f' and f'' at some det F.
struct VolumeLaw {
  double value, slope, curvature;
};

/// The stable neo-Hookean law (2018, equation 14 without its logarithm), at rest where F = I: c = mu and
/// f(J) = lambda / 2 (J - a)^2 with a = 1 + mu / lambda.
VolumeLaw stable_volume(double lambda, double mu, double J);

/// A barrier that no volume passes: f(J) = k (-log((J - least) / (1 - least)) + (J - 1) / (1 - least)), which is zero,
/// as its slope is, at J = 1, and infinite from J = least down.
VolumeLaw volume_barrier(double k, double least, double J);

/// psi at F.
double energy(double c, const VolumeLaw& f, const Matrix3d& F);

/// Adds the tet's forces dE/dx and the projected d2E/dx2, for one with this volume (m^3).
void linearize(double c, const VolumeLaw& f, const Matrix3d& F, const Gradients& gradients, double volume,
               Forces& forces, Tangent& tangent);

}  // namespace dynamorph
