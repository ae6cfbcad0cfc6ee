# SPDX-License-Identifier: GPL-3.0-or-later
"""One character simulated by several methods on the same input, and the figures that distinguish them. Never touches
bpy.

Used by `dynamorph report` and by the figures of the sample scenes.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..character import Character
from ..engine import dynamorph
from ..model import cage
from ..model.model import Model
from ..motion import posing, simulate
from ..motion.baked import Bake
from ..motion.rig_samples import RigSamples
from ..settings import VARIANTS, SimulationSettings

NOTHING = 1e-12  # meters, for a reference that does not move


@dataclass(frozen=True)
class Run:
    """One variant of a character: as it was built, simulated, and what the simulation reported.

    character: with the variant's settings. A full variant's bake keeps every mode of the shot: nothing is compressed.
    """

    character: Character
    model: Model
    bake: Bake
    report: dict

    @property
    def motion(self) -> np.ndarray:
        """Displacement (F, V, 3) of the surface, local space."""
        return np.array([self.bake.displacement(k) for k in range(len(self.bake.frames))])

    @property
    def static(self) -> np.ndarray:
        """Displacement (F, V, 3) of the targets' shapes, blended by their weights."""
        shapes = np.array([target.shape for target in self.character.targets])
        return np.tensordot(self.bake.weights, shapes, 1)


@dataclass(frozen=True)
class MotionError:
    """Distance of a motion from its reference, RMS and largest over all vertices and frames.

    rms, max: meters. rms_total and max_total: as fractions of the RMS and of the largest displacement of the reference
    from the Basis. rms_dynamic and max_dynamic: as fractions of those of its dynamic motion alone, the displacement
    from the targets' blended shapes.
    """

    rms: float
    max: float
    rms_total: float
    max_total: float
    rms_dynamic: float
    max_dynamic: float


def motion_error(motion: np.ndarray, reference: np.ndarray, static: np.ndarray) -> MotionError:
    """Compares displacements (F, V, 3); static (F, V, 3): the reference's blended shapes."""
    apart = np.linalg.norm(motion - reference, axis=2)
    total = np.maximum(np.linalg.norm(reference, axis=2), NOTHING)
    dynamic = np.maximum(np.linalg.norm(reference - static, axis=2), NOTHING)
    rms, largest = _rms(apart), float(apart.max())
    return MotionError(
        rms,
        largest,
        rms / _rms(total),
        largest / float(total.max()),
        rms / _rms(dynamic),
        largest / float(dynamic.max()),
    )


def runs(
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    variants: Mapping[str, dict],
    progress: cage.ProgressFn | None = None,
) -> Iterator[tuple[str, Run]]:
    """Simulates each variant on one core; they share one cage. progress(fraction, message) -> bool, as in `build`."""
    model = None
    for k, (name, changes) in enumerate(variants.items()):
        building, baking = (
            progress and partial(_part, progress, 2 * k + half, 2 * len(variants), name) for half in (0, 1)
        )
        varied = character.with_settings(**changes)
        if varied.settings.solver == "FULL":
            varied = varied.with_settings(modes=len(settings.frames))
        with one_core():
            made = simulate.build_for(varied, rig, settings, building, model)
            baked, report = simulate.bake(made, varied, rig, settings, baking)
        if made.summary.tets:
            model = model or made
            # The stages of the cage, which is shared, before the others.
            of_cage = {stage: model.summary.seconds[stage] for stage in ("meshing", "embedding")}
            made = made.with_summary(seconds=of_cage | made.summary.seconds | of_cage)
        yield name, Run(varied, made, baked, report)


def _part(progress: cage.ProgressFn, done: int, parts: int, name: str, fraction: float, message: str) -> bool:
    return progress((done + fraction) / parts, f"{name}: {message}")


