# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist chose for simulations and bakes, stored on the Object."""

from __future__ import annotations

import math
from dataclasses import fields

import bpy
from bpy.types import PropertyGroup

from ...core.material.feel import FEELS
from ...core.settings import MOST_SUBSTEPS, OutputSettings, SimulationSettings
from ..events import shown_changed
from ..keyless import (
    ANIMATED,
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)
from ..references import OVERRIDE
from .target_properties import DynamorphKey

NATURAL = FEELS["NATURAL"]  # of a new soft skin
TO_ACTION = (
    "Store the curves of this bake and the next ones in slots of the armature's Action instead of in a separate "
    "Action. Turn it on to keep the whole performance in one Action"
)
SLOTS = (("A", "A", "The first set of settings", 0), ("B", "B", "The second set of settings", 1))


class DynamorphLive(PropertyGroup):
    """Simulation during playback, shown by one shape key that is rewritten at each frame."""

    key: PointerProperty(name="Key", description="The shape key that Live rewrites", type=DynamorphKey)
    others: StringProperty(
        name="Other Keys", description="Names of the other shape keys, by which a renamed Key is told from them"
    )
    muted: CollectionProperty(name="Muted", description="Target keys that Live muted", type=DynamorphKey)
    lent: BoolProperty(
        name="In Preview",
        description="Whether a preview shows something else for a while",
    )
    was_on: BoolProperty(name="Was Live", description="Whether Live was on before the preview")
    moved: BoolProperty(name="Moved", description="Whether a preview moves this object by its delta transform")
    deltas: FloatVectorProperty(name="Deltas", description="The delta transform of this object before that", size=10)
    slot: EnumProperty(name="Slot", description="Which of two sets of settings is in use", items=SLOTS, default="A")
    beside: PointerProperty(
        name="Beside", description="The soft skin that this empty shows a copy of, to compare the two",
        type=bpy.types.Object,
    )  # fmt: skip
    beside_slot: StringProperty(
        name="Slot Beside", description="The slot of the bake that the copy shows, empty for plain skinning"
    )
    other: StringProperty(name="Other Slot", description="The settings of the slot that is not in use, as JSON")
    checks: StringProperty(
        name="Targets", description="How far the skin at rest is from each target's shape, one target per line"
    )


