# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a target is in pose space: its bones with their captured pose, and its channel."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from bpy.types import PropertyGroup

from ...core.character import Skeleton
from ..events import sampled_changed
from ..keyless import ANIMATED, BoolProperty, CollectionProperty, FloatProperty, FloatVectorProperty, StringProperty
from ..references import OVERRIDE, OVERRIDE_LIST

IDENTITY = tuple(np.eye(4).ravel())


class DynamorphBone(PropertyGroup):
    """The name of a bone that places a target in pose space."""


class DynamorphChannel(PropertyGroup):
    """A number that places the targets that name it, beside their bones. Where it is 0, only the others count."""

    value: FloatProperty(
        name="Channel",
        description="Places the targets that name it: 0 is where it does nothing. Drag it, key it, or drive it by any "
        "property. It acts in Live and in bakes",
        default=0.0, soft_min=0.0, soft_max=1.0, step=1, precision=3, options=ANIMATED, override=OVERRIDE,
        update=sampled_changed,
    )  # fmt: skip


class DynamorphBonePose(PropertyGroup):
    """One bone of a captured pose. Matrices are row after row."""

    rest: FloatVectorProperty(
        name="Rest", description="Rest matrix, to find a renamed bone", size=16, override=OVERRIDE
    )
    local: FloatVectorProperty(
        name="Local", description="Transform relative to the evaluated parent", size=16, override=OVERRIDE
    )


class Placed:
    """Mixin of a target."""

    bones: CollectionProperty(
        name="Bones", description="Bones whose rotations decide when the target applies", type=DynamorphBone,
        override=OVERRIDE_LIST,
    )  # fmt: skip
    auto_bones: BoolProperty(
        name="Automatic Bones",
        description="Whether Finish Sculpting chooses the bones from the sculpt. Bones that you choose stay",
        override=OVERRIDE,
    )  # fmt: skip
    channel: StringProperty(
        name="Channel",
        description="A number that places the target too, beside its bones or without any: for muscles that tense, a "
        "belly that breathes. Add it from the menu of any property in Blender",
        override=OVERRIDE,
    )  # fmt: skip
    reached_at: FloatProperty(
        name="Reached At", description="The channel's value at which the target has its shape and material",
        default=1.0, step=1, precision=3, override=OVERRIDE,
    )  # fmt: skip
    fade_out_angle: FloatProperty(
        name="Fade-Out Angle",
        description="Distance from its pose, over all its bones, at which the target has faded out. 0 is no limit: it "
        "reaches until another target is nearer. Set it if the target shows in poses that it is not meant for",
        default=0.0, min=0.0, soft_max=np.pi, subtype="ANGLE", override=OVERRIDE,
    )  # fmt: skip
    pose: CollectionProperty(
        name="Pose", description="The captured pose of every bone", type=DynamorphBonePose, override=OVERRIDE_LIST
    )
    rig_world: FloatVectorProperty(
        name="Armature Transform", description="World transform of the armature when the pose was captured",
        size=16, default=IDENTITY, override=OVERRIDE,
    )  # fmt: skip

    def bone_names(self) -> tuple[str, ...]:
        return tuple(bone.name for bone in self.bones)

    def set_bones(self, names: Iterable[str], automatic: bool = False) -> None:
        """automatic: nobody chose them by hand."""
        self.auto_bones = automatic
        self.bones.clear()
        for name in names:
            self.bones.add().name = name

    def set_pose(self, skeleton: Skeleton, local: np.ndarray, rig_world: np.ndarray) -> None:
        """Store a pose: local (B, 4, 4) as `Skeleton.local_transforms` gives it, rig_world (4, 4)."""
        self.pose.clear()
        for name, rest, transform in zip(skeleton.names, skeleton.rest, local, strict=True):
            bone = self.pose.add()
            bone.name, bone.rest, bone.local = name, rest.ravel(), transform.ravel()
        self.rig_world = rig_world.ravel()

    @property
    def reached(self) -> dict[str, float]:
        """The channels that are not 0 in its pose."""
        return {self.channel: self.reached_at} if self.channel else {}

    def placing(self) -> tuple:
        """Everything that places the target in pose space, for comparison: cheap enough for every frame."""
        return self.fade_out_angle, self.bone_names(), self.channel, self.reached_at, self.pose_bytes()

    def pose_bytes(self) -> bytes:
        """The captured transforms, float32."""
        stored = np.empty(16 * len(self.pose), np.float32)
        self.pose.foreach_get("local", stored)
        return stored.tobytes()

    def local(self, skeleton: Skeleton) -> np.ndarray:
        """The captured pose (B, 4, 4) in the skeleton's order; bones added since then are at rest."""
        stored = np.frombuffer(self.pose_bytes(), np.float32).reshape(-1, 4, 4).astype(np.float64)
        by_name = dict(zip((bone.name for bone in self.pose), stored, strict=True))
        return np.array([by_name.get(name, np.eye(4)) for name in skeleton.names]).reshape(-1, 4, 4)
