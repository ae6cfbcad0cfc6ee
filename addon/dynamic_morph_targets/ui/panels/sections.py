# SPDX-License-Identifier: GPL-3.0-or-later
"""Where everything is drawn: the tab in the sidebar, the Physics tab and below Shape Keys, as a table of sections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Panel

from ...core.time_left import clock
from ...run import remembered
from ...scene import skin
from ...scene.registration import of_classes
from ..operators.presets import DYNAMORPH_PT_material_presets, DYNAMORPH_PT_setup_presets, PresetList
from ..widgets import draw_message, is_narrow, progress_text
from .advanced import DYNAMORPH_UL_modes, draw_advanced, draw_cage, draw_detail, draw_modes, draw_solver, has_modes
from .attachments import DYNAMORPH_UL_attachments, attachments_title, draw_attachments
from .bake import draw_bake, draw_details, draw_export, draw_result, draw_setup, is_baked
from .collision import draw_beside, draw_collision, is_beside
from .compare import draw_compare, draw_shake_test
from .feel import draw_feel, draw_firmness, draw_material, draw_max_distance
from .grips import DYNAMORPH_UL_grips, draw_grips, grips_title
from .status import draw_messages, draw_top
from .targets import (
    DYNAMORPH_MT_targets,
    DYNAMORPH_UL_targets,
    bones_title,
    draw_bones,
    draw_key,
    draw_target_weights,
    draw_targets,
    has_bones,
    has_weights,
)

SIDEBAR = {"bl_space_type": "VIEW_3D", "bl_region_type": "UI", "bl_category": "Dynamorph"}
PHYSICS = {"bl_space_type": "PROPERTIES", "bl_region_type": "WINDOW", "bl_context": "physics"}


class SoftSkinPanel:
    """Mixin: draws one section for the mesh of the context."""

    section: Any  # a Section
    layout: Any  # of bpy.types.Panel

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = skin.mesh_in(context)
        is_soft = obj is not None and len(obj.dynamorph.targets) > 0
        return cls.section.needed(obj) if is_soft else obj is not None and cls.section.before

    def draw_header(self, context: bpy.types.Context) -> None:
        if self.section.switch:
            self.layout.prop(*self.section.switch(skin.mesh_in(context)), text="")
        if self.section.title:
            self.layout.label(text=self.section.title(skin.mesh_in(context)), translate=False)

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        if self.section.presets:
            self.section.presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = not is_narrow()
        self.layout.use_property_decorate = False
        self.section.draw(self.layout, context, skin.mesh_in(context))


@dataclass(frozen=True)
class Section:
    """A panel inside another one. Those of one parent stand in the order of the table."""

    name: str  # of the class, after DYNAMORPH_PT_
    label: str  # "" where a title says more
    parent: str
    draw: Callable  # (layout, context, object)
    closed: bool = True  # at first
    needed: Callable = lambda _obj: True  # (soft skin): whether it is there at all
    before: bool = False  # whether a mesh has it before it is a soft skin
    title: Callable | None = None  # (object)
    switch: Callable | None = None  # (object): the owner and the name of a property that turns it on, in its header
    presets: type[PresetList] | None = None  # in its header

    def panel(self, place: dict) -> type[Panel]:
        described = {
            "bl_label": self.label,
            "bl_parent_id": f"DYNAMORPH_PT_{self.parent}",
            "bl_options": {"DEFAULT_CLOSED"} if self.closed else set(),
            "section": self,
        }
        return type(f"DYNAMORPH_PT_{self.name}", (SoftSkinPanel, Panel), place | described)


# While posing and sculpting.
SIDEBAR_SECTIONS = (
    Section("feel", "Feel", "sidebar", draw_feel, closed=False),
    Section("material", "Material", "feel", draw_material, presets=DYNAMORPH_PT_material_presets),
    Section("firmness", "Firmness", "sidebar", draw_firmness),
    Section("max_distance", "Max Distance", "sidebar", draw_max_distance),
    Section("targets", "Targets", "sidebar", draw_targets),
    Section("bones", "", "targets", draw_bones, needed=has_bones, title=bones_title),
    Section("target_weights", "Target Weights", "sidebar", draw_target_weights, needed=has_weights),
    Section("shake_test", "Shake Test", "sidebar", draw_shake_test),
    Section("compare", "Compare", "sidebar", draw_compare),
    Section("result", "Result", "sidebar", draw_result, closed=False, needed=is_baked),
    Section("details", "Details", "result", draw_details),
    Section("beside", "Selected Meshes", "sidebar", draw_beside, closed=False, needed=is_beside),
    Section("messages", "Messages", "sidebar", draw_messages, closed=False, before=True),
)
# Once.
PHYSICS_SECTIONS = (
    Section("attachments", "", "physics", draw_attachments, title=attachments_title),
    Section("grips", "", "physics", draw_grips, title=grips_title),
    Section("collision", "Collision", "physics", draw_collision, switch=lambda obj: (obj.dynamorph.collision, "use")),
    Section("bake", "Bake Settings", "physics", draw_bake),
    Section("export", "Export", "physics", draw_export),
    Section("setup", "Setup", "physics", draw_setup, presets=DYNAMORPH_PT_setup_presets),
    Section("advanced", "Advanced", "physics", draw_advanced),
    Section("cage", "Cage", "advanced", draw_cage),
    Section("detail", "Detail", "advanced", draw_detail),
    Section("modes", "Modes", "advanced", draw_modes, needed=has_modes),
    Section("solver", "Solver", "advanced", draw_solver),
    Section("physics_messages", "Messages", "physics", draw_messages, closed=False),
)


class DYNAMORPH_PT_sidebar(Panel):
    """The tab. It is there for every object, because it says what to select."""

    bl_label = "Dynamorph"
    bl_space_type, bl_region_type, bl_category = SIDEBAR.values()

    def draw(self, context: bpy.types.Context) -> None:
        obj = skin.mesh_in(context)
        if obj:
            draw_top(self.layout, context, obj)
            return
        names = [each.name for each in skin.soft_skins(skin.shown_objects(context.view_layer))]
        text = "Select a character's mesh or its armature"
        if names:
            text = iface_("Select '{name}' or its armature").format(name=names[0])
        draw_message(self.layout, text, icon="INFO")


class DYNAMORPH_PT_physics(Panel):
    bl_label = "Soft Skin"
    bl_space_type, bl_region_type, bl_context = PHYSICS.values()

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = skin.mesh_in(context)
        return obj is not None and len(obj.dynamorph.targets) > 0

    def draw(self, context: bpy.types.Context) -> None:
        draw_top(self.layout, context, skin.mesh_in(context))


class DYNAMORPH_PT_object_data(SoftSkinPanel, Panel):
    bl_label = "Dynamic Morph Target"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "data"
    bl_parent_id = "DATA_PT_shape_keys"
    bl_options = {"DEFAULT_CLOSED"}
    section = Section("object_data", bl_label, "", draw_key)


def draw_add(panel: bpy.types.Panel, context: bpy.types.Context) -> None:
    """Soft Skin among Blender's own buttons that add and remove physics."""
    obj = skin.mesh_in(context)
    if obj is None:
        return
    if obj.dynamorph.targets:
        panel.layout.operator("dynamorph.remove_soft_skin", text="Soft Skin", icon="X")
    else:
        panel.layout.operator("dynamorph.add_soft_skin", text="Soft Skin", icon="MOD_SOFT")


