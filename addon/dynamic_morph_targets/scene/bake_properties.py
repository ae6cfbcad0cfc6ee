# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist chose for simulations and bakes, stored on the Object."""

from __future__ import annotations

import math
from dataclasses import fields

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy.types import PropertyGroup

from ..core.settings import OutputSettings
from .events import shown_changed
from .references import OVERRIDE
from .target_properties import DynamorphKey


class DynamorphLive(PropertyGroup):
    """Simulation during playback, shown by one shape key that is rewritten at each frame."""

    key: PointerProperty(name="Key", description="The shape key that Live rewrites", type=DynamorphKey)
    muted: CollectionProperty(name="Muted", description="Target keys that Live muted", type=DynamorphKey)
    slot: EnumProperty(
        name="Slot", description="Which of two sets of settings is in use",
        items=(("A", "A", "Settings A"), ("B", "B", "Settings B")), default="A",
    )  # fmt: skip
    other: StringProperty(name="Other Slot", description="The settings of the slot that is not in use, as JSON")
    checks: StringProperty(name="Targets", description="How far each target is missed, a line each")


class DynamorphSimulation(PropertyGroup):
    """How a shot is simulated."""

    use_scene_range: BoolProperty(
        name="Scene Range", description="Bake the frames of the scene", default=True, override=OVERRIDE
    )
    start: IntProperty(name="Start", description="First frame", default=1, override=OVERRIDE)
    end: IntProperty(name="End", description="Last frame", default=250, override=OVERRIDE)
    substeps: IntProperty(
        name="Substeps",
        description="Steps a frame; 0 chooses as many as keep a step below 1/120 s",
        default=0, min=0, max=1000, soft_max=20, override=OVERRIDE,
    )  # fmt: skip
    samples: IntProperty(
        name="Samples",
        description="Times a frame at which the motion is kept, so that motion blur sees it swing between two frames. "
        "Substeps are rounded up to a multiple",
        default=1, min=1, max=32, soft_max=8, override=OVERRIDE,
    )  # fmt: skip
    scheme: EnumProperty(
        name="Scheme",
        description="Time integration",
        items=(
            ("BDF2", "BDF2", "Second order: keeps the bounce"),
            ("EULER", "Implicit Euler", "First order: damps strongly"),
        ),
        default="BDF2", override=OVERRIDE,
    )  # fmt: skip
    gravity: FloatProperty(
        name="Gravity",
        description="Factor on the scene's gravity. Targets do not sag: in a target's own pose and tilt it is balanced",
        default=1.0, min=-10.0, max=10.0, soft_min=0.0, soft_max=1.0, override=OVERRIDE,
    )  # fmt: skip
    fields: FloatProperty(
        name="Force Fields",
        description="Factor on the scene's Wind and Force fields, whose strength is newtons on a square metre of skin",
        default=1.0, min=0.0, soft_max=1.0, override=OVERRIDE,
    )  # fmt: skip
    amount: FloatProperty(
        name="Amount",
        description="How much of the motion shows, in Live and in the next bake: 0 none, 1 as simulated",
        default=1.0, min=0.0, max=4.0, soft_max=2.0, subtype="FACTOR", override=OVERRIDE, update=shown_changed,
    )  # fmt: skip
    max_displacement: FloatProperty(
        name="Max Displacement",
        description="How far the skin may move away from the animation, as a part of the body's size. The first bake "
        "of a shot rehearses it and raises Bounce until this holds. 0: no limit",
        default=0.0, min=0.0, max=1.0, soft_max=0.2, precision=3, subtype="FACTOR", override=OVERRIDE,
    )  # fmt: skip
    max_thickness: FloatProperty(
        name="Of Thickness",
        description="How far the skin may move away from the animation, as a part of how thick the body is there. "
        "0: no limit",
        default=0.0, min=0.0, max=10.0, soft_max=1.0, precision=2, subtype="FACTOR", override=OVERRIDE,
    )  # fmt: skip
    rehearsed: StringProperty(
        name="Rehearsed", description="What the rehearsal of the shot has set, for the artist", override=OVERRIDE
    )
    begin: EnumProperty(
        name="Begin",
        description="What the flesh does before the first frame",
        items=(
            ("REST", "Rest", "It has the targets' shape, at rest, and the first motion hits it"),
            ("SETTLE", "Settle", "It is in balance with gravity, and moves with the rig as if that had always moved"),
        ),
        default="SETTLE", override=OVERRIDE,
    )  # fmt: skip
    preroll: IntProperty(
        name="Pre-Roll", description="Frames that are simulated before the start",
        default=0, min=0, max=10_000, soft_max=100, override=OVERRIDE,
    )  # fmt: skip
    preroll_pose: EnumProperty(
        name="Pre-Roll Pose",
        description="What the rig does in the frames before the start. A loop needs no animated ones",
        items=(
            ("HELD", "Held", "It holds the pose of the start"),
            ("ANIMATED", "Animated", "It moves as its animation says: by keyframes before the start, or extrapolated"),
        ),
        default="HELD", override=OVERRIDE,
    )  # fmt: skip
    keep_outside: BoolProperty(
        name="Keep Other Frames",
        description="Bake the range into the last bake, of which the other frames stay as they are. The rig runs up to "
        "the range for a second, and where the two meet they are blended",
        override=OVERRIDE,
    )  # fmt: skip
    loop: BoolProperty(
        name="Loop", description="The range is a cycle: its last frame continues with its first, without a jump",
        override=OVERRIDE,
    )  # fmt: skip

    @property
    def is_patch(self) -> bool:
        """Whether the range is to go into the last bake."""
        return self.keep_outside and not self.use_scene_range

    def steps_per_frame(self, fps: float) -> int:
        return self.substeps or max(1, math.ceil(120.0 / fps - 1e-6))


