# SPDX-License-Identifier: GPL-3.0-or-later
"""How far one motion of a cage's nodes is from another, as a whole and by parts of the body. NumPy only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

TORSO = "torso"
REGIONS = {  # by how the names of their bones begin
    TORSO: ("root", "pelvis", "hips", "spine", "chest", "belly", "breast"),
    "arms": ("clavicle", "shoulder", "upperarm", "lowerarm", "hand", "index", "middle", "pinky", "ring", "thumb"),
    "legs": ("thigh", "calf", "foot", "ball", "toe"),
    "head and neck": ("neck", "head", "jaw", "eye", "ear", "tail"),
}
NOTHING = 1e-9  # meters: what moves less has no error,
HARDLY = 0.05  # and nor has a region that moves less than this part of the whole


def by_bones(node_weights: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Which nodes (n,) belong to each region, by the bone with the most of them; node_weights (n, B + 1) with the
    nodes that no bone moves in the last column, names (B,) of the bones. Raises ValueError on a bone of no region."""
    regions = np.array([region_of(name) for name in names] + [""])
    nodes = regions[node_weights.argmax(axis=1)]
    return {region: nodes == region for region in REGIONS}


def region_of(bone: str) -> str:
    for region, beginnings in REGIONS.items():
        if bone.lower().startswith(beginnings):
            return region
    raise ValueError(f"bone: expected one of a region, got '{bone}'")


def by_thickness(thickness: np.ndarray) -> dict[str, np.ndarray]:
    """Which nodes (n,) are where the body is thick and where it is thin: more or less than half of the thickest,
    which is the 98th percentile. thickness (n,)."""
    thick = thickness > 0.5 * np.percentile(thickness, 98)
    return {"thick": thick, "thin": ~thick}


def moves(motion: np.ndarray, mass: np.ndarray) -> float:
    """RMS of a motion (F, n, 3) about its mean over the frames, by the nodes' mass (n,)."""
    about_mean = motion - motion.mean(axis=0)
    return float(np.sqrt(np.einsum("fnc,n->", about_mean**2, mass) / (len(motion) * mass.sum())))


def errors(
    motion: np.ndarray, reference: np.ndarray, mass: np.ndarray, regions: Mapping[str, np.ndarray], dynamic: np.ndarray
) -> dict:
    """Of a motion (F, n, 3): RMS of its difference from the reference, both about their means, as a part of that of
    the reference's dynamic motion (F, n, 3), of the whole and by regions (n,): {"error", "regions"}.

    None where the motion is not finite, or where the reference hardly moves.
    """
    apart = motion - reference
    everywhere = np.ones(len(mass), bool)
    whole = moves(dynamic, mass)

    def of(nodes: np.ndarray) -> float | None:
        size = moves(dynamic[:, nodes], mass[nodes]) if mass[nodes].any() else 0.0
        error = moves(apart[:, nodes], mass[nodes]) / size if size > max(NOTHING, HARDLY * whole) else np.nan
        return error if np.isfinite(error) else None

    return {"error": of(everywhere), "regions": {region: of(nodes) for region, nodes in regions.items()}}
