# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole soft skin as the bytes of one file: a model file with all that a program needs to pose, step and draw it.

The engine reads it (cpp/dynamorph/file/character.hpp); docs/file_format.md describes it. Never touches bpy.
"""

from __future__ import annotations

import numpy as np

from ..core.character import Character
from ..core.model.model import Model
from ..core.motion import posing
from ..core.motion.posing import Posing
from ..core.motion.rig_samples import RigSamples
from . import model_file

# Arrays that only building again needs are empty here, and these are rounded: half the bytes when compressed. The modes
# are not, which the engine requires to be orthonormal.
UNUSED = ("hold", "thickness", "unpainted_stiffness", "unpainted_hold")
EXACT = ("nodes", "basis", "responses", "to_bind", "rest")


def packed(model: Model, character: Character, world: RigSamples, gravity: tuple[float, float, float]) -> bytes:
    """The bytes of the file. world: where armature and mesh are. Raises ModelFileError."""
    arrays, meta = model.to_arrays()
    for name, array in arrays.items():
        if name in UNUSED:
            arrays[name] = np.zeros((0, 0))
        elif array.dtype == np.float64 and name not in EXACT:
            arrays[name] = array.astype(np.float32).astype(np.float64)
        elif array.dtype.kind == "i":
            arrays[name] = array.astype(np.int32)
    channels = posing.channels(character.targets)
    described = {
        "name": character.name,
        "blending": character.settings.blending,
        "targets": [target.name for target in character.targets],
        "sets": [
            {"name": each.name, "bones": _placing(character, {bone for t in each.targets for bone in t.bones})}
            | ({"channels": [channels.index(name) for name in posing.channels(each.targets)]} if channels else {})
            for each in character.target_sets
        ],
    } | ({"channels": channels} if channels else {})
    meta = {name: meta[name] for name in ("settings", "bone_names")} | {"character": described}
    return model_file.pack(arrays | _arrays(model, character, world, gravity), meta)


def _placing(character: Character, bones: set[str]) -> list[int]:
    return [index for index, name in enumerate(character.skeleton.names) if name in bones]


def _arrays(model: Model, character: Character, world: RigSamples, gravity: tuple) -> dict[str, np.ndarray]:
    """What a model lacks."""
    targets = character.targets
    materials = [character.material(index) for index in range(len(targets))]
    bones, weights = _influences(character.weights)
    channels = posing.channels(targets)
    placed = {"target_channels": posing.reached(targets, channels)} if channels else {}
    return placed | {
        "vertices": character.vertices.astype(np.float32),
        "triangles": character.triangles.astype(np.int32),
        "influence_bones": bones,
        "influence_weights": weights,
        "target_materials": np.array(
            [[m.stiffness, m.poisson, m.density, m.mass_damping, m.stiffness_damping] for m in materials], float
        ),
        "target_poses": np.array([target.local for target in targets], float),
        "target_bones": Posing(model, character, probed=False).target_frames(world),
        "fade_out_angles": np.array([target.fade_out_angle for target in targets], float),
        "object_frames": np.stack([world.rig_world[0], world.object_world[0]]),
        "gravity": np.array(gravity, float),
    }


def _influences(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bones (V, K) that move each vertex, the strongest first, and their weights, of weights (V, B + 1)."""
    most = max(1, int((weights > 0.0).sum(axis=1).max(initial=0)))
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :most]
    return bones.astype(np.int32), np.take_along_axis(weights, bones, 1).astype(np.float32)
