# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that paint vertex groups: softness, stiffness, and what is held."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.props import EnumProperty
from bpy.types import Operator

from ..core import engine
from ..core.errors import SceneError
from ..run import heat
from ..scene import mesh_data, skin
from ..scene.registration import of_classes
from ..write import bake, storage
from ..write.fixes import owned
from .base import SoftSkinOperator

STEPS = 1000  # levels of softness that a vertex group distinguishes


@dataclass(frozen=True)
class Painted:
    """A map that the artist paints. name: of a new vertex group; label: of the map; field: of DynamorphSettings; start:
    weight of a new group everywhere.
    """

    name: str
    label: str
    field: str
    start: float


PAINTED = {
    "SOFT": Painted("Soft", "Softness Map", "soft_group", 1.0),
    "STIFFNESS": Painted("Stiffness", "Stiffness Map", "stiffness_group", 0.0),
}


def is_painting(obj, which: str) -> bool:
    """Whether this vertex group of `obj` is the one being painted."""
    active = obj.vertex_groups.active
    return (
        obj.mode == "WEIGHT_PAINT"
        and active is not None
        and active.name == getattr(obj.dynamorph, PAINTED[which].field)
    )


class DYNAMORPH_OT_paint_group(SoftSkinOperator, Operator):
    """Paint the map in Weight Paint, with a new vertex group if there is none. Press again to leave Weight Paint"""

    bl_idname = "dynamorph.paint_group"
    bl_label = "Paint Soft Skin Map"

    which: EnumProperty(
        name="Map",
        description="The map to paint",
        items=[
            (key, painted.label, f"Paint the {painted.label}", i) for i, (key, painted) in enumerate(PAINTED.items())
        ],
    )

    def apply(self, obj):
        if is_painting(obj, self.which):
            self._leave(obj)
        else:
            self._enter(obj)

    def _enter(self, obj):
        if not obj.visible_get():
            raise SceneError("'{name}' is hidden: show it to paint on it", name=obj.name)
        owned(obj.data)
        active, display = bpy.context.object, bpy.context.window_manager.dynamorph
        if obj.mode != "WEIGHT_PAINT":
            display.posed = active.name if active.mode == "POSE" else ""
            bpy.context.view_layer.objects.active = obj
            obj.select_set(True)
            bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)  # remembers the mesh's own mode
        settings, field = obj.dynamorph, PAINTED[self.which].field
        name = getattr(settings, field) or PAINTED[self.which].name
        known = name in obj.vertex_groups
        if not known:
            _write_groups(name, self._start(obj))
        weights, group = mesh_data.group_weights(obj, [name])[:, 0], obj.vertex_groups[name]
        if getattr(settings, field) != group.name:
            setattr(settings, field, group.name)
        obj.vertex_groups.active_index = group.index
        if len(weights) and (not known or np.ptp(weights) < 1e-3):
            _set_brush(weights)

    def _start(self, obj) -> dict[int, np.ndarray]:
        """Weights (V,) of a new group, by session_uid of each mesh that gets one. A new softness map starts from the
        hold by thickness: 1 everywhere would make thin parts soft.
        """
        with suppress(*engine.expected_errors()):
            if self.which == "SOFT" and obj.dynamorph.model.hold == "THICKNESS":
                return _softness_of_hold(obj)
        return {obj.session_uid: np.full(len(obj.data.vertices), PAINTED[self.which].start)}

    def _leave(self, obj):
        display, objects = bpy.context.window_manager.dynamorph, bpy.context.view_layer.objects
        bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)
        posed, display.posed = objects.get(display.posed), ""
        if posed:
            objects.active = posed
            bpy.ops.object.mode_set(mode="POSE")
        if obj.dynamorph.model.content_id:
            storage.show_stale(obj)


def _softness_of_hold(obj) -> dict[int, np.ndarray]:
    """Softness (V,) in the model of the vertices of each mesh in its cage, by session_uid. Raises SceneError."""
    return {uid: 1.0 - held for uid, held in heat.holds(obj).items()}


def _write_groups(name: str, weights: dict[int, np.ndarray]):
    """`_write_group` for each mesh, by session_uid."""
    for uid, values in weights.items():
        _write_group(skin.find(uid), name, values)


def _write_group(obj, name: str, weights: np.ndarray):
    """Write weights (V,), rounded to a thousandth, to the vertex group of this name; it is created if there is none."""
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    steps = np.round(weights * STEPS).astype(int)
    for step in np.unique(steps):
        group.add(np.flatnonzero(steps == step).tolist(), step / STEPS, "REPLACE")


def _set_brush(weights: np.ndarray):
    """Make the first stroke visible: the brush paints 0 if most of the weights (V,) are over a half, otherwise 1."""
    tools = bpy.context.scene.tool_settings
    shared = getattr(tools.weight_paint, "unified_paint_settings", None) or tools.unified_paint_settings
    shared.weight = 0.0 if np.median(weights) > 0.5 else 1.0
    brush = tools.weight_paint.brush
    if brush and brush.is_editable:
        brush.weight = shared.weight


class DYNAMORPH_OT_hold_to_group(SoftSkinOperator, Operator):
    """Fill the softness map of all meshes in the cage with the softness that the built model gives each vertex"""

    bl_idname = "dynamorph.hold_to_group"
    bl_label = "Softness from Hold"

    @classmethod
    def disabled_reason(cls, context):
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not skin.mesh_in(context).dynamorph.model.content_id:
            return "Press Build Model first: it computes the hold"
        return disabled_reason

    def apply(self, obj):
        bake.check_not_edited(obj)
        owned(obj.data)
        name = obj.dynamorph.soft_group or PAINTED["SOFT"].name
        _write_groups(name, _softness_of_hold(obj))
        obj.dynamorph.soft_group = name
        obj.vertex_groups.active_index = obj.vertex_groups[name].index
        storage.show_stale(obj)


CLASSES = (
    DYNAMORPH_OT_paint_group,
    DYNAMORPH_OT_hold_to_group,
)
register, unregister = of_classes(CLASSES)
