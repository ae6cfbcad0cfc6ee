# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that show the flesh without a bake: Live, shake tests, single modes; and those that compare settings."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from itertools import islice

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty, FloatProperty
from bpy.types import Operator
from mathutils import Matrix

from . import comparison, events, extract, jobs, live, live_key, properties, sinks
from .extract import SceneError
from .operators import JobOperator, SoftSkinOperator, guarded, press
from .scene_data import Material, RigSamples
from .sinks import SinkError

SECONDS = 2.5  # a shake test
FIRST_LOOK = 2.0  # seconds of the hop in which a new soft skin shows itself
REST = 0.1  # seconds of it before it moves
STOMP, HOP, TWIST = 0.08, 0.12, math.radians(60)  # how far: body sizes, and an angle
SWING = 0.05  # body sizes: a mode that plays
DELTAS = ("delta_location", "delta_rotation_euler", "delta_rotation_quaternion")
NAVIGATION = {
    "MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM",
    "MOUSEROTATE", "MOUSESMARTZOOM", "NDOF_MOTION",
}  # fmt: skip


class FleshOperator(SoftSkinOperator):
    """Mixin: shows the flesh of the built model, which nothing else may show meanwhile."""

    @classmethod
    def obstacle(cls, context):
        return super().obstacle(context) or live.obstacle(properties.mesh_in(context))


class DYNAMORPH_OT_live(FleshOperator, Operator):
    """Simulate while Blender plays, without a bake; again: stop that"""

    bl_idname = "dynamorph.live"
    bl_label = "Live Soft Skin"

    @classmethod
    def obstacle(cls, context):
        obj = properties.mesh_in(context)
        playing = obj is not None and live.is_on(obj)
        return super(FleshOperator, cls).obstacle(context) if playing else super().obstacle(context)

    def apply(self, obj):
        end_preview()
        if live.is_on(obj):
            live.turn_off(obj)
        else:
            live.turn_on(obj, bpy.context.scene)


class EndsLive(JobOperator):
    """Mixin: builds a model, and in a window turns Live on then and lets the armature hop."""

    def modal(self, context, event):
        result = super().modal(context, event)
        if result == {"FINISHED"}:
            guarded(self, self._look, context)
        return result

    def _look(self, context):
        obj = jobs.find(self.batch.jobs[0].session_uid)
        obstacle = live.obstacle(obj)
        if obstacle:
            raise SceneError(obstacle)
        live.turn_on(obj, context.scene)
        if properties.mesh_in(context) == obj and not context.screen.is_animation_playing:
            press(self, "dynamorph.shake_test", kind="HOP", seconds=FIRST_LOOK)


class DYNAMORPH_OT_first_look(EndsLive, Operator):
    """Build a new soft skin, turn Live on and let it hop, so that it shows how it moves; Esc stops"""

    bl_idname = "dynamorph.first_look"
    bl_label = "Build Soft Skin"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}


# Previews ----------------------------------------------------------------------------------------------------------


class Preview:
    """The live key lent to something that shows the flesh in motion for a while; the rig may be moved along.

    Raises SceneError or SinkError.
    """

    def __init__(self, obj, operator: type[Operator]):
        self.name, self.label = operator.bl_idname, operator.bl_label
        self.session_uid = obj.session_uid
        self.flesh = live.Flesh(obj, bpy.context.scene)
        self._movers: list[_Mover] = []
        self._was_live = live.is_on(obj)
        self._sculpt = obj.dynamorph.sculpt.shown.name
        if not self._was_live:
            self.flesh.add_keys(obj)
        live.lent.add(self.session_uid)

    def show(self, values: np.ndarray, transform: Matrix | None = None):
        """values: see Flesh.values. transform: in world space, of the rig. Raises SceneError when the key is gone."""
        obj = jobs.find(self.session_uid)
        if not self.flesh.show(values):
            raise SceneError("The live key was removed: the test stops")
        if transform is not None:
            self._movers = self._movers or [_Mover(moved) for moved in movers(obj)]
            for mover in self._movers:
                mover.move(transform)

    def end(self):
        """Put everything back."""
        live.lent.discard(self.session_uid)
        for mover in self._movers:
            mover.restore()
        with suppress(SceneError, SinkError):  # it was deleted; or is edited now, and then stays live
            obj = jobs.find(self.session_uid)
            if self._was_live:
                live.refresh(obj)
            else:
                live_key.remove(obj)
                sinks.show_target(obj, self._sculpt)


