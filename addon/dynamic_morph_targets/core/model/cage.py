# SPDX-License-Identifier: GPL-3.0-or-later
"""Character -> tetrahedra around its skin, and what they inherit from it. Never touches bpy."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import firmness as paint
from ..character import Character, OwnCage
from ..engine import dynamorph
from ..geometry import diagonal, triangle_areas, without_cards
from . import pins
from .hold import BodyThickness, Depths, Hold, depths, hold
from .model import Model
from .summary import Summary

ProgressFn = Callable[[float, str], bool]  # of a build: how much is done, and what is at hand
Report = Callable[[float], bool]  # of a stage of it
GRID = (
    2.0**-13
)  # body sizes; with a finer grid, the last digits of coordinates, which a scale changes, would change the mesh
MOSTLY = 0.5  # fraction of the vertices; with more of them outside, a cage does not belong to this body
FEWEST_NODES = 50  # of an attachment's own cage


@dataclass(frozen=True)
class Cage:
    """The cage before the targets: n nodes, m tets, S target sets, B bones. Bind space, meters.

    embedding: of the V surface vertices; fill (m,) filled fraction; stiffness (m,) factor by thickness; firmness (n,)
    weights of the Firmness map; region_weights (m, S); pinned (n,) bool; node_weights (n, B + 1); hold: by thickness,
    or None; made: as `Model.made`.
    """

    mesh: dynamorph.TetMesh
    embedding: dynamorph.Embedding
    fill: np.ndarray
    stiffness: np.ndarray
    firmness: np.ndarray
    region_weights: np.ndarray
    pinned: np.ndarray
    node_weights: np.ndarray
    hold: Hold | None
    summary: Summary
    made: dict


def make_cage(character: Character, previous: Model | None, stages: Stages) -> Cage:
    """The cage of a character; previous: an earlier model whose tetrahedra are used again. Raises dynamorph.Error with
    advice when the skin cannot be filled or nothing holds it.
    """
    surface = character.bind_points[character.coincident]
    contents = _cages(character, surface)
    if previous and len(contents) > 1 and (character.settings.hold == "BONES" or character.cage):
        previous = None  # the model does not tell which nodes are whose
    if previous:
        filled, defects, body = _filled_before(contents, previous, surface), previous.summary.defects, None
    else:
        filled, defects, body = _new(character, contents, surface, stages)
    mesh, embedding = filled.mesh, filled.embedding
    made = kept_depths(previous) if previous else {}
    with stages("Embedding", 0.35 if previous else 0.02):
        inherited = inherit(character, mesh, embedding)
        if character.settings.hold == "BONES":
            painted = (inherited.firmness - paint.NEUTRAL) / (1.0 - paint.NEUTRAL)
            firm = np.maximum(inherited.rigidity, painted)
            pinned, warned = pins.all_pinned(character, mesh, embedding, inherited.weights, filled.pinned, firm)
            of_thickness = None
        else:
            pinned, warned = filled.pinned, []
            of_thickness = held_by_thickness(character, mesh, inherited, filled.fill, made, body)
    summary = Summary(
        nodes=len(mesh.nodes),
        tets=len(mesh.tets),
        pinned=int(pinned.sum()),
        held=float(of_thickness.phi.mean() if of_thickness else pinned.mean()),
        defects=defects,
        quality=dynamorph.tet_quality(mesh),
        glued=filled.glued,
        held_parts=len(warned),
        warnings=(*filled.warnings, *warned),
    )
    stiffness = of_thickness.stiffness if of_thickness else np.ones(len(mesh.tets))
    firmness, weights, _, region_weights = inherited
    return Cage(
        mesh, embedding, filled.fill, stiffness, firmness, region_weights, pinned, weights, of_thickness, summary, made
    )


def kept_depths(model: Model) -> dict:
    """What of `Model.made` another model with the same tetrahedra has, too: stiffness and modes do not count in it."""
    return {made_from: found for made_from, found in model.made.items() if made_from[0] == "depths"}


def held_by_thickness(
    character: Character,
    mesh: dynamorph.TetMesh,
    inherited: Inherited,
    fill: np.ndarray,
    made: dict,
    body: BodyThickness | None = None,
) -> Hold:
    """The hold of a character's cage. fill (m,); made: keeps the depths in it, which follow from neither paint nor
    weights; body: of the character, where it is known.
    """
    made_from = (mesh.nodes, mesh.tets, *_enclosing(character))
    key = b"".join(hashlib.sha256(array.tobytes()).digest() for array in made_from)
    if ("depths", key) not in made:
        made["depths", key] = depths(mesh, body or BodyThickness.of(*_enclosing(character)))
    known: Depths = made["depths", key]
    return hold(mesh, known.with_lent(mesh, inherited.weights), inherited.rigidity, inherited.firmness, fill)


def _enclosing(character: Character) -> tuple[np.ndarray, np.ndarray]:
    """The skin (V, 3), and the triangles that enclose the body."""
    surface = character.bind_points[character.coincident]
    return surface, without_cards(surface, character.soft_triangles)


# Cages: of the body, and of attachments that have their own -----------------------------------------------------------


def _cages(character: Character, surface: np.ndarray) -> dict[int, Character]:
    """The content of each cage, by the number of its attachment: the character with those triangles and its share of
    the nodes. A triangle between attachments belongs to the one with the largest number. Rigid attachments have no
    cage.
    """
    number = character.cage_index[character.triangles].max(axis=1, initial=-1)
    if not number.any():
        return {0: character}
    area = triangle_areas(surface, character.triangles)
    density = character.settings.cage_nodes / max(area[number >= 0].sum(), 1e-300)
    cages = {}
    for index in np.unique(number[number >= 0]):
        of_cage = number == index
        cage_nodes = max(FEWEST_NODES, round(density * area[of_cage].sum()))
        cages[int(index)] = replace(
            character.with_settings(cage_nodes=cage_nodes),
            triangles=character.triangles[of_cage],
            cage=None if index else character.cage,
        )
    if not cages:
        raise dynamorph.Error(
            f"'{character.name}': every part of it is rigid: choose With Body for at least one attachment"
        )
    return cages


def _turns(count: int, report: Report) -> list[Report]:
    """The progress of each of so many steps; they take similar times."""

    def of_turn(turn: int) -> Report:
        return lambda fraction: report((turn + fraction) / count)

    return [of_turn(turn) for turn in range(count)]


@dataclass(frozen=True)
class _Filled:
    """One cage, or all of them, of n nodes and m tets, cut where skin merely touches. embedding: of all V vertices;
    fill (m,); pinned (n,) bool: by bones; glued: counts, as in the summary.
    """

    mesh: dynamorph.TetMesh
    embedding: dynamorph.Embedding
    fill: np.ndarray
    pinned: np.ndarray
    glued: dict[str, int]
    warnings: list[str]


def _filled(cage: Character, mesh: dynamorph.TetMesh, surface: np.ndarray, report: Report) -> _Filled:
    warnings = _outside(cage, mesh, surface)  # first: skin far larger than its cage would take all memory to part
    mesh, embedding, glued = _parted(cage, mesh, surface)
    fill = dynamorph.fill_fractions(mesh, surface, cage.triangles, progress=report)
    return _Filled(mesh, embedding, fill, _pinned(cage, mesh, surface), glued, warnings)


def _new(
    character: Character, contents: dict[int, Character], surface: np.ndarray, stages: Stages
) -> tuple[_Filled, dict[str, int], BodyThickness | None]:
    """New cages, the defects of the skin, and the thickness of the body where that holds it."""
    with stages("Meshing", 0.30) as report:
        defects = dynamorph.closed_surface(surface, character.triangles)[2]  # first: it refuses with advice
        meshes, body = _meshed(character, contents, surface, report)
    with stages("Embedding", 0.03) as report:
        each_filled = zip(contents.values(), meshes, _turns(len(meshes), report), strict=True)
        cages = [_filled(each, mesh, surface, turn) for each, mesh, turn in each_filled]
        mesh, embedding = _together(character.cage_index, list(contents), cages)
        filled = _Filled(
            mesh,
            _alike(embedding, character.coincident),
            np.concatenate([cage.fill for cage in cages]),
            np.concatenate([cage.pinned for cage in cages]),
            {name: sum(cage.glued[name] for cage in cages) for name in cages[0].glued},
            [text for cage in cages for text in cage.warnings],
        )
    return filled, defects, body


def _filled_before(contents: dict[int, Character], model: Model, surface: np.ndarray) -> _Filled:
    """The cages of an earlier model."""
    mesh = dynamorph.TetMesh(model.nodes, model.tets)
    cage = next(iter(contents.values()))
    warnings = _outside(cage, mesh, surface)
    return _Filled(mesh, model.embedding, model.fill, _pinned(cage, mesh, surface), model.summary.glued, warnings)


def _pinned(cage: Character, mesh: dynamorph.TetMesh, surface: np.ndarray) -> np.ndarray:
    by_bones = cage.settings.hold == "BONES"
    return pins.pinned(cage, mesh, surface) if by_bones else np.zeros(len(mesh.nodes), bool)


def _together(
    cage_index: np.ndarray, numbers: list[int], cages: list[_Filled]
) -> tuple[dynamorph.TetMesh, dynamorph.Embedding]:
    """One mesh of all cages, which are not coupled, and the embedding (V,) of each attachment in its own. A vertex of
    an attachment without a cage has no weights: the simulation does not move it.
    """
    if len(cages) == 1 and (cage_index == numbers[0]).all():
        return cages[0].mesh, cages[0].embedding
    first = np.cumsum([0] + [len(cage.mesh.nodes) for cage in cages])[:-1]
    nodes, weights = np.zeros((len(cage_index), 4), np.int32), np.zeros((len(cage_index), 4))
    for number, start, cage in zip(numbers, first, cages, strict=True):
        of_cage = cage_index == number
        nodes[of_cage], weights[of_cage] = cage.embedding.nodes[of_cage] + start, cage.embedding.weights[of_cage]
    tets = np.concatenate([cage.mesh.tets + start for start, cage in zip(first, cages, strict=True)])
    mesh = dynamorph.TetMesh(np.concatenate([cage.mesh.nodes for cage in cages]), tets)
    return mesh, dynamorph.Embedding(nodes, weights)


def _alike(embedding: dynamorph.Embedding, coincident: np.ndarray) -> dynamorph.Embedding:
    """The embedding in which all vertices at one place have that of the first, because a cut would tear them apart."""
    if np.array_equal(coincident, np.arange(len(coincident))):
        return embedding
    return dynamorph.Embedding(embedding.nodes[coincident], embedding.weights[coincident])


def _meshed(
    character: Character, contents: dict[int, Character], surface: np.ndarray, report: Report
) -> tuple[list[dynamorph.TetMesh], BodyThickness | None]:
    """The tetrahedra of each cage, and the thickness of the body where that holds it. It is found while another process
    meshes the first cage.
    """
    by_thickness = character.settings.hold != "BONES"
    turns = iter(_turns(by_thickness + len(contents), report))
    meshes: list[dynamorph.TetMesh] = []
    body = None
    for each in contents.values():
        with _begun(each, surface) as meshing:
            if by_thickness and not meshes:
                body = BodyThickness.of(*_enclosing(character), next(turns))
            meshes.append(_tetrahedra(each, surface, meshing, next(turns)))
    return meshes, body


def _begun(character: Character, surface: np.ndarray) -> dynamorph.Meshing:
    """The mesher of a cage, at work."""
    settings, cage = character.settings, character.cage
    with _named(cage):
        return dynamorph.Meshing(
            _snapped(surface, character, surface),
            character.triangles,
            settings.cage_nodes,
            cage=cage and cage[1:],
            bones=_snapped(character.bone_segments, character, surface) if settings.hold == "BONES" else None,
            pin_radius=settings.pin_radius,
        )


def _tetrahedra(
    character: Character, surface: np.ndarray, meshing: dynamorph.Meshing, report: Report
) -> dynamorph.TetMesh:
    """What that mesher makes."""
    cage = character.cage
    with _named(cage):
        mesh = meshing.result(report)[2]
    if character.settings.hold == "BONES":  # for whose lines nodes were placed
        return mesh
    skin = _snapped(surface, character, surface)
    return dynamorph.symmetric_like(mesh, *(cage[1:] if cage else (skin, character.triangles)))


def _snapped(points: np.ndarray, character: Character, surface: np.ndarray) -> np.ndarray:
    """The points on the grid of the character's skin."""
    grid = GRID * 2.0 ** np.floor(np.log2(diagonal(surface[np.unique(character.triangles)])))
    return np.round(points / grid) * grid


