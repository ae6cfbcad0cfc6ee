# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the curves of a bake are: in an Action of its own, or in slots of the one that the armature plays."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.errors import WriteError
from ...scene import animation
from ...scene.properties.bake_properties import DynamorphBake
from ...scene.references import rig_of

SHAPES, MOTION = "Dynamorph Shapes", "Dynamorph"  # the tracks from bottom to top, and the Action's slots


class BakedAction:
    """action: may be None. is_shared: it is the artist's, in which only the slots with these handles are the bake's;
    else they are found by their names, which in an Action of the bake's own nobody else uses.
    """

    def __init__(self, action: Any, is_shared: bool = False, handles: dict[str, int] | None = None):
        self.action, self.is_shared = action, is_shared
        self.handles = handles or {}  # by title

    @classmethod
    def of(cls, obj: bpy.types.Object) -> BakedAction:
        """That of the bake of `obj`."""
        record = obj.dynamorph.bake
        handles = {title: handle for title, handle in zip((SHAPES, MOTION), record.action_slots, strict=True) if handle}
        return cls(record.action, bool(handles), handles)

    @classmethod
    def new(cls, obj: bpy.types.Object, body: bpy.types.Object) -> BakedAction:
        """That of a new bake of `obj`, which is the soft skin `body` or follows it."""
        if goes_to_rig(body):
            return cls(rig_action(body), is_shared=True)
        return cls(bpy.data.actions.new(f"{MOTION} {obj.name}"))

    def record(self, record: DynamorphBake) -> None:
        """The inverse of `of`. A shared Action in which the bake has nothing is not the bake's."""
        record.action = None if self.is_shared and not self.handles else self.action
        record.action_slots = [self.handles.get(title, 0) for title in (SHAPES, MOTION)]

    def slot(self, title: str) -> Any:
        """The slot with this title, or None."""
        for slot in self.action.slots if self.action else ():
            if slot.handle == self.handles.get(title) if self.is_shared else slot.name_display == title:
                return slot
        return None

    def holds(self, slot: bpy.types.ActionSlot | None) -> bool:
        """Whether a slot of the Action, which may be None, can be the bake's."""
        return not self.is_shared or (slot is not None and slot.handle in self.handles.values())

    def add_slot(self, keys: bpy.types.Key, title: str) -> tuple:
        """A new slot for shape keys, and what holds its curves. An Action has at most one layer and one strip."""
        layer = self.action.layers[0] if self.action.layers else self.action.layers.new("Layer")
        strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
        slot = self.action.slots.new(keys.id_type, title)
        if self.is_shared:
            self.handles[title] = slot.handle
        return slot, strip.channelbag(slot, ensure=True)

    def name_slots(self) -> None:
        """Give its slots their titles, which those of an earlier bake had."""
        for title in self.handles:
            self.slot(title).name_display = title

    def take_back(self) -> None:
        """Remove what a bake that failed has added."""
        if self.action and not self.is_shared:
            bpy.data.actions.remove(self.action)
        for title in self.handles:
            self.action.slots.remove(self.slot(title))


def goes_to_rig(body: bpy.types.Object) -> bool:
    """Whether the curves of the bakes of a soft skin go to the armature's Action."""
    return body.dynamorph.output.bake_to_action and body.dynamorph.output.format != "PC2"


def check_rig_action(body: bpy.types.Object) -> None:
    """Raises WriteError where a bake is to go to the Action of an armature that plays none, or one that is linked."""
    action = rig_action(body) if goes_to_rig(body) else None
    if goes_to_rig(body) and (action is None or not action.is_editable):
        raise WriteError(
            "The armature of '{name}' plays no Action of this file, to which the bake could go: choose one in the "
            "Action Editor, or turn Bake to Action off",
            name=body.name,
        )


def rig_action(body: bpy.types.Object) -> bpy.types.Action | None:
    """The Action that the armature of a soft skin plays, or None."""
    rig = rig_of(body)
    return rig and rig.animation_data and rig.animation_data.action


def players_of(slot: bpy.types.ActionSlot) -> list:
    """The shape keys of the file that play a slot, muted or not. Blender's own list does not notice removed strips."""
    found = [keys for keys in bpy.data.shape_keys if keys.animation_data]
    return [keys for keys in found if slot in _played(keys.animation_data)]


def _played(data: bpy.types.AnimData) -> list:
    return [each.action_slot for each in (data, *animation.strips(data.nla_tracks))]