class DynamorphSimulation(PropertyGroup):
    """How a shot is simulated."""

    use_scene_range: BoolProperty(
        name="Scene Range",
        description="Bake the frame range of the scene. Turn it off to bake a part of the shot",
        default=True,
        override=OVERRIDE,
    )
    frame_start: IntProperty(
        name="Frame Start",
        description="First frame of the bake. Set it when Scene Range is off",
        default=SimulationSettings.frame_start,
        override=OVERRIDE,
    )
    frame_end: IntProperty(
        name="Frame End",
        description="Last frame of the bake. Set it when Scene Range is off",
        default=SimulationSettings.frame_end,
        override=OVERRIDE,
    )
    speed: FloatProperty(
        name="Speed",
        description="How fast time passes for the soft skin. Set 0.5 if the animation is in slow motion at half speed, "
        "so that the skin swings as slowly as the rest of the shot moves",
        default=SimulationSettings.speed, min=0.01, max=10.0, soft_min=0.1, soft_max=2.0, precision=2,
        override=OVERRIDE,
    )  # fmt: skip
    substeps: IntProperty(
        name="Substeps Per Frame",
        description="How many time steps the simulation takes per frame. 0 takes as many as keep a step below 1/120 s. "
        "Raise it if steps do not converge",
        default=0, min=0, max=MOST_SUBSTEPS, soft_max=20, override=OVERRIDE,
    )  # fmt: skip
    samples: IntProperty(
        name="Samples Per Frame",
        description="How many states per frame are kept. Raise it for motion blur, which then follows the swing "
        "between two frames. The substeps are rounded up to a multiple",
        default=SimulationSettings.samples, min=1, max=32, soft_max=8, override=OVERRIDE,
    )  # fmt: skip
    integrator: EnumProperty(
        name="Integrator",
        description="How the simulation steps through time. Change it only to compare with other programs",
        items=(
            ("BDF2", "BDF2", "Second order. It keeps the bounce", 0),
            ("EULER", "Implicit Euler", "First order. It damps the motion strongly", 1),
        ),
        default=SimulationSettings.integrator, override=OVERRIDE,
    )  # fmt: skip
    gravity: FloatProperty(
        name="Gravity",
        description="Multiplies the scene's gravity. The sculpted shapes do not sag: in a target's own pose and "
        "orientation, gravity is in balance. Lower it for bodies under water or in space",
        default=1.0, min=-10.0, max=10.0, soft_min=0.0, soft_max=1.0, override=OVERRIDE,
    )  # fmt: skip
    fields: FloatProperty(
        name="Force Fields",
        description="Multiplies the scene's Wind, Force, Vortex and Turbulence fields. Their strength is newtons per "
        "square meter of skin. Lower it if the wind moves the skin too much",
        default=1.0, min=0.0, soft_max=1.0, override=OVERRIDE,
    )  # fmt: skip
    amount: FloatProperty(
        name="Amount",
        description="How much of the motion is shown, in Live and in the next bake: 0 shows none, 1 shows it as "
        "simulated. Raise it to exaggerate quickly; for softer tissue, lower Bounce instead",
        default=SimulationSettings.amount, min=0.0, max=4.0, soft_max=2.0, subtype="FACTOR", options=ANIMATED,
        override=OVERRIDE, update=shown_changed,
    )  # fmt: skip
    max_displacement: FloatProperty(
        name="Max Displacement",
        description="How far the skin may move away from the animation, as a fraction of the body's size. From half "
        "of it on, bones that move faster than their tissue can follow move it less. Raise it for cartoons. "
        "0 is no limit",
        default=NATURAL.max_displacement, min=0.0, max=1.0, soft_max=0.2, precision=3, subtype="FACTOR",
        override=OVERRIDE,
    )  # fmt: skip
    max_thickness: FloatProperty(
        name="Of Thickness",
        description="How far the skin may move away from the animation, as a fraction of the body's thickness at that "
        "place. Lower it if thin parts stretch too far. 0 is no limit",
        default=NATURAL.max_thickness, min=0.0, max=10.0, soft_max=1.0, precision=2, subtype="FACTOR",
        override=OVERRIDE,
    )  # fmt: skip
    initial_state: EnumProperty(
        name="Initial State",
        description="The state of the soft tissue at the first frame. Choose Rest Shape if the shot begins with a blow",
        items=(
            (
                "REST_SHAPE", "Rest Shape",
                "It starts in the targets' shape without motion, so the first motion hits it",
                0,
            ),
            (
                "SETTLED", "Settled",
                "It is in balance with gravity and moves with the rig as if the rig had always moved",
                1,
            ),
        ),
        default=SimulationSettings.initial_state, override=OVERRIDE,
    )  # fmt: skip
    keep_outside: BoolProperty(
        name="Keep Other Frames",
        description="Bake this range into the last bake and keep its other frames. The simulation starts one second, "
        "at the Speed of the skin, before the range, and the two are blended where they meet. Turn it on to change "
        "a few frames of a long shot",
        override=OVERRIDE,
    )  # fmt: skip
    loop: BoolProperty(
        name="Loop",
        description="Make the range a cycle, so that its last frame leads into its first without a jump. Turn it on "
        "for walks and other cycles",
        override=OVERRIDE,
    )  # fmt: skip

    @property
    def is_patch(self) -> bool:
        """Whether the range goes into the last bake."""
        return self.keep_outside and not self.use_scene_range

    def steps_per_frame(self, fps: float, substeps: int | None = None) -> int:
        """How many time steps a frame takes; substeps: instead of the setting, 0 for automatic too."""
        chosen = self.substeps if substeps is None else substeps
        return chosen or max(1, math.ceil(120.0 * self.speed / fps - 1e-6))


class DynamorphCollision(PropertyGroup):
    """What stops the skin, and how."""

    use: BoolProperty(
        name="Collision",
        description="Let mesh objects with Blender's Collision (Physics tab) stop the skin, so that it dents instead "
        "of passing through. Turn it on if something touches the body. Set Distance instead of the thickness of the "
        "objects, which is ignored",
        override=OVERRIDE,
    )  # fmt: skip
    collection: PointerProperty(
        name="Collection",
        description="Only objects in this collection stop the skin. Choose one if the scene has other objects with "
        "Collision that should not affect this body",
        type=bpy.types.Collection,
        override=OVERRIDE,
    )
    distance: FloatProperty(
        name="Distance",
        description="How far from other objects the skin stops, as a fraction of the body's size. Raise it if objects "
        "show through the skin. Keys and drivers act at each step",
        default=SimulationSettings.distance, min=0.0, max=0.05, soft_max=0.01, precision=4, subtype="FACTOR",
        options=ANIMATED, override=OVERRIDE,
    )  # fmt: skip
    use_self: BoolProperty(
        name="Self Collision",
        description="Let the skin stop itself too, such as a belly on the thighs or an arm on the chest; skin that "
        "touches at rest, or folds at a joint, is ignored. Turn it on if parts of the body pass through each other",
        override=OVERRIDE,
    )
    use_friction: BoolProperty(
        name="Override Friction",
        description="Use one friction for all objects instead of a tenth of the cloth friction that each object's "
        "Collision has. Turn it on if those values are meant for other simulations",
        override=OVERRIDE,
    )
    friction: FloatProperty(
        name="Friction",
        description="How much the skin clings to objects: 0 is like ice, 0.5 like dry skin. Raise it if the skin slips "
        "too easily. Keys and drivers act at each step; between soft bodies, only the first key counts",
        default=0.5, min=0.0, max=5.0, soft_max=1.0, precision=2, options=ANIMATED, override=OVERRIDE,
    )  # fmt: skip
    bake_full: BoolProperty(
        name="Bake in Full Quality",
        description="Bake colliding bodies in Full Quality, with more accurate dents. Turn it off to bake what Live "
        "shows, which is faster",
        default=True, override=OVERRIDE,
    )  # fmt: skip


