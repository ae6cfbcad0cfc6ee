# SPDX-License-Identifier: GPL-3.0-or-later
"""Live: the soft skin is simulated while Blender plays, by the same Player as a bake, and shown by one shape key.

A session is kept in this module by its object's session id. It never holds a reference into Blender, because undo and
loading move everything there; it asks for what it needs again at each frame.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import bpy
from bpy.app.handlers import persistent

from ..core import engine, errors, logger, states
from ..core.message import Message, joined
from ..core.motion import contact
from ..core.motion.coupling import refusal
from ..core.settings import SimulationSettings
from ..scene import events, references
from ..scene.motion import colliders
from ..scene.remembered import opened
from ..scene.skin import shown_attachments, soft_skins
from ..scene.store import model_store, staleness
from ..write import reconcile
from ..write.bake import muting
from ..write.display import live_key
from . import remembered
from .playing import live_surface
from .playing.live_group import LiveGroup
from .playing.session import Session, painted, way_to_skin
from .playing.tissue import simulation_settings

STROKE = 0.2  # seconds without an edit after which a stroke of paint shows
SCRUBBED = 0.02  # seconds between two checks whether the artist still drags through the timeline


# On, off, and the present frame ------------------------------------------------------------------------------------


def is_on(obj: bpy.types.Object) -> bool:
    return bool(obj.dynamorph.live.key.name) and obj.session_uid not in remembered.live.suspended


def disabled_reason(obj: bpy.types.Object) -> str:
    """Why the soft skin of an object cannot be shown, or ''. Reasons that take longer to find are raised by
    `turn_on`.
    """
    if obj.session_uid in opened.drafts:
        return ""
    age = staleness.model_age(obj) if obj.dynamorph.model.content_id else ["not built yet"]
    return Message("Press Build Model first: {reasons}", reasons=joined("; ", age)) if age else ""


def must_prepare(obj: bpy.types.Object) -> bool:
    """Whether Live would hold the window while it makes what a job can make beside it: how the skin gives way where
    something presses it. There must be no `disabled_reason`.
    """
    if obj.session_uid in opened.drafts or not obj.dynamorph.collision.use:
        return False
    try:
        model = model_store.load_model(obj)
    except errors.ModelFileError:  # `turn_on` says so
        return False
    shown = model.with_settings(replace(model.settings, solver=obj.dynamorph.model.solver))
    return model.settings.method != "STATIC" and not contact.has_kept(shown, obj.dynamorph.collision.use_self)


def turn_on(obj: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Add the live key and show the present frame. Raises what prevents it from playing, before anything is changed.

    There must be no `disabled_reason`.
    """
    session = Session(obj, scene)
    session.tissue.add_keys(obj)
    remembered.live.sessions[obj.session_uid], remembered.live.any_live = session, True
    remembered.live.problems.pop(obj.session_uid, None)
    follow(obj, scene)
    events.redraw(events.PANELS)


def turn_off(obj: bpy.types.Object) -> None:
    """Raises WriteError."""
    session = remembered.live.sessions.pop(obj.session_uid, None)
    if session:
        session.rig.close()
    remembered.live.problems.pop(obj.session_uid, None)
    live_key.remove(obj)
    events.redraw(events.PANELS)


def refresh(obj: bpy.types.Object) -> None:
    """Show changed settings of an object at once, if it is live."""
    if is_on(obj):
        follow(obj, bpy.context.scene, arrives=False)


def problem(obj: bpy.types.Object) -> str:
    """Why a live object does not play, or ''."""
    text, model = remembered.live.problems.get(obj.session_uid, ("", None))
    return text if text and model == _stated(obj) else ""


def played_texts(obj: bpy.types.Object) -> list[Message]:
    """What went wrong in the frames that a live object has played: with colliders, and by what playback dropped."""
    session = remembered.live.sessions.get(obj.session_uid)
    found = session.touched() if session else None
    return [*(found.texts if found else []), *(session.dropped if session else [])]


