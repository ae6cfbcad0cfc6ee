# SPDX-License-Identifier: GPL-3.0-or-later
"""The attachments of a character: finds other meshes on its armature and loose parts, and says what is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import bpy
import numpy as np

from ...core import errors
from ...core.geometry import diagonal, loose_parts, triangle_areas, vertex_areas
from ...core.message import Message
from ...core.model import rigid
from ...scene import references
from ...scene.check import checks
from ...scene.properties.model_properties import DynamorphAttachment
from ...scene.read import mesh_data
from ...scene.read.nearest import nearest
from ...scene.read.source import Source
from ...scene.references import armature_modifiers, rig_of
from ...scene.skin import attachments_of
from ...scene.skinning import Skinning, meshes_on
from ..bake import writer

PREFIX = "Dynamorph Attachment "  # prefix of the vertex groups for loose parts
FEW = 8  # up to so many loose parts are separate attachments
LARGE = 0.02  # fraction of the body's area; larger loose parts are separate attachments
ACCESSORY = 0.05  # of the soft area of a character's softest mesh; a mesh with less is not the intended soft skin
ROOT, LIES = 0.005, 0.02  # of the size: distances from soft skin of the nearest point of what lies on it, and of half
FEW_BONES = 3  # names listed in a reason
FEWEST_BONES = 3  # bones that carry the parts of a wholly hard character


# What a character has ----------------------------------------------------------------------------------------------


def find(obj: bpy.types.Object) -> list[str]:
    """Add the attachments of the soft skin `obj` that are not in its list yet: every other mesh on its armature and
    every rigid part, each with a reason. Returns their names. Raises SceneError.
    """
    checks.check_mesh(obj)
    body = Source.of(checks.skinned(obj))
    names = body.skeleton.names
    listed = {each.object: each.attached_by for each in obj.dynamorph.attachments if each.object and not each.group}
    found, added = [_look_at(body)], []
    for other in [*_siblings(obj), *(each for each, choice in listed.items() if choice in {"WITH_BODY", "HELD"})]:
        source = body.attachment(Skinning.of(other))
        try:
            refusal = _refusal(source)
            found += [] if refusal else [_look_at(source)]
        except errors.SceneError as error:
            refusal = str(error)
        if refusal and other not in listed:
            choice = "OWN_CAGE" if other.dynamorph.targets else "RIGID"
            added.append(_add(obj, other, "", choice, refusal))
    _leave_something_soft(found)
    _let_ride(found)
    for each, touches in zip(found, _touching(found), strict=True):
        whole = each.obj != obj and bool(each.hard.all()) and len(set(each.bones.tolist())) == 1
        if each.obj != obj and each.obj not in listed:
            added.append(_add_mesh(obj, each, whole, touches, names))
        if not whole:
            added += [*_add_hidden(obj, each), *_add_parts(obj, each, touches, names)]
    moved = references.as_moved(body.skeleton, body.rig)
    obj.dynamorph.model.head = ", ".join(names[bone] for bone in rigid.heads(moved, *_all_together(found)))
    return added


def remove(obj: bpy.types.Object, index: int) -> None:
    """Remove an attachment from the list, with the vertex group that was made for it."""
    attachment = obj.dynamorph.attachments[index]
    owner = attachment.object or obj
    group = owner.vertex_groups.get(attachment.group)
    if group and group.name.startswith(PREFIX):
        owner.vertex_groups.remove(group)
    obj.dynamorph.attachments.remove(index)
    obj.dynamorph.active_attachment_index = max(min(index, len(obj.dynamorph.attachments) - 1), 0)


def members(obj: bpy.types.Object, group: str) -> np.ndarray:
    """The vertices (V,) bool of a part."""
    return mesh_data.group_weights(obj, [group])[:, 0] >= mesh_data.MEMBER


def problem(obj: bpy.types.Object, attachment: DynamorphAttachment) -> str:
    """What is wrong with an attachment of `obj`, or ''. Reads no mesh: fast enough for drawing."""
    if not (attachment.object or attachment.group):
        gone = Message("'{name}' is gone: remove the attachment", name=attachment.name)
        return gone if attachment.name else "Choose an object or a vertex group"
    if attachment.object and not attachment.object.users_scene:
        return Message("'{name}' is gone: remove the attachment", name=attachment.name)
    if attachment.group:
        if attachment.group in (attachment.object or obj).vertex_groups:
            return ""
        return Message(
            "The vertex group '{group}' is gone: choose another, or remove the attachment", group=attachment.group
        )
    if attachment.attached_by in {"WITH_BODY", "HELD"} and rig_of(obj):
        return next(
            (each.text for each in checks.attachment_problems(Skinning.of(obj), Skinning.of(attachment.object))), ""
        )
    return ""


def left_alone(obj: bpy.types.Object) -> Iterator[str]:
    """The meshes of a character that no skin moves, one sentence each."""
    rig = rig_of(obj)
    family = dict.fromkeys([*(rig.children_recursive if rig else ()), *obj.children_recursive])
    children = [other for other in family if other.users_scene]
    for other in children:
        if other.type != "MESH" or other == obj or armature_modifiers(other):
            continue
        if other.parent_type == "BONE":
            yield Message(
                "'{name}' is parented to bone '{bone}': it moves with the bone and is left alone",
                name=other.name,
                bone=other.parent_bone,
            )
        elif other.parent_type in {"VERTEX", "VERTEX_3"}:
            yield Message(
                "'{name}' is parented to vertices of '{parent}': it moves with them",
                name=other.name,
                parent=other.parent.name,
            )
        else:
            yield Message(
                "'{name}' is parented to '{parent}': it moves with it as a whole and is left alone",
                name=other.name,
                parent=other.parent.name,
            )


def _siblings(obj: bpy.types.Object) -> list:
    """The other meshes on the armature of `obj` that are not attachments yet."""
    rig, known = rig_of(obj), [obj, *(each.object for each in obj.dynamorph.attachments)]
    return [
        other
        for other in bpy.context.scene.objects
        if other.type == "MESH"
        and other not in known
        and len(other.data.vertices)
        and any(modifier.object == rig for modifier in armature_modifiers(other))
    ]


# Its body -----------------------------------------------------------------------------------------------------------


def body_for(obj: bpy.types.Object) -> bpy.types.Object:
    """The mesh to become a soft skin for `obj`: itself, unless it is rigid and another one on its armature is not. For
    an armature object, the mesh with the largest soft surface. Raises SceneError.
    """
    rig = obj if obj.type == "ARMATURE" else rig_of(obj) or carried_by(obj)
    if rig is None or obj.mode == "EDIT":
        return obj
    areas = {other: _soft_area(other, rig) for other in meshes_on(rig) if _may_be_soft(other, rig)}
    largest = max(areas, key=lambda other: areas[other], default=obj)
    accessory = areas.get(obj, 0.0) <= ACCESSORY * areas.get(largest, 0.0)
    return largest if obj.type == "ARMATURE" or accessory else obj


def carried_by(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The armature object that is an ancestor of `obj` by parenting, if it skins a mesh."""
    above = obj.parent
    while above and above.type != "ARMATURE":
        above = above.parent
    return above if above and any(rig_of(other) == above for other in meshes_on(above)) else None