class DynamorphOutput(PropertyGroup):
    """What a bake becomes."""

    sink: EnumProperty(
        name="Bake To", description="What plays the motion in Blender",
        items=(
            ("MODES", "Shape Keys", "A few keys, the modes, with a curve each: small, editable, for engines too"),
            ("FRAMES", "Shape Key a Frame", "The surface at single frames as keys, and curves that blend them"),
            ("PC2", "Point Cache (PC2)", "A file with the surface at every frame, played by a Mesh Cache modifier"),
            ("MDD", "Point Cache (MDD)", "As PC2, for programs that read only that"),
        ),
        default=OutputSettings.sink, override=OVERRIDE,
    )  # fmt: skip
    keys: IntProperty(
        name="Keys",
        description="How many shape keys the motion may take; the best for this shot are found. 0: one for each mode",
        default=OutputSettings.keys, min=0, soft_max=32, override=OVERRIDE,
    )  # fmt: skip
    every: IntProperty(
        name="Frame Step", description="Frames from one key to the next", default=OutputSettings.every,
        min=1, soft_max=10, override=OVERRIDE,
    )  # fmt: skip
    tolerance: FloatProperty(
        name="Tolerance",
        description="How far the surface may be off between keys, which then are where they are needed. 0: a key at "
        "regular frames",
        default=OutputSettings.tolerance, min=0.0, soft_max=0.01, precision=4, subtype="DISTANCE", override=OVERRIDE,
    )  # fmt: skip

    def settings(self) -> OutputSettings:
        """As the panels show them: lengths in Blender units."""
        return OutputSettings(**{field.name: getattr(self, field.name) for field in fields(OutputSettings)})


class DynamorphBake(PropertyGroup):
    """What a bake changed, so that Free Bake can undo exactly that."""

    keys: CollectionProperty(name="Keys", description="Shape keys that the bake added", type=DynamorphKey)
    cache: StringProperty(name="Cache", description="File name of the point cache, if one plays the motion")
    muted: CollectionProperty(name="Muted", description="Target keys that the bake muted", type=DynamorphKey)
    action: PointerProperty(name="Action", description="Action with the modal curves", type=bpy.types.Action)
    had_animation_data: BoolProperty(
        name="Had Animation Data", description="Whether the shape keys were animated before the bake"
    )
    active_index: IntProperty(name="Active Key", description="Index of the active shape key before the bake")
    basis: StringProperty(name="Basis", description="Hash of the Basis that the keys belong to")
    summary: StringProperty(name="Result", description="What the last bake made")
    warnings: StringProperty(name="Warnings", description="Of the last bake, a line each")
    inputs: StringProperty(name="Inputs", description="What the bake was made from, as JSON")
    animation: StringProperty(name="Animation", description="Hashes of the rig's animation as last seen, as JSON")
    verdict: StringProperty(name="Verdict", description="How believable the last bake looks, as JSON")
    was_rendered: BoolProperty(
        name="Was Rendered", description="Whether renders showed the point cache before plain skinning was shown",
        default=True,
    )  # fmt: skip
    content_id: StringProperty(name="Bake Id", description="Hash of all that the bake was made from")
    digest: StringProperty(name="Result Id", description="Hash of what was simulated")

    @property
    def exists(self) -> bool:
        return bool(self.keys or self.cache)


class DynamorphSculpt(PropertyGroup):
    """What sculpting a target in its pose changed, so that Finish Sculpting can put it back."""

    active: BoolProperty(name="Sculpting", description="Whether a target is being sculpted")
    was_pinned: BoolProperty(name="Was Pinned", description="Whether the active shape key was shown alone before")
    was_posing: BoolProperty(name="Was Posing", description="Whether the armature was in Pose Mode before")
    in_editmode: BoolProperty(name="In Edit Mode", description="Whether Edit Mode showed the Armature modifier before")
    on_cage: BoolProperty(name="On Cage", description="Whether Edit Mode edited through the modifier before")
    key: PointerProperty(name="Key", description="The shape key that is sculpted", type=DynamorphKey)
    is_new: BoolProperty(name="New", description="Whether it began with what the other targets show in its pose")
    shown: PointerProperty(
        name="Shown", description="The target's shape key that is turned on to be looked at before there is a model",
        type=DynamorphKey,
    )  # fmt: skip
