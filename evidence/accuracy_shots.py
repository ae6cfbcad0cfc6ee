# SPDX-License-Identifier: GPL-3.0-or-later
"""One character, reduced in every way that is asked for, against its unreduced model, for accuracy.py.

    python evidence/accuracy_shots.py NAME FILE MODES:20 RESPONSES:120 ...

NAME: of accuracy.SUBJECTS. FILE gets the figures as JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import project  # noqa: F401
import fresh_blender  # noqa: F401

import believable_bake
import bpy
import characters
import dynamic_morph_targets
import dynamorph
import motion_error
import numpy as np
import subjects
from accuracy import FITTED, FRAMES, MODES, SUBJECTS, Subject
from contact_sheet import quiet
from dynamic_morph_targets.core.character import Character
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.model.model import EngineModel, Model
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.player import TELEPORT, Frame, Player
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.result import compare
from dynamic_morph_targets.core.settings import ModelSettings, SimulationSettings
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job

ROUNDS = 7  # in which the time of every reduced model is measured, one after the other
SLOW = 5000.0  # microseconds a step: what takes longer is measured once


def main() -> int:
    subject, file = SUBJECTS[sys.argv[1]], Path(sys.argv[2])
    rows = [(basis, int(detail)) for basis, _, detail in (row.partition(":") for row in sys.argv[3:])]
    dynamic_morph_targets.register()
    with quiet():
        shots = scene_shots(subject) if subject.is_scene else one_click_shots(subject)
    found = measure(subject, shots, rows) | {"blender": bpy.app.version_string}
    file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


# Shots ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shot:
    """A character, and the rig at every step of a clip."""

    clip: str
    character: Character
    rig: RigSamples
    settings: SimulationSettings


def one_click_shots(subject: Subject) -> list[Shot]:
    """The character after Add Soft Skin and Build, in each of the subject's clips, or in its liveliest."""
    characters.open_file(characters.ASSETS / subject.file)
    body = characters.largest_skinned()
    rig = characters.armature_of(body)
    liveliest = believable_bake.choose_clip(rig)["clip"]
    bpy.context.view_layer.objects.active = body
    bpy.ops.dynamorph.add_soft_skin()
    bpy.ops.dynamorph.build()  # which sets the stiffness that gives the Bounce
    if not subject.clips:
        return [read_shot(body, liveliest.rpartition("|")[2])]
    shots = []
    for clip, first in subject.clips.items():
        characters.play(rig, bpy.data.actions[clip])
        bpy.context.scene.frame_start, bpy.context.scene.frame_end = first, first + FRAMES - 1
        shots.append(read_shot(body, clip))
    return shots


def read_shot(body, clip: str) -> Shot:
    """The scene's frames."""
    job = Job(body, "BAKE", whole=True, stored=False)
    return Shot(clip, rig=batch.read_rig(job), character=job.input.character, settings=job.input.settings)


def scene_shots(subject: Subject) -> list[Shot]:
    """The frames of a sample scene over which docs/results.md compares."""
    scene = subjects.SUBJECTS[subject.file]
    shot = subjects.open_shot(scene).part(*scene.measured)
    return [Shot("own motion", shot.character, shot.rig, shot.settings)]


# Models ---------------------------------------------------------------------------------------------------------------


def row_settings(settings: ModelSettings, basis: str, detail: int) -> ModelSettings | None:
    """None if the extension knows no such basis."""
    if basis == FITTED:
        return replace(settings, modes=detail)
    changes = {"solver": "REDUCED", "fit_to_shot": False, "modes": detail}
    try:
        return replace(settings, **changes, basis=basis)
    except TypeError:
        return replace(settings, **changes) if basis == MODES else None


@dataclass(frozen=True)
class Solved:
    """A model in one shot. motion (F, n, 3): displacement of the free nodes, bind space."""

    model: Model
    engine: EngineModel
    shot: Shot
    frames: list[Frame]
    motion: np.ndarray

    @cached_property
    def dynamic(self) -> np.ndarray:
        """The motion without the targets' shapes (F, n, 3)."""
        shapes = np.array([self.nodes(shape) for shape in self.model.target_coordinates(self.engine)])
        return self.motion - np.tensordot([frame.weights for frame in self.frames], shapes, 1)

    def nodes(self, coordinates: np.ndarray) -> np.ndarray:
        return self.engine.displacement(coordinates)[self.model.free]

    def steps(self) -> dict:
        """Iterations and microseconds a step, and the frames in which a step has not converged."""
        steps = [frame.steps for frame in self.frames if frame.steps.steps]
        count = sum(each.steps for each in steps)
        return {
            "iterations": sum(each.iterations for each in steps) / count,
            "microseconds": 1e6 * float(np.median([each.seconds / each.steps for each in steps])),
            "unconverged": sum(not each.converged for each in steps),
        }


def solve(model: Model, shot: Shot) -> Solved:
    player = Player(model, shot.character, shot.settings)
    frames, engine = list(player.run(shot.rig)), player.engine
    motion = np.array([engine.displacement(frame.coordinates)[model.free] for frame in frames])
    return Solved(model, engine, shot, frames, motion)


