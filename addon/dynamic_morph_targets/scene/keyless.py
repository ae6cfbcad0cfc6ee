# SPDX-License-Identifier: GPL-3.0-or-later
"""The properties of bpy.props without a key or a driver, which Blender offers unless told otherwise: a simulation would
not follow them. What it follows says `options=ANIMATED`.
"""

from functools import partial
from typing import Any

from bpy import props

ANIMATED = {"ANIMATABLE"}


def _keyless(kind: Any) -> Any:
    return partial(kind, options=set())


BoolProperty = _keyless(props.BoolProperty)
CollectionProperty = _keyless(props.CollectionProperty)
EnumProperty = _keyless(props.EnumProperty)
FloatProperty = _keyless(props.FloatProperty)
FloatVectorProperty = _keyless(props.FloatVectorProperty)
IntProperty = _keyless(props.IntProperty)
IntVectorProperty = _keyless(props.IntVectorProperty)
PointerProperty = _keyless(props.PointerProperty)
StringProperty = _keyless(props.StringProperty)
