# SPDX-License-Identifier: GPL-3.0-or-later
"""One character, one click, for believable.py: bakes it, measures the saved file and takes its pictures.

    python evidence/believable_bake.py ASSET FOLDER [CLIP]

FOLDER gets figures.json, and plain.png, baked.png, heat.png and strip_1.png to strip_5.png if there was a bake. CLIP:
an action; the liveliest if none is given.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path

import project  # noqa: F401
import fresh_blender  # noqa: F401

import bpy
import characters
import dynamic_morph_targets
import numpy as np
from believable_measure import NATURAL, baked_keys, positions, rest, show, world_points
from contact_sheet import quiet, render
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.motion import shake
from dynamic_morph_targets.run.bake import job
from dynamic_morph_targets.ui.operators import jobs
from heat import paint
from mathutils import Matrix, Vector
from portrait import aim

TOOL = Path(__file__).with_name("believable_measure.py")
FRAMES = 48  # of a clip at most
TRIED = 600  # vertices whose motion says which clip is the liveliest
HARDLY = 0.005  # body sizes: a clip that shakes it less is replaced by a hop and a twist
AT_ALL = 0.0005  # body sizes: an everyday clip shakes it at least so much
EVERYDAY = ("walk", "run", "jog", "swim", "fly", "gallop", "idle")  # with which words of such a clip's name begin
HOP = "hop and twist"  # the clip of a character that has none
HOPS = 1.0  # seconds they take; then comes the twist
CELL = (390, 260)
STRIP_CELL, STRIP = (234, 176), 5  # pixels of a picture of the strip, and how many frames it has
COLORS = {0.0: (0.45, 0.47, 0.5), 0.01: (0.16, 0.42, 0.72), 0.03: (0.2, 0.65, 0.3), 0.05: (0.95, 0.8, 0.15),
          0.1: (0.85, 0.1, 0.05), 0.2: (0.6, 0.0, 0.6)}  # fmt: skip  # of |displacement| / size


def main() -> int:
    asset, folder = Path(sys.argv[1]), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    found = {"file": asset.name, "blender": bpy.app.version_string}
    dynamic_morph_targets.register()
    try:
        measure(asset, folder, found)
    except Exception as error:
        traceback.print_exc()
        found["error"] = f"{type(error).__name__}: {error}".strip()
    (folder / "figures.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def measure(asset: Path, folder: Path, found: dict) -> None:
    """found: is filled as far as it comes. Raises what opening and baking raise."""
    began = time.perf_counter()
    with quiet():
        characters.open_file(asset)
    found["seconds"] = {"open": time.perf_counter() - began}
    body = characters.largest_skinned()
    rig = characters.armature_of(body)
    found |= {"body": body.name, "vertices": sum(len(each.data.vertices) for each in skinned(rig))}
    found |= choose_clip(rig, *sys.argv[3:])
    done = click(body, found)
    if done is None:
        return
    found |= of_job(done)
    found["seconds"] |= of_stages(done)
    with tempfile.TemporaryDirectory(prefix="dynamorph_believable_") as place:
        baked = Path(place) / f"{asset.stem}.blend"
        with quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(baked), check_existing=False)
        run = subprocess.run([sys.executable, TOOL, baked], capture_output=True, text=True, check=False)
    if run.returncode:
        raise RuntimeError(f"{TOOL.name}: {run.stderr.strip() or run.stdout[-500:]}")
    found["measured"] = json.loads(run.stdout.strip().splitlines()[-1])
    found |= photograph(rig, folder)


def skinned(rig) -> list:
    """The meshes that this armature skins."""
    meshes = (obj for obj in bpy.context.scene.objects if obj.type == "MESH" and obj.data.polygons)
    return [obj for obj in meshes if characters.armature_of(obj) == rig]


# The click ------------------------------------------------------------------------------------------------------------


def click(body, found: dict) -> job.Job | None:
    """Add Soft Skin and Bake; the job, or None if one of them refused, and then `found` says why."""
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    batches, run_all = [], jobs.run_all

    def recorded(batch, tick=None):
        batches.append(batch)
        run_all(batch, tick)

    jobs.run_all = recorded
    began = time.perf_counter()
    try:
        bpy.ops.dynamorph.add_soft_skin()
        found["seconds"]["add"] = time.perf_counter() - began
        bpy.ops.dynamorph.bake()
    except RuntimeError as error:
        found["refused"] = str(error).removeprefix("Error: ").strip()
    finally:
        jobs.run_all = run_all
        found["seconds"]["click to baked"] = time.perf_counter() - began
    return None if "refused" in found else batches[-1].jobs[-1]


def of_job(job: job.Job) -> dict:
    """What the bake says of itself."""
    tets = len(job.outcome.model.tets)
    held = job.outcome.verdict.held
    return {
        "held": {"bone": held.bone, "excess": held.excess, "frames": held.frames},
        "between_frames": held.reached,
        "pulled": held.pulled,
        "verdict": job.outcome.verdict.text,
        "nodes": len(job.outcome.model.nodes),
        "tets": tets,
        "modes": job.outcome.model.summary.modes,
        "inverted_tets": job.outcome.report["inverted"],
        "inverted": job.outcome.report.get("inverted_volume", job.outcome.report["inverted"] / max(tets, 1)),
        "warnings": job.warnings,
        "summary": job.summary(),
    }


def of_stages(job: job.Job) -> dict[str, float]:
    """Seconds by stage of the job and, as "build: ...", of what a build consists of."""
    built = {f"build: {stage}": seconds for stage, seconds in job.outcome.model.summary.seconds.items()}
    return job.progress.seconds | built


# The clip -------------------------------------------------------------------------------------------------------------


def choose_clip(rig, name: str = "") -> dict:
    """Let the rig play the liveliest part of this clip of the file's, by default of the liveliest, or hop and twist
    where none moves it much. Also returns the name of an everyday clip, empty if there is no other."""
    areas = [surface(obj) for obj in skinned(rig)]
    whole, random = sum(each.sum() for each in areas), np.random.default_rng(0)
    meshes = [
        Sampled(obj, rig, random.choice(len(area), int(TRIED * area.sum() / whole) + 1, p=area / area.sum()))
        for obj, area in zip(skinned(rig), areas, strict=True)
    ]
    size = size_of(meshes)
    scene = bpy.context.scene
    tried = {}
    if rig.animation_data:
        for track in rig.animation_data.nla_tracks:
            track.mute = True
        for action in bpy.data.actions:
            rig.animation_data.action = action
            if rig.animation_data.action_suitable_slots:
                rig.animation_data.action_slot = rig.animation_data.action_suitable_slots[0]
                tried[action.name] = liveliest(meshes, size, *(round(frame) for frame in action.frame_range))
    name = name or max(
        (name for name in tried if tried[name][0] >= HARDLY), key=lambda name: tried[name][0], default=HOP
    )
    if name == HOP:
        first, last = 1, FRAMES
        hop_and_twist(rig, size)
        lively, *_ = liveliest(meshes, size, first, last)
    else:
        lively, first, last = tried[name]
        characters.play(rig, bpy.data.actions[name])
    scene.frame_start, scene.frame_end = first, last
    scene.frame_set(first)
    other = {name: lively for name, (lively, *_) in tried.items() if lively >= AT_ALL} | {name: 0.0}
    del other[name]
    return {
        "clip": name,
        "frames": [first, last],
        "fps": scene.render.fps,
        "lively": lively,
        "everyday": everyday(other),
    }


def everyday(clips: dict[str, float]) -> str:
    """Of clips and how lively they are: one that is named so, the plainest name first; otherwise the calmest."""

    def order(name: str) -> tuple:
        words = re.findall("[a-z]+", name.rpartition("|")[2].lower())
        kind = next(
            (k for k, kind in enumerate(EVERYDAY) if any(word.startswith(kind) for word in words)), len(EVERYDAY)
        )
        return kind, len(words) if kind < len(EVERYDAY) else 0, clips[name]

    return min(clips, key=order, default="")


def surface(obj) -> np.ndarray:
    """Of each face, world units squared."""
    areas = np.empty(len(obj.data.polygons), np.float32)
    obj.data.polygons.foreach_get("area", areas)
    return areas.astype(float) * obj.matrix_world.median_scale**2 + 1e-30


class Sampled:
    """A vertex of each of some faces of a skinned mesh, with its weights."""

    def __init__(self, obj, rig, faces):
        self.obj, self.rig = obj, rig
        names = {group.index: group.name for group in obj.vertex_groups}
        self.bones = [bone.name for bone in rig.data.bones if bone.use_deform]
        row = {name: k for k, name in enumerate(self.bones)}
        self.points = np.ones((len(faces), 4))
        self.weights = np.zeros((len(faces), len(self.bones)))
        for k, face in enumerate(faces):
            vertex = obj.data.vertices[obj.data.polygons[int(face)].vertices[0]]
            self.points[k, :3] = vertex.co
            for group in vertex.groups:
                if names[group.group] in row:
                    self.weights[k, row[names[group.group]]] += group.weight
        self.weights /= np.maximum(self.weights.sum(1, keepdims=True), 1e-9)
        self.unposed = np.array([np.linalg.inv(rig.data.bones[name].matrix_local) for name in self.bones])

    def posed(self) -> np.ndarray:
        """Where bones alone have them now (V, 3), world."""
        rig = np.array(self.rig.matrix_world)
        matrices = np.array([self.rig.pose.bones[name].matrix for name in self.bones]) @ self.unposed
        skinning = np.einsum("vb,bij->vij", self.weights, matrices)
        local = self.points @ np.array(self.obj.matrix_world).T @ np.linalg.inv(rig).T
        return (np.einsum("vij,vj->vi", skinning, local) @ rig.T)[:, :3]


def size_of(meshes: list[Sampled]) -> float:
    """Diagonal of the box around them at rest, world."""
    corners = [np.array([each.obj.matrix_world @ vertex.co for vertex in each.obj.data.vertices]) for each in meshes]
    return diagonal(np.concatenate(corners))


def liveliest(meshes: list[Sampled], size: float, first: int, last: int) -> tuple[float, int, int]:
    """RMS acceleration over NATURAL², body sizes, in the liveliest part of these frames; its first and last frame."""
    scene = bpy.context.scene
    paths = []
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        paths.append(np.concatenate([each.posed() for each in meshes]))
    if len(paths) < 3:
        return 0.0, first, last
    squares = (np.diff(paths, 2, axis=0) ** 2).sum(2).mean(1)
    window = min(FRAMES - 2, len(squares))
    sums = np.convolve(squares, np.ones(window), "valid")
    begin = int(sums.argmax())
    lively = np.sqrt(max(sums[begin], 0.0) / window) * scene.render.fps**2 / NATURAL**2 / size
    return float(lively), first + begin, first + begin + window + 1


def hop_and_twist(rig, size: float) -> None:
    """Keyframes on the rig, in its rest pose: two hops and a turn about the vertical,
    as far and as fast as in the add-on's shake tests."""
    scene = bpy.context.scene
    rig.animation_data_clear()
    for bone in rig.pose.bones:
        bone.matrix_basis = Matrix()
    bpy.context.view_layer.update()
    seconds = np.arange(FRAMES) / (scene.render.fps / scene.render.fps_base)
    heights, _ = shake.shake("HOP", seconds)
    _, angles = shake.shake("TWIST", seconds - HOPS)
    world = rig.matrix_world.copy()
    rotation = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}
    for frame, (height, angle) in enumerate(zip(heights, angles, strict=True), 1):
        turned = Matrix.Rotation(angle, 4, "Z") @ world
        turned.translation = world.translation
        turned.translation.z += size * height
        rig.matrix_world = turned
        rig.keyframe_insert("location", frame=frame)
        rig.keyframe_insert(rotation.get(rig.rotation_mode, "rotation_euler"), frame=frame)


