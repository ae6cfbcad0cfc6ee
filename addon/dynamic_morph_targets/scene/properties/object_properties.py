# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist authored, stored on the Object as `Object.dynamorph`, and how it follows renames.

Blender gives shape keys no lasting identity and bones only their names, so each reference keeps a second clue: a hash
of the key's shape, the bone's rest matrix. `reconcile` uses it when a name is gone. The settings live on the Object
(not the Key, which vanishes with its last shape key, and not the ShapeKey, which takes no properties).
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.types import PropertyGroup

from .. import events
from ..keyless import BoolProperty, CollectionProperty, IntProperty, PointerProperty, StringProperty
from ..references import OVERRIDE, OVERRIDE_LIST
from ..registration import of_classes
from .bake_properties import (
    DynamorphBake,
    DynamorphCollision,
    DynamorphLive,
    DynamorphOutput,
    DynamorphSculpt,
    DynamorphSimulation,
)
from .grip_properties import DynamorphGrip
from .model_properties import DynamorphAttachment, DynamorphMode, DynamorphModel, DynamorphPart
from .target_place import DynamorphBone, DynamorphBonePose, DynamorphChannel
from .target_properties import DynamorphKey, DynamorphTarget


class DynamorphSettings(PropertyGroup):
    """Everything about the soft skin of one object."""

    targets: CollectionProperty(
        name="Targets", description="Dynamic morph targets; the first is the neutral one", type=DynamorphTarget,
        override=OVERRIDE_LIST,
    )  # fmt: skip
    channels: CollectionProperty(
        name="Channels", description="Numbers that place targets in pose space", type=DynamorphChannel,
        override=OVERRIDE_LIST,
    )  # fmt: skip
    active_target_index: IntProperty(
        name="Active Target", description="Index of the target selected in the list", override=OVERRIDE
    )
    firmness_group: StringProperty(
        name="Firmness",
        description="Vertex group that is 0 where the skin is softer, 0.5 where it is unchanged, 0.9 where it is "
        "firmer and 1 where the bones hold it. Paint it when a part moves too much or too little",
        override=OVERRIDE,
        update=events.mesh_changed,
    )
    parts: CollectionProperty(
        name="Parts", description="Soft parts of the body, such as its belly, found by its bones", type=DynamorphPart,
        override=OVERRIDE_LIST,
    )  # fmt: skip
    max_distance_group: StringProperty(
        name="Max Distance",
        description="Vertex group that scales how far the skin may move: 1 as far as Max Displacement says, 0 not at "
        "all, so that the skin follows the bones exactly. Paint it where soft skin comes too near to something hard",
        override=OVERRIDE,
        update=events.mesh_changed,
    )
    excluded_group: StringProperty(
        name="Exclude",
        description="Vertex group of skin that ignores objects, with a weight of 0.5 or more. Choose one for places "
        "that nothing should push, such as the inside of a mouth",
        override=OVERRIDE,
        update=events.mesh_changed,
    )
    groups: StringProperty(name="Groups", description="Names of the vertex groups, one per line, to follow renames")
    attachments: CollectionProperty(
        name="Attachments", description="Parts of the mesh and other meshes that do not simply belong to the body",
        type=DynamorphAttachment, override=OVERRIDE_LIST,
    )  # fmt: skip
    grips: CollectionProperty(
        name="Grips", description="What holds patches of the skin", type=DynamorphGrip, override=OVERRIDE_LIST
    )
    active_grip_index: IntProperty(
        name="Active Grip", description="Index of the grip selected in the list", min=0, override=OVERRIDE
    )
    active_attachment_index: IntProperty(
        name="Active Attachment", description="Index of the attachment selected in the list", min=0, override=OVERRIDE
    )
    follows: PointerProperty(
        name="Follows", description="The soft skin whose motion the bake or Live shows on this mesh",
        type=bpy.types.Object, override=OVERRIDE,
    )  # fmt: skip
    had_keys: BoolProperty(name="Had Shape Keys", description="Whether the mesh had a Basis before it followed")
    model: PointerProperty(
        name="Model",
        description="How the model is built, and the result of the last build",
        type=DynamorphModel,
        override=OVERRIDE,
    )
    modes: CollectionProperty(
        name="Modes", description="Displacement modes of the built model", type=DynamorphMode, override=OVERRIDE_LIST
    )
    active_mode_index: IntProperty(
        name="Active Mode", description="Index of the mode selected in the list", min=0, override=OVERRIDE
    )
    simulation: PointerProperty(
        name="Simulation", description="How a shot is simulated", type=DynamorphSimulation, override=OVERRIDE
    )
    collision: PointerProperty(
        name="Collision", description="What stops the skin, and how", type=DynamorphCollision, override=OVERRIDE
    )
    live: PointerProperty(name="Live", description="Simulation during playback", type=DynamorphLive)
    output: PointerProperty(
        name="Output", description="The form in which the motion is stored", type=DynamorphOutput, override=OVERRIDE
    )
    bake: PointerProperty(name="Bake", description="What the last bake changed", type=DynamorphBake, override=OVERRIDE)
    sculpt: PointerProperty(name="Sculpt", description="Sculpting in a target's pose", type=DynamorphSculpt)

    @property
    def active_target(self) -> DynamorphTarget | None:
        """The target selected in the list, or None."""
        inside = 0 <= self.active_target_index < len(self.targets)
        return self.targets[self.active_target_index] if inside else None

    @property
    def active_grip(self) -> DynamorphGrip | None:
        """The grip selected in the list, or None."""
        return self.grips[self.active_grip_index] if self.active_grip_index < len(self.grips) else None

    @property
    def active_attachment(self) -> DynamorphAttachment | None:
        """The attachment selected in the list, or None."""
        return (
            self.attachments[self.active_attachment_index]
            if self.active_attachment_index < len(self.attachments)
            else None
        )


