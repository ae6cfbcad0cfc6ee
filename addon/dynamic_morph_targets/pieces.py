# SPDX-License-Identifier: GPL-3.0-or-later
"""The pieces of a character: finds other meshes on its armature and loose parts of its mesh, and says what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import bpy
import numpy as np

from . import checks, extract
from .properties import parts_in, rig_of
from .scene_data import loose_parts

PREFIX = "Dynamorph Piece "  # of the vertex groups that are made for loose parts
FEW = 8  # so many loose parts are a piece each
LARGE = 0.02  # of the body's area: larger loose parts are a piece each
RIGID = 0.99  # of its weight a vertex has from the one bone that it follows rigidly


# What a character has ----------------------------------------------------------------------------------------------


def find(obj) -> list[str]:
    """Add the pieces of the soft skin `obj` that are not in its list yet; returns their names. Raises SceneError."""
    objects, parts = [(other, _choice(other)) for other in _siblings(obj)], _parts(obj)
    return [_add_object(obj, *found) for found in objects] + [_add_part(obj, part) for part in parts]


def remove(obj, index: int):
    """Take a piece out of the list, with the vertex group that was made for it."""
    piece = obj.dynamorph.pieces[index]
    group = obj.vertex_groups.get(piece.group)
    if group and group.name.startswith(PREFIX):
        obj.vertex_groups.remove(group)
    obj.dynamorph.pieces.remove(index)
    obj.dynamorph.active_piece_index = max(min(index, len(obj.dynamorph.pieces) - 1), 0)


def members(obj, group: str) -> np.ndarray:
    """The vertices (V,) bool of a part."""
    return extract.group_weights(obj, [group])[:, 0] >= extract.MEMBER


def problem(obj, piece) -> str:
    """What is wrong with one of the pieces of `obj`, or ''. Reads no mesh: fit for drawing."""
    if piece.group:
        gone = piece.group not in obj.vertex_groups
        return f"The vertex group '{piece.group}' is gone: choose another, or remove the piece" if gone else ""
    if not piece.object or not piece.object.users_scene:
        return f"'{piece.name}' is gone: remove the piece" if piece.name else "Choose an object or a vertex group"
    if piece.choice == "WITH_BODY" and rig_of(obj):
        return next((each.text for each in checks.follower(obj, piece.object)), "")
    return ""


def left_alone(obj) -> Iterator[str]:
    """The meshes of a character that no skin moves, a sentence each."""
    rig = rig_of(obj)
    children = dict.fromkeys([*(rig.children_recursive if rig else ()), *obj.children_recursive])
    for other in children:
        if other.type != "MESH" or other == obj or checks.armature_modifiers(other):
            continue
        if other.parent_type == "BONE":
            yield f"'{other.name}' is parented to bone '{other.parent_bone}': it moves with the bone and is left alone"
        elif other.parent_type in {"VERTEX", "VERTEX_3"}:
            yield f"'{other.name}' is parented to vertices of '{other.parent.name}': it moves with them"
        else:
            yield f"'{other.name}' is parented to '{other.parent.name}': it moves with it as a whole and is left alone"


def _siblings(obj) -> list:
    """The other meshes on the armature of `obj` that are no piece yet."""
    rig, known = rig_of(obj), [obj, *(piece.object for piece in obj.dynamorph.pieces)]
    return [
        other
        for other in bpy.context.scene.objects
        if other.type == "MESH"
        and other not in known
        and len(other.data.vertices)
        and any(modifier.object == rig for modifier in checks.armature_modifiers(other))
    ]


def _choice(other) -> str:
    """What is likely to be meant for another mesh. Eyes and helmets follow one bone."""
    if other.dynamorph.targets:
        return "OWN_CAGE"
    if other.library or other.override_library:
        return "RIGID"
    with suppress(extract.SceneError):
        if rigid_parts(np.zeros(len(other.data.vertices), np.int64), extract.skin_weights(other))[0]:
            return "RIGID"
    return "WITH_BODY"


def _add_object(obj, other, choice: str) -> str:
    piece = obj.dynamorph.pieces.add()
    piece.object, piece.name, piece.choice = other, other.name, choice
    return other.name


def _add_part(obj, part: Part) -> str:
    group = obj.vertex_groups.new(name=PREFIX + part.name)
    group.add(np.flatnonzero(part.members).tolist(), 1.0, "REPLACE")
    piece = obj.dynamorph.pieces.add()
    piece.group = piece.name = group.name
    piece.choice = "RIGID" if part.rigid else "WITH_BODY"
    return group.name


# Loose parts of the mesh -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """Loose parts of a mesh that are one piece. members (V,) bool; rigid: each follows one bone."""

    name: str
    members: np.ndarray
    rigid: bool


def _parts(obj) -> list[Part]:
    """What the mesh of `obj` has besides its body and the pieces there are already. Raises SceneError."""
    extract.check_mesh(obj)
    mesh, points = obj.data, extract.rest_points(obj)
    edges = np.empty((len(mesh.edges), 2), np.int32)
    mesh.edges.foreach_get("vertices", edges.ravel())
    labels = loose_parts(points, edges)
    if not labels.any():
        return []
    triangles = extract.mesh_triangles(mesh)
    slots = np.empty(len(triangles), np.int32)
    mesh.loop_triangles.foreach_get("material_index", slots)
    areas = np.zeros((labels.max() + 1, max(len(mesh.materials), 1)))
    corners = points[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slots = slots.clip(0, areas.shape[1] - 1)  # there may be fewer materials than the faces say
    np.add.at(areas, (labels[triangles[:, 0]], slots), np.linalg.norm(across, axis=1) / 2.0)
    rigid = rigid_parts(labels, extract.skin_weights(obj))
    known = [piece.group for piece in parts_in(obj)]
    taken = (extract.group_weights(obj, known) >= extract.MEMBER).any(axis=1)
    covered = np.bincount(labels, taken) > 0.5 * np.bincount(labels)
    body = areas.sum(axis=1).argmax()
    out = []
    for group in grouped(areas, skip=covered):
        material = mesh.materials[areas[group].sum(axis=0).argmax()] if mesh.materials else None
        same = areas[group].sum(axis=0).argmax() == areas[body].argmax()
        name = "Part" if len(group) == 1 else "Small Parts"
        out.append(Part(material.name if material and not same else name, np.isin(labels, group), rigid[group].all()))
    return out


def grouped(areas: np.ndarray, skip: np.ndarray) -> list[np.ndarray]:
    """Which loose parts are one piece: lists of part numbers, without the body, which is the largest.

    areas (P, M): of P loose parts by material slot; skip (P,) bool: parts that are left out. Where there are more than
    a few, small ones of the same material are together.
    """
    whole = areas.sum(axis=1)
    order = np.argsort(-whole, kind="stable")
    body, others = order[0], [p for p in order[1:] if whole[p] > 0.0 and not skip[p]]
    if len(others) <= FEW:
        return [np.array([p]) for p in others]
    large = [p for p in others[:FEW] if whole[p] > LARGE * whole[body]]
    small: dict[int, list] = {}
    for p in others[len(large) :]:
        small.setdefault(int(areas[p].argmax()), []).append(p)
    return [np.array([p]) for p in large] + [np.array(parts) for parts in small.values()]


def rigid_parts(labels: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Whether (P,) each part follows one bone rigidly; labels (V,) its number, weights (V, B + 1) the skin's."""
    bone, count = weights.argmax(axis=1), labels.max() + 1
    first, last = np.full(count, weights.shape[1]), np.full(count, -1)
    np.minimum.at(first, labels, bone)
    np.maximum.at(last, labels, bone)
    loose = np.bincount(labels, weights.max(axis=1) <= RIGID, count) > 0
    return (first == last) & ~loose
