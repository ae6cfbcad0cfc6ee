# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each target counts: in the present pose, and over the frames of the scene. Reads poses, never the mesh.

A pose is *outside* a set of targets when the nearest of them is further away than 1.1 times half the widest gap: the
largest distance from one of the set's targets to its nearest neighbor. So halfway between two neighbors is inside.
Distances are joint angles over all bones that place the set's targets (pose_space.hpp).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...core import states
from ...core.character import Target, TargetSet
from ...core.errors import SceneError, sentence
from ...core.message import Message
from ...core.motion import rig_samples
from ...core.motion.keyed import KeyedSettings
from ...core.motion.posing import channels_of
from ...core.motion.target_weights import Space, TargetWeights
from ...core.settings import Material
from ...scene import events, references, skin
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.references import bones_key
from ...scene.remembered import opened
from .. import remembered
from ..work.task import Chunks

PATIENCE = 0.5  # seconds without an edit before the graph is updated
SLICE = 0.02  # seconds of reading frames, between which Blender does other things


def space_of(obj: bpy.types.Object) -> Space:
    """The pose space of `obj` as it is authored now. Raises errors that tell the artist why there is none."""
    rig = checks.armature_modifier(obj).object
    targets = _placed_targets(obj)
    placing = {rig.data.bones.get(name) for target in targets for name in target.bone_names()} - {None}
    parents = tuple(bone.parent.name for bone in placing if bone.parent)
    placed = tuple((target.name, target.region, target.placing()) for target in targets)
    return _space(obj.session_uid, (bones_key(rig.data), parents, placed))


def _placed_targets(obj: bpy.types.Object) -> list[bpy.types.PropertyGroup]:
    """The neutral target and, if the method uses them, those that are not muted."""
    neutral, *others = obj.dynamorph.targets
    alone = obj.dynamorph.model.method == "SINGLE"
    return [neutral, *(target for target in others if not (target.mute or alone))]


@states.cached(opened, 8)
def _space(session_uid: int, _authored: tuple) -> Space:
    obj = skin.find(session_uid)
    rig = checks.armature_modifier(obj).object
    skeleton = references.rest_skeleton(rig.data)
    neutral, *others = _placed_targets(obj)

    def placed(target: bpy.types.PropertyGroup) -> Target:
        local = target.local(skeleton)
        return Target(
            target.name, np.zeros((0, 3)), target.bone_names(), local, np.eye(4), Material(), target.fade_out_angle,
            channel=target.channel, reached_at=target.reached_at,
        )  # fmt: skip

    regions = dict.fromkeys(["", *(target.region for target in others)])
    sets = tuple(
        TargetSet(
            region or obj.name,
            (placed(neutral), *(placed(target) for target in others if target.region == region)),
            np.zeros(0),
        )
        for region in regions
    )
    return Space(obj.name, skeleton, sets, rig_motion.pose_order(rig, skeleton))