def _stated(obj: bpy.types.Object) -> tuple[str, ...]:
    return obj.dynamorph.model.content_id, *staleness.model_age(obj)


def follow(
    obj: bpy.types.Object,
    scene: bpy.types.Scene,
    arrives: bool = True,
    depsgraph: bpy.types.Depsgraph | None = None,
) -> None:
    """Show the state of the soft skin at the scene's time. depsgraph: that Blender evaluates next. Problems are
    recorded, see `problem`.
    """
    if problem(obj) or is_away(obj):
        return
    try:
        settings = simulation_settings(obj, scene)
        session = _session(obj, scene)
        group = _group(obj, scene)
        for each in group.sessions:
            each.join(group)
        if live_key.find(obj, session.tissue.skin.written) is None:
            turn_off(obj)
            return
        if obj.data.library and live_key.is_hidden(obj):  # it was linked since: as it was saved
            live_key.hide(obj, False)
        session.tissue.show(session.values(obj, settings, scene.frame_float, arrives), depsgraph)
    except engine.expected_errors() as error:
        stop(obj, errors.sentence(error))
    except Exception as bug:  # raised in a handler, it would be printed at every frame
        logger.log_once(bug)
        stop(obj, logger.bug_sentence(bug))


def _session(obj: bpy.types.Object, scene: bpy.types.Scene) -> Session:
    """That of a live object, a new one where it does not fit any more. Raises what prevents it from playing."""
    before = remembered.live.sessions.get(obj.session_uid)
    if before and before.fits(obj, simulation_settings(obj, scene)):
        return before
    session = remembered.live.sessions[obj.session_uid] = Session(obj, scene)
    if before:
        session.take_over(before)
    muting.show_target(obj, "")  # a target of another build, which Live now shows
    return session


def _group(obj: bpy.types.Object, scene: bpy.types.Scene) -> LiveGroup:
    """The sessions of a live object, and of those that it presses on, and so on."""
    found, objects, waiting = {obj.name: _session(obj, scene)}, {obj.name: obj}, [obj]
    while waiting:
        one = waiting.pop()
        for other in colliders.pressed(one):
            if other.name in found or not is_on(other) or problem(other) or is_away(other):
                continue
            with suppress(*engine.expected_errors()):  # which it is told itself
                session = _session(other, scene)
                if not refusal(_way(found[one.name]), _way(session)):
                    found[other.name], objects[other.name] = session, other
                    waiting.append(other)
    names = sorted(found)
    worn = colliders.garments([objects[name] for name in names])
    group = LiveGroup([found[name] for name in names], names, [(one.name, body.name) for one, body in worn])
    known = found[names[0]].group
    return known if known.is_as(group) else group


def _way(session: Session) -> tuple[str, SimulationSettings]:
    return session.tissue.model.settings.solver, session.tissue.player.settings


def is_away(obj: bpy.types.Object) -> bool:
    """Whether the artist edits the mesh or the rig, which Live then leaves alone."""
    rig = references.rig_of(obj)
    return obj.mode in live_surface.AWAY or bool(rig and rig.mode == "EDIT")


def stop(obj: bpy.types.Object, why: str) -> None:
    """Stop Live of `obj` at what it shows now; the panel says why."""
    remembered.live.sessions.pop(obj.session_uid, None)
    remembered.live.problems[obj.session_uid] = why, _stated(obj)
    events.redraw(events.PANELS)


def holds_still(scene: bpy.types.Scene) -> bool:
    """Whether a render in the window reads what we would write."""
    rendering = not bpy.app.background and bpy.app.is_job_running("RENDER")
    return rendering and not scene.render.use_lock_interface


def stood_still(obj: bpy.types.Object) -> bool:
    """Whether Live did not move the skin in the last animation that was rendered."""
    return obj.session_uid in remembered.live.frozen


# Handlers ----------------------------------------------------------------------------------------------------------


