# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft skins as those of the sample scenes: pinned to the bones, with vibration modes and a stiffness in pascals."""

MODEL = {"hold": "BONES", "hold_head": False, "basis": "MODES", "modes": 20}
MATERIAL = {
    "stiffness": 2e4, "poisson": 0.4, "density": 1000.0, "mass_damping": 1.0, "stiffness_damping": 0.005,
}  # fmt: skip


def with_pins(obj):
    """Give these settings to the soft skin `obj` by its properties alone, without the add-on's modules."""
    settings = obj.dynamorph
    for name, value in MODEL.items():
        setattr(settings.model, name, value)
    for piece in settings.attachments:
        group = obj.vertex_groups.get(piece.group) if piece.group else None
        if group:
            obj.vertex_groups.remove(group)
    settings.attachments.clear()
    settings.simulation.max_displacement = settings.simulation.max_thickness = 0.0
    for target in settings.targets:
        for name, value in MATERIAL.items():
            setattr(target, name, value)
        target.frequency, target.by_hand = 0.0, False  # last: setting a stiffness marks it as set by hand
    return obj
