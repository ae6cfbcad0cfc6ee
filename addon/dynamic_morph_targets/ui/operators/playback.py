# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that show the motion without a bake (Live, shake tests, single modes)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, FloatProperty
from bpy.types import Operator
from mathutils import Matrix

from ...core.character import target_labels
from ...core.errors import SceneError
from ...core.motion.rig_samples import RigSamples
from ...core.motion.shake import SECONDS
from ...core.result import compare
from ...run import live, remembered
from ...run.playing.tissue import Tissue
from ...run.tools import preview
from ...run.tools.first_look import FirstLook
from ...run.tools.preview import SWING, Preview, end_preview, end_recovered, is_running, movers, shaken
from ...run.work import task
from ...scene import animation, events, skin
from ...scene.motion import rig_motion
from ...scene.registration import of_classes
from ...scene.remembered import opened
from ...scene.skinning import Skinning
from ...scene.store import model_store
from ..base import SoftSkinOperator, report_errors
from .jobs import JobOperator, press

FIRST_LOOK = 2.0  # seconds of the hop that shows a new soft skin
NAVIGATION = {
    "MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM",
    "MOUSEROTATE", "MOUSESMARTZOOM", "NDOF_MOTION",
}  # fmt: skip


class TissueOperator(SoftSkinOperator):
    """Mixin: shows the motion of the built model; nothing else may show it at the same time."""

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        obj = skin.mesh_in(context)
        if obj and obj.session_uid in opened.drafts:  # it can be played while the rest of its model is built
            return ""
        return super().disabled_reason(context) or live.disabled_reason(obj)


class DYNAMORPH_OT_live(SoftSkinOperator, Operator):
    """Simulate while Blender plays, over a bake if there is one. Builds an outdated model first. Press again to stop"""

    bl_idname = "dynamorph.live"
    bl_label = "Live Soft Skin"

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        obj = skin.mesh_in(context)
        waits = not live.is_on(obj) and (live.disabled_reason(obj) or live.must_prepare(obj))
        if bpy.app.background or not waits:
            return self.execute(context)
        press(self, "dynamorph.build_live")
        return {"CANCELLED"}  # the undo step is that of the build

    def apply(self, obj: bpy.types.Object) -> None:
        end_preview()
        if live.is_on(obj):
            live.turn_off(obj)
        elif live.disabled_reason(obj):
            raise SceneError(live.disabled_reason(obj))
        else:
            live.turn_on(obj, bpy.context.scene)


class EndsLive(JobOperator):
    """Mixin: builds a model. In a window it then turns Live on."""

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        result = super().modal(context, event)
        if result == {"FINISHED"}:
            report_errors(self, self._look, context)
        return result

    def _look(self, context: bpy.types.Context) -> None:
        request = self.batch.jobs[0].request
        if request.scene.find() != context.scene:  # the artist has gone on in another one
            return
        obj = request.target.find()
        disabled_reason = live.disabled_reason(obj)
        if disabled_reason:
            raise SceneError(disabled_reason)
        if not live.is_on(obj):
            live.turn_on(obj, context.scene)


class DYNAMORPH_OT_first_look(EndsLive, Operator):
    """Build a new soft skin, turn Live on, let the armature hop and then play its animation. Esc stops it"""

    bl_idname = "dynamorph.first_look"
    bl_label = "Build Soft Skin"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    def _batch(self, obj: bpy.types.Object) -> FirstLook:
        self.look, self.hopped = FirstLook(obj), False
        return self.look

    def _tick(self, context: bpy.types.Context) -> set[str]:
        result = super()._tick(context)
        if self.look.shows and result == {"RUNNING_MODAL"}:
            self._hop(context)
        return result

    def _look(self, context: bpy.types.Context) -> None:
        super()._look(context)
        self._hop(context)

    def _hop(self, context: bpy.types.Context) -> None:
        """Once, as soon as Live shows something."""
        obj = self.look.jobs[0].request.target.find()
        if self.hopped or not live.is_on(obj):
            return
        self.hopped = True
        if skin.mesh_in(context) == obj and not context.screen.is_animation_playing:
            press(self, "dynamorph.shake_test", kind="HOP", seconds=FIRST_LOOK, then_plays=True)


class DYNAMORPH_OT_build_live(EndsLive, Operator):
    """Build the model of the soft skin if it is out of date, prepare its motion, and turn Live on"""

    bl_idname = "dynamorph.build_live"
    bl_label = "Build for Live"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}
    builds_again = False


