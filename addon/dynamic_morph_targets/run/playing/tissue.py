# SPDX-License-Identifier: GPL-3.0-or-later
"""A built soft skin that Live and previews step and show."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np

from ...core.character import Character
from ...core.errors import SceneError, SelfCheckError
from ...core.motion import simulate
from ...core.motion.contact import Touched, touched
from ...core.motion.player import Frame, Player, statistics
from ...core.settings import SimulationSettings
from ...scene import skin
from ...scene.motion import run_settings
from ...scene.read import mesh_data, probe
from ...scene.store import model_store
from ...write.display import comparison, live_key
from ...write.reconcile import reconcile
from .live_surface import LiveMesh, Move, by_modes, by_nodes, still


class Tissue:
    """A built soft skin that can be stepped and shown. Raises SceneError when its model is not up to date."""

    def __init__(self, obj: bpy.types.Object, scene: bpy.types.Scene):
        reconcile(obj)
        self.model, self.character = model_store.live_model(obj)
        self.player = Player(self.model, self.character, simulation_settings(obj, scene))
        self.probe = probe.Probe(obj, self.model, self.character) if self.player.probed else None
        self.modes = self.model.modes.shape[1] if self.model.settings.solver == "REDUCED" else 0  # shown one by one
        self.target_names = [target.name for target in self.character.targets]
        character, own_vertices = self.character, self.character.own_vertices
        self.dofs = len(self.player.amounts.gains)
        self.skin = self._mesh(skin.ObjectHandle.of(obj), own_vertices, np.eye(3))
        self.attachments = [
            self._mesh(skin.ObjectHandle(each.session_uid, each.name), each.members, each.from_body)
            for each in character.attachments
        ]

    def exchange(self, character: Character, settings: SimulationSettings) -> None:
        """Go on with the materials, poses and blending of `character`; settings: others with the same time step."""
        self.character = character
        self.player = self.player.exchange(character, settings)
        if self.dofs != len(self.player.amounts.gains):  # with collision, patches of the skin move too
            self.dofs = len(self.player.amounts.gains)
            self.skin.move = self._move(character.own_vertices, np.eye(3))
            for surface, each in zip(self.attachments, character.attachments, strict=True):
                surface.move = self._move(each.members, each.from_body)

    def _mesh(self, handle: skin.ObjectHandle, members: slice, from_body: np.ndarray) -> LiveMesh:
        """A mesh of the body. from_body (3, 3): from the body's local space to it."""
        residual_shapes = self.player.skin.residual_shapes[:, members] @ from_body.T
        basis = mesh_data.rest_points(handle.find())  # the live key is relative to it
        return LiveMesh(handle, basis, self._move(members, from_body), residual_shapes)

    def _move(self, members: slice, from_body: np.ndarray) -> Move:
        """What displaces these vertices of the character; from_body: as for `_mesh`."""
        model = self.model
        if not len(model.tets):  # static morph targets
            return still(members.stop - members.start)
        nodes, weights = model.embedding_nodes[members], self.player.skin.weights[members]
        turn = from_body @ np.linalg.inv(model.to_bind)
        if model.settings.solver == "FULL":
            return by_nodes(model.free, nodes, weights, turn)
        return by_modes(simulate.node_modes(model, self.player.modes.T) @ turn.T, nodes, weights)

    @property
    def vertices(self) -> dict[skin.ObjectHandle, int]:
        """The number of vertices of each mesh that shares the cage, by session_uid."""
        counts = {self.skin.object: self.character.own_vertices.stop}
        for each in self.character.attachments:
            counts[skin.ObjectHandle(each.session_uid, each.name)] = len(each.points)
        return counts

    def values(self, frame: Frame) -> np.ndarray:
        """What `points` asks for: (dofs + J,) coordinates as shown, and target weights."""
        more = max(0, self.dofs - len(frame.coordinates))  # it may be from before collision was turned on, or off
        frame = replace(frame, coordinates=np.pad(frame.coordinates, (0, more))[: self.dofs])
        return np.concatenate([self.player.shown(frame), frame.weights])

    def points(self, values: np.ndarray) -> np.ndarray:
        """Points (3 V,) of the skin, float32, local space."""
        return self.skin.points(values)

    def add_keys(self, obj: bpy.types.Object) -> None:
        """The live keys of the soft skin `obj` and of its attachments. Raises WriteError."""
        if comparison.is_plain(obj):  # which muted nothing that Live may count on
            comparison.show(obj, False)
        live_key.add(obj, self.target_names, [surface.object.find() for surface in self.attachments])

    def show(self, values: np.ndarray, depsgraph: bpy.types.Depsgraph | None = None) -> bool:
        """Write the live keys; False when that of the skin is gone. depsgraph: as in `LiveMesh.show`. Raises
        SelfCheckError.
        """
        if not np.isfinite(values).all():  # Python and drivers can set any value as a gain
            raise SelfCheckError(
                "'{name}': its motion is not finite: press Reset Amounts, or set the targets' Amount to 1",
                name=self.skin.object.name,
            )
        shown = self.skin.show(values, depsgraph)
        for surface in self.attachments:
            with suppress(SceneError):  # it was deleted
                surface.show(values, depsgraph)
        return shown

    def touched(self, frames: dict[int, Frame]) -> Touched | None:
        """How deep simulated frames, by number, went into colliders; None without Collision."""
        player, numbers = self.player, sorted(frames)
        if player.collision is None or not numbers:
            return None
        names = ("contacts", "penetration", "too_deep", "too_deep_sample", "too_deep_collider", "unusable_colliders")
        steps = statistics([frames[number] for number in numbers], names)
        by_name = dict(zip(names, steps.T, strict=True))
        return touched(np.array(numbers), by_name, player.collision, self.model.bone_names)

    def moved(self, values: np.ndarray) -> float:
        """The largest distance of a point from where the targets' shapes alone would have it: meters."""
        to_bind, pairs = self.character.to_bind, zip(self.attachments, self.character.attachments, strict=True)
        others = ((surface, to_bind @ np.linalg.inv(each.from_body)) for surface, each in pairs)
        return max(
            float(np.linalg.norm(self.motion(values, surface) @ to_meters.T, axis=1).max(initial=0.0))
            for surface, to_meters in ((self.skin, to_bind), *others)
        )

    def motions(self, frame: Frame) -> dict[int, np.ndarray]:
        """`motion` of each mesh at a frame, by session_uid."""
        values = self.values(frame)
        return {surface.object.session_uid: self.motion(values, surface) for surface in (self.skin, *self.attachments)}

    def motion(self, values: np.ndarray, surface: LiveMesh) -> np.ndarray:
        """How far the points (V, 3) of the skin, or of an attachment, are from there: local space."""
        return surface.move(values[: self.dofs] - self.player.static(values[self.dofs :])).reshape(-1, 3)


def simulation_settings(obj: bpy.types.Object, scene: bpy.types.Scene) -> SimulationSettings:
    """`run_settings.simulation_settings` without samples between frames, and with the solo modes alone."""
    return replace(run_settings.simulation_settings(obj, scene), samples=1, gains=_gains(obj))


def _gains(obj: bpy.types.Object) -> tuple[float, ...]:
    """Factors on the modes' motion; of solo modes, if there are any, only theirs is not zero."""
    modes = obj.dynamorph.modes
    solo = any(mode.solo for mode in modes)
    return tuple(mode.gain * (mode.solo or not solo) for mode in modes)
