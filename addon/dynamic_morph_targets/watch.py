# SPDX-License-Identifier: GPL-3.0-or-later
"""Handlers that notice what ages models and bakes, and what a running job must hear of."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import changes, events, extract, jobs, live, properties, sinks, targets

PATIENCE = 1.0  # seconds without an edit, after which it is looked at
OWNER = object()  # of the subscriptions


@persistent
def _before_load(*_args):
    """load_pre: the job's results would have nowhere to go."""
    jobs.stop()


@persistent
def _after_undo(*_args):
    """undo_post, redo_post: what a job has read so far is of another scene, and curves are others again."""
    if jobs.running:
        jobs.running.undone = True
    events.soon(_look_at_animations, PATIENCE)


@persistent
def _check_changed(_scene, depsgraph):
    """depsgraph_update_post."""
    if any(obj.dynamorph.model.content_id for obj in properties.changed_objects(depsgraph)):
        look_soon()
    if any(isinstance(update.id, (bpy.types.Action, bpy.types.Key)) for update in depsgraph.updates):
        events.soon(_look_at_animations, PATIENCE)


def look_soon():
    """Look a while later whether the models still fit their meshes and cages."""
    events.soon(_look_at_meshes, PATIENCE)


def _look_at_meshes():
    if extract.render_runs():
        return PATIENCE  # seconds from now
    for obj in properties.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.model.content_id and obj.mode == "OBJECT" and not jobs.running:
            jobs.show_stale(obj)
    return None


def _look_at_animations():
    for obj in properties.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.bake.exists and obj.is_editable:
            changes.look_at_animation(obj)
            sinks.share_strip(obj)


@persistent
def _leave_pose(scene, depsgraph):
    """frame_change_post: a sculpt belongs to one pose, and the frame may have brought another."""
    if scene != bpy.context.scene or live.holds_still(scene):  # reading a rig changes frames too, elsewhere
        return
    for obj in properties.soft_skins(scene.objects):
        if obj.dynamorph.sculpt.shown.name and obj.library is None:
            targets.hide_out_of_pose(obj, depsgraph)


@persistent
def _watch_influence(*_args):
    """load_post too: a file that is opened ends all subscriptions."""
    bpy.msgbus.clear_by_owner(OWNER)
    bpy.msgbus.subscribe_rna(key=(bpy.types.NlaStrip, "influence"), owner=OWNER, args=(), notify=_influence_changed)


def _influence_changed():
    for obj in properties.soft_skins(bpy.data.objects):
        sinks.show_influence(obj)


HANDLERS = {
    "load_pre": _before_load,
    "load_post": _watch_influence,
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "depsgraph_update_post": _check_changed,
    "frame_change_post": _leave_pose,
}


def register():
    events.add(HANDLERS)
    _watch_influence()


def unregister():
    jobs.stop()
    bpy.msgbus.clear_by_owner(OWNER)
    events.remove(HANDLERS)
    for look in (_look_at_meshes, _look_at_animations):
        events.forget(look)
