# SPDX-License-Identifier: GPL-3.0-or-later
"""Which settings the sections of the interface show."""

import types

import bpy
from bl_ext.user_default.dynamic_morph_targets.ui.panels import sections
from layout import SIDEBAR, Layout, is_there


def settings_shown(obj) -> dict[str, list[str]]:
    """The properties that each section draws for a soft skin, as class.name, without those of the viewport alone."""
    found = {}
    context = types.SimpleNamespace(
        object=obj, view_layer=bpy.context.view_layer, scene=bpy.context.scene,
        window_manager=bpy.context.window_manager, **SIDEBAR,
    )  # fmt: skip
    for section in (*sections.SIDEBAR_SECTIONS, *sections.PHYSICS_SECTIONS):
        if is_there(getattr(bpy.types, f"DYNAMORPH_PT_{section.name}"), context):
            layout = Layout([])
            if section.switch:
                layout.prop(*section.switch(obj))
            section.draw(layout, context, obj)
            drawn = [each for each in layout.controls if each.startswith("Dynamorph") and "." in each]
            found[section.name] = [each for each in dict.fromkeys(drawn) if not each.startswith("DynamorphDisplay")]
    return {name: shown for name, shown in found.items() if shown}
