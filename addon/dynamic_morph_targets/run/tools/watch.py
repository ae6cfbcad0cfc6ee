# SPDX-License-Identifier: GPL-3.0-or-later
"""Handlers that notice edits which outdate models and bakes, and events that concern a running job."""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.app.handlers import persistent

from ...core import states
from ...core.motion import prepared
from ...scene import cuts, events, skin
from ...scene.check import body_checks
from ...scene.motion import colliders, read_poses
from ...scene.read import sampling_scene
from ...scene.references import rig_of
from ...scene.remembered import opened
from ...scene.skin import soft_skins
from ...scene.store import staleness
from ...write import storage
from ...write.authoring import targets
from ...write.bake import influence
from ...write.reconcile import reconcile
from .. import live
from ..bake import batch, expected_error
from ..remembered import work
from ..work import child

PATIENCE = 1.0  # seconds without an edit before the check
GLANCE = 0.3  # seconds after a panel has asked about a body
OWNER = object()  # owner of the subscriptions


@persistent
def _before_load(*_args: object) -> None:
    """load_pre: the job's results would have no place to go, and what is kept in memory belongs to nothing any more."""
    expected_error.cancel()
    batch.stop()
    child.dismiss()
    prepared.forget()
    states.reset()


@persistent
def _before_save(*_args: object) -> None:
    """save_pre."""
    expected_error.store()
    sampling_scene.remove_kept()


@persistent
def _after_undo(*_args: object) -> None:
    """undo_post, redo_post: what a job has read so far belongs to another scene, and the curves have changed."""
    sampling_scene.remove_kept()
    if work.running:
        work.running.undone = True
    events.soon(_look_at_animations, PATIENCE)


def _follow_changes(changed: list, depsgraph: bpy.types.Depsgraph) -> None:
    """Follow renames. A renamed bone updates the Armature, but so does posing."""
    for obj in changed:
        reconcile(obj)
    if any(isinstance(update.id, bpy.types.Armature) for update in depsgraph.updates):
        for obj in soft_skins(bpy.data.objects):
            rig = rig_of(obj)
            poses = [bone.name for target in obj.dynamorph.targets for bone in target.pose]
            if rig and obj.library is None and not set(poses).issubset(rig.data.bones.keys()):
                reconcile(obj)


def changed_objects(depsgraph: bpy.types.Depsgraph) -> list[bpy.types.Object]:
    """Soft skins whose shape keys were edited: sculpted, renamed, moved, or a value was set.

    Posing also updates the Key, but only its geometry: an edit of the Key itself has the shading flag too.
    """
    changed = {u.id.original for u in depsgraph.updates if isinstance(u.id, bpy.types.Key) and u.is_updated_shading}
    if not changed:
        return []
    return [obj for obj in soft_skins(bpy.data.objects) if obj.library is None and obj.data.shape_keys in changed]


@persistent
def _changed(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """depsgraph_update_post."""
    changed = changed_objects(depsgraph)
    _follow_changes(changed, depsgraph)
    for update in depsgraph.updates:
        if isinstance(update.id, bpy.types.Mesh):
            body_checks.outdate(update.id.original)
    if depsgraph.id_type_updated("OBJECT"):
        cuts.outdate()
    if any(obj.dynamorph.model.content_id for obj in changed):
        look_soon()
    if any(_may_animate(update.id) for update in depsgraph.updates):
        events.soon(_look_at_animations, PATIENCE)


def _may_animate(edited: bpy.types.ID) -> bool:
    """Whether an edit may be one of an animation, or of a collider. That of a strip names only its object, as posing
    does.
    """
    if isinstance(edited, bpy.types.Object):
        return edited.animation_data is not None or colliders.is_collider(edited)
    return isinstance(edited, (bpy.types.Action, bpy.types.Key))


def _ask(look: Callable, obj: bpy.types.Object) -> None:
    opened.asked.add((look, obj.session_uid))
    events.soon(_look_at_bodies, GLANCE)


def _look_at_bodies() -> float | None:
    """By a timer: look at the bodies that panels have asked about."""
    if events.render_runs():
        return GLANCE  # seconds from now
    for obj in bpy.context.scene.objects if opened.asked else ():
        for look in (body_checks.look, cuts.look):
            if (look, obj.session_uid) in opened.asked and obj.mode == "OBJECT":
                look(obj)
    opened.asked.clear()
    events.redraw(events.PANELS)
    return None


def look_soon() -> None:
    """Check a while later whether the models still fit their meshes and cages."""
    events.soon(_look_at_meshes, PATIENCE)


def _look_at_meshes() -> float | None:
    if events.render_runs():
        return PATIENCE  # seconds from now
    for obj in skin.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.model.content_id and obj.mode == "OBJECT" and not work.running:
            storage.show_stale(obj)
    events.redraw(events.PANELS)
    return None


def _look_at_animations() -> float | None:
    """By a timer: find out which bakes an edit of an animation has outdated, whatever object and mode is active."""
    if events.render_runs():
        return PATIENCE  # seconds from now
    for obj in skin.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.bake.exists and obj.is_editable:
            staleness.look_at_animation(obj)
            staleness.look_at_colliders(obj)
            staleness.look_for_caches(obj)
            if staleness.outdated(obj):
                read_poses.forget(obj)
            influence.share_strip(obj)
    events.redraw(events.PANELS)
    return None


@persistent
def _frame_changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """frame_change_post: a sculpt belongs to one pose, and the frame may have brought another; so may other add-ons."""
    if scene != bpy.context.scene or live.holds_still(scene):  # reading a rig changes frames too, elsewhere
        return
    for obj in skin.soft_skins(scene.objects):
        if obj.dynamorph.sculpt.shown.name and obj.library is None:
            targets.hide_out_of_pose(obj, depsgraph)
        read_poses.look(obj, scene.frame_float, depsgraph)


@persistent
def _begin(*_args: object) -> None:
    """load_post too: a file that is opened ends all subscriptions, and its caches may be gone. One that Blender saved
    by itself may hold a sampling scene.
    """
    sampling_scene.remove_kept()
    events.soon(_look_at_animations, PATIENCE)
    bpy.msgbus.clear_by_owner(OWNER)
    bpy.msgbus.subscribe_rna(key=(bpy.types.NlaStrip, "influence"), owner=OWNER, args=(), notify=_influence_changed)


@persistent
def _playback_changed(*_args: object) -> None:
    """animation_playback_pre, animation_playback_post: the panels say what Space does."""
    events.redraw(events.PANELS)


def _influence_changed() -> None:
    for obj in skin.soft_skins(bpy.data.objects):
        influence.show_influence(obj)


HANDLERS = {
    "load_pre": _before_load,
    "load_post": _begin,
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "save_pre": _before_save,
    "depsgraph_update_post": _changed,
    "frame_change_post": _frame_changed,
    "animation_playback_pre": _playback_changed,
    "animation_playback_post": _playback_changed,
}


LISTENERS: dict[events.Event, Callable[..., object]] = {
    events.Event.MESH_CHANGED: look_soon,
    events.Event.LOOK_ASKED: _ask,
}


def register() -> None:
    events.add(HANDLERS)
    events.subscribe(LISTENERS)
    _begin()


def unregister() -> None:
    _before_load()
    child.dismiss()
    sampling_scene.remove_kept()
    bpy.msgbus.clear_by_owner(OWNER)
    events.unsubscribe(LISTENERS)
    events.remove(HANDLERS)
    for look in (_look_at_meshes, _look_at_animations, _look_at_bodies, sampling_scene.remove_unused):
        events.forget(look)
