# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's hand in a soft skin that is live: it drags the skin, lets go, slaps it, or holds it where it is.

While Blender plays, the hands act in what is simulated. While it stands, a copy of the motion goes on, which the next
frame discards. Nothing of the file is changed but what Live shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core import engine, errors, logger
from ..core.errors import SceneError
from ..core.geometry import diagonal
from ..core.model.model import Model
from ..core.motion.grab import FIRM, Grab, pinch
from ..core.motion.player import Frame, Player, State
from ..scene import events, skin
from . import live
from .session import Session

RADIUS = 0.03  # of the body's size: of what a hand takes hold of
FARTHEST = 0.25  # of the size: that a hand leads the skin away from where it took hold
HELD = 0.5  # of a node, from 0 to 1: where the bones have more of it, it does not move by itself
SLAP, SLAP_FRAMES = 0.06, 2  # of the size: how far a slap leads the skin in, and for how many frames
CALM, LONGEST = 1e-5, 8.0  # of the size, in a frame: what moves less stands still; seconds that a copy goes on at most


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
    """The motion of a session that goes on by itself, at rest to begin with, from the frame `now` that shows."""

    def __init__(self, obj: bpy.types.Object, session: Session):
        state = None if session.now is None else session.state_at(session.now)
        if session.now is None or state is None:
            raise SceneError("What Live shows at this frame is not kept: go to the first frame and play")
        coordinates, bones, excess, touched = state
        self.now = session.now
        self.frames = 0  # since a hand last did something
        self._state: State = [coordinates[0]] * 4, [bones[0]] * 4, excess, touched
        substeps = session.tissue.player.settings.substeps
        self._rig = session.rig.after(obj, self.now)[:1].still(substeps)

    def step(self, player: Player) -> Frame:
        """The next frame; the player is left as it was."""
        state, number = player.state, player.number
        player.state = self._state
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
        session = live.sessions.get(obj.session_uid)
        if session is None or not live.is_on(obj):
            raise SceneError("'{name}' is not live: press Live Soft Skin first", name=obj.name)
        if session.tissue.player.hand is None:
            raise SceneError("With the Method Static nothing moves by itself: there is nothing to grab")
        self.object = skin.ObjectHandle.of(obj)
        self.holds: dict[int, Hold] = {}  # by the number of the hand
        self._taken = 0  # so many hands, until now
        self._copy: Copy | None = None
        self._shown: np.ndarray | None = None

    def session(self) -> Session:
        """Raises SceneError when it has ended."""
        session = live.sessions.get(self.object.session_uid)
        if session is None:
            raise SceneError("'{name}' is not live any more", name=self.object.name)
        return session

    def take(self, place: np.ndarray, points: np.ndarray) -> int:
        """A hand takes hold of the skin at `place` (3,), which shows at points (V, 3): world space. Returns its number.
        Raises SceneError.
        """
        tissue, size = self.session().tissue, diagonal(points)
        vertices, share = pinch(points, place, RADIUS * size, _moving(tissue.model)[: len(points)])
        if not len(vertices):
            raise SceneError("This part does not move by itself: grab a softer one")
        _, shear = tissue.character.material(0).lame()  # of the neutral target
        stiffness = FIRM * shear * RADIUS * size * skin.unit_scale() * share
        number, self._taken = self._taken, self._taken + 1
        self.holds[number] = Hold(vertices, points[vertices] - place, stiffness, place, place)
        if self._copy is None or self._copy.now != self.session().now:
            self.session().rewind()
            self._begin()
        self._changed()
        return number

    def lead(self, number: int, goal: np.ndarray) -> None:
        """Lead a hand to a goal (3,), world space; at most FARTHEST from where it took hold."""
        hold, farthest = self.holds[number], FARTHEST * self._size
        way = goal - hold.start
        length = float(np.linalg.norm(way))
        self.holds[number] = replace(hold, goal=hold.start + way * min(1.0, farthest / max(length, 1e-300)))
        self._changed()

    def let_go(self, number: int) -> None:
        self.holds.pop(number, None)  # it may have let go by itself
        self._changed()

    def slap(self, number: int, inward: np.ndarray) -> None:
        """Lead a hand inward, a unit vector (3,), and let go by itself."""
        hold = self.holds[number]
        self.holds[number] = replace(hold, goal=hold.start + SLAP * self._size * inward, frames=SLAP_FRAMES)
        self._changed()

    def end(self) -> None:
        """Let go of everything."""
        self.holds.clear()
        self._changed()

    def tick(self) -> bool:
        """A frame has passed: let go of what is slapped, and where time stands still, let the copy go on. Returns
        whether there is anything left to do. Raises what a step does.
        """
        obj, session = self.object.find(), self.session()
        if not live.is_on(obj):  # a preview shows something else
            return False
        self.holds = {number: _aged(hold) for number, hold in self.holds.items() if hold.frames != 0}
        self._apply()
        if events.is_playing():
            self._copy = None
            return bool(self.holds)
        if self._copy is None or self._copy.now != session.now:
            if not self.holds or session.now is None:
                return False
            self._begin()
        return self._go_on(obj, session)

    @property
    def _size(self) -> float:
        return self.session().tissue.player.size / skin.unit_scale()

    def _begin(self) -> None:
        self._copy, self._shown = None, None
        if not events.is_playing():
            self._copy = Copy(self.object.find(), self.session())

    def _changed(self) -> None:
        self._apply()
        if self._copy:
            self._copy.frames = 0

    def _apply(self) -> None:
        session = live.sessions.get(self.object.session_uid)
        if session is not None:
            session.grabs = tuple(hold.grab(skin.unit_scale()) for hold in self.holds.values())

    def _go_on(self, obj: bpy.types.Object, session: Session) -> bool:
        assert self._copy is not None
        tissue, player = session.tissue, session.tissue.player
        session.pull()
        values = tissue.values(self._copy.step(player))
        tissue.show(values)
        points = tissue.points(values)
        moved = np.inf if self._shown is None else np.abs(points - self._shown).max()
        self._shown = points
        calm = moved * np.abs(tissue.character.to_bind).max() < CALM * player.size
        seconds = self._copy.frames * player.settings.substeps * player.settings.step
        return bool(self.holds) or (not calm and seconds < LONGEST)


