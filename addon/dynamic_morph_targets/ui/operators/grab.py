# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool that grabs a soft skin which is live, and what it does with the mouse."""

from __future__ import annotations

import time
from functools import partial

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Operator, WorkSpaceTool
from bpy_extras.view3d_utils import (
    location_3d_to_region_2d,
    region_2d_to_location_3d,
    region_2d_to_origin_3d,
    region_2d_to_vector_3d,
)
from mathutils import Vector

from ...run import remembered
from ...run.tools import grabbing
from ...scene import events, registration, skin
from ...scene.read import mesh_data
from ...scene.registration import of_classes
from ..base import report_errors
from ..widgets import draw_record

TAP, TAP_PIXELS = 0.4, 4  # a press that is shorter in seconds, and moves less, slaps
HAND_PIXELS = 12  # from the middle of a hand: a press there lets it go
NOTCH = 0.01  # of the body's size: by which the wheel moves the hand away from the viewer, or nearer


class DYNAMORPH_OT_grab(Operator):
    """Drag the soft skin while Live is on, and let go; a tap slaps it, and Shift at the release holds it"""

    bl_idname = "dynamorph.grab"
    bl_label = "Grab Soft Skin"
    bl_options = {"INTERNAL"}  # it leaves nothing that could be undone

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return skin.mesh_in(context) is not None and context.region_data is not None

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return report_errors(self, self._take, context, event)

    def _take(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        obj, mouse = skin.mesh_in(context), (event.mouse_region_x, event.mouse_region_y)
        if (held := _held_at(context, obj, mouse)) is not None:
            remembered.live.hands.let_go(held)
            events.redraw(events.VIEWS)
            return {"FINISHED"}
        hit, normal = _under(context, obj, mouse)
        if hit is None:
            return {"CANCELLED", "PASS_THROUGH"}
        self.grabbing = grabbing.begin(obj)
        points = mesh_data.shown_points(obj, context.evaluated_depsgraph_get()).astype(np.float64)
        self.hold = self.grabbing.take(np.array(hit), points)
        self.mouse = self.first = mouse
        self.depth, self.normal, self.pressed = hit, normal, time.perf_counter()
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(iface_("Drag to Pull   |   Wheel: Depth   |   Shift: Hold   |   Esc: Let Go"))
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        result = report_errors(self, self._follow, context, event)
        if "CANCELLED" in result:
            self.cancel(context)
        elif "FINISHED" in result:
            self._done(context)
        return result

    def cancel(self, context: bpy.types.Context) -> None:
        """Also by Blender, when the window closes."""
        self.grabbing.let_go(self.hold)
        self._done(context)

    def _done(self, context: bpy.types.Context) -> None:
        context.workspace.status_text_set(None)
        events.redraw(events.VIEWS)

    def _follow(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if remembered.live.hands is not self.grabbing:
            return {"CANCELLED"}
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.grabbing.let_go_of_all()
            return {"CANCELLED"}
        if event.type in {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}:
            self.mouse = event.mouse_region_x, event.mouse_region_y
            self._lead(context)
        elif event.type in {"WHEELUPMOUSE", "WHEELDOWNMOUSE"}:
            away = region_2d_to_vector_3d(context.region, context.region_data, self.mouse)
            notch = NOTCH * self.grabbing.size
            self.depth = self.depth + (notch if event.type == "WHEELUPMOUSE" else -notch) * away
            self._lead(context)
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self._release(event)
            return {"FINISHED"}
        elif event.type == "TIMER":
            return {"PASS_THROUGH"}  # playback goes on
        return {"RUNNING_MODAL"}

    def _lead(self, context: bpy.types.Context) -> None:
        goal = region_2d_to_location_3d(context.region, context.region_data, self.mouse, self.depth)
        self.grabbing.lead(self.hold, np.array(goal))
        events.redraw(events.VIEWS)

    def _release(self, event: bpy.types.Event) -> None:
        moved = max(abs(now - then) for now, then in zip(self.mouse, self.first, strict=True))
        if moved < TAP_PIXELS and time.perf_counter() - self.pressed < TAP:
            self.grabbing.slap(self.hold, -np.array(self.normal))
        elif not event.shift:
            self.grabbing.let_go(self.hold)


class DYNAMORPH_OT_let_go(Operator):
    """Let go of all hands that hold the soft skin"""

    bl_idname = "dynamorph.let_go"
    bl_label = "Let Go of Soft Skin"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return bool(remembered.live.hands and remembered.live.hands.holds)

    def execute(self, _context: bpy.types.Context) -> set[str]:
        remembered.live.hands.let_go_of_all()
        events.redraw(events.VIEWS)
        return {"FINISHED"}


def _held_at(context: bpy.types.Context, obj: bpy.types.Object, mouse: tuple[int, int]) -> int | None:
    """The number of a hand on `obj` that holds it under the mouse."""
    hands = remembered.live.hands
    for number, hold in hands.holds.items() if hands and hands.is_of(obj) else ():
        if hold.frames is not None:  # a slap
            continue
        shown = location_3d_to_region_2d(context.region, context.region_data, hold.goal.tolist())
        if shown and (shown - Vector(mouse)).length < HAND_PIXELS:
            return number
    return None


def _under(context: bpy.types.Context, obj: bpy.types.Object, mouse: tuple[int, int]) -> tuple[Vector | None, Vector]:
    """The place on the soft skin `obj` under the mouse, and its normal: world space; None where something else is."""
    origin = region_2d_to_origin_3d(context.region, context.region_data, mouse)
    direction = region_2d_to_vector_3d(context.region, context.region_data, mouse)
    found, place, normal, _, other, _ = context.scene.ray_cast(context.evaluated_depsgraph_get(), origin, direction)
    if not found or other.original != obj:
        return None, direction
    return place, normal if normal.dot(direction) < 0.0 else -normal


class GrabTool(WorkSpaceTool):
    """What the tools of both modes have in common."""

    bl_space_type = "VIEW_3D"
    bl_label = "Grab Soft Skin"
    bl_description = (
        "Drag the soft skin while Live is on, and let go.\n"
        "A tap slaps it. The wheel moves the hand in depth; Shift at the release leaves it there; a click on it, or "
        "Esc, lets go"
    )
    bl_icon = "brush.uv_sculpt.grab"

    @staticmethod
    def draw_settings(context: bpy.types.Context, layout: bpy.types.UILayout, _tool: bpy.types.WorkSpaceTool) -> None:
        obj = skin.mesh_in(context)
        if obj is not None and obj.dynamorph.targets:
            draw_record(layout, obj)

    bl_keymap = (
        (DYNAMORPH_OT_let_go.bl_idname, {"type": "ESC", "value": "PRESS"}, None),
        *(
            (DYNAMORPH_OT_grab.bl_idname, {"type": "LEFTMOUSE", "value": "PRESS", "shift": shift}, None)
            for shift in (False, True)
        ),
    )


class DYNAMORPH_TOOL_grab_object(GrabTool):
    bl_context_mode = "OBJECT"
    bl_idname = "dynamorph.grab_object"


class DYNAMORPH_TOOL_grab_pose(GrabTool):
    bl_context_mode = "POSE"
    bl_idname = "dynamorph.grab_pose"


TOOLS = (DYNAMORPH_TOOL_grab_object, DYNAMORPH_TOOL_grab_pose)
_register, _unregister = of_classes((DYNAMORPH_OT_grab, DYNAMORPH_OT_let_go))


def register() -> None:
    _register()
    for tool in TOOLS:
        bpy.utils.register_tool(tool, separator=True)
        registration.later(__name__, partial(bpy.utils.unregister_tool, tool))


def unregister() -> None:
    grabbing.end()
    registration.take_back(__name__)
    _unregister()