@persistent
def _frame_changed(scene: bpy.types.Scene, _depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """frame_change_pre: writing before Blender evaluates the frame does not make it evaluate twice.

    The rig is not read from there but separately, in a scene of its own, which changes frames too.
    """
    if remembered.live.asleep:
        _wake()
    if remembered.live.any_live is None:
        remembered.live.any_live = any(is_on(obj) for obj in soft_skins(bpy.data.objects))
    if not remembered.live.any_live or scene != bpy.context.scene:
        return
    live = [obj for obj in soft_skins(scene.objects) if is_on(obj)]
    if holds_still(scene):
        remembered.live.frozen.update(obj.session_uid for obj in live)
        return
    others = remembered.live.sessions.keys() - {obj.session_uid for obj in live} - remembered.live.suspended
    if others:  # not those of another scene, which may play in another window
        others -= {obj.session_uid for obj in soft_skins(bpy.data.objects) if is_on(obj)}
    for gone in others:
        del remembered.live.sessions[gone]
    scrubbing = events.is_scrubbing()
    for obj in live:
        session = remembered.live.sessions.get(obj.session_uid)
        if scrubbing and not (session and session.knows(scene.frame_float)):
            events.soon(_show_present, SCRUBBED)
        else:
            follow(obj, scene, not scrubbing, live_surface.evaluated_next())


def _show_present() -> float | None:
    """By a timer: show the frame that was scrubbed to, when the mouse is up, or that an undo has brought back."""
    if events.is_scrubbing():
        return SCRUBBED  # seconds from now
    for obj in soft_skins(bpy.context.scene.objects):
        refresh(obj)
    return None


@persistent
def _render_begins(*_args: object) -> None:
    """render_init. Here it is too late to lock the interface; what stands still is told afterward."""
    remembered.live.frozen.clear()


@persistent
def _edited(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """depsgraph_update_post, which changing the frame does not call."""
    if depsgraph.id_type_updated("OBJECT"):
        remembered.live.any_live = None  # one may have been added
    updates = list(depsgraph.updates)
    if remembered.live.ahead and any(isinstance(update.id, bpy.types.Key) for update in updates):
        live_surface.catch_up()
    if not (remembered.live.sessions or remembered.live.problems) or scene != bpy.context.scene:
        return
    if updates:
        remembered.live.problems.clear()  # try again
    moved = any(_moves(update) for update in updates)
    reskinned = any(_may_reskin(update) for update in updates)
    here = soft_skins(scene.objects)
    elsewhere = remembered.live.sessions.keys() - {obj.session_uid for obj in here} - remembered.live.suspended
    for other in elsewhere if moved or reskinned else ():  # it may depend on that, and begins again
        del remembered.live.sessions[other]
    for obj in [obj for obj in here if obj.session_uid in remembered.live.sessions]:
        session = remembered.live.sessions[obj.session_uid]
        if moved or (obj.dynamorph.collision.use and any(_reshapes(update, obj) for update in updates)):
            session.rig_changed()
        if not events.is_playing() and session.are_channels_elsewhere(obj):
            events.soon(_show_present, 0.0)
        if reskinned:
            events.soon(_after_stroke, STROKE)
        if reskinned and way_to_skin(obj) != session.skinning:
            del remembered.live.sessions[obj.session_uid]
        if is_on(obj) and live_key.find(obj, session.tissue.skin.written) is None:
            turn_off(obj)
        elif is_on(obj):
            reconcile.note_others(obj.data.shape_keys.key_blocks, obj.dynamorph.live)


def _after_stroke() -> None:
    """By a timer: show what was painted, or mirrored or filled, since the sessions began."""
    for obj in soft_skins(bpy.context.scene.objects):
        session = remembered.live.sessions.get(obj.session_uid)
        if session and painted(obj) != session.painted:
            del remembered.live.sessions[obj.session_uid]
            refresh(obj)


def _may_reskin(update: bpy.types.DepsgraphUpdate) -> bool:
    edited = update.id
    is_mesh = isinstance(edited, bpy.types.Object) and edited.type == "MESH" and update.is_updated_geometry
    return is_mesh or isinstance(edited, bpy.types.Armature)


def _moves(update: bpy.types.DepsgraphUpdate) -> bool:
    """Whether an edit may have changed how rigs move. Posing is one, and so is any object: a rig may follow it."""
    edited = update.id
    if isinstance(edited, bpy.types.Object):
        return update.is_updated_transform or (update.is_updated_geometry and edited.type != "MESH")
    return isinstance(edited, bpy.types.Action)


def _reshapes(update: bpy.types.DepsgraphUpdate, obj: bpy.types.Object) -> bool:
    """Whether an edit may have changed the shape of something that stops the soft skin `obj`."""
    edited = update.id
    is_other = isinstance(edited, bpy.types.Object) and edited.session_uid != obj.session_uid
    return is_other and update.is_updated_geometry and colliders.is_collider(edited)


@persistent
def _undone(*_args: object) -> None:
    """undo_post, redo_post. The simulated frames stay valid; the motion of the rig may not."""
    remembered.live.any_live = None
    remembered.live.problems.clear()
    for session in remembered.live.sessions.values():
        session.rig_changed()
    events.soon(_show_present, 0.0)  # the key may be that of an earlier frame


@persistent
def _loaded(*_args: object) -> None:
    """load_post."""
    _wake()


@persistent
def _before_save(*_args: object) -> None:
    """save_pre: record the shapes of the live keys, which identify them after a rename, and hide the keys.

    In a file that is opened without the extension, the skin would stay frozen at the last frame.
    """
    live_surface.catch_up()
    skins = soft_skins(bpy.data.objects)
    for obj in [each for skin in skins for each in (skin, *shown_attachments(skin))]:
        block = live_key.find(obj)
        if block is not None and obj.library is None:
            blocks = obj.data.shape_keys.key_blocks
            obj.dynamorph.live.key.refer_to(blocks, blocks.find(block.name))
    remembered.live.hidden[:] = _hide()


@persistent
def _after_save(*_args: object) -> None:
    """save_post, save_post_fail: show what was hidden for the file."""
    for obj in soft_skins(bpy.data.objects):
        if obj.session_uid in remembered.live.hidden:
            live_key.hide(obj, False)
    remembered.live.hidden.clear()


def _hide() -> list[int]:
    """Hide Live wherever it shows. Returns the session ids of those objects."""
    # While add-ons are enabled Blender shows them no data: then there is nothing of ours to hide either.
    skins = soft_skins(getattr(bpy.data, "objects", ()))
    shown = [
        obj for obj in skins if obj.library is None and obj.dynamorph.live.key.name and not live_key.is_hidden(obj)
    ]
    for obj in shown:
        live_key.hide(obj, True)
    return [obj.session_uid for obj in shown]


def _wake() -> None:
    """Show Live again where it was hidden when its file was saved, or when the add-on was disabled."""
    remembered.live.asleep = False
    for obj in soft_skins(bpy.data.objects):
        if obj.dynamorph.live.key.name and live_key.is_hidden(obj):
            live_key.hide(obj, False)


def _wake_late() -> None:
    """By a timer, for when the add-on is enabled: then Blender does not show it its data yet."""
    if remembered.live.asleep:
        _wake()


HANDLERS = live_surface.HANDLERS | {
    "frame_change_pre": _frame_changed,
    "render_init": _render_begins,
    "depsgraph_update_post": _edited,
    "undo_post": _undone,
    "redo_post": _undone,
    "load_post": _loaded,
    "save_pre": _before_save,
    "save_post": _after_save,
    "save_post_fail": _after_save,
}


LISTENERS = {events.Event.SHOWN_CHANGED: refresh}


def register() -> None:
    events.add(HANDLERS)
    events.subscribe(LISTENERS)
    events.soon(_wake_late, 0.0)


def unregister() -> None:
    events.unsubscribe(LISTENERS)
    events.remove(HANDLERS)
    live_surface.catch_up()
    for look in (_show_present, _after_stroke, _wake_late):
        events.forget(look)
    states.reset(remembered.live)
    _hide()
