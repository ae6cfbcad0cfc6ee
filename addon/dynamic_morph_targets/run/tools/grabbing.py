# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's hand in a soft skin that is live: it drags the skin, lets go, slaps it, or holds it where it is.

While Blender plays, the hands act in what is simulated. While it stands, a copy of the motion goes on, which the next
frame discards. Nothing of the file is changed but what Live shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core import engine, errors, logger
from ...core.errors import SceneError
from ...core.message import Message
from ...core.model.model import Model
from ...core.motion.grab import FIRM, RADIUS, Grab, pinch
from ...core.motion.player import Frame, Player, changed
from ...scene import events, skin
from ...write.authoring import grips
from .. import live, remembered
from ..playing.session import Session

FARTHEST = 0.25  # of the size: that a hand leads the skin away from where it took hold
HELD = 0.5  # of a node, from 0 to 1: where the bones have more of it, it does not move by itself
SLAP, SLAP_SECONDS = 0.06, 2 / 24  # of the size: how far a slap leads the skin in, and for how long
CALM, CALM_SECONDS = 1e-5, 1 / 24  # of the size: what moves less in so long stands still
LONGEST = 8.0  # seconds that a copy goes on at most


@dataclass(frozen=True)
class Hold:
    """A hand on the skin. offsets (K, 3): of its vertices from the place where it took hold, `start`; goal: where that
    is led: world space, Blender units; frames: after how many it lets go, None: when it is told to.
    """

    vertices: np.ndarray
    offsets: np.ndarray
    stiffness: np.ndarray
    start: np.ndarray
    goal: np.ndarray
    frames: int | None = None

    def grab(self, unit: float) -> Grab:
        """unit: meters per Blender unit."""
        return Grab(self.vertices, unit * (self.goal + self.offsets), self.stiffness)


class Copy:
    """The motion of a session that goes on by itself, at rest to begin with, from the frame that shows. Raises
    SceneError where that is not kept.
    """

    def __init__(self, obj: bpy.types.Object, session: Session):
        state = None if session.now is None else session.state_at(session.now)
        if session.now is None or state is None:
            raise SceneError("What Live shows at this frame is not kept: go to the first frame and play")
        self.now, self._rig_changes = session.now, session.rig_changes
        self.frames = 0  # since a hand last did something
        self._state = changed(state, coordinates=[state.coordinates[0]] * 4, bones=[state.bones[0]] * 4)
        substeps = session.tissue.player.settings.substeps
        self._rig = session.rig.after(obj, self.now)[:1].still(substeps)

    def is_of(self, session: Session) -> bool:
        """Whether the session still shows that frame of the same motion of the rig."""
        return (self.now, self._rig_changes) == (session.now, session.rig_changes)

    def step(self, player: Player, grabs: Sequence[Grab]) -> Frame:
        """The next frame; the player is left as it was."""
        assert player.hand is not None
        state, number = player.state, player.number
        player.state = self._state
        player.hand.pull(grabs)
        try:
            frame = player.advance(self._rig, self.now)
            self._state = player.state
        finally:
            player.state, player.number = state, number
        self.frames += 1
        return frame