class PreviewOperator(TissueOperator):
    """Mixin: shows a Preview. In a window it plays until it ends or Esc stops it; in the background all frames run at
    once.
    """

    bl_options = {"REGISTER"}  # it leaves nothing that could be undone
    bl_idname: str

    frames: Callable  # (self, obj, tissue): an iterator over what to show
    passes: Callable  # (self, event): whether an event goes on to Blender

    @property
    def lasts(self) -> float | None:
        """Seconds; None: until it is stopped."""
        return None

    def apply(self, obj: bpy.types.Object) -> None:
        running = Preview(obj, type(self))
        try:
            moved = []
            for values, transform in self.frames(obj, running.tissue):
                running.show(values, transform)
                moved.append(running.tissue.moved(values))
        finally:
            running.end()
        self._report(max(moved))

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        return report_errors(self, self._begin, context)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.running is not remembered.live.preview:  # its button, undo or anything else has ended it
            return self._end(context)
        if event.type == "ESC" and event.value == "PRESS":
            return self._end(context)
        if event.type != "TIMER":
            return {"PASS_THROUGH"} if self.passes(event) else {"RUNNING_MODAL"}
        result = {"CANCELLED"}
        try:
            result = report_errors(self, self._tick, context)
        finally:
            if result != {"RUNNING_MODAL"}:
                self._end(context)
        if result == {"FINISHED"}:
            self.finished(context)
        return {"PASS_THROUGH"} if result == {"RUNNING_MODAL"} else result  # others have timers too

    def cancel(self, context: bpy.types.Context) -> None:
        self._end(context)

    def finished(self, context: bpy.types.Context) -> None:
        """What follows a preview that nobody has stopped."""

    def _begin(self, context: bpy.types.Context) -> set[str]:
        stopped = is_running(type(self).bl_idname)
        end_preview()
        if stopped:
            return {"CANCELLED"}
        if context.screen.is_animation_playing:
            raise SceneError("Stop the playback first")
        obj = skin.mesh_in(context)
        self.running = preview.begin_preview(obj, type(self))
        self.largest = 0.0
        try:
            self.left = self.frames(obj, self.running.tissue)
        except BaseException:
            end_preview()
            raise
        self.fps = self.running.tissue.player.settings.fps
        self.began, self.done = time.monotonic(), 0
        self.timer = context.window_manager.event_timer_add(1.0 / self.fps, window=context.window)
        context.window_manager.modal_handler_add(self)
        events.redraw_status(context)
        return {"RUNNING_MODAL"}

    def _tick(self, context: bpy.types.Context) -> set[str]:
        """Show the frame that is due now. A slow window drops frames, as playback does."""
        if events.render_runs():  # which reads what would be written
            return {"RUNNING_MODAL"}
        due = 1 + int((time.monotonic() - self.began) * self.fps) - self.done
        frames = list(islice(self.left, due))
        self.done += len(frames)
        for values, _ in frames:
            self.largest = max(self.largest, self.running.tissue.moved(values))
        if frames:
            self.running.show(*frames[-1])
        if self.lasts is not None:
            speed = self.running.tissue.player.settings.speed
            self.running.seconds_left = max(self.lasts / speed - self.done / self.fps, 0.0)
            events.redraw_status(context)
        if len(frames) == due:
            return {"RUNNING_MODAL"}
        self._report(self.largest)
        return {"FINISHED"}

    def _end(self, context: bpy.types.Context) -> set[str]:
        if self.running is remembered.live.preview:
            end_preview()
        context.window_manager.event_timer_remove(self.timer)
        events.redraw_status(context)
        return {"CANCELLED"}

    def _report(self, largest: float) -> None:
        text = rpt_("The skin moves by up to {distance:.1f} mm")
        self.report({"INFO"}, text.format(distance=1000 * largest))


class DYNAMORPH_OT_shake_test(PreviewOperator, Operator):
    """Shake the armature in place, without keyframes, to see how the skin swings. Esc stops it"""

    bl_idname = "dynamorph.shake_test"
    bl_label = "Shake Test"

    kind: EnumProperty(
        name="Kind",
        description="How the test moves the armature",
        items=(
            ("STOMP", "Stomp", "Rise, drop and stop abruptly", 0),
            ("TWIST", "Twist", "Turn quickly about the vertical axis and back", 1),
            ("HOP", "Hop", "Move up and down twice", 2),
        ),
        options={"SKIP_SAVE"},
    )  # fmt: skip
    seconds: FloatProperty(
        name="Seconds", description="Duration of the test", default=SECONDS, min=0.1, max=60.0, options={"SKIP_SAVE"}
    )

    then_plays: BoolProperty(
        name="Then Play", description="Play the armature's own animation after the test, if it has one",
        options={"SKIP_SAVE", "HIDDEN"},
    )  # fmt: skip

    @property
    def lasts(self) -> float:
        return self.seconds

    def finished(self, context: bpy.types.Context) -> None:
        obj = skin.mesh_in(context)
        moves = self.then_plays and obj and animation.is_animated(Skinning.of(obj))
        if moves and not context.screen.is_animation_playing:
            press(self, "screen.animation_play")

    def passes(self, event: bpy.types.Event) -> bool:
        """Only navigation: an undo step would store the rig in its shaken position."""
        return event.type in NAVIGATION

    def frames(self, obj: bpy.types.Object, tissue: Tissue) -> Iterator[tuple[np.ndarray, Matrix]]:
        for moved in movers(obj):
            if self.kind == "TWIST" and moved.rotation_mode == "AXIS_ANGLE":
                raise SceneError(
                    "'{name}' rotates by Axis Angle: choose another rotation mode to twist it", name=moved.name
                )
        return self._played(tissue, *shaken(obj, tissue, self.kind, self.seconds))

    @staticmethod
    def _played(tissue: Tissue, samples: RigSamples, transforms: np.ndarray) -> Iterator[tuple[np.ndarray, Matrix]]:
        player, substeps = tissue.player, tissue.player.settings.substeps
        count = len(samples) // substeps
        yield tissue.values(player.begin(samples[:2])), Matrix(transforms[0])
        for k, frame in enumerate(player.play(samples[1:], range(1, count + 1)), 1):
            yield tissue.values(frame), Matrix(transforms[k * substeps])


