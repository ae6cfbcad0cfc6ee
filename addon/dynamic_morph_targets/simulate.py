# SPDX-License-Identifier: GPL-3.0-or-later
"""Model + moving rig -> frames. Never touches bpy. The button, the command line and scripts all run this."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import dynamorph
import numpy as np

from .build import Model, Progress, build
from .scene_data import Bake, Character, RigSamples, SimulationSettings, determinant, inverse

CHUNK = 32  # frames whose rig is turned into matrices at once: bounds memory, hides NumPy's call overhead
TELEPORT = 18.0  # body sizes a second off its course in one step: no motion, but a cut
CHECKED = 10  # frames looked at for inverted tetrahedra: those with the largest coordinates


@dataclass(frozen=True)
class Frame:
    """One simulated frame: coordinates (dofs,), target weights (J,), and the engine's report of its steps."""

    number: int
    coordinates: np.ndarray
    weights: np.ndarray
    steps: dict


def placing_bones(character: Character) -> list[int]:
    """Indices of the bones whose rotations place targets in pose space; those that are missing left out."""
    names = character.skeleton.names
    placing = {bone for target in character.targets for bone in target.bones}
    return [index for index, name in enumerate(names) if name in placing]


def pose_space(character: Character) -> dynamorph.PoseSpace:
    """Raises dynamorph.Error, naming both, when two targets have the same pose; ValueError on a missing bone."""
    names = character.skeleton.names
    sets = []
    for target_set in character.target_sets:
        named = sorted({bone for target in target_set.targets for bone in target.bones})
        missing = [bone for bone in named if bone not in names]
        if missing:
            raise ValueError(f"'{character.name}': bone '{missing[0]}' of target set '{target_set.name}' is missing")
        sets.append(
            dynamorph.TargetSet(
                [names.index(bone) for bone in named],
                [target.name for target in target_set.targets],
                [target.local for target in target_set.targets],
            )
        )
    return dynamorph.PoseSpace(sets)


def simulate(
    model: Model,
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    progress: Progress | None = None,
    engine=None,
) -> Iterator[Frame]:
    """Yields every frame from settings.start to settings.end.

    rig: 1 + (end - start) * substeps samples, the first at `start`. progress(fraction, message) -> bool is asked at
    every frame, of an unreduced model at every iteration; False raises dynamorph.Cancelled. engine:
    model.engine(character), if it is at hand already.
    """
    character = character.by_method()
    space = pose_space(character)
    done = 0

    def keep_going() -> bool:
        number = settings.start + done
        return progress is None or progress(done / len(settings.frames), f"Simulating frame {number}")

    engine = engine or model.engine(character)
    simulation = _simulation(engine, model, character, rig, settings, keep_going)
    frames, substeps = settings.frames, settings.substeps
    if len(rig) != 1 + (len(frames) - 1) * substeps:
        raise ValueError(f"rig: expected {1 + (len(frames) - 1) * substeps} samples, got {len(rig)}")

    skin = _Skin(model, character) if rig.fields else None

    def pushed(sample: int, bones: np.ndarray):
        """What the force fields do to the nodes, from where the flesh is now; None without any."""
        return skin and skin.push(rig.fields, sample, bones, engine.displacement(simulation.coordinates))

    bones, weights = _samples(model, character, space, rig[:2])
    held = settings.preroll > 0
    begun = simulation.start(bones[0], bones[0] if held else bones[-1], weights[0])
    for _ in range(settings.preroll):
        still = np.repeat(bones[:1], substeps, axis=0), np.repeat(weights[:1], substeps, axis=0)
        simulation.advance(*still, pushed(0, bones[0]))
    yield Frame(int(frames[0]), simulation.coordinates, weights[0], begun)
    for first in range(1, len(frames), CHUNK):
        last = min(first + CHUNK, len(frames))
        bones, weights = _samples(model, character, space, rig[1 + (first - 1) * substeps : 1 + (last - 1) * substeps])
        for done in range(first, last):
            if not keep_going():
                raise dynamorph.Cancelled("cancelled")
            steps = slice((done - first) * substeps, (done - first + 1) * substeps)
            report = simulation.advance(bones[steps], weights[steps], pushed(done * substeps, bones[steps][-1]))
            yield Frame(int(frames[done]), simulation.coordinates, weights[steps][-1], report)


