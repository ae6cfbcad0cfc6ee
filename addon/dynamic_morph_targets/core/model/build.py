# SPDX-License-Identifier: GPL-3.0-or-later
"""Character -> Model: cage, tetrahedra, target shapes in the nodes, modes, polynomials. Never touches bpy.

A Model holds geometry only. Stiffness, damping, density and poses come from the Character when it is simulated, so
that changing them never needs a new build.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, TypeAlias, TypeGuard

import numpy as np

from .. import firmness
from ..character import Character, Target
from ..engine import dynamorph
from ..errors import SceneError
from ..settings import ENGINE, FREE_SETTINGS, TABULATED, ModelSettings
from . import cage
from .cage import ProgressFn, Report, Stages
from .model import CAGE_DEPENDENCIES, MESH_DEPENDENCIES, Model, array_hash, engine_hash, morph_targets
from .summary import Summary

SimulateShot = Callable[[Model, Report], tuple[np.ndarray, np.ndarray]]
FITTED_IN_FULL = 1500  # degrees of freedom up to which a shot is simulated unreduced, to fit modes to it
CAGE_SHARE = 0.35  # of the time of a build
DRAFT = 40  # modes of a draft
# What a model takes over from an earlier one with the same tissue, and what the summary says of that.
TISSUE = (
    "nodes", "tets", "fill", "stiffness", "pinned", "hold_strength", "hold", "thickness", "unpainted_stiffness",
    "unpainted_hold", "node_weights", "embedding_nodes", "embedding_weights",
)  # fmt: skip
CAGE_FACTS = ("nodes", "tets", "pinned", "held", "held_parts", "defects", "quality", "glued")
PAINT = {"Firmness", "what is rigid"}  # the dependencies on the Firmness map: soft paint frees the head


def build(
    character: Character,
    progress: ProgressFn | None = None,
    previous: Model | None = None,
    simulate_shot: SimulateShot | None = None,
    draft: Callable[[Model], None] | None = None,
) -> Model:
    """Builds the model of a character.

    progress(fraction, message) -> bool; False raises dynamorph.Cancelled. previous: a model of the same character,
    whose parts are used again where nothing that they depend on has changed. simulate_shot(model, report):
    coordinates (F, dofs) and target weights (F, J) of the shot to which modes are fitted. draft(model): is called with
    a model of few modes, which can be played while the others are found, where there are many. Raises dynamorph.Error
    or SceneError with advice when the mesh or the targets cannot be used.
    """
    hashes = dependencies(character)
    if character.settings.method == "STATIC":
        return _static_model(character, hashes)
    stages = Stages(progress)
    model = _with_tissue(character, hashes, previous, stages)
    made = model.made
    body = model.soft_body()
    with stages("Target shapes", 0.10):
        _shape_targets(model, body, character.targets)
    targets = morph_targets(character, model.displacements)
    full = _full_model(body, targets, character.settings)
    basis: Basis
    if character.settings.solver == "REDUCED":
        if character.settings.fits_shot:
            basis = _fitted_basis(model, body, full, character, simulate_shot, stages)
        else:
            drafts = draft and character.settings.basis == "RESPONSES" and character.settings.modes > DRAFT
            if draft and drafts:
                with stages("Draft", 0.10) as report:
                    few = _basis(full, len(targets), replace(character.settings, modes=DRAFT), report)
                    draft(_reduced(model, full, few, lambda _done: True))
            with stages("Modes", 0.25 if drafts else 0.35) as report:
                basis = _basis(full, len(targets), character.settings, report)
        with stages("Polynomials", 0.20) as report:
            model = _reduced(model, full, basis, report)
    model.made.update(made)
    return model.with_summary(
        dofs=full.dofs,
        modes=model.modes.shape[1],
        tabulated=model.basis.shape[1],
        targets=character.target_count,
        seconds=stages.seconds,
    )


def build_cage(character: Character, progress: ProgressFn | None = None, previous: Model | None = None) -> Model:
    """The tetrahedra alone and what holds them: a model to look at, which `build` accepts as its `previous`. Arguments
    and errors as for `build`.
    """
    if character.settings.method == "STATIC":
        raise SceneError("'{name}' needs no cage: with the Method Static nothing is simulated", name=character.name)
    hashes = dependencies(character)
    stages = Stages(progress, CAGE_SHARE)
    of_cage = {name: hashes[name] for name in CAGE_DEPENDENCIES if name in hashes}
    return _with_tissue(character, of_cage, previous, stages).with_summary(seconds=stages.seconds)


Basis: TypeAlias = "np.ndarray | dynamorph.ResponseBasis"  # modes (3 free, r), or modes and responses


def _basis(full: dynamorph.FullModel, targets: int, settings: ModelSettings, report: Report) -> Basis:
    """The subspace that the settings ask for, in which all targets' shapes are among the tabulated modes."""
    if settings.basis == "MODES":
        return dynamorph.make_basis(full, settings.modes, report).U
    sculpted = sum(bool(full.target(j).any()) for j in range(targets))
    tabulated = max(settings.tabulated, sculpted + TABULATED[0])
    return dynamorph.make_response_basis(full, tabulated, max(settings.modes - tabulated, 1), report)