class _Mover:
    """Moves an object by its delta transform, which is neither keyed nor changed by changing the frame."""

    def __init__(self, obj):
        self.session_uid = obj.session_uid
        self.before = [getattr(obj, name).copy() for name in DELTAS]
        self.basis = obj.matrix_basis.copy()  # with the deltas
        self.parent = obj.matrix_world @ self.basis.inverted()

    def move(self, transform: Matrix):
        """transform: in world space, of the object as it stood."""
        obj = jobs.find(self.session_uid)
        moved = self.parent.inverted() @ transform @ self.parent @ self.basis
        turn = moved.to_quaternion() @ self.basis.to_quaternion().inverted()
        _, euler, quaternion = self.before
        obj.delta_location = moved.to_translation() - obj.location
        if obj.rotation_mode == "QUATERNION":
            obj.delta_rotation_quaternion = turn @ quaternion
        elif obj.rotation_mode != "AXIS_ANGLE":  # which has no deltas that Python can set
            turned = turn.to_matrix() @ _matrix(euler, obj.rotation_mode)
            obj.delta_rotation_euler = turned.to_euler(obj.rotation_mode, euler)

    def restore(self):
        with suppress(SceneError):  # it was deleted
            obj = jobs.find(self.session_uid)
            for name, value in zip(DELTAS, self.before, strict=True):
                setattr(obj, name, value)


def _matrix(euler, order: str) -> Matrix:
    """The rotation of an Euler property, which has the order of the object's own rotation whatever it says."""
    euler = euler.copy()
    euler.order = order
    return euler.to_matrix()


def movers(obj) -> list:
    """The objects that a shake test moves: the rig, and the mesh if it does not follow the rig."""
    rig = properties.rig_of(obj)
    parent = obj.parent
    while parent not in (None, rig):
        parent = parent.parent
    return [rig] if parent else [rig, obj]


preview: Preview | None = None  # the one that runs in a window


def is_running(operator: str) -> bool:
    return preview is not None and preview.name == operator


def end_preview():
    global preview
    if preview:
        preview.end()
    preview = None


class PreviewOperator(FleshOperator):
    """Mixin: shows a Preview, in a window by and by until it ends or is stopped with Esc, else all frames at once."""

    bl_options = {"REGISTER"}  # nothing stays that could be undone

    def apply(self, obj):
        running = Preview(obj, type(self))
        try:
            moved = []
            for values, transform in self.frames(obj, running.flesh):
                running.show(values, transform)
                moved.append(running.flesh.moved(values))
        finally:
            running.end()
        self._report(max(moved))

    def invoke(self, context, _event):
        if bpy.app.background:
            return self.execute(context)
        return guarded(self, self._begin, context)

    def modal(self, context, event):
        if self.running is not preview:  # stopped by its button, by undo, or by what else ends previews
            return self._end(context)
        if event.type == "ESC" and event.value == "PRESS":
            return self._end(context)
        if event.type != "TIMER":
            return {"PASS_THROUGH"} if self.passes(event) else {"RUNNING_MODAL"}
        result = {"CANCELLED"}
        try:
            result = guarded(self, self._tick)
        finally:
            if result != {"RUNNING_MODAL"}:
                self._end(context)
        return result

    def cancel(self, context):
        self._end(context)

    def _begin(self, context):
        global preview
        stopped = is_running(type(self).bl_idname)
        end_preview()
        if stopped:
            return {"CANCELLED"}
        if context.screen.is_animation_playing:
            raise SceneError("Stop the playback first")
        obj = properties.mesh_in(context)
        self.running = Preview(obj, type(self))
        preview = self.running
        self.largest = 0.0
        try:
            self.left = self.frames(obj, self.running.flesh)
        except BaseException:
            end_preview()
            raise
        self.fps = self.running.flesh.player.settings.fps
        self.began, self.done = time.monotonic(), 0
        self.timer = context.window_manager.event_timer_add(1.0 / self.fps, window=context.window)
        context.window_manager.modal_handler_add(self)
        events.redraw_status(context)
        return {"RUNNING_MODAL"}

    def _tick(self):
        """Show the frame of this moment: a slow window drops some, as playback does."""
        due = 1 + int((time.monotonic() - self.began) * self.fps) - self.done
        frames = list(islice(self.left, due))
        self.done += len(frames)
        for values, _ in frames:
            self.largest = max(self.largest, self.running.flesh.moved(values))
        if frames:
            self.running.show(*frames[-1])
        if len(frames) == due:
            return {"RUNNING_MODAL"}
        self._report(self.largest)
        return {"FINISHED"}

    def _end(self, context):
        if self.running is preview:
            end_preview()
        context.window_manager.event_timer_remove(self.timer)
        events.redraw_status(context)
        return {"CANCELLED"}

    def _report(self, largest: float):
        text = rpt_("The flesh moves by up to {distance:.1f} mm")
        self.report({"INFO"}, text.format(distance=1000 * largest))


