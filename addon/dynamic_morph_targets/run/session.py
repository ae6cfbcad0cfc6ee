# SPDX-License-Identifier: GPL-3.0-or-later
"""One soft skin in Live: its model, its rig and its state over the frames."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np

from ..core import errors
from ..core.character import Character, Skeleton, TargetSet
from ..core.errors import SceneError
from ..core.message import joined
from ..core.motion import rig_samples, simulate
from ..core.motion.contact import Touched, touched
from ..core.motion.grab import Grab
from ..core.motion.player import Frame, Player, State, statistics
from ..core.motion.rig_samples import RigSamples
from ..core.painted_map import MAPS
from ..core.settings import Material, SimulationSettings
from ..scene import (
    colliders,
    mesh_data,
    model_store,
    probe,
    references,
    rig_motion,
    run_settings,
    skin,
    skinning,
    staleness,
)
from ..write.display import comparison, live_key
from ..write.reconcile import reconcile
from .live_surface import LiveMesh, Move, by_modes, by_nodes, still

# Frames whose rig is read at once; the setup costs as much as five frames, and more frames would be noticed as a
# stutter.
BLOCK = 16
CATCH_UP = 8  # frames that playback may drop; they are simulated nevertheless
RIG_BYTES = 2**28  # bytes of the rig's matrices that are kept, because reading them again takes a while
KEPT = 250  # latest frames from which it can resume after a change of settings
STATE_BYTES = 2**28  # bytes that those may take, if they have the transforms or the displacements of nodes
FRAME_BYTES = 2**28  # bytes of the coordinates of the latest frames, which show again without a simulation


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
        self.skin = self._mesh(skin.ObjectHandle.of(obj), character.vertices[own_vertices], own_vertices, np.eye(3))
        self.attachments = [
            self._mesh(skin.ObjectHandle(each.session_uid, each.name), each.points, each.members, each.from_body)
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

    def _mesh(self, handle: skin.ObjectHandle, points: np.ndarray, members: slice, from_body: np.ndarray) -> LiveMesh:
        """A mesh of the body. points (P, 3): its local space; from_body (3, 3): from the body's local space to it."""
        residual_shapes = self.player.skin.residual_shapes[:, members] @ from_body.T
        return LiveMesh(handle, points, self._move(members, from_body), residual_shapes)

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

    def show(self, values: np.ndarray) -> bool:
        """Write the live keys; False when that of the skin is gone."""
        shown = self.skin.show(values)
        for surface in self.attachments:
            with suppress(SceneError):  # it was deleted
                surface.show(values)
        return shown

    def moved(self, values: np.ndarray) -> float:
        """The largest distance of a point from where the targets' shapes alone would have it: meters."""
        to_bind, pairs = self.character.to_bind, zip(self.attachments, self.character.attachments, strict=True)
        others = ((surface, to_bind @ np.linalg.inv(each.from_body)) for surface, each in pairs)
        return max(
            float(np.linalg.norm(self.motion(values, surface) @ to_meters.T, axis=1).max(initial=0.0))
            for surface, to_meters in ((self.skin, to_bind), *others)
        )

    def motion(self, values: np.ndarray, surface: LiveMesh) -> np.ndarray:
        """How far the points (V, 3) of the skin, or of an attachment, are from there: local space."""
        return surface.move(values[: self.dofs] - self.player.static(values[self.dofs :])).reshape(-1, 3)


