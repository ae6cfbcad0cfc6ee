# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds patches of a soft skin, stored on the Object."""

from __future__ import annotations

import bpy
from bpy.types import PropertyGroup

from ..events import sampled_changed
from ..keyless import ANIMATED, BoolProperty, FloatProperty, PointerProperty, StringProperty
from ..references import OVERRIDE


class DynamorphGrip(PropertyGroup):
    """An object, or a bone of one, that holds a patch of the skin by springs."""

    mute: BoolProperty(name="Mute", description="Let go of the patch, in Live and in bakes", override=OVERRIDE)
    object: PointerProperty(name="Object", description="What holds the patch", type=bpy.types.Object, override=OVERRIDE)
    bone: StringProperty(name="Bone", description="The bone of the object that holds the patch", override=OVERRIDE)
    group: StringProperty(
        name="Group",
        description="Vertex group of the patch. Empty for the skin nearest to the object. Press Attach Here to take "
        "hold of another",
        override=OVERRIDE,
    )  # fmt: skip
    strength: FloatProperty(
        name="Strength",
        description="How firmly the patch is held: 1 as by Grab Soft Skin, 0 not at all. Key it to take hold and to "
        "let go",
        default=1.0, min=0.0, max=100.0, soft_max=1.0, step=1, options=ANIMATED, override=OVERRIDE,
        update=sampled_changed,
    )  # fmt: skip
    patch: StringProperty(  # grab.Patch.text
        name="Patch", description="The vertices that are held, and where", options={"HIDDEN"}, override=OVERRIDE
    )
