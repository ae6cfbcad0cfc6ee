# SPDX-License-Identifier: GPL-3.0-or-later
"""The section about what stops the skin."""

from __future__ import annotations

import bpy

from ...core.message import Message, listed
from ...run import remembered
from ...scene.motion import colliders
from ..widgets import draw_message, draw_setting


def is_beside(obj: bpy.types.Object) -> bool:
    """Whether something is selected that may be meant to collide with the soft skin `obj`."""
    selected = [other for other in bpy.context.selected_objects if other.type == "MESH" and other != obj]
    if not selected:
        return False
    mine, known = colliders.of_body(obj), colliders.colliders(obj)
    return any(not mine(other) and other not in known for other in selected)


def draw_beside(layout: bpy.types.UILayout, _context: bpy.types.Context, _obj: bpy.types.Object) -> None:
    """In the sidebar, while other meshes are selected."""
    layout.enabled = remembered.work.running is None
    layout.operator("dynamorph.collide", icon="MOD_PHYSICS")


def draw_collision(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    settings = obj.dynamorph.collision
    layout.enabled = remembered.work.running is None
    buttons = layout.column(align=True)
    buttons.operator("dynamorph.collide", icon="MOD_PHYSICS")
    buttons.operator("dynamorph.add_floor", icon="MESH_GRID")
    found = [other.name for other in colliders.colliders(obj)]
    if found:
        draw_message(layout, Message("Collides with: {names}", names=listed(found)), icon="CHECKMARK")
    elif settings.use and not settings.use_self:
        draw_message(layout, "No object has Collision yet", icon="INFO")
    pressed = [other.name for other in colliders.pressed(obj)]
    if pressed:
        text = Message("Presses on: {names}. Bake All bakes them together", names=listed(pressed))
        draw_message(layout, text, icon="MOD_SOFT")
    column = layout.column()
    column.active = settings.use
    draw_setting(column, settings, "collection")
    column.prop(settings, "use_self")
    column.prop(settings, "distance")
    column.prop_search(obj.dynamorph, "excluded_group", obj, "vertex_groups")
    draw_setting(column, settings, "use_friction")
    if settings.use_friction:
        column.prop(settings, "friction")
    layout.prop(context.window_manager.dynamorph, "contact", icon="OVERLAY", toggle=True)