def _may_be_soft(other: bpy.types.Object, rig: bpy.types.Object) -> bool:
    skinned = any(modifier.object == rig for modifier in armature_modifiers(other))
    mine = not (other.library or other.override_library)
    return skinned and mine and other.mode != "EDIT" and bool(other.data.polygons)


def _soft_area(other: bpy.types.Object, rig: bpy.types.Object) -> float:
    """The area of the skin of a mesh that no single bone carries, in Blender units."""
    try:
        source = Source.of(checks.skinned(other), rig)
        labels = loose_parts(source.points, source.triangles)
        hard, _ = rigid.rigid_parts(labels, source.weights)
    except errors.SceneError:
        return 0.0
    areas = vertex_areas(source.points @ np.array(other.matrix_world)[:3, :3].T, source.triangles)
    return float(areas[~hard[labels]].sum())


@dataclass(frozen=True)
class _Found:
    """A mesh of the body under examination. labels (P,): of its loose parts; points (P, 3): in the body's bind space;
    hard (parts,): which are rigid; bones (parts,): that carry most of each part; hidden (parts,): which a mask hides.
    """

    source: Source
    labels: np.ndarray
    points: np.ndarray
    hard: np.ndarray
    bones: np.ndarray
    hidden: np.ndarray

    @property
    def obj(self) -> bpy.types.Object:
        return self.source.obj

    @property
    def triangles(self) -> np.ndarray:
        return self.source.triangles


def _refusal(source: Source) -> str:
    """Why a mesh cannot belong to its body, or ''."""
    other, skinning, body = source.obj, source.skinning, source.body
    assert body is not None
    if other.dynamorph.targets:
        return "It is a soft skin of its own"
    problems = checks.attachment_problems(body.skinning, skinning), checks.mesh(other)
    for problem in chain(*problems, checks.skinning_problems(skinning)):
        return problem.text
    try:
        writer.check(other, body.obj)
    except errors.WriteError as error:
        return str(error)
    return ""