class DYNAMORPH_OT_shake_test(PreviewOperator, Operator):
    """Shake the armature in place, without keyframes, to see how the flesh swings; Esc stops"""

    bl_idname = "dynamorph.shake_test"
    bl_label = "Shake Test"

    kind: EnumProperty(
        name="Kind",
        description="How the armature is moved",
        items=(
            ("STOMP", "Stomp", "Rise, drop and stop dead"),
            ("TWIST", "Twist", "Turn about the vertical, quickly, and back"),
            ("HOP", "Hop", "Up and down, twice"),
        ),
        options={"SKIP_SAVE"},
    )  # fmt: skip
    seconds: FloatProperty(
        name="Seconds", description="How long the test takes", default=SECONDS, min=0.1, options={"SKIP_SAVE"}
    )

    def passes(self, event) -> bool:
        """Not what may be undone: it would remember the rig where it is shaken to."""
        return event.type in NAVIGATION

    def frames(self, obj, flesh) -> Iterator[tuple[np.ndarray, Matrix]]:
        for moved in movers(obj):
            if self.kind == "TWIST" and moved.rotation_mode == "AXIS_ANGLE":
                raise SceneError(f"'{moved.name}' rotates by Axis Angle: choose another rotation mode to twist it")
        return self._played(flesh, *shaken(obj, flesh, self.kind, self.seconds))

    @staticmethod
    def _played(flesh, samples, transforms):
        player, substeps = flesh.player, flesh.player.settings.substeps
        count = len(samples) // substeps
        yield flesh.values(player.begin(samples[:2])), Matrix(transforms[0])
        for k, frame in enumerate(player.play(samples[1:], range(1, count + 1)), 1):
            yield flesh.values(frame), Matrix(transforms[k * substeps])