@contextmanager
def _named(cage: OwnCage | None) -> Iterator[None]:
    """Errors name the artist's own cage, if that is what is filled."""
    try:
        yield
    except dynamorph.Error as error:
        raise dynamorph.Error(f"Cage Object '{cage.name}': {error}") if cage else error from None


def _outside(character: Character, mesh: dynamorph.TetMesh, surface: np.ndarray) -> list[str]:
    """Reports which part of the skin the artist's own cage leaves out. Raises dynamorph.Error when that is most of
    it.
    """
    if character.cage is None:
        return []
    size = diagonal(character.bind_points)
    embedding = dynamorph.embed(mesh, surface)
    left = float((embedding.distances > 1e-5 * size)[character.cage_index == 0].mean())
    if left > MOSTLY:
        raise dynamorph.Error(
            f"Cage Object '{character.cage.name}' leaves out {left:.0%} of '{character.name}': it must enclose the "
            "skin as it is in rest pose when the scene starts. Move or enlarge it, or clear Cage Object"
        )
    warning = f"{left:.1%} of the skin lies outside Cage Object '{character.cage.name}' and follows its nearest part"
    return [warning] if left else []


# Parts that touch ----------------------------------------------------------------------------------------------------


def _parted(
    cage: Character, mesh: dynamorph.TetMesh, surface: np.ndarray
) -> tuple[dynamorph.TetMesh, dynamorph.Embedding, dict[str, int]]:
    """The mesh, cut where it joins skin that merely touches, the embedding of the skin in it, and the counts."""
    mesh_cut = dynamorph.MeshCut(mesh, surface, cage.triangles)
    tets = int(mesh_cut.glued.sum())
    if not tets:
        return mesh, dynamorph.embed(mesh, surface), {"tets": tets, "split_nodes": 0}
    cut = mesh_cut.cut()
    return cut, mesh_cut.embed(cut), {"tets": tets, "split_nodes": len(cut.nodes) - len(mesh.nodes)}


