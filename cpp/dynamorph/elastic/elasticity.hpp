// SPDX-License-Identifier: GPL-3.0-or-later
// An element of soft tissue: a constant-strain tetrahedron with a material law about one rest shape, where its energy
// is zero. assembly_kernels.cpp computes the derivatives and has their formulas.
//
//   F = F0 + sum_a u_a g_a^T          deformation gradient, I at the target's shape
//   linear       psi = 1/2 lambda tr(e)^2 + mu e:e,          e = sym(F) - I
//   StVK         psi = 1/2 lambda tr(E)^2 + mu E:E,          E = 1/2 (F^T F - I)
//   stable StVK  psi = 1/2 (lambda + mu) tr(E)^2 + mu (tr E - det F + 1)
//
// The stable law has StVK's small-strain moduli and stays a quartic polynomial of the displacement, but its energy does
// not vanish for inverted elements.
#pragma once

#include <vector>

#include "dynamorph/core/types.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"

namespace dynamorph {

enum class MaterialModel { linear, stvk, stable_stvk };

/// Throws std::invalid_argument unless `material_model` is one of the enumeration's values.
void check(MaterialModel material_model);

/// Lame's parameters, Pa.
struct Lame {
  double lambda;
  double mu;
};

/// One tetrahedron about a rest shape. Column a of `gradients` is g_a = dN_a/dX, 1/m.
struct Element {
  Eigen::Matrix<double, 3, 4> gradients;
  Matrix3d origin;  ///< F0, the deformation gradient at u = 0
  double weight;    ///< m^3: the volume times the fraction that counts (fill, painted stiffness, region)
};

/// Elements about the shape X + d. If that shape would make an element unusable (volume changed by more than 5x or
/// squashed below 0.2), the element keeps the neutral rest shape and is shifted by d instead. It still has its minimum
/// at u = d, but without the V/h^2 stiffness of a sliver.
struct RestShape {
  std::vector<Element> elements;
  int fallbacks = 0;  ///< elements that keep the neutral rest shape
};

/// Which tets (m) such a shape leaves usable; the others would fall back.
std::vector<bool> usable(const TetMesh& mesh, const VectorXd& displacement);

/// displacement (3n): meters. scale (m): multiplies each element's volume. shifted: all elements keep the neutral rest
/// shape, so that the stiffness is that of the neutral at any displacement.
RestShape rest_shape(const TetMesh& mesh, const VectorXd& displacement, const VectorXd& scale, bool shifted = false);

/// Lumped node volumes (n), m^3: the mass of each node for unit density. `fill` (m) is the filled fraction of each tet.
VectorXd lumped_volumes(const TetMesh& mesh, const VectorXd& fill);

}  // namespace dynamorph