def draw_status(header: bpy.types.Header, _context: bpy.types.Context) -> None:
    """What runs, at the left of the status bar of every window, wherever it was started."""
    work = remembered.work.running
    if work:
        text = iface_("{progress}    Esc: cancel").format(progress=progress_text(work))
    elif remembered.live.preview:
        seconds = remembered.live.preview.seconds_left
        text = iface_("{name}    Esc: stop" if seconds is None else "{name}  {time} left    Esc: stop")
        text = text.format(name=iface_(remembered.live.preview.label, "Operator"), time=clock(seconds or 0.0))
    else:
        return
    header.layout.label(text=text, translate=False)


CLASSES = (
    DYNAMORPH_UL_targets,
    DYNAMORPH_UL_attachments,
    DYNAMORPH_UL_grips,
    DYNAMORPH_UL_modes,
    DYNAMORPH_MT_targets,
    DYNAMORPH_PT_sidebar,
    *(section.panel(SIDEBAR) for section in SIDEBAR_SECTIONS),
    DYNAMORPH_PT_physics,
    *(section.panel(PHYSICS) for section in PHYSICS_SECTIONS),
    DYNAMORPH_PT_object_data,
)
_register, _unregister = of_classes(CLASSES)


def register() -> None:
    _register()
    bpy.types.STATUSBAR_HT_header.prepend(draw_status)
    bpy.types.PHYSICS_PT_add.append(draw_add)


def unregister() -> None:
    bpy.types.PHYSICS_PT_add.remove(draw_add)
    bpy.types.STATUSBAR_HT_header.remove(draw_status)
    _unregister()
