# SPDX-License-Identifier: GPL-3.0-or-later
"""What the settings refer to by name (shape keys, bones and the rig), and how each is distinguished from others."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from ..core.character import Skeleton
from .keyless import IntProperty, StringProperty
from .remembered import opened

OVERRIDE = {"LIBRARY_OVERRIDABLE"}
OVERRIDE_LIST = {"LIBRARY_OVERRIDABLE", "USE_INSERTION"}


def rig_of(obj: bpy.types.Object) -> Any:
    """The armature object that places the targets of `obj`, or None: of the first Armature modifier that skins it.

    That has a deforming bone with a vertex group; if none has, the first that has an armature.
    """
    return rig_among(obj, armature_modifiers(obj))


def rig_among(obj: bpy.types.Object, modifiers: Sequence[bpy.types.Modifier]) -> bpy.types.Object | None:
    """`rig_of` with the `armature_modifiers` of `obj`."""
    rigs = [modifier.object for modifier in modifiers]
    if len(rigs) < 2:
        return rigs[0] if rigs else None
    groups = set(obj.vertex_groups.keys())
    skins = (rig for rig in rigs if any(bone.use_deform and bone.name in groups for bone in rig.data.bones))
    return next(skins, rigs[0])


def armature_modifiers(obj: bpy.types.Object) -> list:
    """The Armature modifiers of `obj` that have an armature and are on in the viewport or in renders; if all are off,
    these.
    """
    found = [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE" and is_armature(modifier.object)]
    return [modifier for modifier in found if modifier.show_viewport or modifier.show_render] or found


def is_armature(obj: bpy.types.Object | None) -> bool:
    """Whether it is an armature object; one whose library is missing is an empty."""
    return obj is not None and obj.type == "ARMATURE"


def as_moved(skeleton: Skeleton, rig: bpy.types.Object) -> Skeleton:
    """The skeleton, where a bone that copies the transforms of another one hangs on that: in rigs such as Rigify's the
    deforming bones follow mechanisms, and these the bones that the artist moves.
    """
    parents, numbers = skeleton.parents.copy(), {name: bone for bone, name in enumerate(skeleton.names)}
    for bone in rig.pose.bones:
        for constraint in bone.constraints:
            if constraint.type == "COPY_TRANSFORMS" and constraint.target == rig and not constraint.mute:
                parents[numbers[bone.name]] = numbers.get(constraint.subtarget, parents[numbers[bone.name]])
    return replace(skeleton, parents=parents)


def rest_skeleton(armature: bpy.types.Armature) -> Skeleton:
    """The armature's bones at rest, parents before children."""
    names, rest = bones_key(armature)
    places = {name: place for place, name in enumerate(names)}
    return _skeleton(names, rest, tuple(places[bone.parent.name] if bone.parent else -1 for bone in armature.bones))


@lru_cache(maxsize=8)  # hundreds of bones take several milliseconds
def _skeleton(names: tuple[str, ...], rest: bytes, parents: tuple[int, ...]) -> Skeleton:
    """rest: as `bones_key`; parents: places among the names, -1 for none."""
    depths: dict[int, int] = {-1: -1}
    waiting = set(range(len(names)))
    while waiting:
        level = {bone for bone in waiting if parents[bone] in depths}
        depths |= {bone: depths[parents[bone]] + 1 for bone in level}
        waiting -= level
    order = sorted(range(len(names)), key=depths.__getitem__)  # stable: siblings keep their order
    places = {bone: place for place, bone in enumerate([-1, *order], start=-1)}
    columns = np.frombuffer(rest, np.float32).reshape(-1, 4, 4)  # Blender's, column after column
    return Skeleton(
        tuple(names[bone] for bone in order),
        np.array([places[parents[bone]] for bone in order], dtype=np.int64),
        columns[order].swapaxes(1, 2).astype(np.float64),
    )


def bones_key(armature: bpy.types.Armature) -> tuple:
    """The bones' names and rest places, for comparison."""
    rest = np.empty(16 * len(armature.bones), np.float32)
    armature.bones.foreach_get("matrix_local", rest)
    return tuple(armature.bones.keys()), rest.tobytes()


def key_points(block: bpy.types.ShapeKey) -> np.ndarray:
    """The points of a shape key, (V, 3) float32, local space. float32 because Blender then copies in one piece."""
    points = np.empty((len(block.points), 3), np.float32)
    block.points.foreach_get("co", points.ravel())
    return points


def key_hash(block: bpy.types.ShapeKey) -> str:
    """Identifies a shape key by its shape, whatever its name or place in the list."""
    return _hash("shape", block, _key_shape(block))


def basis_hash(blocks: bpy.types.bpy_prop_collection) -> str:
    """Detects edits of the mesh itself, which change all its shape keys."""
    return _hash("points", blocks[0], key_points(blocks[0]))


def _hash(what: str, block: bpy.types.ShapeKey, points: np.ndarray) -> str:
    """The hash of points (V, 3) float32 of a shape key. Blender does not say which keys an edit has changed, so
    all are compared after each step of a slider; hashing takes five times as long as comparing.
    """
    where, seen = (what, block.id_data.session_uid, block.name), _fingerprint(points)
    if opened.key_hashes.get(where, ("",))[0] != seen:
        opened.key_hashes[where] = seen, hashlib.blake2b(points.tobytes(), digest_size=8).hexdigest()
    return opened.key_hashes[where][1]


def _fingerprint(points: np.ndarray) -> tuple[int, ...]:
    """A number that changes with any of the points (V, 3) float32; of this process only."""
    words = points.ravel().view(np.uint32)
    pairs = words[: len(words) // 2 * 2].view(np.uint64)
    return len(words), int(pairs @ _factors(len(pairs))), *words[2 * len(pairs) :].tolist()


@lru_cache(maxsize=4)
def _factors(count: int) -> np.ndarray:
    """Odd, so that no change of a single word is lost; random, so that several do not cancel out."""
    return np.random.default_rng(1).integers(2**63, size=count, dtype=np.uint64) * np.uint64(2) + np.uint64(1)


def key_displacement(block: bpy.types.ShapeKey) -> float:
    """The largest displacement by a shape key. Unlike the hash it survives an edit of the Basis."""
    return float(np.abs(_key_shape(block)).max(initial=0.0))


def _key_shape(block: bpy.types.ShapeKey) -> np.ndarray:
    return key_points(block) - key_points(block.relative_key)


class KeyReference:
    """Mixin: a shape key, found again after a rename. The group's own `name` is the key's name."""

    key_index: IntProperty(name="Key Index", description="Place of the shape key in the list", override=OVERRIDE)
    key_count: IntProperty(name="Key Count", description="Number of shape keys in the list", override=OVERRIDE)
    key_hash: StringProperty(name="Key Hash", description="Identifies the sculpted shape", override=OVERRIDE)

    def refer_to(self, blocks: bpy.types.bpy_prop_collection, index: int) -> None:
        """Point at `blocks[index]`. Writes only what changed, because writing tags the object for evaluation."""
        block = blocks[index]
        values = {"name": block.name, "key_index": index, "key_count": len(blocks), "key_hash": key_hash(block)}
        for field, value in values.items():
            if getattr(self, field) != value:
                setattr(self, field, value)


KEY_REFERENCE = ("name", *KeyReference.__annotations__)