# What the cage inherits from the skin --------------------------------------------------------------------------------


class Inherited(NamedTuple):
    """What the cage inherits from the skin: firmness (n,) of the Firmness map, weights (n, B + 1) of the bones,
    rigidity (n,), region_weights (m, S) of the tets.
    """

    firmness: np.ndarray
    weights: np.ndarray
    rigidity: np.ndarray
    region_weights: np.ndarray


def inherit(character: Character, mesh: dynamorph.TetMesh, embedding: dynamorph.Embedding) -> Inherited:
    """Values at the skin's points, extended to the cage around them."""
    # Exactly neutral where nothing is painted, and never beyond what is.
    painted = character.firmness - paint.NEUTRAL
    parts = [target_set.region_weights for target_set in character.target_sets]
    values = np.column_stack([painted, character.weights, character.rigidity, *parts])
    at_nodes = dynamorph.extend_to_nodes(mesh, embedding, values)
    firmness = paint.NEUTRAL + at_nodes[:, 0].clip(painted.min(), painted.max())
    bones = character.weights.shape[1]
    weights, rigidity, regions = np.split(at_nodes[:, 1:].clip(0.0), np.cumsum([bones, 1]), axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    return Inherited(firmness, weights, rigidity[:, 0].clip(max=1.0), _of_tets(regions, mesh.tets))


def region_weights(character: Character, model: Model) -> np.ndarray:
    """The same (m, S) in the cage of an earlier model."""
    values = np.column_stack([target_set.region_weights for target_set in character.target_sets])
    return _of_tets(model.at_nodes(values).clip(0.0), model.tets)


def _of_tets(regions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Weights (m, S) of the tets in the regions, which add up to one, from those (n, S) of the nodes."""
    of_tets = regions[tets].mean(axis=1)
    return of_tets / of_tets.sum(axis=1, keepdims=True)


class Stages:
    """Times the stages of a build and maps the progress 0..1 of each to a part of the total."""

    def __init__(self, progress: ProgressFn | None, whole: float = 1.0):
        self.progress = progress
        self.whole = whole
        self.done = 0.0
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, message: str, share: float) -> Iterator[Report]:
        began, start = time.perf_counter(), self.done

        def report(fraction: float) -> bool:
            done = (start + share * fraction) / self.whole
            going_on = self.progress is None or self.progress(done, message)
            if not going_on:
                raise dynamorph.Cancelled("canceled")
            return True

        report(0.0)
        yield report
        name = message.lower()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
        self.done += share
