# SPDX-License-Identifier: GPL-3.0-or-later
"""What the thesis's figures claim of each scene, measured. Meters, cubic meters, degrees.

Each function takes a shot and its runs by method (SHOWN) and returns plain data. `make results` prints it, and
tests/addon/samples/test_claims.py holds the scenes to it.
"""

from __future__ import annotations

from dataclasses import replace

import measures
import numpy as np
from dynamic_morph_targets.core.engine import dynamorph
from dynamic_morph_targets.core.geometry import vertex_areas
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.result.compare import Run, Statics
from subjects import Shot

PLAIN = "plain skinning"  # no run: the skin as the bones move it
# The methods side by side, each with the scene's own material model.
SHOWN: dict[str, dict[str, str]] = {
    "static morphs": {"method": "STATIC"},
    "single material": {"method": "SINGLE", "solver": "REDUCED"},
    "pose-dependent shape": {"method": "SHAPE", "solver": "REDUCED"},
    "DMT reduced": {"method": "DYNAMIC", "solver": "REDUCED"},
    "DMT full": {"method": "DYNAMIC", "solver": "FULL"},
}
ITSELF = ", Self Collision"  # the end of the name of a method that has it
FAST = {name: changes for name, changes in SHOWN.items() if changes.get("solver") != "FULL"}


def surface(shot: Shot, run: Run | None, frame: int) -> np.ndarray:
    """The skin (V, 3) at a frame, world space; without a run, as the bones alone move it."""
    return shot.world(np.zeros_like(shot.rest) if run is None else run.bake.displacement(shot.index(frame)), frame)


def swing(shot: Shot, run: Run, first: int, last: int, patch=slice(None)) -> float:
    """How far the skin, or a patch, leaves its pose's own blended shape between two frames, at most."""
    part = slice(shot.index(first), shot.index(last) + 1)
    return float(np.linalg.norm((run.motion - run.static)[part, patch], axis=2).max())


def give(shot: Shot, run: Run, frame: int) -> float:
    """How far the skin at rest in a frame's pose gives to the scene's force fields: the mean along the push."""
    statics, k = Statics(run.model, run.character), shot.index(frame)
    weights, bones = run.bake.weights[k], shot.bones[k]
    before = shot.world(statics.surface(weights), frame)
    areas = vertex_areas(shot.rest, shot.character.triangles)[:, None]
    push = areas * sum(field.pull(k, before) for field in shot.frames.fields)
    moved = shot.world(statics.surface(weights, bones, push), frame) - before
    return float((push * moved).sum() / np.linalg.norm(push, axis=1).sum())


# The cylinder ---------------------------------------------------------------------------------------------------------

BENDING = range(17, 45)  # from bent back to flexed
FLEXED, STRAIGHT = "flexed", "straight"
PUSHED = {FLEXED: 55, STRAIGHT: 123}
SHAKEN = {FLEXED: (66, 80), STRAIGHT: (136, 150)}
LIMB_ENDS = 2, 3  # bones of the elbow


def cylinder(shot: Shot, runs: dict[str, Run]) -> dict:
    """bend: degrees; bulge: volume of the skin over that of the straight limb; give and swing: see there."""
    bend, bulge = bulges(shot, runs)
    return {
        "bend": bend,
        "bulge": bulge,
        "give": {name: {pose: give(shot, run, frame) for pose, frame in PUSHED.items()} for name, run in runs.items()},
        "swing": {
            name: {pose: swing(shot, run, *frames) for pose, frames in SHAKEN.items()} for name, run in runs.items()
        },
    }


def bulges(shot: Shot, runs: dict[str, Run]) -> tuple[list[float], dict[str, list[float]]]:
    """(bend of the elbow in degrees, volume gained over the straight limb by method) at the frames of BENDING."""
    triangles = shot.character.triangles
    local = shot.character.skeleton.local_transforms(shot.frames.pose)[:, LIMB_ENDS]
    bend = np.degrees(np.arctan2(local[..., 2, 1], local[..., 2, 2])).sum(axis=1)
    straight = measures.volume(shot.rest, triangles)
    gained = {
        name: [measures.volume(surface(shot, run, f), triangles) - straight for f in BENDING]
        for name, run in {PLAIN: None, **runs}.items()
    }
    return [float(bend[shot.index(f)]) for f in BENDING], gained