def shake(kind: str, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height, in body sizes, and angle (S,) at these times after the start."""

    def smooth(t):
        t = np.clip(t, 0.0, 1.0)
        return t * t * (3.0 - 2.0 * t)

    t, none = seconds - REST, np.zeros_like(seconds)
    if kind == "STOMP":
        fallen = np.clip((t - 0.4) / 0.2, 0.0, 1.0)
        return STOMP * np.minimum(smooth(t / 0.4), 1.0 - fallen**2), none
    if kind == "TWIST":
        return none, TWIST * (smooth(t / 0.25) - smooth((t - 1.0) / 0.25))
    airborne = np.where((t > 0.0) & (t < 1.0), t % 0.5 / 0.5, 0.0)
    return HOP * 4.0 * airborne * (1.0 - airborne), none


def shaken(obj, flesh, kind: str, seconds: float = SECONDS) -> tuple[RigSamples, np.ndarray]:
    """The rig in its present pose, shaken: samples at substeps, and the transforms (S, 4, 4) that move it in Blender's
    world, Blender units."""
    still = extract.sample_present(obj, flesh.probe)
    rig_world = still.rig_world[0]
    settings = flesh.player.settings
    count = 1 + round(seconds * settings.fps) * settings.substeps
    heights, angles = shake(kind, np.arange(count) * settings.step)
    transforms = np.array([Matrix.Rotation(angle, 4, "Z") for angle in angles])
    origin = rig_world[:3, 3]
    transforms[:, :3, 3] = origin - transforms[:, :3, :3] @ origin
    transforms[:, 2, 3] += heights * flesh.player.size
    samples = still.moved(transforms)
    transforms[:, :3, 3] /= extract.unit_scale()
    return samples, transforms


class DYNAMORPH_OT_play_mode(PreviewOperator, Operator):
    """Swing the selected mode alone, about the targets' shape in the present pose; again, or Esc: stop"""

    bl_idname = "dynamorph.play_mode"
    bl_label = "Play Mode"

    def passes(self, _event) -> bool:
        return True  # to select other modes meanwhile

    def frames(self, obj, flesh) -> Iterator[tuple[np.ndarray, None]]:
        """A swing a second; in the background, one."""
        if not flesh.modes:
            raise SceneError(f"'{obj.name}' has no modes: choose another Method and build")
        weights = flesh.player.begin(extract.sample_present(obj, flesh.probe)).weights
        return self._swinging(obj.session_uid, flesh, weights)

    @staticmethod
    def _swinging(session_uid: int, flesh, weights):
        fps = flesh.player.settings.fps
        dry = np.concatenate([flesh.player.dry(weights), weights])
        k = 0
        while k < fps or not bpy.app.background:
            settings = jobs.find(session_uid).dynamorph
            index = min(settings.active_mode_index, flesh.modes - 1)
            mode = np.zeros_like(dry)
            mode[index] = 1.0
            amplitude = SWING * flesh.player.size / flesh.moved(dry + mode)
            if index < len(settings.modes):
                amplitude *= settings.modes[index].gain
            yield dry + amplitude * math.sin(2.0 * math.pi * k / fps) * mode, None
            k += 1


# Comparing ---------------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_show_plain(SoftSkinOperator, Operator):
    """Show the mesh as its rig alone moves it, to compare; again, or when the file is saved: show the soft skin"""

    bl_idname = "dynamorph.show_plain"
    bl_label = "Show Plain Skinning"

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and not comparison.can_show(properties.mesh_in(context)):
            return "Turn Live on or bake first: there is only plain skinning to be seen"
        return obstacle

    def apply(self, obj):
        end_preview()
        comparison.show(obj, not comparison.is_plain(obj))


class DYNAMORPH_OT_reset_gains(SoftSkinOperator, Operator):
    """Set the gain of all modes to 1, and none solo"""

    bl_idname = "dynamorph.reset_gains"
    bl_label = "Reset Gains"

    def apply(self, obj):
        for mode in obj.dynamorph.modes:
            mode.gain, mode.solo = 1.0, False


class DYNAMORPH_OT_check_targets(SoftSkinOperator, Operator):
    """Measure how far the soft skin at rest, in each target's pose, is from what was sculpted for it"""

    bl_idname = "dynamorph.check_targets"
    bl_label = "Check Targets"

    def apply(self, obj):
        model, character = jobs.current_model(obj)
        from . import report  # needs the engine, which is there now

        lines = [f"{name}: {1000 * miss:.3f} mm" for name, miss in report.residuals(model, character).items()]
        obj.dynamorph.live.checks = "\n".join(lines)
        self.report({"INFO"}, f"{obj.name}: {', '.join(lines)}")


class DYNAMORPH_OT_swap_slot(SoftSkinOperator, Operator):
    """Go to the other of two sets of settings, to compare them: materials, simulation, gains of modes"""

    bl_idname = "dynamorph.swap_slot"
    bl_label = "Swap A and B"

    def apply(self, obj):
        record = obj.dynamorph.live
        left = slot_settings(obj)
        put_slot(obj, json.loads(record.other) if record.other else left)
        record.other = json.dumps(left)
        record.slot = "B" if record.slot == "A" else "A"
        live.refresh(obj)


class DYNAMORPH_OT_copy_slot(SoftSkinOperator, Operator):
    """Make the other set of settings the same as this one"""

    bl_idname = "dynamorph.copy_slot"
    bl_label = "Copy to Other Slot"

    def apply(self, obj):
        obj.dynamorph.live.other = json.dumps(slot_settings(obj))


def slot_settings(obj) -> dict:
    """What one slot holds, fit for JSON. Targets are told apart by name; the neutral one is ''."""
    settings = obj.dynamorph
    return {
        "materials": {name: asdict(target.material()) for name, target in properties.named_targets(obj)},
        "frequencies": {name: [target.frequency, target.by_hand] for name, target in properties.named_targets(obj)},
        "simulation": properties.plain(settings.simulation),
        "gains": [mode.gain for mode in settings.modes],
    }


def put_slot(obj, values: dict):
    """The inverse of `slot_settings`; targets and modes that came since then stay as they are."""
    for name, target in properties.named_targets(obj):
        if name in values["materials"]:
            target.set_material(Material(**values["materials"][name]))
            target.frequency, target.by_hand = values.get("frequencies", {}).get(name, (0.0, False))
    properties.assign(obj.dynamorph.simulation, values["simulation"])
    for mode, gain in zip(obj.dynamorph.modes, values["gains"], strict=False):
        if mode.gain != gain:
            mode.gain = gain


@persistent
def _before_change(*_args):
    """What a preview moves must not be saved, nor stay where undo passes by."""
    end_preview()


@persistent
def _before_save(*_args):
    """save_pre: a file that is opened or rendered elsewhere shows the soft skin."""
    _before_change()
    for obj in properties.soft_skins(bpy.data.objects):
        if obj.library is None and comparison.is_plain(obj):
            with suppress(SinkError):  # in Edit Mode the panel goes on saying it
                comparison.show(obj, False)


HANDLERS = dict.fromkeys(("undo_pre", "redo_pre", "load_pre"), _before_change) | {"save_pre": _before_save}
CLASSES = (
    DYNAMORPH_OT_live,
    DYNAMORPH_OT_first_look,
    DYNAMORPH_OT_shake_test,
    DYNAMORPH_OT_play_mode,
    DYNAMORPH_OT_show_plain,
    DYNAMORPH_OT_reset_gains,
    DYNAMORPH_OT_check_targets,
    DYNAMORPH_OT_swap_slot,
    DYNAMORPH_OT_copy_slot,
)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register():
    _register_classes()
    events.add(HANDLERS)


def unregister():
    end_preview()
    events.remove(HANDLERS)
    _unregister_classes()
