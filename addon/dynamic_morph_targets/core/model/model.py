# SPDX-License-Identifier: GPL-3.0-or-later
"""A built soft skin: geometry only, on arrays. Never touches bpy."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, TypeAlias

import numpy as np

from .. import memory
from ..character import Character, Skeleton
from ..engine import dynamorph
from ..errors import ModelFileError, SceneError
from ..geometry import interpolated
from ..settings import Material, ModelSettings
from . import schema
from .summary import Summary

# The tetrahedra of a model, and the skin's place in them, depend on these, named as in `Model.dependencies`.
MESH_DEPENDENCIES = (
    "mesh", "object scale", "bones at rest", "cage nodes", "cage object", "pin radius", "attachments", "engine", "hold",
)  # fmt: skip
# The tetrahedra together with what holds them depend on these; shapes, modes and polynomials on everything.
CAGE_DEPENDENCIES = (*MESH_DEPENDENCIES, "skin weights", "Firmness", "what is rigid", "hold head")

# What a build makes again, and the rest after it: the parts of a model in the order in which they are built.
CAGE, HOLD, MODES = "CAGE", "HOLD", "MODES"


def first_part(changed: Iterable[str]) -> str:
    """The first part that depends on what has changed, of names as in `Model.dependencies`."""
    names = set(changed)
    return CAGE if names & set(MESH_DEPENDENCIES) else HOLD if names & set(CAGE_DEPENDENCIES) else MODES


EngineModel: TypeAlias = "dynamorph.ReducedModel | dynamorph.FullModel"


@dataclass(frozen=True)
class Model:
    """A built soft skin: n nodes, m tets, V surface vertices, J targets, S sets, B bones, r modes. Bind space, meters.

    nodes (n, 3), tets (m, 4), fill (m,), stiffness (m,) factor on the targets', region_weights (m, S), pinned (n,). Of
    a hold by thickness, else empty: hold_strength (m,) 1/m^2 as `dynamorph.SoftBody` takes it, hold (n,) how firmly
    from 0 to 1, thickness (V,) of the body at the skin. Where Firmness is painted, else empty:
    unpainted_stiffness and unpainted_hold (m,), the stiffness and hold_strength without it.
    node_weights (n, B + 1), embedding_nodes and embedding_weights (V, 4), target_sets (J,) the set that each target is
    in, displacements (J, n, 3), residual_shapes (J, V, 3) local space: what the cage cannot carry of the targets'
    shapes; to_bind (3, 3); parents (B,), rest (B, 4, 4) of the skeleton. basis (3 free, r), table_lambda and table_mu
    (J, ...) of a reduced model (dynamorph.ReducedTables), empty of a full one. Of one with responses, else empty:
    responses (3 free, h), response_lambda and response_mu (J, h) their stiffness, coupling_lambda and coupling_mu
    (J, ...) in single precision as it is simulated, relaxation (J, h, r). Static morph targets have no nodes: their
    residual shapes are the shapes. made: what others have made of the model that takes long, by what else it depends
    on; it goes along to other processes.
    """

    nodes: np.ndarray
    tets: np.ndarray
    fill: np.ndarray
    stiffness: np.ndarray
    region_weights: np.ndarray
    pinned: np.ndarray
    hold_strength: np.ndarray
    hold: np.ndarray
    thickness: np.ndarray
    unpainted_stiffness: np.ndarray
    unpainted_hold: np.ndarray
    node_weights: np.ndarray
    embedding_nodes: np.ndarray
    embedding_weights: np.ndarray
    target_sets: np.ndarray
    displacements: np.ndarray
    residual_shapes: np.ndarray
    to_bind: np.ndarray
    parents: np.ndarray
    rest: np.ndarray
    basis: np.ndarray
    table_lambda: np.ndarray
    table_mu: np.ndarray
    responses: np.ndarray
    response_lambda: np.ndarray
    response_mu: np.ndarray
    coupling_lambda: np.ndarray
    coupling_mu: np.ndarray
    relaxation: np.ndarray
    bone_names: tuple[str, ...]
    settings: ModelSettings
    dependencies: dict[str, str]
    summary: Summary
    made: dict = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Lays the arrays out as a stored model's are: of another layout NumPy's sums have other last digits."""
        for name in self.array_names():
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    @classmethod
    def array_names(cls) -> list[str]:
        return [each.name for each in fields(cls) if each.type == "np.ndarray"]

    def to_arrays(self) -> tuple[dict[str, np.ndarray], dict]:
        """(arrays, metadata) for `model_file`. The same model gives the same bytes."""
        meta = {
            "settings": asdict(self.settings),
            "bone_names": list(self.bone_names),
            "dependencies": self.dependencies,
            "summary": self.summary.stored,
        }
        return {name: getattr(self, name) for name in self.array_names()}, meta

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray], meta: dict) -> Model:
        """The inverse of `to_arrays`. Raises ModelFileError when something is missing, or does not fit together."""
        try:
            known: dict[str, Any] = {name: arrays[name] for name in cls.array_names()}
            settings = ModelSettings(**meta["settings"])
            described: dict[str, Any] = {
                "bone_names": meta["bone_names"],
                "dependencies": {**meta["dependencies"]},
                "summary": meta["summary"],
            }
        except (KeyError, TypeError) as error:
            raise ModelFileError("The stored model is incomplete ({error}): build it again", error=error) from error
        schema.check(known, settings, described, set(described["dependencies"]) <= set(CAGE_DEPENDENCIES))
        described["bone_names"] = tuple(described["bone_names"])
        described["summary"] = Summary.from_stored(described["summary"])
        model = cls(**known, **described, settings=settings)
        try:
            model._check_with_engine()
        except (ValueError, KeyError, dynamorph.Error) as error:
            raise schema.damaged(str(error)) from error
        return model

    def _check_with_engine(self) -> None:
        """Make, with any material, what would be simulated; raises what the engine does."""
        if not len(self.tets):
            return
        body = self.soft_body()
        if self.settings.solver == "REDUCED" and not self.only_cage:
            room = memory.room()
            needed = memory.inertia_bytes(self.node_weights, self.basis.shape[1], self.region_weights.shape[1])
            if needed > room.limit:
                raise schema.damaged("it needs more memory than there is")
            if needed > room.free:
                raise MemoryError
            dynamorph.ReducedModel(body, self.plain_targets(), self._tables(), dynamorph.Blending.EVEN)

    @property
    def only_cage(self) -> bool:
        """Whether only its tetrahedra are built, and what holds them."""
        return set(self.dependencies) <= set(CAGE_DEPENDENCIES)

    @property
    def skeleton(self) -> Skeleton:
        return Skeleton(self.bone_names, self.parents, self.rest)

    @property
    def free(self) -> np.ndarray:
        """Which nodes (n,) are not pinned to bones."""
        return ~self.pinned.astype(bool)

    def soft_body(self, probed: bool = False) -> dynamorph.SoftBody:
        """The engine's body. probed: every free node has a transform of its own."""
        mesh, weights = dynamorph.TetMesh(self.nodes, self.tets), None if probed else self.node_weights
        strength, pinned = self.hold_strength if self.hold_strength.size else None, (~self.free).tolist()
        return dynamorph.SoftBody(mesh, self.fill, self.stiffness, self.region_weights, pinned, weights, strength)

    @property
    def embedding(self) -> dynamorph.Embedding:
        """Of the surface vertices (V,) in the tetrahedra."""
        return dynamorph.Embedding(self.embedding_nodes, self.embedding_weights)

    def at_nodes(self, values: np.ndarray) -> np.ndarray:
        """Values (n, k) at the nodes from values (V, k) of the skin, smooth inside; may overshoot slightly."""
        return dynamorph.extend_to_nodes(dynamorph.TetMesh(self.nodes, self.tets), self.embedding, values)

    def engine(self, character: Character, probed: bool = False) -> EngineModel:
        """The engine's model with the materials and blending of `character`. Raises SceneError if the model is not that
        character's. probed: as for `soft_body`.
        """
        if len(character.targets) != len(self.displacements):
            raise SceneError("'{name}' has other targets than its model: build it again", name=character.name)
        targets = morph_targets(character, self.displacements)
        blending = dynamorph.Blending.__members__[character.settings.blending]
        if self.settings.solver == "FULL":
            material_model = dynamorph.MaterialModel.__members__[self.settings.material_model]
            return dynamorph.FullModel(self.soft_body(probed), targets, material_model, blending)
        return dynamorph.ReducedModel(self.soft_body(probed), targets, self._tables(), blending)

    def plain_targets(self) -> list[dynamorph.MorphTarget]:
        """The engine's targets, all of one material that no artist has chosen."""
        lame_lambda, lame_mu = Material().lame()
        return [
            dynamorph.MorphTarget("", shape, lame_lambda=lame_lambda, lame_mu=lame_mu, density=Material.density, set=s)
            for shape, s in zip(self.displacements, self.target_sets.tolist(), strict=True)
        ]

    def _tables(self) -> dynamorph.ReducedTables:
        lame_lambda = np.hstack([self.response_lambda, self.coupling_lambda])
        lame_mu = np.hstack([self.response_mu, self.coupling_mu])
        return dynamorph.ReducedTables(
            dynamorph.MaterialModel.__members__[self.settings.material_model],
            self.basis, list(self.table_lambda), list(self.table_mu),
            self.responses, list(lame_lambda), list(lame_mu), list(self.relaxation),
        )  # fmt: skip

    def with_settings(self, settings: ModelSettings) -> Model:
        """The same model, to be simulated with another `solver`. One that was built as FULL has no modes for a reduced
        simulation.
        """
        return self._as_well_made(replace(self, settings=settings))

    def with_summary(self, **changes: Any) -> Model:
        """The same model with other facts in its summary."""
        return self._as_well_made(replace(self, summary=replace(self.summary, **changes)))

    def _as_well_made(self, same: Model) -> Model:
        object.__setattr__(same, "made", self.made)  # the same tissue has the same made of it
        return same

    @property
    def unpainted(self) -> Model:
        """The same body as it is without the Firmness map, for which Bounce is meant."""
        if not self.unpainted_stiffness.size:
            return self
        return replace(self, stiffness=self.unpainted_stiffness, hold_strength=self.unpainted_hold)

    @property
    def modes(self) -> np.ndarray:
        """Displacement (3 free, dofs) of the free nodes by each coordinate of a reduced model."""
        return np.hstack([self.basis, self.responses]) if self.responses.size else self.basis

    def target_coordinates(self, engine: EngineModel) -> np.ndarray:
        """Coordinates (J, dofs) of every target's shape."""
        return np.array([engine.target(j) for j in range(len(self.displacements))])

    def surface(self, displacement: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Displacement of the render surface (..., V, 3), local space, from that of the nodes (..., n, 3), bind.

        weights (V, 4): by which the nodes carry it, by default `embedding_weights`.
        """
        bind = interpolated(displacement, self.embedding_nodes, self.embedding_weights if weights is None else weights)
        return bind @ np.linalg.inv(self.to_bind).T

    def on_nodes(self, force: np.ndarray) -> np.ndarray:
        """Forces on the nodes (n, 3) equivalent to those on the surface's vertices (V, 3), world space."""
        carried = (self.embedding_weights[:, :, None] * force[:, None]).reshape(-1, 3)
        nodes = self.embedding_nodes.ravel()
        return np.column_stack([np.bincount(nodes, axis, len(self.nodes)) for axis in carried.T])


def engine_hash(number: int) -> str:
    return array_hash((np.array([number]),))


def morph_targets(character: Character, displacements: np.ndarray) -> list[dynamorph.MorphTarget]:
    shifted = character.settings.method == "SHAPE"
    out = []
    sets = character.set_of_target.tolist()
    for j, (target, s, displacement) in enumerate(zip(character.targets, sets, displacements, strict=True)):
        material = character.material(j)
        lame_lambda, lame_mu = material.lame()
        out.append(
            dynamorph.MorphTarget(
                target.name,
                displacement,
                lame_lambda=lame_lambda,
                lame_mu=lame_mu,
                density=material.density,
                mass_damping=material.mass_damping,
                stiffness_damping=material.stiffness_damping,
                set=s,
                shifted=shifted,
            )
        )
    return out


def array_hash(arrays: tuple[np.ndarray, ...]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(str((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