# The shoulder ---------------------------------------------------------------------------------------------------------

FOLDS = {"arm raised": range(38, 105), "arm lowered": range(148, 215)}
COARSELY = 4  # frames from one to the next where a skin has intersections, which take long to measure
LOWERING = range(108, 137, 2)
CHEST = (0.06, 1.25), (0.16, 1.38)  # x and z, from the breastbone to the armpit
BACKWARD = np.array([0.0, 1.0, 0.0])
BICEPS = (0.27, 1.24), (0.36, 1.36)
ARM_SHAKEN = {FLEXED: (176, 190), "relaxed": (234, 248)}


def shoulder(shot: Shot, runs: dict[str, Run]) -> dict:
    """folds: for each way to fold, by method, the worst intersections on the whole path; chest: depth by frame;
    swing: of the biceps, flexed and relaxed."""
    chest, biceps = between(shot.rest, *CHEST), between(shot.rest, *BICEPS)
    skins: dict[str, Run | None] = {PLAIN: None, **runs}
    return {
        "folds": {way: {name: path(shot, name, run, frames) for name, run in skins.items()}
                  for way, frames in FOLDS.items()},
        "lowering": list(LOWERING),
        "chest": {name: [measures.depth(surface(shot, run, f), chest, BACKWARD) for f in LOWERING]
                  for name, run in skins.items()},
        "swing": {name: {pose: swing(shot, run, *frames, biceps) for pose, frames in ARM_SHAKEN.items()}
                  for name, run in runs.items()},
    }  # fmt: skip


def path(shot: Shot, name: str, run: Run | None, frames: range) -> dict[str, list]:
    """Intersecting pairs and depth along a motion; a method that has shapes for it is looked at in every frame."""
    seen = frames[:: COARSELY if name in (PLAIN, "single material") else 1]
    found = [measures.self_intersections(surface(shot, run, f), shot.character.triangles) for f in seen]
    return {"frames": list(seen), "pairs": [f.pairs for f in found], "depth": [f.depth for f in found]}


def between(vertices: np.ndarray, low: tuple[float, float], high: tuple[float, float]) -> np.ndarray:
    """Which vertices (V,) are in a box of x and z, through the whole body."""
    return ((vertices[:, [0, 2]] > low) & (vertices[:, [0, 2]] < high)).all(axis=1)


# Herbert --------------------------------------------------------------------------------------------------------------

UPRIGHT, TUCKED = "upright", "tucked"
POSES = {UPRIGHT: 1, TUCKED: 91}
IN_THE_TUCK, AFTER_THE_WALL = range(87, 96), range(176, 201)
TRUNK_BONES, THIGHS = ("pelvis", "spine_01", "spine_02", "spine_03"), ("thigh_l", "thigh_r")
CREASE = 0.75  # of the tissue's thickness: what is nearer to the other limb at rest belongs to the joint
WAIST = (-0.08, 0.88), (0.08, 1.06)  # x and z
FORWARD = np.array([0.0, -1.0, 0.0])
PATCHES = {"belly": (-0.10, FORWARD), "back": (0.05, -FORWARD)}  # where it begins in y; outward
TRUNK = "spine_02"
SHAKE, SHAKES, WATCHED = 0.01, 4.0, 36  # meters to and fro, Hz for half a second, frames


def herbert(shot: Shot, runs: dict[str, Run]) -> dict:
    """out: mean displacement of belly and back, outward, by frame; swing: amplitude of the belly under one and the
    same shake, upright and tucked; inside: vertices of trunk and thighs in each other, at most in the tuck, by method,
    with Self Collision too."""
    frames = [*IN_THE_TUCK, *AFTER_THE_WALL]
    rows = [shot.index(f) for f in frames]
    out = {
        name: {
            patch: measures.patch_displacement(run.motion[rows], waist(shot.rest, patch), PATCHES[patch][1]).tolist()
            for patch in PATCHES
        }
        for name, run in runs.items()
    }
    swings: dict[str, dict[str, float]] = {name: {} for name in runs}
    for pose, frame in POSES.items():
        still = shaken(shot, frame)
        for name, run in still.runs({name: SHOWN[name] for name in runs}).items():
            belly = measures.patch_displacement(run.motion - run.static, waist(shot.rest, "belly"), FORWARD)
            swings[name][pose] = measures.amplitude(belly)
    return {"frames": frames, "out": out, "swing": swings, "inside": in_each_other(shot, runs)}


