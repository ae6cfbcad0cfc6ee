# SPDX-License-Identifier: GPL-3.0-or-later
"""What a sculpt says about its target: the bones that place it, and the region that it is limited to.

*Bones.* A joint bends a piece of skin if it carries some of it and not the rest. With c the part that a bone and all
below it carry, that is 4 c (1 - c), times the turn of the bone. A bone further up carries all of it along, c = 1, and
does not matter. What counts is how joints bend the sculpt's region, of those that bend the sculpt itself or skin it.

*Regions.* A vertex group that is 1 where the sculpt moves the skin and a little further, and falls smoothly to 0 over
about the radius of what is sculpted, along the skin. Targets that share a bone or a channel compete for the same poses,
so they have one group together, the union of theirs; the others' weights do not depend on what these limbs do.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import bpy
import numpy as np

from ...core.character import REGION, Skeleton
from ...core.geometry import diagonal, smooth_step, triangle_areas, turned, welded
from ...core.painted_map import MAPS
from ...scene import animation
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.properties.target_properties import DynamorphTarget
from ...scene.read import mesh_data
from ...scene.read.mesh_data import VertexGroups
from ...scene.read.source import Source
from ..reconcile import reconcile

SUPPORT = 0.02  # of a sculpt's largest displacement; vertices that move less do not count as sculpted
GROWN = 0.25  # of the sculpt's radius; the region is 1 up to this distance beyond the sculpt
RINGS = 3.0  # smallest number of edges over which a region fades
WIDEST = 0.08  # of the body's size; the largest distance over which it fades
BENDS = 0.05  # 4 c (1 - c) of a sculpt; a joint with less does not bend it
SKINS = 0.1  # of a sculpt; a bone with less does not skin it
LESS = 0.25  # of the largest bend; joints that bend less do not place the target


# Bones -------------------------------------------------------------------------------------------------------------


def driver_bones(
    obj: bpy.types.Object,
    skeleton: Skeleton,
    neutral: np.ndarray,
    local: np.ndarray,
    shape: np.ndarray,
    alone: bool = True,
) -> list[str]:
    """Names of the bones, turned from one pose (B, 4, 4) to another, that place a target with the shape (V, 3).

    Of a shape that moves nothing they are all that are turned. alone: nothing else places it; otherwise there are none
    where no joint bends the sculpt. Raises SceneError.
    """
    names = rig_motion.bones_turned(obj, skeleton, neutral, local)
    if len(names) < 1 + alone or not _moves(shape):
        return names
    skin = Source.of(checks.skinned(obj)).weights[:, :-1]
    skins, bends = _of_skin(skeleton, skin, _is_sculpted(shape))
    _, bends_around = _of_skin(skeleton, skin, region(*_surface(obj), shape))
    counts = bends_around * turned(neutral, local) * ((bends >= BENDS) | (skins >= SKINS))
    candidates = [skeleton.names.index(name) for name in names]
    largest = counts[candidates].max()
    if largest <= 0.0:
        return _nearest(skeleton, candidates, skins) if alone else []
    return [skeleton.names[bone] for bone in candidates if counts[bone] >= LESS * largest]


def _of_skin(skeleton: Skeleton, skin: np.ndarray, where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of some skin that each bone (B,) skins, and how much its joint bends it, 4 c (1 - c).

    skin (V, B): weights; where (V,): how much each vertex counts.
    """
    skins = where @ skin / where.sum()
    carried = skins.copy()
    for bone in reversed(range(len(skins))):  # children come after their parents
        if skeleton.parents[bone] >= 0:
            carried[skeleton.parents[bone]] += carried[bone]
    return skins, (4.0 * carried * (1.0 - carried)).clip(0.0)


def _nearest(skeleton: Skeleton, candidates: list[int], skins: np.ndarray) -> list[str]:
    """The candidates nearest, in the hierarchy, to the bones that skin a sculpt.

    skins (B,): the part that each bone skins. The joints of such a bone are its own and those of its children.
    """
    parents = skeleton.parents
    reached = {bone for bone in range(len(parents)) if skins[bone] >= SKINS}
    reached |= {bone for bone in range(len(parents)) if parents[bone] in reached}
    while reached:
        found = [bone for bone in candidates if bone in reached]
        joints = [bone for bone in found if parents[bone] >= 0] or found  # a root's turn bends nothing
        if joints:
            return [skeleton.names[bone] for bone in joints]
        beyond = {bone for bone in range(len(parents)) if parents[bone] in reached}
        beyond |= {int(parents[bone]) for bone in reached if parents[bone] >= 0}
        if beyond <= reached:
            break
        reached |= beyond
    return [skeleton.names[bone] for bone in candidates]


