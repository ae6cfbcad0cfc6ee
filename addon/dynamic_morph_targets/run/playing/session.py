# SPDX-License-Identifier: GPL-3.0-or-later
"""One soft skin in Live: its model, its rig and its state over the frames."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from ...core.character import Character, Skeleton, same
from ...core.errors import SceneError
from ...core.message import Message, joined
from ...core.motion import handover, rig_samples
from ...core.motion.contact import Touched
from ...core.motion.grab import Grab
from ...core.motion.keyed import Setting
from ...core.motion.loops import begin_again
from ...core.motion.player import Frame, State
from ...core.motion.rig_samples import RigSamples
from ...core.painted_map import MAPS
from ...core.settings import Material, SimulationSettings
from ...scene import events, keyed, references, skin, skinning
from ...scene.motion import colliders, rig_motion
from ...scene.read import mesh_data, probe
from ...scene.read.sampling_scene import SamplingScene
from ...scene.store import model_store, staleness
from .live_group import LiveGroup
from .tissue import Tissue

BLOCK = 16  # frames whose rig is read at once at most,
UNNOTICED = 0.02  # in so many seconds
CATCH_UP = 24  # frames that playback may drop; they are simulated nevertheless,
AT_THE_END = 8  # and so many before it goes on with a loop's first
DROPPED = "Playback dropped {count} frames, so Live began again at {frame}: set Sync to Play Every Frame"
RIG_BYTES = 2**28  # bytes of the rig's matrices that are kept, because reading them again takes a while
KEPT = 250  # latest frames from which it can resume after a change of settings
STATE_BYTES = 2**28  # bytes that those may take, if they have the transforms or the displacements of nodes
FRAME_BYTES = 2**28  # bytes of the coordinates of the latest frames, which show again without a simulation


class Rig:
    """The rig at true sub-frames, as a bake reads it, some frames at once. The latest are kept until an edit."""

    def __init__(self, substeps: int, skeleton: Skeleton, probe: probe.Probe | None):
        self.substeps, self.skeleton, self.probe = substeps, skeleton, probe
        self._frames: dict[int, RigSamples] = {}  # from each frame to the next one
        self._at_once = 1  # frames that are read next
        self._without: Sequence[str] = ()  # as of `rig_motion.RigSampling`
        self._scene = SamplingScene()

    def leave_out(self, names: Sequence[str]) -> None:
        """From now on these are no colliders."""
        self._without = names
        self.forget()

    def after(self, obj: bpy.types.Object, frame: int) -> RigSamples:
        """1 + substeps samples, from `frame` to the next one. Raises SceneError."""
        if frame not in self._frames:
            self._read(obj, frame)
        return self._frames[frame]

    def _read(self, obj: bpy.types.Object, first: int) -> None:
        """Read from a frame on. Plain rigs are read faster many frames at once, others would be seen to stutter."""
        began, count = time.perf_counter(), self._at_once
        samples = rig_motion.sample_rig(
            obj, first, first + count, self.substeps, self.probe, self._without, self._scene
        )
        seconds = (time.perf_counter() - began) / count
        self._at_once = max(1, min(BLOCK, 2 * count, int(UNNOTICED / seconds)))
        before = self._frames.get(first - 1)
        samples, _ = rig_samples.keep_collapsed(samples, self.skeleton, before.pose[-1] if before else None)
        for k in range(count):
            self._frames[first + k] = samples[k * self.substeps : (k + 1) * self.substeps + 1]
        while len(self._frames) > max(2 * BLOCK, count * RIG_BYTES // samples.nbytes):
            del self._frames[next(iter(self._frames))]

    def forget(self) -> None:
        self._frames.clear()

    def close(self) -> None:
        """Remove the scene in which it is read."""
        self._scene.close()


class Session:
    """One object that plays: its simulation since it last began, and the state from which it continues."""

    def __init__(self, obj: bpy.types.Object, scene: bpy.types.Scene):
        self.tissue = Tissue(obj, scene)
        self.content_id = obj.dynamorph.model.content_id
        self.first = self.last = 0  # frames simulated from and to, while there are any
        self.now: int | None = None  # the one that shows, or just before
        self.grabs: dict[int, Grab] = {}  # by which the artist pulls the skin, by the number of the hand
        self.recorded: dict[int, dict[int, Grab]] | None = None  # those to each frame, while they are recorded
        self.group = LiveGroup([self], [obj.name])
        self.dropped: list[Message] = []  # what to say of frames that playback left out, more than are simulated
        self.rig_changes = 0  # how often the rig's motion was edited
        self._frames: dict[int, Frame] = {}
        self._states: dict[int, tuple[int, State]] = {}
        self.skinning, self.painted = way_to_skin(obj), painted(obj)
        self._placing, self._material = _placing(obj), _materials(obj)
        self._sampled, self._channels = _sampling(obj), keyed.present_channels(obj)
        settings = self.tissue.player.settings
        moving = len(self.tissue.probe.rest) if self.tissue.probe else 1
        self._kept = min(KEPT, max(1, STATE_BYTES // (4 * (96 * moving + 8 * self.tissue.dofs))))
        self._shown = max(KEPT, FRAME_BYTES // (8 * max(self.tissue.dofs, 1)))  # latest frames
        self.rig = Rig(settings.substeps, self.tissue.character.skeleton, self.tissue.probe)

    def fits(self, obj: bpy.types.Object, settings: SimulationSettings) -> bool:
        """Whether this is still a session of the object's model, with the same time step."""
        mine = self.tissue.player.settings
        same = (mine.step, mine.substeps) == (settings.step, settings.substeps)
        same &= self.tissue.model.settings.solver == obj.dynamorph.model.solver
        same &= not self.tissue.probe or _placing(obj) == self._placing  # nodes are posed as targets are captured
        return same and self.content_id == obj.dynamorph.model.content_id

    def take_over(self, before: Session) -> None:
        """Go on with the motion of an earlier session, where that is of the same cage and by the same steps."""
        if before.now is None or before.now not in before._frames or not (state := before.state_at(before.now)):
            return
        if frame := handover.hand_over(before.tissue.player, state, before._frames[before.now], self.tissue.player):
            self._start(before.now, frame)
            self.now = before.now

    def values(self, obj: bpy.types.Object, settings: SimulationSettings, time: float, arrives: bool) -> np.ndarray:
        """What `Tissue.show` asks for, at a frame or between two. arrives: at the start of the range
        the motion begins again; otherwise the start only shows.

        Raises SceneError.
        """
        self._sync_settings(obj, settings)
        before, fraction = math.floor(time), time % 1.0
        if before == self.now and self.are_channels_elsewhere(obj) and not events.is_playing():
            self._frames = {}  # dragged while it stands: it begins at this frame once more
        self._channels = keyed.present_channels(obj)
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
        return values

    def motions(self) -> dict[int, np.ndarray]:
        """`Tissue.motions` at the frame that shows. Empty before the first frame."""
        return self.tissue.motions(self._frames[self.now]) if self.now in self._frames else {}

    def touched(self) -> Touched | None:
        """How deep the simulated frames went into colliders; None without Collision."""
        return self.tissue.touched(self._frames)

    def knows(self, time: float) -> bool:
        """Whether a frame, or a time between two, has been simulated already."""
        return {math.floor(time), math.ceil(time)} <= self._frames.keys()

    def are_channels_elsewhere(self, obj: bpy.types.Object) -> bool:
        """Whether a channel has moved since the frame that shows."""
        return not same(self._channels, keyed.present_channels(obj))

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
            and settings.frame_end - AT_THE_END <= self.last <= settings.frame_end
        ):
            while self.last < settings.frame_end:
                self._advance(obj)
            self._begin_again(obj)
        elif starts or not self._frames or not self.first <= number <= self.last + CATCH_UP:
            lost = number - self.last - 1 if self._frames and not starts and events.is_playing() else 0
            self.dropped = [Message(DROPPED, count=lost, frame=number)] if lost >= CATCH_UP else []
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
        self._start(settings.frame_start, begin_again(self.tissue.player, cycle, self._frames[settings.frame_end]))

    def _start(self, number: int, frame: Frame) -> None:
        self._frames, self._states = {}, {}
        self.first = number
        self.keep(number, frame)

    def join(self, group: LiveGroup) -> None:
        """From now on press on the others of the group; where they are new, begin again at the frame that shows."""
        before, self.group = self.group, group
        if before.names == group.names:
            return
        self.rig.leave_out(group.names)
        if self.now is not None:
            self._begin(self.tissue.skin.object.find(), self.now)

    def _advance(self, obj: bpy.types.Object) -> None:
        if self.fits_colliders(self.rig.after(obj, self.last)[1:]):
            self.group.advance(self.last)
        else:  # others are there: it begins again
            self._begin(obj, self.last + 1)

    def fits_colliders(self, samples: RigSamples) -> bool:
        """Whether these samples have the same colliders."""
        collision = self.tissue.player.collision
        return collision is None or collision.fits(samples)

    @property
    def last_simulated(self) -> int | None:
        """The last frame that was simulated."""
        return self.last if self._frames else None

    def keep(self, number: int, frame: Frame) -> None:
        """Take the next frame, with the state after it."""
        self._frames[number], self.last = frame, number
        if self.recorded is not None:
            self.recorded[number] = self.grabs
        if len(self._frames) > self._shown:
            del self._frames[self.first]
            self.first += 1
        self._states[number % self._kept] = number, self.tissue.player.state

    def state_at(self, number: int) -> State | None:
        """From which the frame after this one goes on; None where that is not kept."""
        kept = self._states.get(number % self._kept)
        return kept[1] if kept and kept[0] == number else None

    def rewind(self) -> None:
        """Drop the group's frames after the one that shows; if its state is no longer stored, all of them."""
        for each in self.group.sessions:
            each.rewind_alone()

    def rewind_alone(self) -> None:
        """As `rewind`, of this one."""
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