class Timed:
    """All steps of a shot in one call of the engine, without force fields, which change from frame to frame."""

    def __init__(self, solved: Solved):
        model, engine, shot = solved.model, solved.engine, solved.shot
        player = Player(model, shot.character, shot.settings)
        player.begin(shot.rig)
        self.bones, self.weights = player.posing.posed(shot.rig[1:])
        self.state, settings = player.state, shot.settings
        self.simulation = dynamorph.Simulation(
            engine,
            settings.step,
            integrator=dynamorph.Integrator.__members__[settings.integrator],
            gravity=settings.gravity,
            teleport=TELEPORT * engine.body.size * settings.step,
        )
        if any(settings.gravity):
            self.simulation.balance_targets(player.posing.target_frames(shot.rig[:1]))
        self.seconds: list[float] = []  # a step

    def run(self) -> None:
        if self.seconds and 1e6 * self.seconds[-1] > SLOW:
            return
        self.simulation.state = self.state
        report = self.simulation.advance(self.bones, self.weights)
        self.seconds.append(report.seconds / report.steps)

    @property
    def microseconds(self) -> float:
        return 1e6 * float(np.median(self.seconds))


# Measuring ------------------------------------------------------------------------------------------------------------


def measure(subject: Subject, shots: Sequence[Shot], rows: Sequence[tuple[str, int]]) -> dict:
    """All figures of a character; `accuracy` says what they are."""
    character = shots[0].character
    own = character.settings
    basis = FITTED if own.fits_shot else getattr(own, "basis", MODES)
    rows = sorted({*rows, (basis, own.modes)}, key=lambda row: (row[0] == FITTED, row[0], row[1]))
    unreduced = simulate.build_for(character.with_settings(solver="FULL"), shots[0].rig, shots[0].settings)
    body, mass, regions = parts(subject, unreduced, character)
    with compare.one_core():
        full = [solve(unreduced, shot) for shot in shots]
        found = {
            "title": subject.title,
            "material_model": own.material_model,
            "frequency": character.targets[0].frequency,
            "targets": len(character.targets),
            "default": [basis, own.modes],
            "nodes": len(unreduced.nodes),
            "dofs": full[0].engine.dofs,
            "clips": {each.shot.clip: of_clip(each, mass, regions, body) for each in full},
        }
        reduced = [reduce(row, unreduced, full, mass, regions) for row in rows]
        reduced = [each for each in reduced if each]
        timed = [(row["clips"][clip], Timed(solved)) for row, runs in reduced for clip, solved in runs.items()]
        for _ in range(ROUNDS):
            for _, each in timed:
                each.run()
    for figures, each in timed:
        figures["microseconds"] = each.microseconds
    return found | {"rows": [row for row, _ in reduced]}


def parts(subject: Subject, model: Model, character: Character) -> tuple[float, np.ndarray, dict[str, np.ndarray]]:
    """The body's size in meters, the free nodes' masses (n,) for unit density, and which belong to each region."""
    free = model.free
    mass = np.asarray(model.soft_body(character.probed).volumes).sum(axis=1)
    regions = {}
    if subject.by_bones:
        regions = motion_error.by_bones(model.node_weights, model.bone_names)
    elif len(model.thickness):
        regions = motion_error.by_thickness(model.at_nodes(model.thickness[:, None])[:, 0])
    size = diagonal(character.vertices @ character.to_bind.T)
    return float(size), mass, {name: nodes[free] for name, nodes in regions.items()}


def of_clip(full: Solved, mass: np.ndarray, regions: dict[str, np.ndarray], size: float) -> dict:
    """What the unreduced model does: its motion in body sizes, and its steps."""
    settings, moves = full.shot.settings, motion_error.moves
    return {
        "frames": [settings.frame_start, settings.frame_end],
        "substeps": settings.substeps,
        "moves": moves(full.dynamic, mass) / size,
        "largest": float(np.linalg.norm(full.dynamic, axis=2).max()) / size,
        "regions": {
            name: moves(full.dynamic[:, nodes], mass[nodes]) / size for name, nodes in regions.items() if nodes.any()
        },
    } | full.steps()


def reduce(row, unreduced: Model, full: Sequence[Solved], mass, regions) -> tuple[dict, dict[str, Solved]] | None:
    """A reduced model's figures but for its time, and its runs by clip; without runs if it cannot be built. None if
    the extension knows no such basis."""
    basis, detail = row
    shot = full[0].shot
    settings = row_settings(shot.character.settings, basis, detail)
    if settings is None:
        print(f"{basis} is not known", flush=True)
        return None
    character = replace(shot.character, settings=settings)
    figures = {"basis": basis, "detail": detail, "clips": {}}
    runs = {}
    try:
        model = simulate.build_for(character, shot.rig, shot.settings, previous=unreduced)
        for reference in full:
            solved = solve(model, reference.shot)
            figures["coordinates"] = solved.engine.dofs
            figures["clips"][reference.shot.clip] = solved.steps() | motion_error.errors(
                solved.motion, reference.motion, mass, regions, reference.dynamic
            )
            runs[reference.shot.clip] = solved
    except dynamorph.Error as error:
        figures["refused"] = str(error)
    print(json.dumps(figures), flush=True)
    return figures, runs


if __name__ == "__main__":
    sys.exit(main())
