# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints that physics shapes, for shapes.py: how plain skinning folds them, and how the targets do.

Characters of ../shared/assets are left out where those are not there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from project import ROOT

import bpy
import numpy as np
from contact_sheet import quiet
from dynamic_morph_targets.core.geometry import diagonal, welded
from dynamic_morph_targets.scene.motion import rig_motion
from dynamic_morph_targets.scene.read import mesh_data
from dynamic_morph_targets.scene.store import model_store
from dynamic_morph_targets.write.authoring import targets
from mathutils import Quaternion, Vector
from performance_page import grid
from recipes import cast
from shapes_posed import deepest, intersecting_pairs, side_by_side, volume_of

ASSETS = ROOT.parent / "shared" / "assets"
OPS = bpy.ops.dynamorph
ANGLE, OTHERS = 110, (55, 80, 130)  # degrees: of the target's pose, and where it blends
FORWARD, UP, SIDE = Vector((0, -1, 0)), Vector((0, 0, 1)), Vector((1, 0, 0))


@dataclass(frozen=True)
class Joint:
    """bones: names that it has, by rig, lower case and without dots; axis: world space, about which it bends."""

    name: str
    bones: tuple[str, ...]
    axis: Vector | None  # None: the elbow's, which brings the hand forward


JOINTS = (
    Joint("elbow", ("lowerarm_l", "lowerarml", "forearm_l"), None),
    Joint("knee", ("calf_l", "lowerlegl"), SIDE),
    Joint("hip", ("thigh_l", "upperlegl"), -SIDE),
    Joint("shoulder", ("upperarm_l", "upperarml"), FORWARD),
)


@dataclass(frozen=True)
class State:
    """Of a bent joint. pairs: that intersect; depth: the deepest, relative to the body's size; volume: of the limb, 1
    at rest.
    """

    pairs: int
    depth: float
    volume: float


@dataclass(frozen=True)
class Measured:
    """plain, shaped: at `ANGLE`; others: the same of `OTHERS`. least: volume of a tetrahedron in bind space, 1 at rest.
    picture: plain and shaped vertices, triangles, and which vertices (V,) are the limb's.
    """

    character: str
    joint: str
    plain: State
    shaped: State
    others: dict[int, tuple[State, State]]
    least: float
    seconds: float
    picture: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def characters() -> Iterator[tuple[str, Path | None]]:
    yield "Herbert", None
    for name in ("mh_male_53bones.blend", "mh_chubby_53bones.blend"):
        yield name.removesuffix("_53bones.blend"), ASSETS / name
    for name in ("Man_Suit", "Woman_Casual", "Man_Beach"):
        yield name, ASSETS / "zoo" / f"{name}.glb"


def opened(path: Path | None, joint: Joint) -> bpy.types.Object:
    """The mesh of a character that the joint bends most, at rest, as a soft skin."""
    with quiet():
        if path is None:
            return soft(cast.herbert(cast.stand, "Stand"))
        if path.suffix == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path))
        else:
            bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
            bpy.ops.import_scene.gltf(filepath=str(path))
        meshes = [each for each in bpy.context.scene.objects if each.type == "MESH" and each.find_armature()]
        return soft(max(meshes, key=lambda each: carried(each, joint)))


def carried(body: bpy.types.Object, joint: Joint) -> int:
    """How many vertices the joint's bone moves together with others."""
    numbers = {group.index for group in body.vertex_groups if plain_name(group.name) in joint.bones}
    return sum(
        any(group.group in numbers and 0.05 < group.weight < 0.95 for group in vertex.groups)
        for vertex in body.data.vertices
    )


def plain_name(bone: str) -> str:
    return bone.lower().replace(".", "")


def soft(body: bpy.types.Object) -> bpy.types.Object:
    rig, keys = body.find_armature(), body.data.shape_keys
    rig.animation_data_clear()
    if keys:  # shapes that the rig drives are not skinning
        keys.animation_data_clear()
        for key in keys.key_blocks[1:]:
            key.value = 0.0
    for track in [*(rig.animation_data.nla_tracks if rig.animation_data else ())]:
        rig.animation_data.nla_tracks.remove(track)
    for bone in rig.pose.bones:
        bone.matrix_basis.identity()
        bone.rotation_mode = "QUATERNION"
    cast.activate(body)
    OPS.add_soft_skin()
    return body


