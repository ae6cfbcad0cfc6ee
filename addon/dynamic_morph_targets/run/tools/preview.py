# SPDX-License-Identifier: GPL-3.0-or-later
"""Shake tests and single modes: a motion of the armature without keyframes, played at once."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np
from bpy.types import Operator
from mathutils import Euler, Matrix

from ...core.errors import SceneError, WriteError
from ...core.motion import shake
from ...core.motion.rig_samples import RigSamples
from ...scene import events, references, skin
from ...scene.motion import rig_motion
from ...write.bake import muting
from ...write.display import live_key
from .. import live, remembered
from ..playing.tissue import Tissue

SWING = 0.05  # body sizes: a mode that plays
DELTAS = ("delta_location", "delta_rotation_euler", "delta_rotation_quaternion")


class Preview:
    """Borrows the live key for something that shows the soft skin in motion for a while; the rig may be moved along.
    Raises SceneError or WriteError.
    """

    def __init__(self, obj: bpy.types.Object, operator: type[Operator]):
        events.check_not_rendering()
        self.name, self.label = operator.bl_idname, operator.bl_label
        self.seconds_left: float | None = None  # None: until it is stopped
        self.object = skin.ObjectHandle.of(obj)
        self.tissue = Tissue(obj, bpy.context.scene)
        self._movers: list[_Mover] = []
        self._was_live = live.is_on(obj)
        self._sculpt = obj.dynamorph.sculpt.shown.name
        if not self._was_live:
            self.tissue.add_keys(obj)
        remembered.live.suspended.add(self.object.session_uid)
        obj.dynamorph.live.lent, obj.dynamorph.live.was_on = True, self._was_live

    def show(self, values: np.ndarray, transform: Matrix | None = None) -> None:
        """values: see Tissue.values. transform: in world space, of the rig. Raises SceneError when the key is gone."""
        obj = self.object.find()
        if not self.tissue.show(values):
            raise SceneError("The live key was removed: the test stops")
        if transform is not None:
            self._movers = self._movers or [_Mover(moved) for moved in movers(obj)]
            for mover in self._movers:
                mover.move(transform)

    @property
    def moves_rig(self) -> bool:
        return bool(self._movers)

    def end(self) -> None:
        """Put everything back."""
        remembered.live.suspended.discard(self.object.session_uid)
        for mover in self._movers:
            mover.restore()
        with suppress(SceneError, WriteError):  # it was deleted; or is edited now, and then stays live
            obj = self.object.find()
            obj.dynamorph.live.lent = obj.dynamorph.live.was_on = False
            if self._was_live:
                live.refresh(obj)
            else:
                live_key.remove(obj)
                muting.show_target(obj, self._sculpt)


def end_recovered() -> None:
    """Put back what a preview, or the draft of a model, showed when the loaded file was saved: by Blender itself
    (autosave, quit.blend), which calls no handler that would have ended a preview, or while the model was built.
    """
    for obj in [obj for obj in bpy.data.objects if obj.library is None]:
        record = obj.dynamorph.live
        if record.key.name and not (obj.dynamorph.model.content_id or obj.dynamorph.follows):
            with suppress(WriteError):
                live_key.remove(obj)
        if record.moved:
            _move_back(obj)
        if record.lent:
            was_on, record.lent, record.was_on = record.was_on, False, False
            if not was_on:
                with suppress(WriteError):  # in Edit Mode it stays live
                    live_key.remove(obj)


class _Mover:
    """Moves an object by its delta transform, which is neither keyed nor affected by frame changes."""

    def __init__(self, obj: bpy.types.Object):
        self.object = skin.ObjectHandle.of(obj)
        self.before = [getattr(obj, name).copy() for name in DELTAS]
        obj.dynamorph.live.deltas = [number for delta in self.before for number in delta]
        obj.dynamorph.live.moved = True
        self.basis = obj.matrix_basis.copy()  # with the deltas
        self.parent = obj.matrix_world @ self.basis.inverted()

    def move(self, transform: Matrix) -> None:
        """transform: in world space, of the object as it stood."""
        obj = self.object.find()
        moved = self.parent.inverted() @ transform @ self.parent @ self.basis
        turn = moved.to_quaternion() @ self.basis.to_quaternion().inverted()
        _, euler, quaternion = self.before
        obj.delta_location = moved.to_translation() - obj.location
        if obj.rotation_mode == "QUATERNION":
            obj.delta_rotation_quaternion = turn @ quaternion
        elif obj.rotation_mode != "AXIS_ANGLE":  # which has no deltas that Python can set
            turned = turn.to_matrix() @ _matrix(euler, obj.rotation_mode)
            obj.delta_rotation_euler = turned.to_euler(obj.rotation_mode, euler)

    def restore(self) -> None:
        with suppress(SceneError):  # it was deleted
            _move_back(self.object.find())


def _move_back(obj: bpy.types.Object) -> None:
    """Move an object back to where it stood before a `_Mover` moved it."""
    numbers = iter(obj.dynamorph.live.deltas)
    for name in DELTAS:
        setattr(obj, name, [next(numbers) for _ in getattr(obj, name)])
    obj.dynamorph.live.moved = False
    obj.dynamorph.live.property_unset("deltas")


def _matrix(euler: Euler, order: str) -> Matrix:
    """The rotation of an Euler property, which uses the order of the object's own rotation."""
    euler = euler.copy()
    euler.order = order
    return euler.to_matrix()


def movers(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """The objects that a shake test moves: the rig, and the mesh if it does not follow the rig."""
    rig = references.rig_of(obj)
    parent = obj.parent
    while parent not in (None, rig):
        parent = parent.parent
    return [rig] if parent else [rig, obj]


def is_running(operator: str) -> bool:
    running = remembered.live.preview
    return running is not None and running.name == operator


def begin_preview(obj: bpy.types.Object, operator: type[Operator]) -> Preview:
    """Begin a preview, and end the one that runs."""
    end_preview()
    running = remembered.live.preview = Preview(obj, operator)
    events.redraw(events.PANELS)
    return running


def end_preview() -> None:
    if remembered.live.preview:
        remembered.live.preview.end()
        events.redraw(events.PANELS)
    remembered.live.preview = None


def shaken(
    obj: bpy.types.Object, tissue: Tissue, kind: str, seconds: float = shake.SECONDS
) -> tuple[RigSamples, np.ndarray]:
    """The rig in its present pose, shaken: samples at substeps, and the transforms (S, 4, 4) that move it in Blender's
    world, Blender units."""
    still = rig_motion.sample_present(obj, tissue.probe)
    still = replace(still, tracks=(*still.tracks, *rig_motion.present_colliders(obj)))
    transforms = shake.transforms(kind, still, tissue.player, seconds)
    samples = still.moved(transforms)
    transforms[:, :3, 3] /= skin.unit_scale()
    return samples, transforms