class Grabbing:
    """The hands on one soft skin that is live. Raises SceneError where there is nothing to take hold of."""

    def __init__(self, obj: bpy.types.Object):
        if live.is_on(obj) and obj.session_uid not in remembered.live.sessions:
            live.refresh(obj)  # its file was just opened, or its skinning changed
        session = remembered.live.sessions.get(obj.session_uid)
        if session is None or not live.is_on(obj):
            raise SceneError(
                live.problem(obj) or Message("'{name}' is not live: press Live Soft Skin first", name=obj.name)
            )
        if session.tissue.player.hand is None:
            raise SceneError("With the Method Static nothing moves by itself: there is nothing to grab")
        self.object = skin.ObjectHandle.of(obj)
        self.holds: dict[int, Hold] = {}  # by the number of the hand
        self.size = session.tissue.player.size / skin.unit_scale()  # of the body, Blender units
        self._session = session
        self._taken = 0  # so many hands, until now
        self._copy: Copy | None = None
        self._shown: np.ndarray | None = None  # points of the copy when it was last looked at
        self._still = False  # the copy has hardly moved since the look before
        self._calm = False  # the copy stands still, held
        self._frame: int | None = None  # that showed when hands last grew older

    def is_of(self, obj: bpy.types.Object) -> bool:
        """Whether these are hands on the soft skin `obj` as it is live now."""
        return live.is_on(obj) and remembered.live.sessions.get(obj.session_uid) is self._session

    def take(self, place: np.ndarray, points: np.ndarray) -> int:
        """A hand takes hold of the skin at `place` (3,), which shows at points (V, 3): world space. Returns its number.
        Raises SceneError.
        """
        tissue, radius = self._session.tissue, RADIUS * self.size
        vertices, share = pinch(points, place, radius, _moving(tissue.model)[: len(points)])
        if not len(vertices):
            raise SceneError("This part is rigid: grab softer skin")
        self._begin_copy(self.object.find())
        _, shear = tissue.character.material(0).lame()  # of the neutral target
        stiffness = FIRM * shear * radius * skin.unit_scale() * share
        number, self._taken = self._taken, self._taken + 1
        self.holds[number] = Hold(vertices, points[vertices] - place, stiffness, place, place)
        self._changed()
        return number

    def lead(self, number: int, goal: np.ndarray) -> None:
        """Lead a hand to a goal (3,), world space; at most FARTHEST from where it took hold."""
        if number not in self.holds:  # all have let go
            return
        hold = self.holds[number]
        way = goal - hold.start
        most = FARTHEST * self.size / max(float(np.linalg.norm(way)), 1e-300)
        self.holds[number] = replace(hold, goal=hold.start + way * min(1.0, most))
        self._changed()

    def let_go(self, number: int) -> None:
        self.holds.pop(number, None)  # it may have let go by itself
        self._changed()

    def slap(self, number: int, inward: np.ndarray) -> None:
        """Lead a hand inward, a unit vector (3,), and let go by itself."""
        if number in self.holds:
            start = self.holds[number].start
            goal = start + SLAP * self.size * inward
            self.holds[number] = replace(self.holds[number], goal=goal, frames=self._frames(SLAP_SECONDS))
            self._changed()

    def let_go_of_all(self) -> None:
        self.holds.clear()
        self._changed()

    def tick(self) -> bool:
        """A frame may have passed: let go of what was slapped, and where time stands still, let the copy go on. Returns
        whether there is anything left to do. Raises what a step does.
        """
        obj = next((each for each in bpy.data.objects if each.session_uid == self.object.session_uid), None)
        if obj is None or not self.is_of(obj):  # it is gone, or a preview shows something else
            return False
        if events.is_scrubbing() or events.render_runs() or live.is_away(obj):
            return True  # what Live waits for, too
        if events.is_playing():
            self._copy = None
            if self.holds and self._session.now is not None and self._session.knows(self._session.now + 1):
                self._session.rewind()  # those frames were simulated without the hand
            self._grow_older(self._session.now)
            return bool(self.holds)
        if self._calm and self._copy and self._copy.is_of(self._session):
            return True
        return self._go_on(obj)

    def _go_on(self, obj: bpy.types.Object) -> bool:
        session = self._session
        if self._copy is None or not self._copy.is_of(session):
            if not self.holds:
                return False
            self._begin_copy(obj)
        assert self._copy is not None
        tissue, player = session.tissue, session.tissue.player
        self._grow_older(None)
        tissue.show(tissue.values(self._copy.step(player, [*session.grabs.values()])))
        if self._copy.frames % self._frames(CALM_SECONDS) == 0:
            before, self._shown = self._shown, tissue.skin.written
            moved = np.inf if before is None or self._shown is None else np.abs(self._shown - before).max()
            self._still = bool(moved * np.abs(tissue.character.to_bind).max() < CALM * player.size)
        self._calm = self._still and bool(self.holds)
        return bool(self.holds) or (not self._still and self._copy.frames < self._frames(LONGEST))

    def _frames(self, seconds: float) -> int:
        """How many frames last so long for the skin; fewer seconds than a frame are one."""
        return max(1, round(seconds * self._session.tissue.player.settings.rate))

    def _begin_copy(self, obj: bpy.types.Object) -> None:
        """Where time stands still, unless there is one that goes on."""
        if not events.is_playing() and (self._copy is None or not self._copy.is_of(self._session)):
            self._copy, self._shown, self._still = Copy(obj, self._session), None, False

    def _grow_older(self, frame: int | None) -> None:
        """A hand that slaps lets go after its frames. frame: the one that shows while Blender plays."""
        if frame is None or frame != self._frame:
            self.holds = {number: _aged(hold) for number, hold in self.holds.items() if hold.frames != 0}
            self._frame = frame
            self._apply()

    def stop_live(self, why: str) -> None:
        """The panel says why."""
        with suppress(SceneError):  # it was deleted
            live.stop(self.object.find(), why)

    def _changed(self) -> None:
        self._apply()
        self._still = self._calm = False
        if self._copy:
            self._copy.frames = 0

    def _apply(self) -> None:
        self._session.grabs = {number: hold.grab(skin.unit_scale()) for number, hold in self.holds.items()}


