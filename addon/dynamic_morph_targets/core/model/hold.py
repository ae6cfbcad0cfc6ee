# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds the soft tissue against the skeleton. It follows from the thickness of the body, not from the bones'
lines.

Importers guess where bones end; the thickness is always right. Let T be the radius of the largest ball in the body that
covers a point, and d its depth below the skin. Held are the core (deep compared with T), thin parts (T small compared
with the body's, unless thick ones are beside them: fingers, ears, horns, feet, tails, blades), whatever is rigid, and
what the Firmness map says. A smooth field phi from 0 to 1 says how firmly. The hold is an energy, FIRMNESS mu phi / T^2
|u - d_j|^2 / 2 integrated over the body, inside each target's own (docs/theory.md): it converges as the cage gets
finer, whereas pins node by node do not.
Never touches bpy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .. import firmness as paint
from ..engine import dynamorph
from ..geometry import determinant, smooth_step, unique_edges

FIRMNESS = 100.0  # of fully held tissue, which then moves like tissue of a tenth of its thickness
CORE = 0.35, 0.65  # depth over thickness where the hold of the core begins, and where it is full
THIN = 0.3, 0.55  # thickness relative to the body's below which a part is fully held, and above which it is not held
# Thickness lent to thin tissue: how it fades with the distance from thick tissue, and with the change of the bones, of
# the body's thickness; the largest factor; thickness relative to the body's below which none is lent, and from which
# all of it.
FADES, BONES, LENT, BORROWS = 0.5, 1.5, 1.2, (0.25, 0.4)
STIFFER = 0.9, 20.0  # fraction of the body's thickness below which tissue is stiffer, and the largest factor
THICKEST = 0.98  # quantile of the thickness over the soft volume that counts as the body's
EDGES = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]  # of a tetrahedron, by its corners
# Quadrature points of a tetrahedron, as weights of its corners; each represents a quarter of it.
A, B = 0.5854101966249685, 0.1381966011250105
QUADRATURE = np.full((4, 4), B) + (A - B) * np.eye(4)


@dataclass(frozen=True)
class Hold:
    """The hold of a cage of n nodes and m tets, and the V vertices of the skin.

    strength (m,): FIRMNESS phi / T^2, 1/m^2, and unpainted (m,): the same without the Firmness map; stiffness (m,):
    factor by thickness; phi (n,): how firmly nodes are held, for display; thickness (V,): T at the skin, meters.
    """

    strength: np.ndarray
    unpainted: np.ndarray
    stiffness: np.ndarray
    phi: np.ndarray
    thickness: np.ndarray


@dataclass(frozen=True)
class Depths:
    """Of the quadrature points (m, 4) of the tets: thickness of the body there and depth below the skin, meters;
    thickness (V,) at the skin.
    """

    thickness: np.ndarray
    depth: np.ndarray
    at_skin: np.ndarray

    def with_lent(self, mesh: dynamorph.TetMesh, weights: np.ndarray) -> Depths:
        """The same with what thick tissue lends to thin one. weights (n, B): of the bones at the nodes."""
        return replace(self, thickness=with_lent(mesh, weights, self.thickness))


@dataclass(frozen=True)
class BodyThickness:
    """How thick a body is, before it has a cage: `measured` at any point, at_skin (V,) at the skin, meters."""

    measured: dynamorph.Thickness
    at_skin: np.ndarray

    @classmethod
    def of(
        cls, surface: np.ndarray, triangles: np.ndarray, going_on: Callable[[float], bool] | None = None
    ) -> BodyThickness:
        """surface (V, 3): the skin, bind space; triangles (T, 3): those that enclose the body. going_on: False raises
        dynamorph.Cancelled. Raises dynamorph.Error.
        """
        thickness = dynamorph.Thickness(surface, triangles, going_on)
        return cls(thickness, thickness.at(surface)[0])


def depths(mesh: dynamorph.TetMesh, body: BodyThickness) -> Depths:
    """Of a body with such tetrahedra."""
    points = np.einsum("qa,eac->eqc", QUADRATURE, mesh.nodes[mesh.tets])
    radius, depth = (part.reshape(-1, len(QUADRATURE)) for part in body.measured.at(points.reshape(-1, 3)))
    return Depths(radius, depth, body.at_skin)


def with_lent(mesh: dynamorph.TetMesh, weights: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The thickness (m, 4) at the quadrature points, and what thick tissue lends to thin one beside it on the same
    bones: a breast or an udder is not held like a finger, which is as thin, but far from the trunk, nor like an arm,
    which has a bone of its own. Along the edges of the tets.
    """
    low, high = unique_edges(mesh.tets[:, EDGES].reshape(-1, 2), len(mesh.nodes)).T
    changed = 0.5 * np.abs(weights[low] - weights[high]).sum(axis=1)
    fades = FADES * np.linalg.norm(mesh.nodes[low] - mesh.nodes[high], axis=1) + BONES * radius.max() * changed
    first, second, fades = np.concatenate([low, high]), np.concatenate([high, low]), np.concatenate([fades, fades])
    order = np.argsort(first, kind="stable")
    first, second, fades = first[order], second[order], fades[order]
    nodes, starts = np.unique(first, return_index=True)
    lent = np.zeros(len(mesh.nodes))
    np.maximum.at(lent, mesh.tets, radius)
    while True:
        raised = np.maximum(lent[nodes], np.maximum.reduceat(lent[second] - fades, starts))
        if not (raised > lent[nodes]).any():
            break
        lent[nodes] = raised
    most = 1.0 + (LENT - 1.0) * smooth_step(radius / radius.max(), *BORROWS)
    return np.clip(lent[mesh.tets] @ QUADRATURE.T, radius, most * radius)


def hold(mesh: dynamorph.TetMesh, at: Depths, rigidity: np.ndarray, firmness: np.ndarray, fill: np.ndarray) -> Hold:
    """The hold of a body.

    rigidity and weights of the Firmness map (n,): at the nodes, from the skin; fill (m,).
    """
    corners, radius = mesh.nodes[mesh.tets], at.thickness
    rigid = rigidity[mesh.tets] @ QUADRATURE.T
    volume = fill * np.abs(determinant(corners[:, 1:] - corners[:, :1]))
    body = _quantile(radius.ravel(), (volume[:, None] * (1.0 - rigid)).ravel(), THICKEST)
    firm = paint.NEUTRAL + (firmness - paint.NEUTRAL)[mesh.tets] @ QUADRATURE.T
    core = np.maximum(smooth_step(at.depth / radius, *CORE), rigid)
    thin = 1.0 - smooth_step(radius / body, *THIN)
    unpainted = np.maximum(core, thin)
    phi = np.maximum(np.maximum(core, paint.kept(firm) * thin), paint.held(firm))
    ratio, limit = STIFFER
    stiffness = np.clip((ratio * body / radius) ** 2, 1.0, limit)
    nodes = mesh.tets.ravel()
    weights = np.repeat(volume, 4)
    shown = np.bincount(nodes, weights * phi.ravel(), len(mesh.nodes)) / np.bincount(nodes, weights, len(mesh.nodes))
    # The stiffness also multiplies the hold; its mean is taken once.
    strength, unpainted = (FIRMNESS * (field / radius**2).mean(axis=1) for field in (phi, unpainted))
    return Hold(strength, unpainted, stiffness.mean(axis=1), shown, at.at_skin)


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order][min(np.searchsorted(sums, share * sums[-1]), len(values) - 1)])