def _moving(model: Model) -> np.ndarray:
    """Which vertices (V,) of the skin may move by themselves: the bones do not hold them."""
    free = model.free.astype(float)
    if len(model.hold):  # by thickness: nothing is pinned
        free = free * (model.hold < HELD)
    return (free[model.embedding_nodes] * model.embedding_weights).sum(axis=1) > 0.5


def _aged(hold: Hold) -> Hold:
    return hold if hold.frames is None else replace(hold, frames=hold.frames - 1)


current: Grabbing | None = None


def begin(obj: bpy.types.Object) -> Grabbing:
    """The hands on the soft skin `obj`; those on another one let go. Raises SceneError."""
    global current
    if current is None or current.object.session_uid != obj.session_uid or not live.is_on(obj):
        end()
        current = Grabbing(obj)
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick)
    return current


def end() -> None:
    """Let go of everything."""
    global current
    if current is not None:
        current.end()
    current = None


def _tick() -> float | None:
    """By a timer, once a frame."""
    global current
    if current is None:
        return None
    try:
        goes_on = current.tick()
    except engine.expected_errors() as error:
        logger.log_once(SceneError(errors.sentence(error)))
        goes_on = False
    except Exception as bug:  # a timer that raises would be called no more, and say nothing
        logger.log_once(bug)
        goes_on = False
    events.redraw(events.VIEWS)
    if not goes_on:
        end()
        return None
    scene = bpy.context.scene
    return scene.render.fps_base / scene.render.fps