# Regions -----------------------------------------------------------------------------------------------------------


def update(obj: bpy.types.Object, left: Iterable[str] = ()) -> None:
    """Update the automatic regions of `obj` from the sculpts. left: groups of a removed target.

    An automatic region that was painted stays as it is from now on. It does nothing in Edit Mode, where Blender
    writes no weights. Raises SceneError.
    """
    settings = obj.dynamorph
    automatic = [target for target in settings.targets[1:] if target.auto_region]
    if obj.mode == "EDIT" or not (automatic or left):
        return
    reconcile(obj)
    active = obj.vertex_groups.active.name if obj.vertex_groups.active else ""
    groups = mesh_data.VertexGroups(obj)
    automatic = _not_painted(obj, automatic, groups)
    before = {target.region for target in automatic} | {*left}
    chosen = [target for target in settings.targets[1:] if not target.auto_region]
    made = {target.region for target in automatic if target.made_region or target.region.startswith(REGION)}
    free = made - {target.region for target in chosen}
    for together in _placed_together(automatic):
        places = _places(together)
        company = next((target for target in chosen if places & _places([target])), None)
        if company:  # whose region belongs to the artist
            group, digest = company.region, ""
        else:
            group, digest = _write(obj, together, groups, free)
        for target in together:
            target.set_region(group, automatic=True)
            target.made_region = digest
    _remove(obj, before)
    reconcile(obj)
    if active in obj.vertex_groups:
        obj.vertex_groups.active_index = obj.vertex_groups[active].index


def automatic_regions(obj: bpy.types.Object, targets: Iterable[DynamorphTarget]) -> set[str]:
    """The regions that only the add-on has made: they were made here, and not painted since."""
    groups = mesh_data.VertexGroups(obj)
    return {target.region for target in targets if target.auto_region and not _is_painted(obj, target, groups)}


def _is_painted(obj: bpy.types.Object, target: DynamorphTarget, groups: VertexGroups) -> bool:
    if not target.made_region or target.region not in obj.vertex_groups:
        return False
    locked = obj.vertex_groups[target.region].lock_weight  # by the artist, who keeps it as it is
    return locked or _digest(groups.weights([target.region])) != target.made_region


def _not_painted(obj: bpy.types.Object, automatic: list, groups: VertexGroups) -> list:
    """The targets whose region is unchanged since it was made; the other regions belong to the artist from now on."""
    painted = {target.region for target in automatic if _is_painted(obj, target, groups)}
    for target in automatic:
        if target.region in painted:
            target.auto_region = False
    return [target for target in automatic if target.auto_region]


def _places(targets: list) -> set[tuple[str, str]]:
    """The bones and channels that place targets."""
    bones = {("bone", bone) for target in targets for bone in target.bone_names()}
    return bones | {("channel", target.channel) for target in targets if target.channel}


def _placed_together(targets: list) -> list[list]:
    """The targets in sets, so that those of different sets have no bone and no channel in common."""
    sets: list[list] = []
    for target in targets:
        joined = [one for one in sets if _places(one) & _places([target])]
        sets = [one for one in sets if one not in joined] + [[*(each for one in joined for each in one), target]]
    return sets


def _write(obj: bpy.types.Object, together: list, groups: VertexGroups, free: set[str]) -> tuple[str, str]:
    """The vertex group of targets that share bones, and its digest; "" while nothing is sculpted. free: names of
    earlier automatic groups that can be used again; the used one is removed from it.
    """
    keys = animation.keys_of(obj)
    shapes = [mesh_data.target_shape(obj, target.name, groups) for target in together if target.name in keys]
    surface = _surface(obj)
    regions = [region(*surface, shape) for shape in shapes if _moves(shape)]
    if not regions:
        return "", ""
    weights = np.max(regions, axis=0)
    name = next((target.region for target in together if target.region in free), "")
    free.discard(name)
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=REGION + together[0].name)
    write_group(group, weights)
    return group.name, _digest(weights)