def measured(name: str, path: Path | None, joint: Joint) -> Measured | None:
    """None where the rig has no such bone, or skinning bends nothing there."""
    body = opened(path, joint)
    rig = body.find_armature()
    bones = {plain_name(bone.name): bone for bone in rig.pose.bones}
    bone = next((bones[each] for each in joint.bones if each in bones), None)
    if bone is None:
        return None
    axis, straight = local_axis(rig, bone, joint)
    bend(bone, axis, ANGLE - straight)
    began = time.perf_counter()
    with quiet():
        OPS.shape_by_physics()
        seconds = time.perf_counter() - began
        OPS.build()
    target = body.dynamorph.active_target
    model, key = model_store.load_model(body), body.data.shape_keys.key_blocks[target.name]
    shape = mesh_data.target_shape(body, target.name)
    # Importers split vertices at seams of UVs.
    places = welded(cast.coordinates(body.data))
    first = np.unique(places, return_index=True)[1]
    triangles = first[places[mesh_data.mesh_triangles(body.data)]]
    triangles = triangles[(np.diff(np.sort(triangles, axis=1)) > 0).all(axis=1)]
    moved = np.linalg.norm(shape @ model.to_bind.T, axis=1)
    if not moved.any():
        return None
    far = np.median(model.thickness[: len(shape)][moved > 0.1 * moved.max()]) / 3.0 / body.matrix_world.median_scale
    whole = np.ones(len(triangles), bool)
    limb = (moved > 0.02 * moved.max())[triangles].all(axis=1)
    bend(bone, axis, 0)
    rest = shown(body, key, 0.0)

    at_rest = {*map(tuple, intersecting_pairs(rest, triangles, rest, far).tolist())}

    def state(points: np.ndarray) -> State:
        pairs = intersecting_pairs(points, triangles, rest, far)
        pairs = np.array([pair for pair in pairs.tolist() if tuple(pair) not in at_rest], int).reshape(-1, 2)
        # The rest of the body keeps its volume: what is gained or lost is the limb's.
        gained = volume_of(points, triangles, whole) - volume_of(rest, triangles, whole)
        volume = 1.0 + gained / volume_of(rest, triangles, limb)
        return State(len(pairs), deepest(points, triangles, pairs) / diagonal(rest), volume)

    found = {}
    for angle in (ANGLE, *OTHERS):
        bend(bone, axis, angle - straight)
        _, local, _ = rig_motion.current_pose(body)
        blended = targets.blended_shape(body, local)
        weight = float((blended * shape).sum() / (shape**2).sum())
        plain, shaped = shown(body, key, 0.0), shown(body, key, weight)
        found[angle] = state(plain), state(shaped)
        if angle == ANGLE:
            picture = plain, shaped, triangles, moved > 0.02 * moved.max()
    return Measured(name, joint.name, *found.pop(ANGLE), found, least_volume(model), seconds, picture)


def local_axis(rig: bpy.types.Object, bone: bpy.types.PoseBone, joint: Joint) -> tuple[Vector, float]:
    """The axis of the bone about which the joint bends, and by how many degrees an elbow is bent at rest."""
    turn = rig.matrix_world.to_3x3()
    rest = turn @ bone.bone.matrix_local.to_3x3()
    axis, straight = joint.axis, 0.0
    if axis is None:  # from joint to joint, since importers guess where bones point
        head = bone.bone.head_local
        above, along = turn @ (head - bone.parent.bone.head_local), turn @ (bone.children[0].bone.head_local - head)
        straight = np.degrees(above.angle(along))
        axis = above.cross(along) if straight > 10 else along.cross(FORWARD)
    return (rest.inverted() @ axis).normalized(), straight


def bend(bone: bpy.types.PoseBone, axis: Vector, degrees: float) -> None:
    bone.rotation_quaternion = Quaternion(axis, np.radians(degrees))
    bpy.context.view_layer.update()


def shown(body: bpy.types.Object, key: bpy.types.ShapeKey, weight: float) -> np.ndarray:
    """Where Blender shows the vertices (V, 3) with the target's key at a weight, local space."""
    key.value = weight
    bpy.context.view_layer.update()
    return cast.coordinates(body.evaluated_get(bpy.context.evaluated_depsgraph_get()).data)


