# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake that an object shows, read from its shape keys and curves."""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...core.errors import WriteError
from ...core.motion.baked import Bake
from ...scene import animation
from ...scene.references import key_points
from ..reconcile import reconcile
from .baked_action import MOTION, SHAPES, BakedAction


def read_back(obj: bpy.types.Object, samples: int = 1) -> Bake:
    """The bake of `obj` as its shape keys and curves now have it, at its frames and `samples` times a frame, local
    space. All keys are modes. Its strips count as they were baked. Raises WriteError.
    """
    record, keys = obj.dynamorph.bake, obj.data.shape_keys
    reconcile(obj)
    dynamic, static = _curves_of(obj, MOTION), _curves_of(obj, SHAPES)
    blocks = [keys.key_blocks[name] for name in baked_names(obj)] if keys else []
    paths = [f"{block.path_from_id()}.value" for block in blocks]
    curves = [curve for curve in (*map(dynamic.get, paths), *map(static.get, paths)) if curve]
    if not curves or record.cache:
        raise WriteError("'{name}' has no curves of a bake's motion: bake to shape keys first", name=obj.name)
    render = bpy.context.scene.render
    per_frame = render.frame_map_old / render.frame_map_new
    ends = [end / per_frame for curve in curves for end in curve.range()]
    first, last = math.ceil(min(ends) - 1e-3), math.floor(max(ends) + 1e-3)
    frames = first + np.arange((last - first) * samples + 1) / samples

    def values(curve: bpy.types.FCurve | None) -> np.ndarray:
        return np.array([curve.evaluate(time) for time in frames * per_frame]) if curve else np.zeros(len(frames))

    basis = key_points(keys.reference_key).astype(np.float64)
    return Bake(
        frames=frames,
        coordinates=np.array([values(dynamic.get(path) or static.get(path)) for path in paths]).T,
        weights=np.zeros((len(frames), 0)),
        modes=np.array([key_points(block) - basis for block in blocks]),
        residual_shapes=np.zeros((0, *basis.shape)),
        target_names=tuple(target.name for target in obj.dynamorph.targets),
        static=np.array([values(static.get(path)) for path in paths]).T,
        key_names=tuple(block.name for block in blocks),
    )


def shape_curves(obj: bpy.types.Object) -> dict:
    """The curves of the bake of `obj` that play only the targets' shapes, by path."""
    return _curves_of(obj, SHAPES)


def _curves_of(obj: bpy.types.Object, title: str) -> dict:
    """The curves of one slot of the bake of `obj`, by path."""
    baked = BakedAction.of(obj)
    slot = baked.slot(title)
    if not (obj.data.shape_keys and slot):
        return {}
    return {curve.data_path: curve for curve in animation.curves(baked.action, slot)}


def baked_names(obj: bpy.types.Object) -> list[str]:
    """Names of the shape keys that the bake added and that are still there; the references must be reconciled."""
    return [key.name for key in obj.dynamorph.bake.keys if key.name]