def in_each_other(shot: Shot, runs: dict[str, Run]) -> dict[str, int]:
    """How many vertices of trunk and thighs are in each other in the tuck, away from the joint, at most, by method."""
    tuck = shot.part(IN_THE_TUCK[0] - round(shot.settings.fps), IN_THE_TUCK[-1])
    alone = tuck.touching_itself().runs({name: SHOWN[name] for name in runs if SHOWN[name]["method"] == "DYNAMIC"})
    skins = [(PLAIN, shot, None), *((name, shot, run) for name, run in runs.items())]
    skins += [(name + ITSELF, tuck, run) for name, run in alone.items()]
    limbs = list(against_each_other(shot))
    return {name: max(buried(surface(part, run, frame), limbs) for frame in IN_THE_TUCK) for name, part, run in skins}


def against_each_other(shot: Shot):
    """Of thigh and trunk, and the other way around: vertices of the first away from the joint, triangles (T, 3) of the
    second.
    """
    names, triangles = np.array(shot.character.skeleton.names), shot.character.soft_triangles
    carried = shot.character.weights[:, : len(names)]
    thickness = dynamorph.Thickness(shot.rest, triangles).at(shot.rest)[0]
    trunk = carried[:, np.isin(names, TRUNK_BONES)].sum(axis=1) > 0.5
    for thigh in (carried[:, names == bone].sum(axis=1) > 0.5 for bone in THIGHS):
        for own, other in ((thigh, trunk), (trunk, thigh)):
            others = triangles[other[triangles].any(axis=1)]
            ways = shot.rest[own, None] - shot.rest[np.unique(others)]
            apart = np.linalg.norm(ways, axis=2).min(axis=1) > CREASE * thickness[own]
            yield np.flatnonzero(own)[apart], others


def buried(skin: np.ndarray, limbs) -> int:
    """How many vertices of a skin (V, 3) are inside of the others, of `against_each_other`."""
    found = 0
    for own, others in limbs:
        low, high = skin[others].min(axis=(0, 1)), skin[others].max(axis=(0, 1))
        near = own[((skin[own] > low) & (skin[own] < high)).all(axis=1)]  # no other vertex can be inside
        found += int((measures.winding_numbers(skin[near], skin, others) > 0.5).sum())
    return found


def waist(vertices: np.ndarray, patch: str) -> np.ndarray:
    """Which vertices (V,) are belly or back."""
    begins, outward = PATCHES[patch]
    return between(vertices, *WAIST) & ((vertices - [0, begins, 0]) @ outward > 0)


def shaken(shot: Shot, frame: int) -> Shot:
    """The pose of a frame, shaken along the way the trunk faces; the same in every pose."""
    settings = replace(shot.settings, frame_start=1, frame_end=WATCHED)
    time = np.arange((WATCHED - 1) * settings.substeps + 1) * settings.step
    trunk = shot.character.skeleton.names.index(TRUNK)
    faces = shot.bones[shot.index(frame), trunk, :, :3] @ FORWARD
    way = SHAKE * np.sin(2 * np.pi * SHAKES * time) * (time < 0.5)
    moved = np.tile(np.eye(4), (len(time), 1, 1))
    moved[:, :3, 3] = way[:, None] * faces / np.linalg.norm(faces)
    k = shot.index(frame)
    pose = np.repeat(shot.frames.pose[k : k + 1], len(time), axis=0)
    rig = RigSamples(pose, moved @ shot.frames.rig_world[k], moved @ shot.frames.object_world[k])
    return Shot(shot.subject, shot.character, rig, settings)


MEASURE = {"bulging_cylinder": cylinder, "shoulder": shoulder, "herbert": herbert}