def least_volume(model: object) -> float:
    """Of a tetrahedron in the shape of a target, in bind space, 1 at rest."""

    def volumes(nodes: np.ndarray) -> np.ndarray:
        corners = nodes[model.tets]
        return np.linalg.det(corners[:, 1:] - corners[:, :1])

    rest = volumes(model.nodes)
    return float(min((volumes(model.nodes + each) / rest).min() for each in model.displacements))


# The page -------------------------------------------------------------------------------------------------------------

SHOWN = (("Herbert", "knee"), ("mh_male", "hip"), ("Woman_Casual", "elbow"))
TEXT = """## Shape by Physics

Joints of six characters, bent by {angle}°: plain skinning, and the target that *Shape by Physics* makes there. An
elbow's angle counts from the straight arm. Shape keys that the rig drives itself are off. Where a character is made of
several meshes, it is the one that the joint bends; where skinning bends none, the joint is left out.

- *Pairs*: of triangles that intersect, and whose places at rest are farther apart than a third of the limb's
  thickness, plain and shaped, but those that intersect at rest. Asked: at most 5% of plain skinning's.
- *Depth*: of the deepest vertex in a triangle of another piece of skin, % of the body's size, plain and shaped. Asked:
  at most 0.3.
- *Volume*: gained or lost, % of the limb between the places where the shape begins, plain and shaped. Asked: at most 2.
- *Least*: volume of a tetrahedron in bind space, in the target's shape, 1 at rest. Asked: at least 0.1.
- *Time*: of the button, with two cores, seconds. It includes reading the character and finding its cage again.
- *At {others}°*: pairs where the target blends with the neutral one, or has been passed; plain and shaped.

{meets} of {count} joints meet what is asked of pairs, depth, volume and least volume. Values that do not are bold.

{table}
{pictures}"""


def section(picture: Callable[[str], Path]) -> str:
    """The part of the page; its pictures are written."""
    found = [
        result
        for name, path in characters()
        if path is None or path.exists()
        for joint in JOINTS
        if (result := measured(name, path, joint))
    ]
    head = "Character, joint", "Pairs", "Depth", "Volume", "Least", "Time", *(f"At {angle}°" for angle in OTHERS)
    shown = []
    for result in found:
        if (result.character, result.joint) not in SHOWN:
            continue
        plain, shaped, triangles, limb = result.picture
        file = f"{result.character}_{result.joint}.jpg".lower()
        side_by_side(picture(file), {"plain skinning": plain, "shaped by physics": shaped}, triangles, near=limb)
        shown.append(f"![{result.character}, {result.joint}](images/shapes/{file})\n")
    return TEXT.format(
        angle=ANGLE, others=", ".join(map(str, OTHERS)), count=len(found),
        meets=sum(not missed(each) for each in found),
        table=grid(head, map(row, found)), pictures="\n".join(shown),
    )  # fmt: skip


def missed(result: Measured) -> set[str]:
    """Which columns do not have what is asked."""
    plain, shaped = result.plain, result.shaped
    asked = {
        "pairs": shaped.pairs <= 0.05 * plain.pairs,
        "depth": shaped.depth <= 0.003,
        "volume": abs(shaped.volume - 1.0) <= 0.02,
        "least": result.least >= 0.1,
    }
    return {name for name, good in asked.items() if not good}


def row(result: Measured) -> list[str]:
    bad, plain, shaped = missed(result), result.plain, result.shaped

    def cell(name: str, before: str, after: str) -> str:
        after = f"**{after}**" if name in bad else after
        return f"{before} → {after}" if before else after

    return [
        f"{result.character}, {result.joint}",
        cell("pairs", str(plain.pairs), str(shaped.pairs)),
        cell("depth", f"{100 * plain.depth:.2f}", f"{100 * shaped.depth:.2f}"),
        cell("volume", f"{100 * (plain.volume - 1.0):.1f}", f"{100 * (shaped.volume - 1.0):.1f}"),
        cell("least", "", f"{result.least:.2f}"),
        f"{result.seconds:.1f}",
        *(f"{before.pairs} → {after.pairs}" for before, after in result.others.values()),
    ]
