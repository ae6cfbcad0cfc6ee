# SPDX-License-Identifier: GPL-3.0-or-later
"""Two sets of settings to compare, kept with the object."""

from __future__ import annotations

from dataclasses import asdict, replace

import bpy

from ...scene import plain, skin
from .. import assign


def slot_settings(obj: bpy.types.Object) -> dict:
    """The content of one slot, as JSON data. Targets are identified by name; the neutral one is ''."""
    settings = obj.dynamorph
    return {
        "materials": {name: asdict(target.material()) for name, target in skin.named_targets(obj)},
        "frequencies": {name: [target.frequency, target.by_hand] for name, target in skin.named_targets(obj)},
        "simulation": plain.plain(settings.simulation),
        "gains": [mode.gain for mode in settings.modes],
    }


def put_slot(obj: bpy.types.Object, values: dict) -> None:
    """The inverse of `slot_settings`; targets and modes that were added since then stay as they are.

    values: as `records.slot` reads them. Settings that are unknown, or that do not take the value, stay too.
    """
    for name, target in skin.named_targets(obj):
        if name in values["materials"]:
            target.set_material(replace(target.material(), **values["materials"][name]))
            target.frequency, target.by_hand = values["frequencies"].get(name, (0.0, False))
    simulation = obj.dynamorph.simulation
    properties = simulation.bl_rna.properties
    known = {name: value for name, value in values["simulation"].items() if name in properties}
    assign.assign(simulation, {name: value for name, value in known.items() if plain.fits(properties[name], value)})
    for mode, gain in zip(obj.dynamorph.modes, values["gains"], strict=False):
        if mode.gain != gain:
            mode.gain = gain
