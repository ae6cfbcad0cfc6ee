# SPDX-License-Identifier: GPL-3.0-or-later
"""How believable a baked soft skin looks, in numbers, from Blender's evaluated meshes alone.

    python evidence/believable_measure.py FILE.blend

Prints one line of JSON. Each mesh with keys of the add-on ("Dynamorph ...") is measured as baked, and with those keys
muted, which is plain skinning, in every frame of the scene. The displacement is taken in the bind pose, without the
Armature modifiers, because a body that turns does not move its tissue. Figures are weighted by the area of the rest
surface; quantiles are taken in each frame, and the worst frame counts. Lengths are relative to the size, the diagonal
of the character's box at rest, or to the local thickness.

disp_max, disp_p999      largest and 99.9th percentile of the displacement, of size
over_thickness           99th percentile over the surface of each point's largest displacement over the local thickness
stretch_lo, stretch_hi   0.1th and 99.9th percentile of an edge's length over that in plain skinning, or over half of
                         that at rest, if that is longer
plain_stretch_lo         stretch_lo of plain skinning, whose joints may make edges vanish
stretch_kept             stretch_lo over plain_stretch_lo
flipped                  share of the surface whose normal turns by over 90 degrees against plain skinning
alive, alive_area        RMS motion about its mean of the liveliest tenth, of size; share of the surface above a tenth
                         of that
thin_moves               RMS motion of the thinnest fifth of the surface over that of the thickest fifth; None where
                         that is not twice as thick: there are no thin parts
ends_move                RMS motion of hands and feet over that of the torso; None where no arms and legs are found by
                         their bones' names
shaken                   RMS acceleration of the thickest fifth of the surface in plain skinning over (2 pi 3.5 Hz)^2,
                         of size: how far tissue of 3.5 Hz is asked to move
flicker, flicker_plain   how often the displacement turns, and plain skinning in the world, see judge.flicker_of
jitter, jitter_24        share of the power of the displacement's acceleration above 0.35 of the frame rate, at the
                         scene's frames and at 24 a second; None below 16 of them
seam                     largest gap between points of different meshes of the rig that coincide at rest, baked less
                         plain, of size; None where there is one mesh
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import project  # noqa: F401

import bpy
import numpy as np
from dynamic_morph_targets.core.character import Skeleton
from dynamic_morph_targets.core.geometry import diagonal, vertex_areas
from dynamic_morph_targets.core.model import rigid
from dynamic_morph_targets.core.model.body_parts import RiggedSkin, limb_ends
from dynamic_morph_targets.core.result.judge import SPLINTER, flicker_of, quantiles
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from mathutils.kdtree import KDTree

MARK = "Dynamorph"  # with which the names of baked shape keys begin
TOPOLOGY = {"SUBSURF", "MULTIRES", "MIRROR", "SOLIDIFY", "ARRAY", "BEVEL", "DECIMATE", "REMESH", "TRIANGULATE", "WELD",
            "EDGE_SPLIT"}  # fmt: skip  # modifiers that change the number of vertices
NATURAL = 2.0 * np.pi * 3.5  # rad/s: what `shaken` refers to
STILL = 1e-5  # of size; smaller steps are what single precision leaves of a body that does not move
THINNEST = 0.02  # of size; thinner parts count as this thick
PROBES, RAYS, SPREAD = 5000, 9, 0.35  # vertices whose thickness is measured, rays of each, and how far they spread
LAYERS = 12  # of surfaces, which a ray may pass
OFF = 1e-4  # of size; how far off a surface a ray starts
LIES_ON = 0.01  # of size; what has no wider gap below it lies on what is there
HIGH = 0.35  # of the frame rate, above which acceleration is jitter
CINEMA = 24.0  # frames a second, at which characters are compared
SHORTEST = 16  # frames whose spectrum says something
TOUCHES = 1e-5  # of size; nearer points coincide


def main() -> int:
    path = Path(sys.argv[1])
    bpy.ops.wm.open_mainfile(filepath=str(path))
    print(json.dumps({"file": path.name, **measure(bpy.context.scene)}))
    return 0


def measure(scene) -> dict:
    """The figures of the scene's bake, rounded. Raises SystemExit where nothing is baked."""
    soft = [obj for obj in scene.objects if baked_keys(obj)]
    if not soft:
        raise SystemExit("no mesh here has keys of the add-on: nothing is baked")
    rigs = {modifier.object for obj in soft for modifier in armatures(obj)}
    others = [obj for obj in scene.objects if obj.type == "MESH" and obj not in soft and obj.data.polygons
              and any(modifier.object in rigs for modifier in armatures(obj))]  # fmt: skip
    for obj in soft + others:
        for modifier in obj.modifiers:
            modifier.show_viewport &= modifier.type not in TOPOLOGY
    frames = range(scene.frame_start, scene.frame_end + 1)
    rate = scene.render.fps / scene.render.fps_base
    baked = recorded(soft + others, frames)
    show(plain=True)
    plain = recorded(soft + others, frames)
    show(plain=False)
    skin = Skin.of(soft)
    motion = displacement(soft, frames) / skin.size
    at_24 = np.arange(int((len(frames) - 1) * CINEMA / rate + 1e-9) + 1) * rate / CINEMA + frames[0]
    world = np.concatenate([plain[obj] for obj in soft], axis=1) / skin.size
    found = {
        "meshes": len(soft),
        "vertices": len(skin.rest),
        "frames": len(frames),
        "size_m": round(skin.size, 3),
        **rounded(distances(motion, skin), 4),
        **rounded(edge_lengths(soft, baked, plain, skin.size), 4),
        "flipped": round(max(flipped(obj, baked[obj], plain[obj]) for obj in soft) / skin.areas.sum(), 5),
        **liveliness(motion, skin),
        "thin_moves": rounded_or_none(thin_moves(motion, skin), 3),
        "ends_move": rounded_or_none(ends_move(soft, motion, skin), 3),
        "shaken": rounded_or_none(shaken(world[:, skin.thick], skin.areas[skin.thick], rate), 4),
        "flicker": round(flicker(motion, skin.areas), 3),
        "flicker_plain": round(flicker(world, skin.areas), 3),
        "jitter": rounded_or_none(jitter(motion, skin.areas), 3),
        "jitter_24": rounded_or_none(jitter(displacement(soft, at_24), skin.areas), 3),
    }
    seam = largest_gap(soft, others, baked, plain, skin.size) if soft[1:] or others else None
    return found | {"seam": rounded_or_none(seam, 6)}