def build_for(
    character: Character,
    rig: RigSamples | None,
    settings: SimulationSettings | None,
    progress: Progress | None = None,
    previous: Model | None = None,
) -> Model:
    """`build.build` for a character in a shot, to which its modes are fitted if it says so; else no shot is needed."""

    def rehearse(model: Model, report) -> tuple[np.ndarray, np.ndarray]:
        frames = list(simulate(model, character, rig, settings, lambda fraction, _message: report(fraction)))
        return np.array([frame.coordinates for frame in frames]), np.array([frame.weights for frame in frames])

    model = build(character, progress, previous, rehearse if rig is not None else None)
    if "rehearsal" in model.summary["seconds"]:
        model.summary["fitted"] = [settings.start, settings.end]
    return model


def bake(
    model: Model,
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    progress: Progress | None = None,
) -> tuple[Bake, dict]:
    """Simulates a shot: (Bake, report). progress(fraction, message) -> bool; False raises dynamorph.Cancelled."""
    began = time.perf_counter()
    character = character.by_method()
    if model.settings.method == "STATIC":
        return _static_bake(model, character, rig, settings)
    engine = model.engine(character)
    frames = list(simulate(model, character, rig, settings, progress, engine))
    coordinates = np.array([frame.coordinates for frame in frames])
    weights = np.array([frame.weights for frame in frames])
    report = _report(frames)
    report.update(_worst_elements(model, engine, coordinates, weights))
    if model.settings.solver == "FULL":
        coordinates, modes, report["compression_error"] = _compress(model, coordinates)
    else:
        modes = _node_modes(model, model.basis.T)
    report["seconds"] = time.perf_counter() - began
    names = tuple(target.name for target in character.targets)
    return Bake(settings.frames, coordinates, weights, model.surface(modes), model.details, names), report


def _static_bake(model: Model, character: Character, rig: RigSamples, settings: SimulationSettings):
    """Geometric morph targets follow their weights and nothing else."""
    began = time.perf_counter()
    _, weights = _samples(model, character, pose_space(character), rig[:: settings.substeps])
    modes = np.zeros((0, *character.vertices.shape))
    names = tuple(target.name for target in character.targets)
    report = _report([]) | {"smallest_det": 1.0, "inverted": 0, "seconds": time.perf_counter() - began}
    return Bake(settings.frames, np.zeros((len(weights), 0)), weights, modes, model.details, names), report


