# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft skins as those of the sample scenes: pinned to the bones, with vibration modes and a stiffness in pascals."""

MATERIAL = ("stiffness", "poisson", "density", "mass_damping", "stiffness_damping")


def with_pins(obj):
    """Give these settings to the soft skin `obj` by its properties alone, without the add-on's modules."""
    settings = obj.dynamorph
    settings.model.hold, settings.model.hold_head = "BONES", False
    settings.model.property_unset("basis")
    settings.model.property_unset("modes")
    for piece in settings.attachments:
        group = obj.vertex_groups.get(piece.group) if piece.group else None
        if group:
            obj.vertex_groups.remove(group)
    settings.attachments.clear()
    settings.simulation.max_displacement = settings.simulation.max_thickness = 0.0
    for target in settings.targets:
        for name in (*MATERIAL, "frequency", "by_hand"):  # these come last: setting a stiffness marks it as set by hand
            target.property_unset(name)
        target.frequency, target.by_hand = 0.0, False
    return obj
