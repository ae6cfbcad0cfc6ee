# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample scenes as the figures see them: what happens when, and what is measured where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import bpy
import measures
import numpy as np
from contact_sheet import quiet
from dynamic_morph_targets.core.character import Character
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.result import compare
from dynamic_morph_targets.core.settings import SimulationSettings
from dynamic_morph_targets.scene.character import extract
from dynamic_morph_targets.scene.motion import rig_motion, run_settings

FOLDER = Path(__file__).resolve().parents[1] / "sample_blends"
SHAPE, SWING = "SHAPE", "SWING"  # what the colors of a sheet tell
ELBOW = (0.382, -0.019, 1.211)  # of the shoulder, bind space


@dataclass(frozen=True)
class Sheet:
    """A contact sheet: figure of the thesis, title, frames and what happens there.

    shows: what colors tell, the SHAPE, how far it is from plain skinning, or the SWING about the pose's sculpted shape;
    red: from there on they are red, meters. zoom: part of the camera's picture, around the soft skin or, in frames of
    `around`, a point of it in bind space.
    """

    figure: str
    title: str
    frames: dict[int, str]
    shows: str
    red: float
    zoom: float
    around: dict[int, tuple[float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Subject:
    """One scene. Ranges of frames are the first and the last.

    thesis: row of its table 5.1. overview: frames for figure 5.1. measured: the frames over which full and reduced
    models are timed and compared. ringing: frame before a stop, first and last frame in which the tracked vertex then
    swings freely; tracked(vertices (V, 3) in bind space) is its index, direction the unit vector, local space, along
    which it is watched. zoom: part of the camera's picture that the overview shows, around the soft skin. full: ranges
    around the sheets' frames, for a scene whose unreduced model is too slow for more. also: further ranges in which the
    scene's own reduced model is compared with the unreduced one.
    """

    name: str
    title: str
    object: str
    thesis: dict[str, str]
    overview: tuple[int, ...]
    sheets: tuple[Sheet, ...]
    measured: tuple[int, int]
    ringing: tuple[int, int, int]
    tracked: Callable[[np.ndarray], int]
    direction: tuple[float, float, float]
    zoom: float = 1.0
    full: tuple[tuple[int, int], ...] = ()
    also: tuple[tuple[int, int], ...] = ()

    @property
    def path(self) -> Path:
        return FOLDER / f"{self.name}.blend"


def nearest(point) -> Callable[[np.ndarray], int]:
    """The vertex nearest to a point."""
    return lambda vertices: int(np.linalg.norm(vertices - point, axis=1).argmin())


CYLINDER = Subject(
    name="bulging_cylinder",
    title="Bulging cylinder",
    object="Limb",
    thesis={"bones": "4", "dofs": "918", "modes": "13", "targets": "4", "linear full": "28 → 25",
            "linear reduced": "93 → 89", "StVK reduced": "90 → 64", "precompute": "21.2"},
    overview=(16, 32, 44, 91),
    sheets=(
        Sheet(
            "5.3",
            "The limb bulges as it bends",
            {16: "bent back", 22: "bending", 32: "half bent", 44: "flexed"},
            shows=SHAPE, red=0.03, zoom=0.78,
        ),
        Sheet(
            "5.4",
            "The same push and the same shake, flexed and straight",
            {55: "pushed flexed", 72: "shaken flexed", 123: "pushed straight", 142: "shaken straight"},
            shows=SWING, red=0.012, zoom=0.78,
        ),
    ),
    measured=(1, 160),
    ringing=(86, 91, 113),
    tracked=nearest((0.50, 0.0, 0.07)),
    direction=(0.0, 0.0, 1.0),
    zoom=0.78,
)  # fmt: skip

SHOULDER = Subject(
    name="shoulder",
    title="Shoulder",
    object="Shoulder",
    thesis={"bones": "4", "dofs": "4899", "modes": "19", "targets": "6", "linear full": "3 → 3",
            "linear reduced": "87 → 85", "StVK reduced": "30 → 22", "precompute": "661"},
    overview=(36, 76, 142, 185),
    sheets=(
        Sheet(
            "5.7",
            "Two ways to fold one elbow, and the chest as the arm lowers",
            {36: "arm raised", 76: "folded, raised", 142: "arm lowered", 185: "folded, lowered"},
            shows=SHAPE, red=0.02, zoom=0.36, around={76: ELBOW, 185: ELBOW},
        ),
    ),
    measured=(38, 104),
    ringing=(234, 244, 260),
    tracked=nearest((0.30, -0.08, 1.29)),
    direction=(0.0, -1.0, 0.0),
    zoom=0.62,
    full=((34, 36), (72, 76), (138, 142), (172, 185)),
    also=((148, 214),),
)  # fmt: skip

HERBERT = Subject(
    name="herbert",
    title="Herbert",
    object="Herbert",
    thesis={"bones": "46", "dofs": "603", "modes": "12", "targets": "3", "linear full": "36 → 34",
            "linear reduced": "96 → 92", "StVK reduced": "90 → 58", "precompute": "16.8"},
    overview=(61, 73, 91, 178),
    sheets=(
        Sheet(
            "5.5",
            "The dive",
            {61: "lands on the board", 73: "throw", 91: "tucked", 103: "opens out"},
            shows=SWING, red=0.04, zoom=0.58,
        ),
        Sheet(
            "5.6",
            "The wall",
            {174: "running", 177: "hits the wall", 180: "squeezed", 184: "thrown back"},
            shows=SWING, red=0.06, zoom=0.6,
        ),
    ),
    measured=(1, 104),
    ringing=(174, 177, 200),
    tracked=nearest((0.0, -0.23, 0.95)),
    direction=(0.0, -1.0, 0.0),
    zoom=0.46,
)  # fmt: skip

SUBJECTS = {subject.name: subject for subject in (CYLINDER, SHOULDER, HERBERT)}


@dataclass(frozen=True)
class Shot:
    """A range of frames of an opened scene: the character, the rig at every step, the run."""

    subject: Subject
    character: Character
    rig: RigSamples
    settings: SimulationSettings

    @property
    def rest(self) -> np.ndarray:
        """The skin's vertices (V, 3), bind space."""
        return self.character.vertices @ self.character.to_bind.T

    @cached_property
    def frames(self) -> RigSamples:
        """The rig at whole frames."""
        return self.rig[:: self.settings.substeps]

    @cached_property
    def bones(self) -> np.ndarray:
        """Skin matrices (F, B + 1, 3, 4) at whole frames."""
        return self.frames.skin_matrices(self.character.skeleton, self.character.to_bind)

    def index(self, frame: int) -> int:
        """Of a frame in arrays (F, ...)."""
        return frame - self.settings.frame_start

    def world(self, displacement: np.ndarray, frame: int) -> np.ndarray:
        """Where the skin is (V, 3), world space, displaced by (V, 3) in local space before the bones move it."""
        bind = (self.character.vertices + displacement) @ self.character.to_bind.T
        return measures.posed(bind, self.character.weights, self.bones[self.index(frame)])

    def middle(self, frame: int) -> np.ndarray:
        """Of the soft skin (3,), as the bones move it, world space."""
        return self.world(np.zeros_like(self.rest), frame)[self.character.firmness < 0.75].mean(axis=0)

    def part(self, first: int, last: int) -> Shot:
        """The frames from first to last."""
        steps = self.settings.substeps
        rig = self.rig[self.index(first) * steps : self.index(last) * steps + 1]
        return Shot(self.subject, self.character, rig, replace(self.settings, frame_start=first, frame_end=last))

    def touching_itself(self) -> Shot:
        """The same with Self Collision."""
        return replace(self, settings=replace(self.settings, collision=True, self_collision=True))

    def every_step(self) -> Shot:
        """The same with each step as a frame, so that a motion shows what happens between the frames."""
        rate = self.settings.fps * self.settings.substeps
        settings = replace(self.settings, frame_start=0, frame_end=len(self.rig) - 1, fps=rate, substeps=1)
        return Shot(self.subject, self.character, self.rig, settings)

    def runs(self, variants: dict[str, dict]) -> dict[str, compare.Run]:
        return dict(compare.runs(self.character, self.rig, self.settings, variants))


def open_shot(subject: Subject) -> Shot:
    """Opens the subject's .blend, whose whole range it reads. As in the thesis, nothing touches anything."""
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(subject.path))
        obj = bpy.data.objects[subject.object]
        settings = run_settings.simulation_settings(obj, bpy.context.scene)
        settings = replace(settings, collision=False, self_collision=False)
        rig = rig_motion.sample_rig(obj, settings.frame_start, settings.frame_end, settings.substeps)
        return Shot(subject, extract.character(obj), rig, settings)