def _reduced(model: Model, full: dynamorph.FullModel, basis: Basis, report: Report) -> Model:
    """The model in `basis`."""
    tables = dynamorph.reduce(full, basis, report)
    model = replace(
        model,
        basis=tables.basis,
        table_lambda=np.array(tables.lame_lambda),
        table_mu=np.array(tables.lame_mu),
    )
    if not tables.responses.size:
        return model
    h = tables.responses.shape[1]
    response_lambda, response_mu = np.array(tables.response_lambda), np.array(tables.response_mu)
    return replace(
        model,
        responses=tables.responses,
        response_lambda=response_lambda[:, :h],
        response_mu=response_mu[:, :h],
        coupling_lambda=response_lambda[:, h:].astype(np.float32),
        coupling_mu=response_mu[:, h:].astype(np.float32),
        relaxation=np.array(tables.relaxation),
    )


def _fitted_basis(
    model: Model,
    body: dynamorph.SoftBody,
    full: dynamorph.FullModel,
    character: Character,
    simulate_shot: SimulateShot | None,
    stages: Stages,
) -> np.ndarray:
    """Modes (3 free, r) for a shot: the targets' shapes exactly, then the largest motion about them in a rehearsal
    (mass-PCA).

    The rehearsal is unreduced where that takes seconds, and otherwise uses more modes than requested. The usual modes
    are mixed in with a small weight, so that there are enough modes in a shot with little motion.
    """
    if simulate_shot is None:
        raise ValueError(f"'{character.name}': there is no shot to fit the modes to")
    wanted = character.settings.modes
    in_full = full.dofs <= FITTED_IN_FULL
    with stages("Modes", 0.05 if in_full else 0.15) as report:
        more = 0 if in_full else min(character.settings.rehearsed_modes, full.dofs // 3)
        usual = dynamorph.make_basis(full, max(wanted, more), report).U
    with stages("Rehearsal", 0.30 if in_full else 0.20) as report:
        building = 0.0 if in_full else 0.8  # of the time, by polynomials in many modes
        if in_full:
            rehearsed = replace(model, settings=replace(model.settings, solver="FULL"))
            root = np.sqrt(np.repeat(body.volumes.sum(axis=1), 3))  # of the mass for unit density
            orthonormal, scale, little = np.diag(1.0 / root), root, root[:, None] * usual
        else:
            orthonormal, scale, little = usual, 1.0, np.eye(usual.shape[1])
            rehearsed = _reduced(model, full, usual, lambda fraction: report(building * fraction))
        coordinates, weights = simulate_shot(rehearsed, lambda fraction: report(building + (1.0 - building) * fraction))
        targets = rehearsed.target_coordinates(rehearsed.engine(character))
        motion = (scale * (coordinates - weights @ targets)).T
        u, s, _ = np.linalg.svd((scale * targets).T, full_matrices=False)
        shapes = u[:, s > 1e-9 * max(s[0], 1e-300)]
        motion = np.hstack([motion, little * max(1e-3 * np.abs(motion).max(), 1e-300)])
        others, _, _ = np.linalg.svd(motion - shapes @ (shapes.T @ motion), full_matrices=False)
    return orthonormal @ np.hstack([shapes, others[:, : wanted - shapes.shape[1]]])


def _static_model(character: Character, hashes: dict[str, str]) -> Model:
    """Geometric morph targets: nothing is simulated, so there are no tetrahedra, and the shapes are residual shapes
    only.
    """
    targets = character.targets
    return _model(
        character,
        hashes,
        region_weights=np.zeros((0, len(character.target_sets))),
        residual_shapes=np.array([target.shape for target in targets]),
        summary=Summary(targets=character.target_count),
    )


def only_paint_changed(model: Model, character: Character) -> bool:
    """Whether `repainted` makes `model` fit `character` again."""
    changed = set(changes(model, character))
    return bool(changed) and changed <= PAINT and character.settings.hold == "THICKNESS" and not model.only_cage


def repainted(model: Model, character: Character) -> Model:
    """The model of another Firmness map, for a picture while it is painted. The cage and the span of the modes stay.
    Only what depends on the stiffness is computed again. A build finds modes for the map, so this is never stored.
    """
    mesh = dynamorph.TetMesh(model.nodes, model.tets)
    inherited = cage.inherit(character, mesh, model.embedding)
    hold = cage.held_by_thickness(character, mesh, inherited, model.fill, model.made)
    model = replace(
        model,
        stiffness=hold.stiffness * _factor(inherited.firmness, mesh.tets),
        hold_strength=hold.strength,
        hold=hold.phi,
        unpainted_stiffness=hold.stiffness,
        unpainted_hold=hold.unpainted,
    )
    if not model.basis.size:
        return model
    full = _full_model(model.soft_body(), morph_targets(character, model.displacements), model.settings)
    basis: Basis = model.basis
    if model.responses.size:
        basis = dynamorph.adapt_response_basis(full, model.basis, model.responses)
    return _reduced(model, full, basis, lambda _done: True)


def _full_model(
    body: dynamorph.SoftBody, targets: list[dynamorph.MorphTarget], settings: ModelSettings
) -> dynamorph.FullModel:
    """The model from which modes are made."""
    material_model = dynamorph.MaterialModel.__members__[settings.material_model]
    return dynamorph.FullModel(body, targets, material_model, dynamorph.Blending.EVEN)


def _factor(weights: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The factor (m,) on the stiffness of tets whose nodes have these weights (n,) of the Firmness map."""
    return firmness.stiffness(weights)[tets].mean(axis=1)


def _model(character: Character, hashes: dict[str, str], **known: Any) -> Model:
    """A model with the `known` fields and those that it takes over from the character; all others are empty."""
    empty = {name: np.zeros((0, 0)) for name in Model.array_names()}
    taken: dict[str, Any] = {
        "target_sets": character.set_of_target,
        "to_bind": character.to_bind,
        "parents": character.skeleton.parents,
        "rest": character.skeleton.rest,
        "bone_names": character.skeleton.names,
        "settings": character.settings,
        "dependencies": hashes,
        "summary": Summary(),
    }
    return Model(**(empty | taken | known))


def _with_tissue(character: Character, hashes: dict[str, str], previous: Model | None, stages: Stages) -> Model:
    """The tetrahedra around the skin with everything that they inherit from it; the targets' shapes are added later."""
    if _fits(previous, hashes, CAGE_DEPENDENCIES) and not previous.summary.warnings:  # which names may have outdated
        return _with_tissue_of(previous, character, hashes, stages)
    tissue = cage.make_cage(character, previous if _fits(previous, hashes, MESH_DEPENDENCIES) else None, stages)
    hold, painted = tissue.hold, bool((tissue.firmness != firmness.NEUTRAL).any())
    model = _model(
        character,
        hashes,
        nodes=tissue.mesh.nodes,
        tets=tissue.mesh.tets,
        fill=tissue.fill,
        stiffness=tissue.stiffness * _factor(tissue.firmness, tissue.mesh.tets),
        region_weights=tissue.region_weights,
        pinned=tissue.pinned,
        hold_strength=hold.strength if hold else np.zeros(0),
        hold=hold.phi if hold else np.zeros(0),
        thickness=hold.thickness if hold else np.zeros(0),
        unpainted_stiffness=tissue.stiffness if painted else np.zeros(0),
        unpainted_hold=hold.unpainted if hold and painted else np.zeros(0),
        node_weights=tissue.node_weights,
        embedding_nodes=tissue.embedding.nodes,
        embedding_weights=tissue.embedding.weights,
        displacements=np.zeros((len(character.targets), len(tissue.mesh.nodes), 3)),
        residual_shapes=np.zeros((len(character.targets), len(character.vertices), 3)),
        summary=tissue.summary,
    )
    model.made.update(tissue.made)
    return model


def _with_tissue_of(previous: Model, character: Character, hashes: dict[str, str], stages: Stages) -> Model:
    """The same of an earlier model that fits. Only the regions may be others."""
    with stages("Embedding", CAGE_SHARE):
        region_weights = cage.region_weights(character, previous)
    model = _model(
        character,
        hashes,
        **{name: getattr(previous, name) for name in TISSUE},
        region_weights=region_weights,
        displacements=np.zeros((len(character.targets), len(previous.nodes), 3)),
        residual_shapes=np.zeros((len(character.targets), len(character.vertices), 3)),
        summary=Summary(**{name: getattr(previous.summary, name) for name in CAGE_FACTS}),
    )
    model.made.update(cage.kept_depths(previous))
    return model


def _shape_targets(model: Model, body: dynamorph.SoftBody, targets: list[Target]) -> None:
    """Extends each sculpted shape to the nodes. What the cage cannot represent becomes a residual shape."""
    sculpted = [j for j, target in enumerate(targets) if target.shape.any()]
    if sculpted:
        shapes = np.array([targets[j].shape for j in sculpted])
        model.displacements[sculpted] = body.extend_shapes(model.embedding, shapes @ model.to_bind.T)
        model.residual_shapes[sculpted] = shapes - model.surface(model.displacements[sculpted])


# What a model depends on -------------------------------------------------------------------------------------------

# What the artist calls them, where that is not their name.
TITLES = {
    "basis": "Modes From",
    "blending": "Between Targets",
    "cage nodes": "Cage Nodes",
    "fit to shot": "Fit Modes to Shot",
    "hold": "Hold",
    "hold head": "Hold Head",
    "material model": "Material Model",
    "method": "Method",
    "modes": "Detail (Modes)",
    "pin radius": "Bone Pinning",
    "solver": "Quality",
}


def dependencies(character: Character) -> dict[str, str]:
    """Hashes of everything that a built model depends on, by name. Materials and poses are not among them."""
    skeleton, settings = character.skeleton, character.settings
    parts = {
        "mesh": (character.vertices, character.triangles),
        "object scale": (character.to_bind,),
        "skin weights": (character.weights,),
        "Firmness": (character.firmness,),
        "attachments": (character.cage_index,),
        "what is rigid": (character.rigidity,),
        "bones at rest": (skeleton.parents, skeleton.rest, character.bone_segments),
        "regions": (
            np.array([len(target_set.targets) for target_set in character.authored_sets]),
            *(target_set.region_weights for target_set in character.authored_sets),
        ),
        "number of targets": (np.array([len(character.authored_targets)]),),
    }
    for j, target in enumerate(character.authored_targets):
        parts[f"shape {j}"] = (target.shape,)
    if character.cage:
        parts["cage object"] = character.cage[1:]
    for name, value in asdict(settings).items():
        if name not in FREE_SETTINGS:
            parts[name.replace("_", " ")] = (np.frombuffer(str(value).encode(), np.uint8),)
    return {"engine": engine_hash(ENGINE)} | {name: array_hash(arrays) for name, arrays in parts.items()}


def changes(model: Model, character: Character) -> list[str]:
    """The dependencies by which `model` no longer fits `character`."""
    now, then = dependencies(character), model.dependencies
    considered = CAGE_DEPENDENCIES if model.only_cage else {**now, **then}
    changed = [name for name in considered if now.get(name) != then.get(name)]
    if model.settings.solver == "REDUCED" and "solver" in changed:  # it serves unreduced simulations too
        changed.remove("solver")
    return changed


def stale_reasons(model: Model, character: Character) -> list[str]:
    """Why `model` no longer fits `character`, for the artist; empty when it does."""
    vertices, before = len(character.vertices), model.residual_shapes.shape[1]
    if vertices != before:  # then everything else differs too
        return [f"the mesh has {vertices} vertices instead of {before}"]
    changed = changes(model, character)
    names = TITLES | {f"shape {j}": f"shape of '{target.name}'" for j, target in enumerate(character.authored_targets)}
    if "number of targets" in changed:
        changed = [name for name in changed if not name.startswith("shape ")]
    return ["only the cage is built"] * model.only_cage + [f"{names.get(name, name)} changed" for name in changed]


def has_cage(model: Model, character: Character) -> bool:
    """Whether `model` has the tetrahedra, and the hold, that `character` requires."""
    return _fits(model, dependencies(character), CAGE_DEPENDENCIES)


def _fits(model: Model | None, hashes: dict[str, str], names: tuple[str, ...]) -> TypeGuard[Model]:
    """Whether there are tetrahedra, and nothing of these names has changed since they were built."""
    if model is None or not len(model.tets):
        return False
    return all(model.dependencies.get(name) == hashes.get(name) for name in names)