class DynamorphOutput(PropertyGroup):
    """What a bake becomes."""

    format: EnumProperty(
        name="Format",
        description="How the motion is stored and played in Blender. Shape Keys suit most shots and game engines",
        items=(
            (
                "MODES", "Shape Keys",
                "One key and one curve per mode. They are small, editable and suit game engines",
                0,
            ),
            ("PC2", "Point Cache (PC2)", "A file with the surface at every frame, played by a Mesh Cache modifier", 2),
        ),
        default=OutputSettings.format, override=OVERRIDE,
    )  # fmt: skip
    keys: IntProperty(
        name="Key Limit",
        description="How many shape keys the motion may take. The bake finds the best ones for this shot. Lower it "
        "for game engines. 0 is no limit: it makes one per mode",
        default=OutputSettings.keys, min=0, soft_max=32, override=OVERRIDE,
    )  # fmt: skip
    bake_to_action: BoolProperty(name="Bake to Action", description=TO_ACTION, override=OVERRIDE)

    def settings(self) -> OutputSettings:
        """As the panels show them: lengths in Blender units."""
        return OutputSettings(**{field.name: getattr(self, field.name) for field in fields(OutputSettings)})


class DynamorphBake(PropertyGroup):
    """What a bake changed, so that Delete Bake can undo exactly that. Overridable is what a library override has."""

    keys: CollectionProperty(name="Keys", description="Shape keys that the bake added", type=DynamorphKey)
    cache: StringProperty(
        name="Cache", description="File name of the point cache, if one plays the motion", override=OVERRIDE
    )
    muted: CollectionProperty(name="Muted", description="Target keys that the bake muted", type=DynamorphKey)
    action: PointerProperty(name="Action", description="Action with the modal curves", type=bpy.types.Action)
    action_slots: IntVectorProperty(
        name="Action Slots",
        description="Handles of the bake's slots in that Action, if it is the armature's; otherwise 0",
        size=2,
    )
    had_animation_data: BoolProperty(
        name="Had Animation Data", description="Whether the shape keys were animated before the bake"
    )
    active_index: IntProperty(name="Active Key", description="Index of the active shape key before the bake")
    basis: StringProperty(name="Basis", description="Hash of the Basis that the keys belong to", override=OVERRIDE)
    summary: StringProperty(name="Result", description="What the last bake made", override=OVERRIDE)
    warnings: StringProperty(name="Warnings", description="Warnings of the last bake, one per line", override=OVERRIDE)
    inputs: StringProperty(name="Inputs", description="What the bake was made from, as JSON", override=OVERRIDE)
    lost: StringProperty(
        name="Lost", description="Point caches that are missing as last seen, one per line", override=OVERRIDE
    )
    animation: StringProperty(
        name="Animation", description="Hashes of the rig's animation as last seen, as JSON", override=OVERRIDE
    )
    colliders: StringProperty(
        name="Colliders", description="Hashes of what moves and shapes the colliders as last seen, as JSON",
        override=OVERRIDE,
    )  # fmt: skip
    painted: StringProperty(
        name="Painted", description="Hashes of the painted maps as last seen, one per line", override=OVERRIDE
    )
    off_full: FloatProperty(
        name="Off Full Quality",
        description="How far the reduced motion is from that of Full Quality, as a fraction of it; negative before "
        "they were compared",
        default=-1.0, override=OVERRIDE,
    )  # fmt: skip
    verdict: StringProperty(
        name="Verdict", description="How believable the last bake looks, as JSON", override=OVERRIDE
    )
    was_rendered: BoolProperty(
        name="Was Rendered", description="Whether renders showed the point cache before plain skinning was shown",
        default=True, override=OVERRIDE,
    )  # fmt: skip
    slot: EnumProperty(
        name="Slot", description="Which set of settings the bake was made with", items=SLOTS, override=OVERRIDE
    )
    content_id: StringProperty(
        name="Bake Id", description="Hash of everything that the bake was made from", override=OVERRIDE
    )
    digest: StringProperty(name="Result Id", description="Hash of the simulated motion", override=OVERRIDE)

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
    is_new: BoolProperty(name="New", description="Whether the key began as the blend of the other targets in its pose")
    shown: PointerProperty(
        name="Shown", description="The target's shape key that is turned on to show it before a model exists",
        type=DynamorphKey,
    )  # fmt: skip