def _look_at(source: Source) -> _Found:
    """Raises SceneError."""
    labels = loose_parts(source.points, source.triangles)
    points = source.in_body @ (source.body or source).to_bind.T
    hidden = np.bincount(labels, ~mesh_data.masked(source.obj, source.groups)) == 0
    return _Found(source, labels, points, *rigid.rigid_parts(labels, source.weights), hidden & ~hidden.all())


def _leave_something_soft(found: list[_Found]) -> None:
    """If everything is rigid, on one bone or two, the largest part becomes a soft body: a jelly, for example."""
    bones = {bone for each in found for bone in each.bones.tolist()}
    if len(bones) >= FEWEST_BONES or not all(each.hard.all() for each in found):
        return
    if rigid.is_machine(found[0].source.skeleton, *_all_together(found)):
        return
    areas = [_areas(each) for each in found]
    largest = max(range(len(found)), key=lambda k: areas[k].max())
    found[largest].hard[areas[largest].argmax()] = False


def _areas(each: _Found) -> np.ndarray:
    """Of the parts (P,)."""
    return np.bincount(each.labels, vertex_areas(each.points, each.triangles))


def _let_ride(found: list[_Found]) -> None:
    """Thin parts that lie on soft skin, or grow on it, move with that, whichever bone carries them: cards of hair and
    feathers, straps.
    """
    largest = max(float(_areas(each).max()) for each in found)
    parts = [
        each.hard & ~each.hidden & rigid.thin_parts(each.points, each.triangles, each.labels, largest) for each in found
    ]
    starts = np.cumsum([0, *(len(each.points) for each in found)])[:-1]
    soft = [each.triangles[~each.hard[each.labels[each.triangles[:, 0]]]] for each in found]
    triangles = np.concatenate([faces + start for faces, start in zip(soft, starts, strict=True)])
    if not len(triangles) or not any(chosen.any() for chosen in parts):
        return
    points = np.concatenate([each.points for each in found])
    size = diagonal(points)
    for each, chosen in zip(found, parts, strict=True):
        vertices = np.flatnonzero(chosen[each.labels])
        if not len(vertices):
            continue
        away = nearest(each.points[vertices], points, triangles).distances / size
        numbers, count = np.unique(each.labels[vertices], return_counts=True)
        order = np.lexsort((away, each.labels[vertices]))  # part by part, the nearest first
        least = np.cumsum(count) - count
        rides = (away[order[least]] <= ROOT) & (away[order[least + (count - 1) // 2]] <= LIES)
        each.hard[numbers[rides]] = False


def _all_together(found: list[_Found]) -> tuple:
    """Weights, points and triangles of all meshes, as arguments of `rigid.heads`."""
    starts = np.cumsum([0, *(len(each.points) for each in found)])
    triangles = [each.triangles + start for each, start in zip(found, starts, strict=False)]
    weights, points = [each.source.weights for each in found], [each.points for each in found]
    return np.concatenate(weights), np.concatenate(points), np.concatenate(triangles)


def _touching(found: list[_Found]) -> list[np.ndarray]:
    """For each mesh, which (parts,) of its rigid parts share points with soft skin."""
    points = np.concatenate([each.points for each in found])
    size = diagonal(points)
    first = rigid.coincident(points, rigid.COINCIDE * size)
    counts = [len(each.hard) for each in found]
    starts = np.cumsum([0, *counts])[:-1]
    labels = np.concatenate([each.labels + start for each, start in zip(found, starts, strict=True)])
    hard = np.concatenate([each.hard for each in found])
    return np.split(rigid.joined_to_soft(labels, hard, first), starts[1:])


def _add_mesh(obj: bpy.types.Object, each: _Found, whole: bool, touches: np.ndarray, names: Sequence[str]) -> str:
    """whole: one bone carries all of it."""
    if not whole:
        return _add(obj, each.obj, "", "WITH_BODY", "It is skinned by the same armature")
    bone = [*names, "none"][each.bones[0]]
    if touches.any():
        return _add(obj, each.obj, "", "HELD", f"Only bone '{bone}' moves it, and it shares points with soft skin")
    return _add(obj, each.obj, "", "RIGID", f"Only bone '{bone}' moves it")


def _covered(obj: bpy.types.Object, each: _Found) -> np.ndarray:
    """Which (parts,) belong to an attachment already."""
    parts = attachments_of(obj, None if each.obj == obj else each.obj)
    known = [item.group for item in parts if item.group in each.obj.vertex_groups]
    taken = (each.source.groups.weights(known) >= mesh_data.MEMBER).any(axis=1)
    return np.bincount(each.labels, taken) > 0.5 * np.bincount(each.labels)


def _add_hidden(obj: bpy.types.Object, each: _Found) -> list[str]:
    """The loose parts that nobody sees, such as geometry for fitting clothes, as one attachment outside the cage."""
    parts = np.flatnonzero(each.hidden & ~_covered(obj, each))
    if not len(parts):
        return []
    made = each.obj.vertex_groups.new(name=PREFIX + "Hidden")
    made.add(np.flatnonzero(np.isin(each.labels, parts)).tolist(), 1.0, "REPLACE")
    what = "this loose part" if len(parts) == 1 else f"these {len(parts)} loose parts"
    return [_add(obj, None if each.obj == obj else each.obj, made.name, "RIGID", f"Mask modifiers hide {what}")]


def _add_parts(obj: bpy.types.Object, each: _Found, touches: np.ndarray, names: Sequence[str]) -> list[str]:
    """The rigid loose parts of a mesh as attachments: those of one material on one bone together; if there are many,
    the small ones of one material.
    """
    mesh, labels, owner = each.obj.data, each.labels, None if each.obj == obj else each.obj
    slots = np.zeros(len(each.triangles), np.int32)
    mesh.loop_triangles.foreach_get("material_index", slots)
    areas = np.zeros((len(each.hard), max(len(mesh.materials), 1)))
    of_triangles = triangle_areas(each.points, each.triangles)
    np.add.at(areas, (labels[each.triangles[:, 0]], slots.clip(0, areas.shape[1] - 1)), of_triangles)
    covered, added = _covered(obj, each) | each.hidden, []
    for held in (False, True):
        chosen = np.flatnonzero(each.hard & (touches == held) & ~covered)
        alike = np.column_stack([areas[chosen].argmax(axis=1), each.bones[chosen]])
        kinds, kind = np.unique(alike, axis=0, return_inverse=True)
        of_kinds = np.zeros((len(kinds), areas.shape[1]))
        np.add.at(of_kinds, kind.ravel(), areas[chosen])
        for together in grouped(of_kinds):
            group = chosen[np.isin(kind.ravel(), together)]
            material = mesh.materials[areas[group].sum(axis=0).argmax()] if mesh.materials else None
            made = each.obj.vertex_groups.new(name=PREFIX + (material.name if material else "Part"))
            made.add(np.flatnonzero(np.isin(labels, group)).tolist(), 1.0, "REPLACE")
            bones = dict.fromkeys([*names, "none"][bone] for bone in each.bones[group])
            listed = ", ".join(f"'{bone}'" for bone in list(bones)[:FEW_BONES]) + " ..." * (len(bones) > FEW_BONES)
            parts = "This loose part follows" if len(group) == 1 else f"These {len(group)} loose parts follow"
            reason = f"{parts} {'bone' if len(bones) == 1 else 'one bone each:'} {listed}"
            reason += ", and shares points with soft skin" * held
            added.append(_add(obj, owner, made.name, "HELD" if held else "RIGID", reason))
    return added


def _add(obj: bpy.types.Object, other: Any, group: str, choice: str, reason: str) -> str:
    attachment = obj.dynamorph.attachments.add()
    attachment.object, attachment.group, attachment.name = other, group, group or other.name
    attachment.attached_by = choice
    attachment.reason = reason  # after the choice, whose update clears the reason
    return attachment.name


def grouped(areas: np.ndarray) -> list[np.ndarray]:
    """The loose parts that form one attachment: lists of part numbers.

    areas (P, M): of P loose parts by material slot. If there are more than a few, small ones of the same material are
    together.
    """
    whole = areas.sum(axis=1)
    order = np.argsort(-whole, kind="stable")  # the largest first
    others = [p for p in order if whole[p] > 0.0]
    if len(others) <= FEW:
        return [np.array([p]) for p in others]
    large = [p for p in others[:FEW] if whole[p] > LARGE * whole[order[0]]]
    small: dict[int, list] = {}
    for p in others[len(large) :]:
        small.setdefault(int(areas[p].argmax()), []).append(p)
    return [np.array([p]) for p in large] + [np.array(parts) for parts in small.values()]