def _sampling(obj: bpy.types.Object) -> tuple:
    """What the rig's samples depend on besides its animation."""
    render, collision = bpy.context.scene.render, obj.dynamorph.collision
    moved = keyed.settings(obj)
    friction = None if Setting("FRICTION") in (each.setting for each in moved) else collision.friction
    stops = [other.session_uid for other in colliders.colliders(obj)], collision.use_friction, friction, moved
    held = [
        (grip.name, grip.object and grip.object.session_uid, grip.bone, grip.patch) for grip in skin.used_grips(obj)
    ]
    return held, obj.dynamorph.simulation.fields, render.frame_map_old, render.frame_map_new, skin.unit_scale(), stops


def _physics(settings: SimulationSettings) -> SimulationSettings:
    """What a step depends on."""
    return replace(settings, frame_start=0, frame_end=0, gains=(), amount=1.0)


def _motion_amounts(obj: bpy.types.Object, character: Character) -> np.ndarray:
    """The motion amounts of the character's targets (J,), as authored now."""
    by_name = {name: target.amount for name, target in skin.named_targets(obj)}
    return np.array([by_name[name] for name in character.target_names])


def _materials(obj: bpy.types.Object) -> dict[str, Material]:
    """The materials of all targets by name."""
    return {name: target.material() for name, target in skin.named_targets(obj)}


def _placing(obj: bpy.types.Object) -> tuple[str, list[tuple]]:
    """All else that a running simulation takes from the targets: cheap to compare at each frame."""
    targets = [
        (target.name, target.mute, target.region, tuple(target.rig_world), target.placing())
        for target in obj.dynamorph.targets
    ]
    return obj.dynamorph.model.blending, targets


def _with_materials(character: Character, materials: dict[str, Material]) -> Character:
    names = [name for target_set in character.authored_sets for name in target_set.names]
    return character.with_targets(lambda index, target: replace(target, material=materials[names[index]]))


def painted(obj: bpy.types.Object) -> bytes:
    """The maps of the soft skin's own mesh, to be compared."""
    groups = mesh_data.VertexGroups(obj)
    return b"".join(groups.weights([getattr(obj.dynamorph, each.group)], each.neutral).tobytes() for each in MAPS)


def way_to_skin(obj: bpy.types.Object) -> tuple:
    """What the mapping from the rig to the skin depends on besides weights."""
    rig = references.rig_of(obj)
    return rig and references.bones_key(rig.data), skinning.Skinning.of(obj).settings()