def _moving(model: Model) -> np.ndarray:
    """Which vertices (V,) of the skin may move by themselves: the bones do not hold them."""
    free = model.free.astype(float)
    if len(model.hold):  # by thickness: nothing is pinned
        free = free * (model.hold < HELD)
    return (free[model.embedding_nodes] * model.embedding_weights).sum(axis=1) > 0.5


def _aged(hold: Hold) -> Hold:
    return hold if hold.frames is None else replace(hold, frames=hold.frames - 1)


def record(obj: bpy.types.Object) -> None:
    """From now on Live keeps what hands do to the soft skin `obj`, frame by frame. Raises SceneError."""
    session = remembered.live.sessions.get(obj.session_uid)
    if session is None:
        raise SceneError(
            live.problem(obj) or Message("'{name}' is not live: press Live Soft Skin first", name=obj.name)
        )
    session.recorded = {}


def is_recording(obj: bpy.types.Object) -> bool:
    session = remembered.live.sessions.get(obj.session_uid)
    return session is not None and session.recorded is not None


def recorded(obj: bpy.types.Object) -> int:
    """Ends the recording: grips do what the hands did. Returns how many hands there were."""
    session = remembered.live.sessions[obj.session_uid]
    drags, session.recorded = session.recorded or {}, None
    _, shear = session.tissue.character.material(0).lame()
    return len(grips.from_drags(obj, drags, shear, skin.unit_scale()))


def begin(obj: bpy.types.Object) -> Grabbing:
    """The hands on the soft skin `obj`; those on another one let go. Raises SceneError."""
    current = remembered.live.hands
    if current is None or not current.is_of(obj):
        end()
        current = remembered.live.hands = Grabbing(obj)
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick)
    return current


def end() -> None:
    """Let go of everything, and show what Live has at this frame."""
    ended, remembered.live.hands = remembered.live.hands, None
    if ended is None:
        return
    ended.let_go_of_all()
    with suppress(SceneError):  # it was deleted
        obj = ended.object.find()
        if ended.is_of(obj) and not (events.is_scrubbing() or events.render_runs()):
            live.refresh(obj)


def _tick() -> float | None:
    """By a timer, once a frame."""
    current = remembered.live.hands
    if current is None:
        return None
    try:
        goes_on = current.tick()
    except engine.expected_errors() as error:  # in the next frame Live would fail, too
        current.stop_live(errors.sentence(error))
        goes_on = False
    except Exception as bug:  # a timer that raises would be called no more, and say nothing
        logger.log_once(bug)
        current.stop_live(logger.bug_sentence(bug))
        goes_on = False
    events.redraw(events.VIEWS)
    if not goes_on:
        end()
        return None
    scene = bpy.context.scene
    return scene.render.fps_base / scene.render.fps