@contextmanager
def one_core() -> Iterator[None]:
    """Keeps this thread, in which the engine computes, on one core where the system permits it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def compare(
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    variants: Mapping[str, dict] = VARIANTS,
    progress: cage.ProgressFn | None = None,
) -> dict:
    """All figures as plain data, ready for JSON: {"machine", "frames", "substeps", "variants": {name: figures}}."""
    rows, done = {}, {}
    for name, run in runs(character, rig, settings, variants, progress):
        rows[name] = figures(run, character)
        done[name] = run
    for name, run in done.items():
        full = done.get(name.replace("reduced", "full"))
        if full is not None and full is not run:
            rows[name]["error"] = vars(motion_error(run.motion, full.motion, full.static))
    return {
        "machine": machine(),
        "frames": [settings.frame_start, settings.frame_end],
        "substeps": settings.substeps,
        "variants": rows,
    }


def machine() -> str:
    """The machine on which the seconds were measured."""
    pinned = "pinned to one core" if hasattr(os, "sched_setaffinity") else "on one thread"
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {pinned}"


def figures(run: Run, authored: Character) -> dict:
    """The figures of one run; meters and seconds. authored: the character with its own settings."""
    made, apart = run.model.summary, np.linalg.norm(run.motion - run.static, axis=2)
    row = {
        "dofs": made.dofs,
        "modes": made.modes,
        "targets": made.targets,
        "precompute": made.seconds,
        "steps": run.report["steps"],
        "steps_per_second": run.report["steps_per_second"],
        "iterations": run.report["iterations"],
        "smallest_det": run.report["smallest_det"],
        "inverted": run.report["inverted"],
        "dynamic_max": float(apart.max()),
        "dynamic_rms": _rms(apart),
        "residuals": residuals(run.model, run.character),
        "warnings": [*made.warnings, *run.report["warnings"]],
    }
    if run.character.settings.solver == "FULL" and run.report["steps"]:
        lost = slice(authored.settings.modes, None)
        row["compression_error"] = float(
            np.abs(np.tensordot(run.bake.coordinates[:, lost], run.bake.modes[lost], 1)).max(initial=0.0)
        )
    return row


def residuals(
    model: Model, character: Character, report: Callable[[float], object] = lambda _fraction: None
) -> dict[str, float]:
    """For each authored target, how far the skin at rest in its captured pose is from the shape sculpted for it.

    The largest distance over the surface, meters, without gravity. report(fraction) is called after each target.
    """
    authored = character.with_settings(method="DYNAMIC")  # which leaves out no target
    poses = np.array([target.local for target in authored.targets])
    shapes = np.array([target.shape for target in authored.targets])
    weights, of_authored = (
        posing.pose_space(each).weights(poses, posing.reached(authored.targets, posing.channels(each.targets)))
        for each in (character, authored)
    )
    sculpted = np.tensordot(of_authored, shapes, 1)
    statics, to_meters = Statics(model, character), character.to_bind.T
    found = {}
    for j, target in enumerate(authored.targets):
        miss = (statics.surface(weights[j]) - sculpted[j]) @ to_meters
        found[target.name] = float(np.linalg.norm(miss, axis=1).max())
        report((j + 1) / len(authored.targets))
    return found


class Statics:
    """Static solutions of a model with the materials of a character, without gravity."""

    def __init__(self, model: Model, character: Character):
        self.model = model
        self.simulation = None
        if model.summary.tets:
            self.engine = model.engine(character)
            self.simulation = dynamorph.Simulation(self.engine, 1.0)

    def surface(
        self, weights: np.ndarray, bones: np.ndarray | None = None, push: np.ndarray | None = None
    ) -> np.ndarray:
        """Displacement (V, 3) of the surface, local space, at target weights (J,). bones (B + 1, 3, 4): the pose, which
        matters only with a push; push (V, 3): newtons on the vertices, world space.
        """
        residual = np.tensordot(weights, self.model.residual_shapes, 1)
        if self.simulation is None:  # geometric morph targets
            return residual
        if bones is None:
            bones = np.repeat(np.eye(3, 4)[None], self.model.node_weights.shape[1], axis=0)
        external = None if push is None else self.model.on_nodes(push)
        coordinates, _ = self.simulation.solve_static(bones, weights, external)
        return self.model.surface(self.engine.displacement(coordinates)) + residual


def table(report: dict) -> str:
    """The main figures of `compare` as lines of text."""
    heads = ("DOF", "modes", "precompute", "steps/s", "det F", "motion", "target miss", "error")
    lines = [f"{'':<27}" + "".join(f"{head:>12}" for head in heads)]
    for name, row in report["variants"].items():
        cells = (
            row["dofs"] or "-",
            row["modes"] or "-",
            f"{sum(row['precompute'].values()):.2f} s",
            f"{row['steps_per_second']:.0f}" if row["steps"] else "-",
            f"{row['smallest_det']:.2f}",
            f"{1000 * row['dynamic_max']:.1f} mm",
            f"{1000 * max(row['residuals'].values()):.2g} mm",
            f"{100 * row['error']['rms_total']:.1f} %" if "error" in row else "",
        )
        lines.append(f"{name:<27}" + "".join(f"{cell:>12}" for cell in cells))
    start, end = report["frames"]
    lines += [
        f"Frames {start} to {end}, {report['substeps']} substeps; {report['machine']}",
        "motion: from the targets' blended shapes, at most. target miss: of the skin at rest in a target's pose.",
        "error: of a reduced model from its full one, RMS, relative to the RMS displacement.",
    ]
    return "\n".join(lines)


def _rms(lengths: np.ndarray) -> float:
    return float(np.sqrt(np.mean(lengths**2)))