def weights_now(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> TargetWeights:
    """At the evaluated pose, F = 1. Raises the exceptions of `engine.expected_errors`."""
    space = space_of(obj)
    rig = checks.armature_modifier(obj).object.evaluated_get(depsgraph)
    if len(rig.pose.bones) != len(space.order):
        raise SceneError("The bones of '{name}' are being edited", name=rig.name)
    at = {channel.name: channel.value for channel in obj.dynamorph.channels}
    channels = [[at.get(name, 0.0) for name in space.channels]]
    return space.weights_at(rig_motion.pose_matrices(rig, space.order)[None], np.array(channels))


# Over the frames ---------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class RigPoses:
    """An armature's evaluated poses (F, B, 4, 4) from frame `start` on, for a skeleton with these bones, and what is
    keyed of the soft skin. stale: an animation was edited since. problem: why there are no poses.
    """

    start: int
    end: int
    bones: tuple
    pose: np.ndarray
    keyed: KeyedSettings | None = None
    stale: bool = False
    problem: str = ""


class Reading:
    """An armature that is read frame by frame, from start to end, until it is a shot."""

    def __init__(self, obj: bpy.types.Object, start: int, end: int):
        rig = checks.armature_modifier(obj).object
        self.of = (obj.session_uid, start, end)
        self._rig = rig.session_uid
        self._skeleton = references.rest_skeleton(rig.data)
        self._shot = RigPoses(start, end, bones_key(rig.data), np.zeros((0, 0, 4, 4)))
        self._sampling: rig_motion.RigSampling | None = None

    @property
    def fraction(self) -> float:
        return self._sampling.done / self._sampling.count if self._sampling else 0.0

    @property
    def frame(self) -> int:
        """The one that is read next."""
        return self._sampling.frame if self._sampling else self._shot.start

    def advance(self, obj: bpy.types.Object, seconds: float = np.inf) -> bool:
        """Reads on for about so many seconds; True when everything is read. Raises SceneError, which the shot
        records.
        """
        try:
            if self._sampling is None:
                self._sampling = rig_motion.RigSampling(obj, self._shot.start, self._shot.end, 1)
            if not self._sampling.advance(obj, seconds):
                return False
            samples = self._sampling.samples()
            self._shot.pose = rig_samples.keep_collapsed(samples, self._skeleton)[0].pose
            self._shot.keyed = samples.track(KeyedSettings)
        except SceneError as error:
            self._shot.problem = sentence(error)
            remembered.live.poses[self._rig] = self._shot
            raise
        remembered.live.poses[self._rig] = self._shot
        return True


def reading(session_uid: int, start: int, end: int) -> Chunks[TargetWeights]:
    """The pieces of a `task.Task` that evaluates the rig of an object at every frame from start to end, and keeps its
    poses for `drawn`. The result is the weights there, F = end - start + 1. Raises `engine.expected_errors`.
    """
    work = Reading(skin.find(session_uid), start, end)
    while not work.advance(skin.find(session_uid), SLICE):
        yield work.fraction, Message("Reading frame {frame}", frame=work.frame)
    found = drawn(skin.find(session_uid))
    assert found is not None  # it has just been read
    return found[1]


def drawn(obj: bpy.types.Object) -> tuple[RigPoses, TargetWeights] | None:
    """The known frames with the present targets; evaluates nothing. Raises like `weights_now`."""
    rig = checks.armature_modifier(obj).object
    shot = remembered.live.poses.get(rig.session_uid)
    if shot is None or not len(shot.pose) or shot.bones != bones_key(rig.data):
        return None
    return shot, _over(space_of(obj), shot)


@states.cached(opened, 4)
def _over(space: Space, shot: RigPoses) -> TargetWeights:
    return space.weights_at(shot.pose, channels_of(shot.keyed, len(shot.pose), space.targets))


def problem(obj: bpy.types.Object) -> str:
    """Why the frames of `obj` could not be evaluated, or ''."""
    rig = references.rig_of(obj)
    shot = rig and remembered.live.poses.get(rig.session_uid)
    return shot.problem if shot else ""


# Keeping up --------------------------------------------------------------------------------------------------------


def update_soon(wait: float = PATIENCE) -> None:
    """Update the graph unless something needs it earlier."""
    events.soon(_update, wait)


def _update() -> float | None:
    """A timer: seconds until the next try, or None when all is up to date."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window):
        obj = skin.mesh_in(bpy.context)
    if obj is None or not obj.dynamorph.targets or not bpy.context.window_manager.dynamorph.target_weights:
        return None
    moving = any(operator.bl_idname.startswith("TRANSFORM_OT") for operator in window.modal_operators)
    if moving or remembered.work.running or bpy.app.is_job_running("RENDER"):
        return PATIENCE
    if not _is_old(obj, window.scene):
        return None
    return None if _read_on(obj, window.scene.frame_start, window.scene.frame_end) else SLICE


def _read_on(obj: bpy.types.Object, start: int, end: int) -> bool:
    """Read the frames for a moment; True when there is no more to read."""
    try:
        if remembered.live.reading is None or remembered.live.reading.of != (obj.session_uid, start, end):
            remembered.live.reading = Reading(obj, start, end)
        if not remembered.live.reading.advance(obj, SLICE):
            return False
    except SceneError:
        pass  # the panel shows it: `problem`
    remembered.live.reading = None
    events.redraw(events.PANELS | events.VIEWS)
    return True


def _is_old(obj: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    rig = references.rig_of(obj)
    shot = rig and remembered.live.poses.get(rig.session_uid)
    if not shot:
        return rig is not None
    frames = (scene.frame_start, scene.frame_end)
    return shot.stale or (shot.start, shot.end) != frames or shot.bones != bones_key(rig.data)


@persistent
def _note_changes(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """depsgraph_update_post: any Action may move the rig; armatures, ranges and the selection are looked at later."""
    if not bpy.context.window_manager.dynamorph.target_weights:
        return
    if any(isinstance(update.id, bpy.types.Action) for update in depsgraph.updates):
        remembered.live.reading = None
        for shot in remembered.live.poses.values():
            shot.stale = True
    if remembered.live.reading is None:  # reading also updates the scene
        update_soon()


def follow_frames() -> None:
    """Called where bars are drawn: redraws them at the next frame, because Blender plays without redrawing the
    sidebar.
    """
    remembered.live.bars_drawn = True


@persistent
def _next_frame(*_args: object) -> None:
    """frame_change_post."""
    if remembered.live.bars_drawn and not bpy.app.is_job_running("RENDER"):  # then another thread is here
        remembered.live.bars_drawn = False
        events.redraw(events.PANELS)


HANDLERS = {
    "depsgraph_update_post": _note_changes,
    "frame_change_post": _next_frame,
}


LISTENERS: dict[events.Event, Callable[[], None]] = {events.Event.WEIGHTS_ASKED: partial(update_soon, 0.0)}


def register() -> None:
    events.add(HANDLERS)
    events.subscribe(LISTENERS)


def unregister() -> None:
    events.unsubscribe(LISTENERS)
    events.remove(HANDLERS)
    events.forget(_update)
