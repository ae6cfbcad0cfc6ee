# SPDX-License-Identifier: GPL-3.0-or-later
"""A character folds up, so that its belly meets its thighs, with and without self-collision, for collision.py.

    python evidence/collision_fold.py ASSET FOLDER full|reduced

FOLDER gets e.g. fold_full.json, and a picture of each way, fold_full_none.png and fold_full_self.png. The pose is as
prescribed: hips by 95 degrees, knees by 125 and elbows by 95 in 30 steps of 1/96 s, then still for 8. What is inside is
known by the winding number of the other limb's skin, for 3,000 points away from the joint.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import project  # noqa: F401
import fresh_blender  # noqa: F401

import bpy
import characters
import dynamic_morph_targets
import numpy as np
from contact_sheet import quiet, render
from dynamic_morph_targets.core.engine import dynamorph
from dynamic_morph_targets.core.motion.contact_points import contact_points
from dynamic_morph_targets.core.motion.player import Player
from dynamic_morph_targets.core.settings import SimulationSettings
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job
from dynamic_morph_targets.scene.character import extract
from dynamic_morph_targets.scene.motion import rig_motion
from dynamic_morph_targets.scene.read.source import Source
from dynamic_morph_targets.scene.skinning import Skinning
from dynamic_morph_targets.scene.store.model_store import load_model
from mathutils import Matrix, Vector
from measures import winding_numbers
from portrait import aim

FOLDS, STILL, RATE = 30, 8, 96.0  # steps, steps, steps per second
HIPS, KNEES, ELBOWS = -95.0, 125.0, 95.0  # degrees
POINTS = 3000
APART = 5  # first steps, in which next to nothing touches
CREASE = 0.75  # distance at rest, in thicknesses, below which a point belongs to the joint
CELL = (640, 640)


def main() -> int:
    asset, folder, quality = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    folder.mkdir(parents=True, exist_ok=True)
    dynamic_morph_targets.register()
    with quiet():
        characters.open_file(asset)
        body = characters.largest_skinned()
        fold(characters.armature_of(body))
        body.dynamorph.collision.use = False
        model, character, rig = built(body, quality, 1 + FOLDS + STILL)
    settings = SimulationSettings(1, 1 + FOLDS + STILL, RATE, 1, collision=True)
    found, shots = {"name": asset.stem}, {}
    for way in ("none", "self"):
        shots[way], found[way] = simulated(model, character, rig, replace(settings, self_collision=way == "self"))
        inside = Inside(model, character, shots[way])
        found[way] |= inside.between("thigh", "torso") | {"all": inside.all()}
        photograph(body, shots[way].skin[-1], folder / f"fold_{quality}_{way}.png")
    size = np.linalg.norm(np.ptp(character.bind_points, axis=0))
    moved = shots["self"].points - shots["none"].points
    found["alone"] = float(np.linalg.norm(np.diff(moved, axis=0), axis=2).max() / size)
    for way, shot in shots.items():
        jumps = np.linalg.norm(np.diff(shot.points, 2, axis=0), axis=2) / size
        found[way]["still"] = float(jumps[-STILL + 2 :].max())
        found[way]["second"] = float(jumps.max())
    (folder / f"fold_{quality}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def built(body, quality: str, last: int, substeps: int = 1):
    """Model and character of a body as Add Soft Skin makes it, and its rig up to a frame."""
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    if not body.dynamorph.targets:
        bpy.ops.dynamorph.add_soft_skin()
    body.dynamorph.model.solver = quality.upper()
    batch.run(Job(body, goal="BUILD"))
    model = load_model(body).with_settings(body.dynamorph.model.settings())
    character = extract.read(Source.of(Skinning.of(body)))
    return model, character, rig_motion.sample_rig(body, 1, last, substeps)


def fold(rig) -> None:
    """Keys of the pose, by the names of the MakeHuman rigs."""
    rig.animation_data_clear()
    rig.data.pose_position = "POSE"
    for bone in rig.pose.bones:
        bone.matrix_basis.identity()
        bone.rotation_mode = "QUATERNION"
    for side in "lr":
        upper, lower = (rig.data.bones[f"{name}_{side}"].y_axis for name in ("upperarm", "lowerarm"))
        turns = {"thigh": (HIPS, Vector((1, 0, 0))), "calf": (KNEES, Vector((1, 0, 0))),
                 "lowerarm": (ELBOWS, upper.cross(lower).normalized())}  # fmt: skip
        for name, (degrees, axis) in turns.items():
            bone = rig.pose.bones[f"{name}_{side}"]
            rest = bone.bone.matrix_local.to_3x3()
            for step in range(FOLDS + STILL + 1):
                t = min(step / FOLDS, 1.0)
                turn = Matrix.Rotation(np.radians(degrees) * t * t * (3 - 2 * t), 3, axis)
                bone.rotation_quaternion = (rest.inverted() @ turn @ rest).to_quaternion()
                bone.keyframe_insert("rotation_quaternion", frame=1 + step)


class Shot:
    """The whole skin (F, V, 3), and the points that are looked at (F, P, 3), world space."""

    def __init__(self, skin: np.ndarray, points: np.ndarray):
        self.skin, self.points = skin, points


def simulated(model, character, rig, settings) -> tuple[Shot, dict]:
    player = Player(model, character, settings)
    frames = list(player.run(rig))
    transforms = player.posing.frames(rig)
    skin = []
    for frame, transform in zip(frames, transforms, strict=True):
        moved = player.skin.surface(player.displacement(frame.coordinates))
        moved = moved + np.tensordot(frame.weights, player.skin.residual_shapes, 1)
        skin.append(player.posing.skin.posed(transform, moved @ model.to_bind.T))
    points = looked_at(model, character)
    steps = [frame.steps for frame in frames[1:]]
    return Shot(np.array(skin), np.array([points.of(each) for each in skin])), {
        "milliseconds": 1000 * float(np.median([step.seconds for step in steps])),
        "folding": 1000 * float(np.mean([step.seconds for step in steps])),
        "apart": 1000 * float(np.median([step.seconds for step in steps[:APART]])),
        "iterations": float(np.mean([step.iterations for step in steps])),
        "most": max(step.iterations for step in steps),
        "converged": all(step.converged for step in steps),
        "contacts": max(step.contacts for step in steps),
        "too_deep": max(step.too_deep for step in steps),
    }


def looked_at(model, character):
    return contact_points(model, character).at_most(POINTS)


class Inside:
    """Which points are inside another limb."""

    def __init__(self, model, character, shot: Shot):
        self.points, self.places, self.skin = looked_at(model, character), shot.points[-1], shot.skin[-1]
        self.size = np.linalg.norm(np.ptp(character.bind_points, axis=0))
        self.rest = self.points.rest
        body = dynamorph.Thickness(character.bind_points, character.soft_triangles)
        self.thickness = body.at(self.rest)[0]
        groups = [limb(name) for name in character.skeleton.names] + ["torso"]
        of_bones = np.array(groups)[: character.weights.shape[1]]
        self.limbs = sorted(set(groups))
        parts = np.column_stack([character.weights[:, of_bones == each].sum(axis=1) for each in self.limbs])
        self.limb = np.array(self.limbs)[self.points.of(parts).argmax(axis=1)]
        self.of_vertex = np.array(self.limbs)[parts.argmax(axis=1)]
        self.triangles, self.character = character.soft_triangles, character

    def deep(self, inner: str, outer: str) -> np.ndarray:
        """Depths, in sizes, of the points of one limb in another, away from the joint."""
        skin = self.skin
        own = self.triangles[(self.of_vertex[self.triangles] == outer).any(axis=1)]
        vertices = np.unique(own)
        if len(own) < 50:
            return np.zeros(0)
        low, high = skin[vertices].min(axis=0), skin[vertices].max(axis=0)
        near = np.flatnonzero((self.limb == inner) & (self.places > low).all(axis=1) & (self.places < high).all(axis=1))
        near = near[nearest(self.rest[near], self.character.bind_points[vertices]) >= CREASE * self.thickness[near]]
        within = near[winding_numbers(self.places[near], skin, own) > 0.5]
        return nearest(self.places[within], skin[vertices]) / self.size

    def between(self, *names: str) -> dict:
        pairs = [(a, b) for a in self.limbs for b in self.limbs
                 if {a.split("_")[0], b.split("_")[0]} == set(names)]  # fmt: skip
        depths = np.concatenate([self.deep(a, b) for a, b in pairs])
        return {"inside": len(depths), "deepest": float(depths.max(initial=0.0))}

    def all(self) -> dict:
        out = {}
        for a in self.limbs:
            for b in self.limbs:
                if a != b and len(depths := self.deep(a, b)):
                    out[f"{a} in {b}"] = [len(depths), round(100 * float(depths.max()), 2)]
        return out


def limb(bone: str) -> str:
    side = bone[-2:] if bone.endswith(("_l", "_r")) else ""
    for name in ("thigh", "calf", "upperarm", "lowerarm"):
        if bone.startswith(name):
            return name + side
    if bone.startswith(("foot", "ball")):
        return "foot" + side
    if bone.startswith(("hand", "index", "middle", "pinky", "ring", "thumb")):
        return "hand" + side
    return "head" if bone.startswith("head") else "torso"


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The distance (P,) of each of the points (P, 3) from the nearest of the others (N, 3)."""
    out = np.empty(len(points))
    for first in range(0, len(points), 256):
        chunk = points[first : first + 256]
        square = (chunk**2).sum(axis=1)[:, None] + (others**2).sum(axis=1) - 2 * chunk @ others.T
        out[first : first + 256] = np.sqrt(square.min(axis=1, initial=np.inf).clip(0.0))
    return out


def photograph(body, skin: np.ndarray, path: Path) -> None:
    """The skin (V, 3) alone."""
    mesh = body.data.copy()
    if mesh.shape_keys:
        shown = bpy.data.objects.new("Shown", mesh)
        shown.shape_key_clear()
    else:
        shown = bpy.data.objects.new("Shown", mesh)
    mesh.vertices.foreach_set("co", skin.astype(np.float32).ravel())
    bpy.context.scene.collection.objects.link(shown)
    hidden = [obj for obj in bpy.context.scene.objects if obj != shown and obj.type == "MESH" and not obj.hide_render]
    for obj in hidden:
        obj.hide_render = True
    bpy.context.scene.display.shading.show_cavity = True
    bpy.context.scene.timeline_markers.clear()  # they switch cameras
    aim(skin, CELL)
    render([1], CELL, "BLENDER_WORKBENCH")[0].save(path)
    bpy.data.objects.remove(shown)
    for obj in hidden:
        obj.hide_render = False


if __name__ == "__main__":
    sys.exit(main())