# Pictures -------------------------------------------------------------------------------------------------------------


def photograph(rig, folder: Path) -> dict:
    """plain.png, baked.png and heat.png at the frame of the largest displacement, and the strip around it. Returns that
    frame, and the strip's frames and their displacements, of size."""
    scene = bpy.context.scene
    frames = range(scene.frame_start, scene.frame_end + 1)
    soft = {obj: displacements(obj, frames) for obj in scene.objects if baked_keys(obj)}
    farthest = np.max([lengths.max(axis=1) for lengths in soft.values()], axis=0)
    worst = int(farthest.argmax())
    scene.frame_set(frames[worst])
    shown = [obj for obj in scene.objects if obj.type == "MESH" and obj.visible_get() and belongs(obj, rig)]
    for obj in scene.objects:
        obj.hide_render = obj not in shown and obj.type != "LIGHT"
    size = diagonal(np.concatenate([rest(obj) for obj in soft]))
    for obj in shown:
        lengths = soft[obj][worst] if obj in soft else np.zeros(len(obj.data.vertices))
        paint(obj.data, lengths / size, COLORS)
    scene.display.shading.show_cavity = True
    scene.view_settings.view_transform = "Standard"
    aim(seen(shown), CELL)
    for name, color in (("plain", "MATERIAL"), ("baked", "MATERIAL"), ("heat", "VERTEX")):
        show(plain=name == "plain")
        scene.display.shading.color_type = color
        render([frames[worst]], CELL, "BLENDER_WORKBENCH")[0].save(folder / f"{name}.png")
    place = max(soft, key=lambda obj: soft[obj][worst].max())
    first = min(max(worst - STRIP // 2, 0), max(len(frames) - STRIP, 0))
    strip = frames[first : first + STRIP]
    scene.display.shading.color_type = "MATERIAL"
    photograph_strip(shown, strip, place, int(soft[place][worst].argmax()), folder)
    return {
        "worst_frame": frames[worst],
        "strip": list(strip),
        "strip_displacements": (farthest[first : first + STRIP] / size).tolist(),
    }


def photograph_strip(shown: list, frames: range, obj, vertex: int, folder: Path) -> None:
    """strip_1.png to strip_5.png: these meshes in consecutive frames, by a camera that follows a vertex as the bones
    alone move it."""
    scene = bpy.context.scene
    points, followed = [], []
    for frame in frames:
        scene.frame_set(frame)
        points.append(seen(shown))
        show(plain=True)
        followed.append(world_points(obj)[vertex])
        show(plain=False)
    aim(np.concatenate([here - place for here, place in zip(points, followed, strict=True)]), STRIP_CELL)
    camera = scene.camera
    home = camera.location.copy()
    for number, (frame, place) in enumerate(zip(frames, followed, strict=True), 1):
        camera.location = home + Vector(place)
        render([frame], STRIP_CELL, "BLENDER_WORKBENCH")[0].save(folder / f"strip_{number}.png")


def seen(shown: list) -> np.ndarray:
    """Where these meshes are now, as the bones alone have them and as baked (V, 3), world."""
    points = []
    for plain in (True, False):
        show(plain=plain)
        points += [world_points(obj) for obj in shown]
    return np.concatenate(points)


def belongs(obj, rig) -> bool:
    """Whether the rig moves this object: by skinning, or as a parent."""
    if obj.type == "MESH" and characters.armature_of(obj) == rig:
        return True
    while obj and obj != rig:
        obj = obj.parent
    return obj == rig


def displacements(obj, frames) -> np.ndarray:
    """How far the baked keys move each vertex (F, V) before the bones do, world units."""
    keys = baked_keys(obj)
    shapes = np.array([positions(key.data) - positions(key.relative_key.data) for key in keys])
    shapes = shapes @ np.array(obj.matrix_world.to_3x3()).T
    lengths = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        values = np.array([key.value for key in keys])
        lengths.append(np.linalg.norm(np.tensordot(values, shapes, 1), axis=1))
    return np.array(lengths)


if __name__ == "__main__":
    sys.exit(main())