def _remove(obj: bpy.types.Object, names: Iterable[str]) -> None:
    """Remove those automatic groups that nothing uses any more."""
    settings = obj.dynamorph
    used = {*(getattr(settings, each.group) for each in MAPS), *(target.region for target in settings.targets)}
    used |= {each.group for each in settings.attachments}
    for name in names:
        if name.startswith(REGION) and name not in used and name in obj.vertex_groups:
            obj.vertex_groups.remove(obj.vertex_groups[name])


def write_group(group: bpy.types.VertexGroup, weights: np.ndarray, members: np.ndarray | None = None) -> None:
    """Give a vertex group the weights (V,) of its members (V,), by default of all vertices where they are not 0."""
    group.remove(range(len(weights)))
    for vertex in np.flatnonzero(weights if members is None else members).tolist():
        group.add([vertex], weights[vertex], "REPLACE")


def _surface(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Points (V, 3) at rest and triangles (T, 3), as large as the object shows them. Raises SceneError."""
    scale = np.abs(obj.matrix_world.to_scale())
    return mesh_data.rest_points(obj) * np.where(scale > 0.0, scale, 1.0), mesh_data.mesh_triangles(obj.data)


def _digest(weights: np.ndarray) -> str:
    """A digest of weights as Blender stores them."""
    return hashlib.blake2b(weights.astype(np.float32).tobytes(), digest_size=8).hexdigest()


# Shapes of regions -------------------------------------------------------------------------------------------------


def region(points: np.ndarray, triangles: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Weights (V,), 0 to 1, of the region of a sculpt.

    points (V, 3), triangles (T, 3): the surface at rest; shape (V, 3): displacements, not all zero.
    """
    sculpted = _is_sculpted(shape)
    places = welded(points)  # imported meshes are split at every seam
    at_place = np.zeros((places.max() + 1, 3))
    at_place[places] = points
    area = (triangle_areas(points, triangles) * sculpted[triangles].mean(axis=1)).sum()
    size = diagonal(points)
    edges, across = _links(places[triangles])
    start = np.zeros(len(at_place), bool)
    start[places[sculpted]] = True
    near = edges[start[edges].any(axis=1)]
    rings = RINGS * np.median(_lengths(at_place, near)) if len(near) else 0.0
    radius = max(min(np.sqrt(area / np.pi), WIDEST * size), rings, 1e-6 * size, 1e-30)
    away = _along(at_place, np.concatenate([edges, across]), start, (1.0 + GROWN) * radius)[places]
    return 1.0 - smooth_step(away / radius - GROWN)


def _moves(shape: np.ndarray) -> bool:
    """Whether a shape moves anything; one with coordinates that are not numbers is refused when it is built."""
    return bool(shape.any() and np.isfinite(shape).all())


def _is_sculpted(shape: np.ndarray) -> np.ndarray:
    """Which vertices (V,) a shape (V, 3) moves."""
    moved = np.linalg.norm(shape, axis=1)
    return moved > SUPPORT * moved.max()


def _links(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (E, 2) of triangles (T, 3), and the pairs (P, 2) of opposite corners across an edge.

    Along edges alone, a path across quads would be longer against their diagonals than along them.
    """
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    count = int(triangles.max(initial=0)) + 1
    numbers = sides.min(axis=1) * count + sides.max(axis=1)  # one number per edge, which sorts quickly
    order = np.argsort(numbers, kind="stable")
    same = np.diff(numbers[order]) == 0
    opposite = triangles[:, [2, 0, 1]].ravel()[order]
    edges = numbers[order][np.append(True, ~same)] if len(order) else numbers
    return np.stack([edges // count, edges % count], axis=1), np.stack([opposite[:-1], opposite[1:]], axis=1)[same]


def _lengths(points: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)


def _along(points: np.ndarray, links: np.ndarray, start: np.ndarray, farthest: float) -> np.ndarray:
    """The distance of each point (P,) from the nearest of `start` (P,) along links (L, 2); inf beyond `farthest`."""
    lengths, away, changed = _lengths(points, links), np.where(start, 0.0, np.inf), start
    while changed.any():
        further = away.copy()
        for begin, end in ((0, 1), (1, 0)):
            used = np.flatnonzero(changed[links[:, begin]])
            np.minimum.at(further, links[used, end], away[links[used, begin]] + lengths[used])
        further[further > farthest] = np.inf
        changed = further < away
        away = further
    return away
