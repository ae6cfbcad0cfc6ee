# SPDX-License-Identifier: GPL-3.0-or-later
"""References to shape keys, vertex groups and bones follow renames."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import bpy
import numpy as np

from ..core.character import Skeleton
from ..core.painted_map import MAPS
from ..scene.properties.bake_properties import DynamorphBake, DynamorphLive
from ..scene.properties.target_properties import DynamorphKey, DynamorphTarget
from ..scene.references import basis_hash, key_hash, rest_skeleton, rig_of
from ..scene.skin import own_attachments


def reconcile(obj: bpy.types.Object) -> None:
    """Make the references of `obj` follow renamed or moved shape keys and renamed bones.

    A reference whose key or bone is really gone stays as it is; whoever uses it reports that.
    """
    settings = obj.dynamorph
    if obj.data.shape_keys:
        blocks = obj.data.shape_keys.key_blocks
        _follow_keys(blocks, settings.targets[1:])
        _follow_keys(blocks, settings.bake.muted)
        _follow_baked_keys(blocks, settings.bake)
        _follow_keys(blocks, settings.live.muted)
        for reference in (settings.sculpt.key, settings.sculpt.shown):
            if reference.name:
                _follow_keys(blocks, [reference])
        _follow_live_key(blocks, settings.live)
    _follow_groups(obj)
    rig = rig_of(obj)
    if rig and rig.mode != "EDIT":  # in Edit Mode the armature's bones lag behind
        skeleton = rest_skeleton(rig.data)
        for target in settings.targets:
            _follow_bones(skeleton, target)


def _follow_baked_keys(blocks: bpy.types.bpy_prop_collection, bake: DynamorphBake) -> None:
    """Delete Bake deletes these keys: a key that only has the name of a baked key is the artist's.

    Unless the mesh itself was edited, or its scale applied: then none looks as it did, and the name has to do.
    """
    basis = basis_hash(blocks) if bake.keys else bake.basis
    if bake.basis == basis:
        for reference in bake.keys:
            block = blocks.get(reference.name)
            if block and not reference.looks_like(block):
                reference.name = ""
    else:
        bake.basis = basis
    for reference in _follow_keys(blocks, bake.keys):
        reference.name = ""


def _follow_live_key(blocks: bpy.types.bpy_prop_collection, live: DynamorphLive) -> None:
    """Live writes to its key and removes it: one that was there beside it, or has no shape, may be the artist's."""
    if live.key.name in blocks or (live.key.name and live.key.key_hash != key_hash(blocks[0])):
        _follow_keys(blocks, [live.key], live.others.split("\n"))
        note_others(blocks, live)


def note_others(blocks: bpy.types.bpy_prop_collection, live: DynamorphLive) -> None:
    """Note the names of the keys beside the one of Live, if that is there under its name."""
    names = blocks.keys()
    others = "\n".join(name for name in names if name != live.key.name)
    if live.key.name in names and live.others != others:
        live.others = others


def _follow_keys(
    blocks: bpy.types.bpy_prop_collection,
    references: Iterable[DynamorphKey | DynamorphTarget],
    others: Collection[str] = (),
) -> list:
    """Returns the references whose key is gone. others: names of keys that none of them has become."""
    lost, taken = [], {0}
    for reference in references:
        index = blocks.find(reference.name)
        if index < 0:
            lost.append(reference)
        else:
            reference.refer_to(blocks, index)
            taken.add(index)
    free = (
        {i: key_hash(block) for i, block in enumerate(blocks) if i not in taken and block.name not in others}
        if lost
        else {}
    )
    empty = key_hash(blocks[0]) if lost else ""  # a shape that tells no key from another: it must be at its place
    gone = []
    for reference in lost:
        in_place = reference.key_index if reference.key_count == len(blocks) else -1
        same = [i for i, digest in free.items() if digest == reference.key_hash and (digest != empty or i == in_place)]
        if not same:
            gone.append(reference)
            continue
        index = reference.key_index if reference.key_index in same else same[0]
        del free[index]
        reference.refer_to(blocks, index)
    return gone


def _follow_groups(obj: bpy.types.Object) -> None:
    """Vertex groups have no other identity than their place among the others."""
    settings = obj.dynamorph
    now, then = obj.vertex_groups.keys(), settings.groups.split("\n")
    if now == then:
        return
    settings.groups = "\n".join(now)
    moved = zip(then, now, strict=True) if len(now) == len(then) else ()
    renamed = {old: new for old, new in moved if old not in now and new not in then}
    users = [(settings, each.group) for each in MAPS]
    users += [(each, "group") for each in own_attachments(obj)]
    for user, name in users:
        if getattr(user, name) in renamed:
            setattr(user, name, renamed[getattr(user, name)])
    for target in settings.targets:
        if target.region in renamed:
            target.set_region(renamed[target.region], target.auto_region)


def _follow_bones(skeleton: Skeleton, target: DynamorphTarget) -> None:
    index = {name: b for b, name in enumerate(skeleton.names)}
    rest = np.empty((len(target.pose), 4, 4), np.float32)
    target.pose.foreach_get("rest", rest.ravel())
    free = sorted(set(index.values()) - {index.get(bone.name) for bone in target.pose})
    before, after = [], []
    for bone, stored in zip(target.pose, rest, strict=True):
        b = index.get(bone.name)
        if b is None:
            b = next((b for b in free if np.allclose(skeleton.rest[b], stored, rtol=1e-5, atol=1e-6)), None)
            if b is None:
                continue
            free.remove(b)
            for used in target.bones:
                if used.name == bone.name:
                    used.name = skeleton.names[b]
            bone.name = skeleton.names[b]
        before.append(stored[:3, :3])
        after.append(skeleton.rest[b, :3, :3])
        if not np.array_equal(skeleton.rest[b].astype(np.float32), stored):
            bone.rest = skeleton.rest[b].ravel()
    _keep_tilt(target, np.array(before), np.array(after))


def _keep_tilt(target: DynamorphTarget, before: np.ndarray, after: np.ndarray) -> None:
    """Bones (B, 3, 3) that at rest were all turned alike, as a rotation that is applied to the armature turns them,
    still stood in the world as they stood when the pose was captured."""
    if len(before) < 2:  # of a single bone it may be the roll
        return
    turn = after[0] @ before[0].T
    if np.allclose(turn, np.eye(3), atol=1e-4) or not np.allclose(turn @ before, after, atol=1e-4):
        return
    world = np.array(target.rig_world).reshape(4, 4)
    world[:3, :3] = world[:3, :3] @ turn.T
    target.rig_world = world.ravel()
