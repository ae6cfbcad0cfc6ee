# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the soft parts of a standing human are, and whether the sliders of a soft skin change the map there."""

import numpy as np
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data

# Height of the middle of each part, as a fraction of the body's, and how far it is in front of the thighs' or behind
# it, as a fraction of the body's depth.
PLACES = {
    "Chest": (0.64, 0.82, "in front"),
    "Belly": (0.53, 0.68, "in front"),
    "Glutes": (0.44, 0.58, "behind"),
    "Thighs": (0.28, 0.5, ""),
    "Upper Arms": (0.68, 0.86, ""),
    "Cheeks": (0.82, 0.96, "in front"),
}
BESIDE = 0.05  # of the depth


def found_right(body, meshes) -> list[str]:
    """The parts whose slider, moved to softest and back, softens the map of these meshes where such a part is, as much
    on the left as on the right. At rest they stand in world space and face -Y.
    """
    places = [mesh_data.rest_points(mesh) @ np.array(mesh.matrix_world.to_3x3()).T for mesh in meshes]
    points = np.concatenate(places)
    points = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    middles = {}
    for name, part in body.dynamorph.parts.items():
        part.firmness = 0.0
        group = body.dynamorph.firmness_group
        softer = 0.5 - np.concatenate([mesh_data.group_weights(mesh, [group], 0.5)[:, 0] for mesh in meshes])
        part.firmness = 0.5
        middles[name] = softer @ points / max(softer.sum(), 1e-300)
    return [name for name, middle in middles.items() if _is_there(name, middle - [0.5, middles["Thighs"][1], 0.0])]


def _is_there(name: str, middle: np.ndarray) -> bool:
    lowest, highest, side = PLACES[name]
    beside = {"in front": middle[1] < -BESIDE, "behind": middle[1] > BESIDE, "": True}[side]
    return lowest < middle[2] < highest and beside and abs(middle[0]) < 0.01