class Rig:
    """The rig at true sub-frames, as a bake reads it: blocks of frames. The latest are kept until an edit."""

    def __init__(self, start: int, substeps: int, skeleton: Skeleton, probe: probe.Probe | None):
        self.start, self.substeps, self.skeleton, self.probe = start, substeps, skeleton, probe
        self._blocks: dict[int, RigSamples] = {}

    def after(self, obj: bpy.types.Object, frame: int) -> RigSamples:
        """1 + substeps samples, from `frame` to the next one. Raises SceneError."""
        index, offset = divmod(frame - self.start, BLOCK)
        if index not in self._blocks:
            first = self.start + index * BLOCK
            samples = rig_motion.sample_rig(obj, first, first + BLOCK, self.substeps, self.probe)
            before = self._blocks.get(index - 1)
            self._blocks[index], _ = rig_samples.keep_collapsed(
                samples, self.skeleton, before.pose[-1] if before else None
            )
            while len(self._blocks) > max(2, RIG_BYTES // samples.nbytes):
                del self._blocks[next(iter(self._blocks))]
        return self._blocks[index][offset * self.substeps : (offset + 1) * self.substeps + 1]

    def forget(self) -> None:
        self._blocks.clear()


class Session:
    """One object that plays: its simulation since it last began, and the state from which it continues."""

    def __init__(self, obj: bpy.types.Object, scene: bpy.types.Scene):
        self.tissue = Tissue(obj, scene)
        self.content_id = obj.dynamorph.model.content_id
        self.first = self.last = 0  # frames simulated from and to, while there are any
        self.now: int | None = None  # the one that shows, or just before
        self.grabs: tuple[Grab, ...] = ()  # by which the artist pulls the skin
        self.rig_changes = 0  # how often the rig's motion was edited
        self._frames: dict[int, Frame] = {}
        self._states: dict[int, tuple[int, State]] = {}
        self.skinning, self.painted = way_to_skin(obj), painted(obj)
        self._placing, self._material = _placing(obj), _materials(obj)
        self._sampled = _sampling(obj)
        settings = self.tissue.player.settings
        moving = len(self.tissue.probe.rest) if self.tissue.probe else 1
        self._kept = min(KEPT, max(1, STATE_BYTES // (4 * (96 * moving + 8 * self.tissue.dofs))))
        self._shown = max(KEPT, FRAME_BYTES // (8 * max(self.tissue.dofs, 1)))  # latest frames
        self.rig = Rig(settings.frame_start, settings.substeps, self.tissue.character.skeleton, self.tissue.probe)

    def fits(self, obj: bpy.types.Object, settings: SimulationSettings) -> bool:
        """Whether this is still a session of the object's model, with the same time step."""
        mine = self.tissue.player.settings
        same = (mine.fps, mine.substeps) == (settings.fps, settings.substeps)
        same &= self.tissue.model.settings.solver == obj.dynamorph.model.solver
        if self.tissue.probe and _placing(obj) != self._placing:
            return False  # the nodes were posed as the targets were captured
        return same and self.content_id == obj.dynamorph.model.content_id

    def values(self, obj: bpy.types.Object, settings: SimulationSettings, time: float, arrives: bool) -> np.ndarray:
        """What `Tissue.show` asks for, at a frame or between two. arrives: at the start of the range
        the motion begins again; otherwise the start only shows.

        Raises SceneError.
        """
        self._sync_settings(obj, settings)
        before, fraction = math.floor(time), time % 1.0
        if fraction and self._frames and before + 1 == self.first:  # a shutter that opens before the first frame
            before, fraction = self.first, 0.0
        elif not fraction or before not in self._frames:
            self._simulate_to(obj, before, arrives)
        self.now = before
        values = self.tissue.values(self._frames[before])
        if fraction:  # as Blender goes between the keyframes of a bake
            if before == self.last:
                self._advance(obj)
            values += fraction * (self.tissue.values(self._frames[before + 1]) - values)
        if not np.isfinite(values).all():  # Python and drivers can set any value as a gain
            raise errors.SelfCheckError(
                "'{name}': its motion is not finite: press Reset Amounts, or set the targets' Amount to 1",
                name=obj.name,
            )
        return values

    def motions(self) -> dict[int, np.ndarray]:
        """How far the points (V, 3) of each mesh are, at the frame that shows, from where the targets' shapes alone
        would have them: local space, by session_uid. Empty before the first frame.
        """
        tissue = self.tissue
        if self.now not in self._frames:
            return {}
        values = tissue.values(self._frames[self.now])
        return {
            surface.object.session_uid: tissue.motion(values, surface) for surface in (tissue.skin, *tissue.attachments)
        }

    def touched(self) -> Touched | None:
        """How deep the simulated frames went into colliders; None without Collision."""
        player, numbers = self.tissue.player, sorted(self._frames)
        if player.collision is None or not numbers:
            return None
        names = ("penetration", "too_deep", "too_deep_sample", "too_deep_collider", "unusable_colliders")
        steps = statistics([self._frames[number] for number in numbers], names)
        return touched(
            np.array(numbers), dict(zip(names, steps.T, strict=True)), player.collision, self.tissue.model.bone_names
        )

    def knows(self, time: float) -> bool:
        """Whether a frame, or a time between two, has been simulated already."""
        return {math.floor(time), math.ceil(time)} <= self._frames.keys()

    def rig_changed(self) -> None:
        """The rig moves differently from now on."""
        self.rig_changes += 1
        self.rig.forget()
        self.rewind()

    def _sync_settings(self, obj: bpy.types.Object, settings: SimulationSettings) -> None:
        """Apply what the artist has changed; the frames simulated after the one that shows are then dropped."""
        age = staleness.live_age(obj)
        if age:
            raise SceneError("The model is out of date ({why}): press Build Model", why=joined("; ", age))
        for handle, count in self.tissue.vertices.items():
            mesh = handle.find().data
            if len(mesh.vertices) != count:
                raise SceneError(
                    "Mesh '{name}' has {count} vertices, its model {expected}: press Build Model",
                    name=mesh.name,
                    count=len(mesh.vertices),
                    expected=count,
                )
        placing, materials, sampled = _placing(obj), _materials(obj), _sampling(obj)
        changed = (placing, materials) != (self._placing, self._material)
        if changed or _physics(settings) != _physics(self.tissue.player.settings):
            self.rewind()
            if placing != self._placing:
                _, character = model_store.live_model(obj)
            else:
                character = _with_materials(self.tissue.character, materials)
            self._placing, self._material = placing, materials
            self.tissue.exchange(character, settings)
        if sampled != self._sampled:
            self._sampled = sampled
            self.rig_changed()
        player = self.tissue.player
        player.follow(settings, _motion_amounts(obj, player.character))

    def _simulate_to(self, obj: bpy.types.Object, number: int, arrives: bool) -> None:
        """Simulate up to a frame: from the last one on, or starting at the frame itself if playback cannot have come
        from there.
        """
        settings = self.tissue.player.settings
        starts = arrives and number == settings.frame_start
        if (
            starts
            and settings.loop
            and self._frames
            and settings.frame_end - CATCH_UP <= self.last <= settings.frame_end
        ):
            while self.last < settings.frame_end:
                self._advance(obj)
            self._begin_again(obj)
        elif starts or not self._frames or not self.first <= number <= self.last + CATCH_UP:
            self._begin(obj, number)
        while self.last < number:
            self._advance(obj)

    def _begin(self, obj: bpy.types.Object, number: int) -> None:
        """Begin at a frame as a bake that starts there does."""
        self._start(number, self.tissue.player.begin(self.rig.after(obj, number)))

    def _begin_again(self, obj: bpy.types.Object) -> None:
        """Go from the end of a cycle to its start, without a jump."""
        settings = self.tissue.player.settings
        first, last = (self.rig.after(obj, frame)[:1] for frame in (settings.frame_start, settings.frame_end))
        cycle = first.concatenate(last)
        self._start(settings.frame_start, self.tissue.player.begin_again(cycle, self._frames[settings.frame_end]))

    def _start(self, number: int, frame: Frame) -> None:
        self._frames, self._states = {}, {}
        self.first = number
        self._keep(number, frame)

    def _advance(self, obj: bpy.types.Object) -> None:
        number, samples = self.last + 1, self.rig.after(obj, self.last)[1:]
        collision = self.tissue.player.collision
        if collision is None or collision.fits(samples):
            if self.tissue.player.hand:
                self.tissue.player.hand.pull(self.grabs)
            self._keep(number, self.tissue.player.advance(samples, number))
        else:  # other colliders are there: it begins again
            self._begin(obj, number)

    def _keep(self, number: int, frame: Frame) -> None:
        self._frames[number], self.last = frame, number
        if len(self._frames) > self._shown:
            del self._frames[self.first]
            self.first += 1
        self._states[number % self._kept] = number, self.tissue.player.state

    def state_at(self, number: int) -> State | None:
        """From which the frame after this one goes on; None where that is not kept."""
        kept = self._states.get(number % self._kept)
        return kept[1] if kept and kept[0] == number else None

    def rewind(self) -> None:
        """Drop the frames after the one that shows; if its state is no longer stored, all of them."""
        now = self.now
        if now == self.last:
            return
        state = None if now is None else self.state_at(now)
        if now is None or state is None:
            self._frames = {}
            return
        self.tissue.player.state = state
        self._frames = {k: frame for k, frame in self._frames.items() if k <= now}
        self.last = now


def simulation_settings(obj: bpy.types.Object, scene: bpy.types.Scene) -> SimulationSettings:
    """`run_settings.simulation_settings` without samples between frames, and with the solo modes alone."""
    return replace(run_settings.simulation_settings(obj, scene), samples=1, gains=_gains(obj))


def _sampling(obj: bpy.types.Object) -> tuple:
    """What the rig's samples depend on besides its animation."""
    render, collision = bpy.context.scene.render, obj.dynamorph.collision
    stops = [other.session_uid for other in colliders.colliders(obj)], collision.use_friction, collision.friction
    return obj.dynamorph.simulation.fields, render.frame_map_old, render.frame_map_new, skin.unit_scale(), stops


def _physics(settings: SimulationSettings) -> SimulationSettings:
    """What a step depends on."""
    return replace(settings, frame_start=0, frame_end=0, gains=(), amount=1.0)


def _gains(obj: bpy.types.Object) -> tuple[float, ...]:
    """Factors on the modes' motion; of solo modes, if there are any, only theirs is not zero."""
    modes = obj.dynamorph.modes
    solo = any(mode.solo for mode in modes)
    return tuple(mode.gain * (mode.solo or not solo) for mode in modes)


def _motion_amounts(obj: bpy.types.Object, character: Character) -> np.ndarray:
    """The motion amounts of the character's targets (J,), as authored now."""
    by_name = {name: target.amount for name, target in skin.named_targets(obj)}
    return np.array([by_name[name] for target_set in character.target_sets for name in _names(target_set)])


def _names(target_set: TargetSet) -> tuple[str, ...]:
    """The names of its targets, as `skin.named_targets` has them."""
    return "", *(target.name for target in target_set.targets[1:])


def _materials(obj: bpy.types.Object) -> dict[str, Material]:
    """The materials of all targets by name."""
    return {name: target.material() for name, target in skin.named_targets(obj)}


def _placing(obj: bpy.types.Object) -> tuple[str, list[tuple]]:
    """All else that a running simulation takes from the targets: cheap to compare at each frame."""
    targets = [
        (target.name, target.mute, tuple(target.rig_world), target.placing()) for target in obj.dynamorph.targets
    ]
    return obj.dynamorph.model.blending, targets


def _with_materials(character: Character, materials: dict[str, Material]) -> Character:
    names = [name for target_set in character.authored_sets for name in _names(target_set)]
    return character.with_targets(lambda index, target: replace(target, material=materials[names[index]]))


def painted(obj: bpy.types.Object) -> bytes:
    """The maps of the soft skin's own mesh, to be compared."""
    groups = mesh_data.VertexGroups(obj)
    return b"".join(groups.weights([getattr(obj.dynamorph, each.group)], each.neutral).tobytes() for each in MAPS)


def way_to_skin(obj: bpy.types.Object) -> tuple:
    """What the mapping from the rig to the skin depends on besides weights."""
    rig = references.rig_of(obj)
    return rig and references.bones_key(rig.data), skinning.Skinning.of(obj).settings()
