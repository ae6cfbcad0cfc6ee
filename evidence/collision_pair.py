# SPDX-License-Identifier: GPL-3.0-or-later
"""Two characters press their bellies on each other, for collision.py.

    python evidence/collision_pair.py ASSET ASSET FOLDER full|reduced

FOLDER gets e.g. pair_full.json, and pictures, pair_full_alone.png and pair_full_together.png. The second character
turns to the first, and its armature moves on in 24 steps of 1/96 s, until their torsos would be in each other by 3 % of
the first one's size; then it stands for 12. What is inside is known by the winding number of the other's skin, for
those of 3,000 points that belong to the torso.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

from collision_fold import CELL, RATE, built, limb, looked_at, nearest  # isort: skip  (it sets up what is imported next)
import bpy
import characters
import dynamic_morph_targets
import numpy as np
from contact_sheet import quiet, render
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.player import STEP
from dynamic_morph_targets.core.settings import SimulationSettings
from mathutils import Vector
from measures import winding_numbers
from portrait import aim

COMES, STANDS = 24, 12  # steps
OVERLAP = 0.03  # of the first one's size


def main() -> int:
    first, second, folder, quality = Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4]
    folder.mkdir(parents=True, exist_ok=True)
    dynamic_morph_targets.register()
    with quiet():
        characters.open_file(first)
        bodies = [characters.largest_skinned()]
        bodies.append(appended(second))
        meet(*bodies)
        made = [built(body, quality, 1 + COMES + STANDS) for body in bodies]
    settings = SimulationSettings(1, 1 + COMES + STANDS, RATE, 1, collision=True)
    ways = {"alone": shots(made, settings, False), "together": shots(made, settings, True)}
    again = shots(made[::-1], settings, True)[::-1]
    found: dict = {"names": [first.stem, second.stem]}
    for way, played in ways.items():
        skins = [skin_of(shot, rig) for shot, (*_, rig) in zip(played, made, strict=True)]
        steps = np.concatenate([shot.kept()["steps"][1:] for shot in played])
        by_name = dict(zip(STEP, steps.T, strict=True))
        found[way] = inside(made, skins) | {
            "milliseconds": 2000 * float(np.median(by_name["seconds"])),  # of both
            "iterations": float(by_name["iterations"].mean()),
            "converged": bool(by_name["converged"].all()),
            "too_deep": float(by_name["too_deep"].max()),
        }
        photograph(bodies, skins, folder / f"pair_{quality}_{way}.png")
    found["size"] = size = ways["together"][0].player.size
    found["order"] = max(
        float(np.abs(skin_of(one, rig) - skin_of(other, rig)).max()) / size
        for one, other, (*_, rig) in zip(ways["together"], again, made, strict=True)
    )
    found["force"] = force(made, settings)
    (folder / f"pair_{quality}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def appended(path: Path):
    """The largest skinned mesh of another file, with its armature."""
    before = set(bpy.data.objects)
    with bpy.data.libraries.load(str(path)) as (source, target):
        target.objects = source.objects
    new = [obj for obj in bpy.data.objects if obj not in before]
    for obj in new:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    skinned = [obj for obj in new if obj.type == "MESH" and any(m.type == "ARMATURE" for m in obj.modifiers)]
    return max(skinned, key=lambda obj: len(obj.data.vertices))


def meet(first, second) -> None:
    """Keys of the second one's armature."""
    rigs = [characters.armature_of(body) for body in (first, second)]
    for rig in rigs:
        rig.animation_data_clear()
        rig.data.pose_position = "POSE"
        for bone in rig.pose.bones:
            bone.matrix_basis.identity()
    moved = rigs[1]
    while moved.parent:
        moved = moved.parent
    moved.rotation_mode = "XYZ"
    moved.rotation_euler.z += np.pi
    bpy.context.view_layer.update()
    fronts = [torso(body)[:, 1] for body in (first, second)]
    size = np.linalg.norm(first.dimensions)
    touching = fronts[0].min() - fronts[1].max()
    start = moved.location.y
    for step in range(COMES + STANDS + 1):
        t = min(step / COMES, 1.0)
        moved.location.y = start + touching + size * OVERLAP * (2 * t * t * (3 - 2 * t) - 1)
        moved.keyframe_insert("location", index=1, frame=1 + step)