def rounded(figures: dict[str, float], digits: int) -> dict[str, float]:
    return {name: round(value, digits) for name, value in figures.items()}


def rounded_or_none(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


# Blender's meshes -----------------------------------------------------------------------------------------------------


def baked_keys(obj) -> list:
    """The add-on's keys of an object."""
    keys = obj.data.shape_keys if obj.type == "MESH" else None
    return [key for key in keys.key_blocks if key.name.startswith(MARK)] if keys else []


def armatures(obj) -> list:
    return [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE"]


def show(plain: bool) -> None:
    """The characters as baked, or as the bones alone move them."""
    for obj in bpy.context.scene.objects:
        for key in baked_keys(obj):
            key.mute = plain
    bpy.context.view_layer.update()


@contextlib.contextmanager
def in_bind_pose(objects: Sequence) -> Iterator[None]:
    shown = [modifier for obj in objects for modifier in armatures(obj) if modifier.show_viewport]
    for modifier in shown:
        modifier.show_viewport = False
    yield
    for modifier in shown:
        modifier.show_viewport = True


def positions(points) -> np.ndarray:
    """(V, 3), local."""
    found = np.empty(3 * len(points), np.float32)
    points.foreach_get("co", found)
    return found.reshape(-1, 3).astype(float)


def rest(obj) -> np.ndarray:
    """(V, 3), in the world's axes, about the object's origin."""
    keys = obj.data.shape_keys
    return positions(keys.reference_key.data if keys else obj.data.vertices) @ np.array(obj.matrix_world.to_3x3()).T


def placed(obj) -> np.ndarray:
    """The points at rest (V, 3), world."""
    return rest(obj) + np.array(obj.matrix_world.translation)


def world_points(obj) -> np.ndarray:
    """As Blender shows it now (V, 3)."""
    local, world = evaluated(obj)
    return local @ world[:3, :3].T + world[:3, 3]


def evaluated(obj) -> tuple[np.ndarray, np.ndarray]:
    """Points (V, 3), local, and the object's matrix (4, 4), as Blender shows it now."""
    shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return positions(shown.data.vertices), np.array(shown.matrix_world)


def recorded(objects: Sequence, frames: Sequence[int]) -> dict:
    """World positions (F, V, 3) of each object. Raises SystemExit where a modifier changes the number of vertices."""
    found = {obj: [] for obj in objects}
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        for obj in objects:
            found[obj].append(world_points(obj))
            if len(found[obj][-1]) != len(obj.data.vertices):
                raise SystemExit(f"{obj.name}: the evaluated mesh has another number of vertices")
    return {obj: np.array(points) for obj, points in found.items()}


def displacement(soft: Sequence, times: Sequence[float]) -> np.ndarray:
    """Baked less plain (F, V, 3), over all these objects, in the bind pose and in the world's axes of the first frame.

    times: frames, which may lie between two.
    """
    bpy.context.scene.frame_set(int(times[0]))
    axes = {obj: np.array(obj.matrix_world.to_3x3()) for obj in soft}

    def shapes() -> np.ndarray:
        found = []
        for time in times:
            bpy.context.scene.frame_set(int(time), subframe=float(time) - int(time))
            found.append(np.concatenate([evaluated(obj)[0] @ axes[obj].T for obj in soft]))
        return np.array(found)

    with in_bind_pose(soft):
        baked = shapes()
        show(plain=True)
        plain = shapes()
        show(plain=False)
    return baked - plain


def triangles_of(obj) -> np.ndarray:
    """(T, 3)."""
    obj.data.calc_loop_triangles()
    found = np.empty(3 * len(obj.data.loop_triangles), np.int32)
    obj.data.loop_triangles.foreach_get("vertices", found)
    return found.reshape(-1, 3)


# The surface at rest --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Skin:
    """The surface of all soft meshes at rest. rest (V, 3), world; areas (V,), 0 at loose vertices;
    thickness (V,), NaN where it is not known."""

    rest: np.ndarray
    areas: np.ndarray
    thickness: np.ndarray
    size: float

    @classmethod
    def of(cls, soft: Sequence) -> Skin:
        surfaces = [(placed(obj), turned_outward(rest(obj), triangles_of(obj))) for obj in soft]
        first = np.cumsum([0, *(len(points) for points, _ in surfaces)])[:-1]
        points = np.concatenate([points for points, _ in surfaces])
        triangles = np.concatenate([corners + start for (_, corners), start in zip(surfaces, first, strict=True)])
        size = diagonal(points[np.unique(triangles)])
        return cls(points, vertex_areas(points, triangles), thickness(points, triangles, size), size)

    @cached_property
    def probed(self) -> np.ndarray:
        """The vertices whose thickness is known."""
        return np.flatnonzero(np.isfinite(self.thickness) & (self.areas > 0))

    @cached_property
    def thick(self) -> np.ndarray:
        """The vertices of the thickest fifth of the surface."""
        (high,) = self.probed_quantiles(self.thickness, [0.8])
        return np.flatnonzero(self.thickness >= high)  # false where it is not known

    def probed_quantiles(self, values: np.ndarray, shares: Sequence[float]) -> list[float]:
        """Of values (V,) where the thickness is known."""
        return quantiles(values[self.probed], self.areas[self.probed], shares)

    def mean(self, values: np.ndarray, where: np.ndarray) -> float:
        """RMS of values (V,) over these vertices."""
        areas = self.areas[where]
        return float(np.sqrt((areas * values[where] ** 2).sum() / max(areas.sum(), 1e-30)))


def turned_outward(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles (T, 3), all turned over where they enclose their volume from inside."""
    inward = np.einsum("ij,ij->", points[triangles[:, 0]] - points.mean(axis=0), normals_of(points, triangles)) < 0
    return triangles[:, ::-1] if inward else triangles


def thickness(points: np.ndarray, triangles: np.ndarray, size: float) -> np.ndarray:
    """Median length (V,) of rays inward to the surface behind; NaN where there is none, and at all but PROBES."""
    random = np.random.default_rng(0)
    normals = normals_of(points, triangles)
    inward = np.zeros_like(points)
    np.add.at(inward, triangles.ravel(), -np.repeat(normals, 3, axis=0))
    inward, normals = normalized(inward), normalized(normals)
    tree = BVHTree.FromPolygons(points.tolist(), triangles.tolist())
    chosen = np.flatnonzero(vertex_areas(points, triangles) > 0)
    if len(chosen) > PROBES:
        chosen = np.sort(random.choice(chosen, PROBES, replace=False))
    found = np.full(len(points), np.nan)
    for vertex in chosen:
        rays = normalized(inward[vertex] + SPREAD * random.normal(size=(RAYS, 3)))
        lengths = [length for ray in rays if (length := length_inside(tree, normals, points[vertex], ray, size))]
        if lengths:
            found[vertex] = np.median(lengths)
    return found


def length_inside(tree: BVHTree, normals: np.ndarray, point: np.ndarray, ray: np.ndarray, size: float) -> float | None:
    """How far a ray goes from a point of the surface until it has left all that it has entered and all that the point
    lies in, such as an eye or the root of a fin and the body that these are sunk into, and all that these lie on, such
    as a pocket and the coat below; where it leaves less than that, until the last back. What it leaves without having
    entered it is what the point lies in, or a sheet.
    """
    gone, lengths, backs = 0.0, [], []
    for _ in range(LAYERS):
        start = point + OFF * size * ray
        place, _, face, length = tree.ray_cast(Vector(start), Vector(ray))
        if place is None:
            break
        gone += length + OFF * size
        lengths.append(gone)
        backs.append(normals[face] @ ray > 0)
        point = np.array(place)
    if not any(backs):
        return None
    change = np.where(backs, -1, 1)
    inside = max(1, -change.sum()) + np.cumsum(change)
    lies_on_more = np.diff(lengths, append=np.inf) < LIES_ON * size
    left = np.flatnonzero(np.array(backs) & (inside <= 0) & ~lies_on_more)
    return lengths[left[0] if len(left) else np.flatnonzero(backs)[-1]]


def normals_of(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 3), twice as long as the triangles' areas."""
    a, b, c = points[triangles].swapaxes(0, 1)
    return np.cross(b - a, c - a)


def normalized(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


# Figures --------------------------------------------------------------------------------------------------------------
# motion (F, V, 3): the displacement in the bind pose, of size.


def distances(motion: np.ndarray, skin: Skin) -> dict[str, float]:
    used = skin.areas > 0
    far = np.linalg.norm(motion, axis=2)
    over = far.max(axis=0) / np.maximum(skin.thickness / skin.size, THINNEST)
    return {
        "disp_max": float(far[:, used].max()),
        "disp_p999": max(quantiles(each[used], skin.areas[used], [0.999])[0] for each in far),
        "over_thickness": skin.probed_quantiles(over, [0.99])[0],
    }


def edge_lengths(soft: Sequence, baked: dict, plain: dict, size: float) -> dict[str, float]:
    """baked, plain: world positions (F, V, 3) of each object."""

    def lengths(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)

    lows, plain_lows, highs = [], [], []
    for obj in soft:
        ends = np.empty(2 * len(obj.data.edges), np.int32)
        obj.data.edges.foreach_get("vertices", ends)
        ends = ends.reshape(-1, 2)
        ends = ends[lengths(rest(obj), ends) > SPLINTER * size]
        at_rest = lengths(rest(obj), ends)
        for moved, skinned in zip(baked[obj], plain[obj], strict=True):
            before = lengths(skinned, ends)
            compared = np.maximum(before, 0.5 * at_rest)
            low, high = quantiles(lengths(moved, ends) / compared, at_rest, [0.001, 0.999])
            lows.append(low)
            highs.append(high)
            plain_lows += quantiles(before / compared, at_rest, [0.001])
    low, plain_low = min(lows), min(plain_lows)
    kept = low / max(plain_low, 1e-4)
    return {"stretch_lo": low, "stretch_hi": max(highs), "plain_stretch_lo": plain_low, "stretch_kept": kept}


def flipped(obj, baked: np.ndarray, plain: np.ndarray) -> float:
    """The area in plain skinning (F, V, 3) of triangles whose normal turns over, in the worst frame, world units."""
    triangles, worst = triangles_of(obj), 0.0
    for moved, skinned in zip(baked, plain, strict=True):
        normals = normals_of(skinned, triangles)
        over = np.einsum("tc,tc->t", normals_of(moved, triangles), normals) < 0
        worst = max(worst, float(np.linalg.norm(normals[over], axis=1).sum() / 2))
    return worst


def liveliness(motion: np.ndarray, skin: Skin) -> dict[str, float]:
    moves = swings(motion)
    order = np.argsort(moves)
    sums = np.cumsum(skin.areas[order])
    alive = skin.mean(moves, order[sums >= 0.9 * sums[-1]])
    return {
        "alive": round(alive, 5),
        "alive_area": round(float(skin.areas[moves > 0.1 * max(alive, 1e-12)].sum() / skin.areas.sum()), 3),
    }


def thin_moves(motion: np.ndarray, skin: Skin) -> float | None:
    (low,) = skin.probed_quantiles(skin.thickness, [0.2])
    if low > 0.5 * skin.thickness[skin.thick].min():
        return None
    moves, thin = swings(motion), skin.thickness <= low  # false where it is not known
    return skin.mean(moves, thin) / max(skin.mean(moves, skin.thick), 1e-12)


def ends_move(soft: Sequence, motion: np.ndarray, skin: Skin) -> float | None:
    rigged = rigged_skin(soft, skin)
    if not rigged.arms or not rigged.legs:
        return None
    of_limbs = rigged.on(np.any([limb.bones for limb in (*rigged.arms, *rigged.legs)], axis=0))
    heads = rigid.heads(rigged.skeleton, rigged.weights, rigged.points, rigged.triangles)
    of_head = rigged.on(np.any([rigged.skeleton.below[head] for head in heads], axis=0)) if heads else 0.0
    moves, ends = swings(motion), limb_ends(rigged) > 0.9
    torso = (of_limbs + of_head < 0.1) & (rigged.weights[:, -1] == 0.0)
    return skin.mean(moves, np.flatnonzero(ends)) / max(skin.mean(moves, np.flatnonzero(torso)), 1e-12)


def rigged_skin(soft: Sequence, skin: Skin) -> RiggedSkin:
    """All soft meshes on the armature of the first one, world space."""
    rig = armatures(soft[0])[0].object
    bones = list(rig.data.bones)
    names = [bone.name for bone in bones]
    parents = np.array([names.index(bone.parent.name) if bone.parent else -1 for bone in bones])
    skeleton = Skeleton(tuple(names), parents, np.array([bone.matrix_local for bone in bones]))
    heads = np.array([rig.matrix_world @ bone.head_local for bone in bones])
    weights, triangles, first = np.zeros((len(skin.rest), len(bones) + 1)), [], 0
    for obj in soft:
        place = {group.index: names.index(group.name) for group in obj.vertex_groups if group.name in names}
        for vertex in obj.data.vertices:
            for element in vertex.groups:
                if element.group in place:
                    weights[first + vertex.index, place[element.group]] = element.weight
        triangles.append(triangles_of(obj) + first)
        first += len(obj.data.vertices)
    sums = weights.sum(axis=1, keepdims=True)
    weights = np.where(sums > 0.0, weights / np.maximum(sums, 1e-12), np.eye(len(bones) + 1)[-1])
    return RiggedSkin(skeleton, heads, skin.rest, np.concatenate(triangles), weights)


def swings(motion: np.ndarray) -> np.ndarray:
    """RMS (V,) about the mean."""
    return np.sqrt(((motion - motion.mean(axis=0)) ** 2).sum(axis=2).mean(axis=0))


def shaken(world: np.ndarray, areas: np.ndarray, rate: float) -> float | None:
    """world (F, V, 3): plain skinning, of size; rate: frames a second."""
    if len(world) <= 3:
        return None
    squares = ((np.diff(world, 2, axis=0) * rate**2) ** 2).sum(axis=2) @ areas / areas.sum()
    return float(np.sqrt(squares.mean()) / NATURAL**2)


def flicker(moved: np.ndarray, areas: np.ndarray) -> float:
    """How often the surface turns, see judge.flicker_of; -1 where it does not move. moved (F, V, 3): of size."""
    change = np.diff(moved, axis=0)
    if np.abs(change).max(initial=0.0) < STILL:
        return -1.0
    return flicker_of(change, change * areas[:, None])


def jitter(motion: np.ndarray, areas: np.ndarray) -> float | None:
    if len(motion) < SHORTEST:
        return None
    acceleration = np.diff(motion, 2, axis=0)
    windowed = (acceleration - acceleration.mean(axis=0)) * np.hanning(len(acceleration))[:, None, None]
    power = (np.abs(np.fft.rfft(windowed, axis=0)) ** 2).sum(axis=2) @ areas
    return float(power[np.fft.rfftfreq(len(acceleration)) > HIGH].sum() / max(power.sum(), 1e-30))


def largest_gap(soft: Sequence, others: Sequence, baked: dict, plain: dict, size: float) -> float:
    """Between a soft mesh and another one, at points that coincide at rest, of size."""
    places = {obj: placed(obj) for obj in (*soft, *others)}
    largest = 0.0
    for number, obj in enumerate(soft):
        tree = KDTree(len(places[obj]))
        for vertex, place in enumerate(places[obj]):
            tree.insert(place, vertex)
        tree.balance()
        for other in (*soft[number + 1 :], *others):
            nearest = ((tree.find(place), vertex) for vertex, place in enumerate(places[other]))
            pairs = [(near, vertex) for (_, near, far), vertex in nearest if near is not None and far < TOUCHES * size]
            if pairs:
                here, there = np.array(pairs).T
                gaps = [np.linalg.norm(points[obj][:, here] - points[other][:, there], axis=2)
                        for points in (baked, plain)]  # fmt: skip
                largest = max(largest, float((gaps[0] - gaps[1]).max() / size))
    return largest


if __name__ == "__main__":
    sys.exit(main())