class _Skin:
    """The skin in world space, for force fields: where it is, and which nodes carry what acts on it."""

    def __init__(self, model: Model, character: Character):
        self.model = model
        self.weights = character.weights
        self.rest = character.vertices @ character.to_bind.T
        corners = self.rest[character.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        thirds = np.repeat(np.linalg.norm(across, axis=1) / 6.0, 3)
        self.areas = np.bincount(character.triangles.ravel(), thirds, len(self.rest))  # m^2

    def push(self, fields, sample: int, bones: np.ndarray, displacement: np.ndarray) -> np.ndarray | None:
        """Newtons on the nodes (n, 3), world space; bones (B + 1, 3, 4), displacement of the nodes (n, 3)."""
        acting = [field for field in fields if field.strength[sample]]
        if not acting:
            return None
        model = self.model
        moved = self.rest + np.einsum("va,vac->vc", model.embedding_weights, displacement[model.embedding_nodes])
        skin = np.tensordot(self.weights, bones, 1)
        points = np.einsum("vij,vj->vi", skin[:, :, :3], moved) + skin[:, :, 3]
        return model.on_nodes(self.areas[:, None] * sum(field.pull(sample, points) for field in acting))


def _simulation(engine, model: Model, character: Character, rig: RigSamples, settings: SimulationSettings, keep_going):
    full = model.settings.solver == "FULL"
    simulation = model.stepper(
        engine,
        settings.step,
        scheme=dynamorph.Scheme.__members__[settings.scheme],
        gravity=settings.gravity,
        teleport=TELEPORT * engine.body.size * settings.step,
        keep_going=keep_going if full else None,  # a reduced step takes less than the question
    )
    if any(settings.gravity):
        simulation.hold_targets(_target_frames(model, character, rig))
    return simulation


def _target_frames(model: Model, character: Character, rig: RigSamples) -> np.ndarray:
    """Skin matrices (J, B + 1, 3, 4) of the targets' captured poses, with the armature where it stood then.

    Sculpted shapes are what the artist saw under gravity, so each is held up in its own pose.
    """
    pose = model.skeleton.pose(np.array([target.local for target in character.targets]))
    rig_world = np.array([_resized(target.rig_world, rig.rig_world[0]) for target in character.targets])
    object_world = rig_world @ inverse(rig.rig_world[0]) @ rig.object_world[0]
    return RigSamples(pose, rig_world, object_world).skin_matrices(model.skeleton, model.to_bind)


def _resized(world: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The place and tilt of a world transform (4, 4) with the size of another: a scale may have been applied since."""
    u, _, vt = np.linalg.svd(world[:3, :3])
    _, sizes, axes = np.linalg.svd(like[:3, :3])
    out = world.copy()
    out[:3, :3] = u @ vt @ (axes.T * sizes) @ axes
    return out


def _samples(model: Model, character: Character, space, rig: RigSamples) -> tuple[np.ndarray, np.ndarray]:
    """Skin matrices (S, B + 1, 3, 4) and target weights (S, J)."""
    skeleton = model.skeleton
    local = skeleton.local_transforms(rig.pose, placing_bones(character))
    return rig.skin_matrices(skeleton, model.to_bind), space.weights(local)


def _report(frames: list[Frame]) -> dict:
    steps = [frame.steps for frame in frames]
    count = sum(step["steps"] for step in steps)
    rates = [step["steps"] / step["seconds"] for step in steps if step["steps"]]
    report = {
        "steps": count,
        "engine_seconds": sum(step["seconds"] for step in steps),
        "steps_per_second": float(np.median(rates)) if rates else 0.0,  # the median frame: machines have other work
        "iterations": sum(step["iterations"] for step in steps),
        "warnings": [],
    }
    unconverged = [frame.number for frame in frames if not frame.steps["converged"]]
    if unconverged:
        report["warnings"].append(f"Steps did not converge at {_some(unconverged)}: raise Substeps")
    cuts = [frame.number for frame in frames if frame.steps["teleported"]]
    if cuts:
        report["warnings"].append(f"The rig jumps at {_some(cuts)}: the soft skin was carried along")
    return report


def _some(numbers: list[int]) -> str:
    listed = ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")
    return f"frame{'s' * (len(numbers) > 1)} {listed}"


def _worst_elements(model: Model, engine, coordinates: np.ndarray, weights: np.ndarray) -> dict:
    """The smallest det F and the largest number of inverted tetrahedra over the most deformed frames."""
    targets = model.target_coordinates(engine)
    strength = np.abs(coordinates - weights @ targets).max(axis=1)
    rest = _volumes(model.nodes, model.tets)
    smallest, inverted = np.inf, 0
    for k in np.argsort(strength)[-CHECKED:]:
        moved = _volumes(model.nodes + engine.displacement(coordinates[k]), model.tets) / rest
        smallest = min(smallest, moved.min())
        inside_out = model.tets[moved <= 0]
        sculpted = _volumes(model.nodes + engine.displacement(weights[k] @ targets), inside_out)
        inverted = max(inverted, int((sculpted > 0).sum()))  # not what the sculpt itself inverts
    return {"smallest_det": float(smallest), "inverted": inverted}


def _volumes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Six times the signed volume of each tetrahedron."""
    corners = nodes[tets]
    return determinant(corners[:, 1:] - corners[:, :1])


def _node_modes(model: Model, free: np.ndarray) -> np.ndarray:
    """Displacement of all nodes (r, n, 3) from rows over the free nodes (r, 3 free)."""
    modes = np.zeros((len(free), len(model.nodes), 3))
    modes[:, ~model.pinned.astype(bool)] = free.reshape(len(free), -1, 3)
    return modes


def _compress(model: Model, displacements: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The best `settings.modes` modes of an unreduced shot: coordinates, node modes, largest error in metres."""
    u, s, vt = np.linalg.svd(displacements, full_matrices=False)
    kept = min(model.settings.modes, len(s))
    coordinates, modes = u[:, :kept] * s[:kept], vt[:kept]
    error = float(np.abs(displacements - coordinates @ modes).max())
    return coordinates, _node_modes(model, modes), error
