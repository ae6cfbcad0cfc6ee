# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tab and the Physics panel begin and end with: the state, the buttons that stay in place, the messages."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ...core import engine
from ...run import live, remembered
from ...scene import events, skin
from ...scene.check import checks
from ...scene.skinning import Skinning
from ...scene.store import staleness
from ...write.display import comparison
from .. import messages
from ..widgets import draw_problem, is_narrow, progress_text


def draw_top(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """The row with the state, and the buttons for it. Nothing here comes or goes, so no button moves."""
    draw_state(layout, context, obj)
    if not obj.dynamorph.targets:
        layout.operator("dynamorph.add_soft_skin", icon="ADD")
        if skin.is_shown_on(obj):
            layout.operator("dynamorph.delete_bake", icon="TRASH")
        return
    playing = live.is_on(obj)
    buttons = layout.column(align=True)
    row = buttons.row(align=True)
    # Side by side, because a tooltip covers what is below.
    row.operator("dynamorph.live", text="Live", icon="PAUSE" if playing else "PLAY", depress=playing)
    row.operator("dynamorph.bake", text="Bake", icon="REC")
    row = buttons.row(align=True)
    row.operator("dynamorph.build", icon="NONE" if is_narrow() else "MOD_LATTICE")
    row.operator("dynamorph.delete_bake", icon="NONE" if is_narrow() else "TRASH")
    hint = "" if remembered.work.running else next_step(obj)
    hint = iface_(hint)
    if is_narrow():  # one line, so that no button moves
        hint = hint.partition(", ")[0]
    layout.label(text=hint, icon="LIGHT" if hint else "NONE", translate=False)


def draw_state(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """One row: what runs, with its progress, or what the skin shows."""
    row = layout.row(align=True)
    job = remembered.work.running
    if job:
        row.progress(factor=job.fraction, text=progress_text(job))
        row.operator("dynamorph.cancel", text="", icon="X")
        return
    text, icon = state(obj)
    if obj != context.object:  # its armature is active
        text = f"{obj.name}: {text}"
    row.label(text=text, icon=icon, translate=False)


def state(obj: bpy.types.Object) -> tuple[str, str]:
    """What the skin of `obj` shows, in few words, and an icon."""
    settings = obj.dynamorph
    follows, sculpt, baked = settings.follows, settings.sculpt, settings.bake.exists
    if engine.engine_problem() or any(checks.problems(Skinning.of(obj))):
        return iface_("See Messages"), "ERROR"
    if not settings.targets:
        return (follows.name, "LINKED") if follows else (iface_("Not a soft skin yet"), "INFO")
    if sculpt.active:
        return iface_("Sculpting '{name}'").format(name=sculpt.key.name), "SCULPTMODE_HLT"
    if comparison.is_plain(obj):
        return iface_("Plain skinning"), "HIDE_ON"
    if remembered.live.preview and remembered.live.preview.object.session_uid == obj.session_uid:
        return iface_(remembered.live.preview.label), "PLAY"
    if live.is_on(obj):
        if live.problem(obj) or is_beyond_live(obj):
            return iface_("Live out of date"), "ERROR"
        return iface_("Live over the bake" if baked else "Live is on"), "PLAY"
    if baked:
        outdated = staleness.outdated(obj)
        return (iface_("Bake out of date"), "ERROR") if outdated else (iface_("Baked"), "CHECKMARK")
    if not settings.model.content_id:
        return iface_("Not built yet"), "INFO"
    if is_outdated(obj):
        return iface_("Model out of date"), "INFO"
    return iface_("Ready"), "CHECKMARK"


def next_step(obj: bpy.types.Object) -> str:
    """What the artist may do next, in few words, or ''."""
    baked = obj.dynamorph.bake.exists
    if engine.engine_problem() or any(checks.problems(Skinning.of(obj))):
        return ""
    if comparison.is_plain(obj) or obj.dynamorph.sculpt.active:
        return ""
    if live.is_on(obj) and is_beyond_live(obj):
        return "Build updates Live"
    if not live.is_on(obj) and baked and staleness.outdated(obj):
        return "Bake updates it"
    if live.is_on(obj) and not baked:
        return "Grab it, or Space stops it" if events.is_playing() else "Space plays, Bake keeps it"
    if live.is_on(obj) or baked:
        return "Space stops it" if events.is_playing() else "Space plays it"
    if is_outdated(obj) or not obj.dynamorph.model.content_id:
        return "Live builds it, Bake too"
    return "Live shows it, Bake keeps it"


def is_outdated(obj: bpy.types.Object) -> bool:
    """Whether the model of `obj` must be built again."""
    model = obj.dynamorph.model
    return bool(model.content_id and (staleness.model_age(obj) or checks.outgrown(obj)))


def is_beyond_live(obj: bpy.types.Object) -> bool:
    """Whether the same is so for Live, which plays a Firmness map without that."""
    return bool(obj.dynamorph.model.content_id and (staleness.live_age(obj) or checks.outgrown(obj)))


# Messages ------------------------------------------------------------------------------------------------------------


def draw_messages(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """All that is wrong or worth knowing. It is the last section, so that nothing moves when one comes or goes."""
    found = list(messages.messages(obj))
    for problem, icon in found:
        draw_problem(layout, problem, icon)
    if not found:
        layout.label(text="Nothing needs attention", icon="CHECKMARK")