def torso(body) -> np.ndarray:
    """Points (V, 3) of a body that its spine moves most, world space."""
    names = {group.index: group.name for group in body.vertex_groups}
    world = np.array(body.matrix_world)
    points = [
        world[:3, :3] @ vertex.co + world[:3, 3]
        for vertex in body.data.vertices
        if vertex.groups and limb(names[max(vertex.groups, key=lambda each: each.weight).group]) == "torso"
    ]
    return np.array(points)


def shots(made, settings, together: bool) -> list[simulate.Shot]:
    played = [simulate.Shot(model, character, settings) for model, character, _ in made]
    rigs = [rig for *_, rig in made]
    if together:
        simulate.play_together(played, rigs)
    else:
        for shot, rig in zip(played, rigs, strict=True):
            shot.play(rig)
    return played


def skin_of(shot: simulate.Shot, rig) -> np.ndarray:
    """The skin (V, 3) at the last frame, world space."""
    player = shot.player
    moved = player.skin.surface(player.displacement(player.coordinates))
    moved = moved + np.tensordot(shot.kept()["weights"][-1], player.skin.residual_shapes, 1)
    return player.posing.skin.posed(player.posing.frames(rig)[-1], moved @ player.model.to_bind.T)


def inside(made, skins) -> dict:
    """How many points of each are inside the other, and how deep they are, in sizes of the first."""
    depths = []
    for (model, character, _), own, (_, other, _), skin in zip(made, skins, made[::-1], skins[::-1], strict=True):
        points = looked_at(model, character)
        limbs = np.array([limb(name) for name in character.skeleton.names])
        of_torso = points.of(character.weights[:, : len(limbs)])[:, limbs == "torso"].sum(axis=1) > 0.5
        places = points.of(own)
        near = places[of_torso & ((places > skin.min(axis=0)) & (places < skin.max(axis=0))).all(axis=1)]
        within = near[winding_numbers(near, skin, other.soft_triangles) > 0.5]
        depths.append(nearest(within, skin))
    size = np.linalg.norm(np.ptp(made[0][1].bind_points, axis=0))
    return {"inside": sum(map(len, depths)), "deepest": float(np.concatenate(depths).max(initial=0.0) / size)}


def force(made, settings) -> float:
    """Of the bodies on each other at the end, newtons."""
    shorter = replace(settings, frame_end=settings.frame_end - 1)
    played = shots([(model, character, rig[:-1]) for model, character, rig in made], shorter, True)
    players = [shot.player for shot in played]
    last = [rig[-1:] for *_, rig in made]
    coupling = simulate.Coupling(players)
    (frames,) = coupling.play(last, [settings.frame_end])
    return float(np.linalg.norm(frames[0].steps.body_force))


def photograph(bodies, skins, path: Path) -> None:
    """The skins (V, 3) alone, cut in the middle and seen from aside."""
    for obj in bpy.context.scene.objects:
        obj.hide_render = obj.type == "MESH"
    shown = []
    for body, skin in zip(bodies, skins, strict=True):
        mesh = body.data.copy()
        obj = bpy.data.objects.new("Shown", mesh)
        if mesh.shape_keys:
            obj.shape_key_clear()
        mesh.vertices.foreach_set("co", skin.astype(np.float32).ravel())
        bpy.context.scene.collection.objects.link(obj)
        shown.append(obj)
    bpy.context.scene.display.shading.show_cavity = True
    bpy.context.scene.timeline_markers.clear()
    low, high = skins[0].min(axis=0), skins[0].max(axis=0)
    points = np.concatenate(skins)
    height = (points[:, 2] - low[2]) / (high[2] - low[2])
    aim(points[(height > 0.42) & (height < 0.8) & (np.abs(points[:, 0]) < 0.1)], CELL, Vector((1, 0, 0)))
    camera = bpy.context.scene.camera
    camera.data.clip_start = camera.location.x - 0.5 * (low + high)[0]
    render([1], CELL, "BLENDER_WORKBENCH")[0].save(path)
    for obj in shown:
        bpy.data.objects.remove(obj)


if __name__ == "__main__":
    sys.exit(main())