COLORINGS = ("heat", "firmness", "max_distance")  # of the surface: one at a time


def _color_surface(which: str) -> Callable[[DynamorphDisplay, bpy.types.Context], None]:
    """The update of a toggle that colors the surface: turning one on turns the others off and redraws the viewports."""

    def update(display: DynamorphDisplay, _context: bpy.types.Context) -> None:
        for other in COLORINGS if getattr(display, which) else ():
            if other != which and getattr(display, other):
                setattr(display, other, False)
        events.redraw(events.VIEWS)

    return update


def _redraw_views(_display: DynamorphDisplay, _context: bpy.types.Context) -> None:
    events.redraw(events.VIEWS)


def _show_target_weights(display: DynamorphDisplay, _context: bpy.types.Context) -> None:
    if display.target_weights and not bpy.app.background:
        events.emit(events.Event.WEIGHTS_ASKED)


class DynamorphDisplay(PropertyGroup):
    """Overlays of the 3D viewport; they last for the session, like Blender's own overlays of a window."""

    cage: BoolProperty(name="Cage", description="Draw the cage of tetrahedra and the nodes that are held")
    target_weights: BoolProperty(
        name="Target Weights",
        description="Draw each target's weight over the frames, and shade the frames that are far from every target",
        update=_show_target_weights,
    )  # fmt: skip
    heat: BoolProperty(
        name="Heat Map",
        description="Color the skin by how far it moves away from the animation, as a fraction of Max Displacement",
        update=_color_surface("heat"),
    )  # fmt: skip
    firmness: BoolProperty(
        name="Show Firmness",
        description="Color the skin by firmness: blue is softer, green is unchanged, and red is held by the bones, "
        "either because it is painted so or because the part is thin or a head",
        update=_color_surface("firmness"),
    )  # fmt: skip
    max_distance: BoolProperty(
        name="Show Max Distance",
        description="Color the skin by how far it may move: red as far as Max Displacement says, blue not at all",
        update=_color_surface("max_distance"),
    )  # fmt: skip
    contact: BoolProperty(
        name="Show Contact",
        description="Show where something stops the visible skin: green points where it touches, red points where it "
        "is still inside, because the bones leave no room",
        update=_redraw_views,
    )  # fmt: skip
    posed: StringProperty(name="Posed", description="The armature that was in Pose Mode when painting began")


CLASSES = (
    DynamorphKey,
    DynamorphBone,
    DynamorphBonePose,
    DynamorphChannel,
    DynamorphTarget,
    DynamorphGrip,
    DynamorphPart,
    DynamorphAttachment,
    DynamorphModel,
    DynamorphMode,
    DynamorphLive,
    DynamorphSimulation,
    DynamorphCollision,
    DynamorphOutput,
    DynamorphBake,
    DynamorphSculpt,
    DynamorphSettings,
    DynamorphDisplay,
)
_register_classes, _unregister_classes = of_classes(CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.Object.dynamorph = PointerProperty(name="Dynamorph", type=DynamorphSettings, override=OVERRIDE)
    bpy.types.WindowManager.dynamorph = PointerProperty(name="Dynamorph", type=DynamorphDisplay)


def unregister() -> None:
    for owner in (bpy.types.WindowManager, bpy.types.Object):
        if hasattr(owner, "dynamorph"):
            del owner.dynamorph
    _unregister_classes()