class DYNAMORPH_OT_play_mode(PreviewOperator, Operator):
    """Swing only the selected mode about the targets' shape in the current pose. Press again, or Esc, to stop"""

    bl_idname = "dynamorph.play_mode"
    bl_label = "Play Mode"

    def passes(self, _event: bpy.types.Event) -> bool:
        return True  # to select other modes meanwhile

    def frames(self, obj: bpy.types.Object, tissue: Tissue) -> Iterator[tuple[np.ndarray, None]]:
        """One swing per second; in the background, a single swing."""
        if tissue.dofs and not tissue.modes:
            raise SceneError("'{name}' is simulated without modes: set Quality to Reduced", name=obj.name)
        if not tissue.modes:
            raise SceneError("'{name}' has no modes: choose another Method and build", name=obj.name)
        weights = tissue.player.begin(rig_motion.sample_present(obj, tissue.probe)).weights
        return self._swinging(obj.session_uid, tissue, weights)

    @staticmethod
    def _swinging(session_uid: int, tissue: Tissue, weights: np.ndarray) -> Iterator[tuple[np.ndarray, None]]:
        fps = tissue.player.settings.fps
        static = np.concatenate([tissue.player.static(weights), weights])
        k = 0
        while k < fps or not bpy.app.background:
            settings = skin.find(session_uid).dynamorph
            index = min(settings.active_mode_index, tissue.modes - 1)
            mode = np.zeros_like(static)
            mode[index] = 1.0
            amplitude = SWING * tissue.player.size / tissue.moved(static + mode)
            if index < len(settings.modes):
                amplitude *= settings.modes[index].gain
            yield static + amplitude * math.sin(2.0 * math.pi * k / fps) * mode, None
            k += 1


class DYNAMORPH_OT_reset_gains(SoftSkinOperator, Operator):
    """Set the Amount of all modes to 1, and turn Solo off"""

    bl_idname = "dynamorph.reset_gains"
    bl_label = "Reset Amounts"

    def apply(self, obj: bpy.types.Object) -> None:
        for mode in obj.dynamorph.modes:
            mode.gain, mode.solo = 1.0, False


class DYNAMORPH_OT_check_targets(JobOperator, Operator):
    """Measure how far the soft skin at rest in each target's pose is from the sculpted shape"""

    bl_idname = "dynamorph.check_targets"
    bl_label = "Check Targets"
    goal = "CHECK_TARGETS"

    def _batch(self, obj: bpy.types.Object) -> task.Task:
        return task.Task(obj, self.goal, self._misses(obj))

    @staticmethod
    def _misses(obj: bpy.types.Object) -> task.Chunks[list[str]]:
        model, character = model_store.current_model(obj)
        check = partial(compare.residuals, model, character)
        misses = yield from task.elsewhere(check, "Checking targets", obj.name, reports=True)
        labels = zip(target_labels(character.authored_sets), character.authored_targets, strict=True)
        return [f"{label}: {1000 * misses[target.name]:.3f} mm" for label, target in labels]

    def _done(self, task: task.Task) -> set[str]:
        obj = task.object.find()
        obj.dynamorph.live.checks = "\n".join(task.result)
        self.report({"INFO"}, f"{obj.name}: {', '.join(task.result)}")
        return {"FINISHED"}


@persistent
def _before_change(*_args: object) -> None:
    """What a preview moves must neither be saved nor end up in an undo step."""
    end_preview()


@persistent
def _loaded(*_args: object) -> None:
    """load_post, before Live's own."""
    end_recovered()


HANDLERS = {
    "undo_pre": _before_change,
    "redo_pre": _before_change,
    "load_pre": _before_change,
    "load_post": _loaded,
    "save_pre": _before_change,
}
CLASSES = (
    DYNAMORPH_OT_live,
    DYNAMORPH_OT_first_look,
    DYNAMORPH_OT_build_live,
    DYNAMORPH_OT_shake_test,
    DYNAMORPH_OT_play_mode,
    DYNAMORPH_OT_reset_gains,
    DYNAMORPH_OT_check_targets,
)
_register_classes, _unregister_classes = of_classes(CLASSES)


def register() -> None:
    _register_classes()
    events.add(HANDLERS)


def unregister() -> None:
    end_preview()
    events.remove(HANDLERS)
    _unregister_classes()
