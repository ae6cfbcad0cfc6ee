# SPDX-License-Identifier: GPL-3.0-or-later
"""How soft it feels and how believable it looks: plain against soft, the verdict and its buttons, presets, Amount."""

from __future__ import annotations

import bpy
import driver
import limb
import numpy as np
from driver import measure, step, until
from editors import (
    addon,
    baked,
    close,
    differing,
    job_done,
    keys,
    moved,
    on_screen,
    physics,
    properties,
    settings,
    shown,
    sidebar,
    skin,
    view,
    viewport,
)

HEAT = "dynamorph.heat"
PLAIN = "dynamorph.show_plain"
BESIDE = "dynamorph.compare_beside"


def wobble() -> float:
    """How far the skin moves after the rig has stopped, meters."""
    return moved(limb.FLEXED + 1, limb.FLEXED + 4)


def swinging() -> float:
    """How much the skin still swings a few frames after the rig has stopped, until the rig moves again, meters: the
    sum over the frames.
    """
    return sum(moved(frame, limb.STRETCHED - 1) for frame in range(limb.FLEXED + 3, limb.STRETCHED - 1))


def bake():
    yield from sidebar.press("dynamorph.bake")
    yield from job_done()


def found():
    """What the panel says of the bake."""
    return addon("core.result.judge").parsed(settings().bake.verdict)


def displacement() -> float:
    """The largest of the bake, of the body's size."""
    return found().displacement


# Plain against soft --------------------------------------------------------------------------------------------------


@step("Show Plain Skinning, and the soft skin again")
def plain():
    bpy.context.scene.frame_set(limb.FLEXED + 1)
    yield from sidebar.unfold("DYNAMORPH_PT_compare")
    yield from driver.drawn()
    pictured, soft = driver.pixels(viewport.box), shown()
    yield from sidebar.press(PLAIN)
    yield from until(lambda: addon("write.display.comparison").is_plain(skin()), "plain skinning")
    yield from driver.drawn()
    changed = differing(pictured)
    assert changed > 0.002 and np.abs(shown() - soft).max() > 1e-3, f"the viewport shows no difference: {changed}"
    yield from driver.keep("plain", view)
    yield from sidebar.press(PLAIN)
    yield from until(lambda: not addon("write.display.comparison").is_plain(skin()), "the soft skin")
    yield from driver.drawn()
    yield from sidebar.fold("DYNAMORPH_PT_compare")
    assert np.array_equal(shown(), soft)
    assert differing(pictured) < 0.1 * changed, f"the viewport shows something else: {differing(pictured)} of {changed}"


@step("Compare Side by Side", picture=view)
def side_by_side():
    """With plain skinning, and with the bake of the other settings."""
    beside = addon("write.display.beside")
    names = lambda: addon("ui.overlays.viewport").names_beside(skin(), beside.find(skin()))  # noqa: E731
    yield from sidebar.unfold("DYNAMORPH_PT_compare")
    yield from driver.drawn()
    pictured = driver.pixels(viewport.box)
    yield from sidebar.press(BESIDE)
    yield from until(lambda: beside.find(skin()), "the copy")
    yield from driver.drawn()
    assert differing(pictured) > 0.01 and names() == ("Bake A", "Bones Only")
    yield from driver.click(on_screen(skin().location + beside.find(skin()).location))
    assert bpy.context.selected_objects in ([], [skin()]), "the copy can be selected"
    bpy.context.view_layer.objects.active = skin()
    yield from viewport.key("Z", ctrl=True)
    yield from viewport.key("Z", ctrl=True)
    yield from until(lambda: not beside.find(skin()), "the copy to be undone")
    yield from viewport.key("Z", ctrl=True, shift=True)
    yield from until(lambda: beside.find(skin()), "the copy to be redone")


@step("Two bakes side by side")
def two_bakes():
    beside = addon("write.display.beside")
    yield from sidebar.press("dynamorph.swap_slot")
    yield from bake()
    assert addon("ui.overlays.viewport").names_beside(skin(), beside.find(skin())) == ("Bake B", "Bake A")
    yield from sidebar.press("dynamorph.swap_slot")
    yield from bake()
    yield from sidebar.press(BESIDE)
    yield from until(lambda: not beside.find(skin()), "the copy to go")
    yield from sidebar.fold("DYNAMORPH_PT_compare")


# The verdict ---------------------------------------------------------------------------------------------------------


@step("Show the worst frame", picture=view)
def heat():
    measure("Verdict on the bake", found().text)
    assert found().is_believable and not found().is_too_large and found().figures
    yield from sidebar.fold("DYNAMORPH_PT_targets")  # now Details is in sight
    yield from sidebar.unfold("DYNAMORPH_PT_details")
    yield from sidebar.press("dynamorph.show_worst")
    yield from until(lambda: bpy.context.window_manager.dynamorph.heat, "the heat map")
    assert bpy.context.scene.frame_current == found().frame
    chosen = [vertex.index for vertex in skin().data.vertices if vertex.select]
    assert chosen == sorted(found().vertices)


@step("Heat Map off and on")
def heat_toggle():
    yield from driver.drawn()
    hot = driver.pixels(viewport.box)
    yield from sidebar.beside(HEAT, "dynamorph.show_worst")
    yield from sidebar.press(HEAT)
    yield from driver.drawn()
    assert differing(hot) > 0.02, "the heat map does not color the skin"
    yield from sidebar.press(HEAT)
    yield from driver.drawn()
    assert differing(hot) < 0.002
    yield from sidebar.press(HEAT)


@step("A bake that a limit holds back, one that goes too far, and the button that repairs it")
def remedy():
    far, before = displacement(), settings().targets[0].frequency
    yield from physics("bake")
    yield from properties.enter("simulation.max_displacement", f"{0.6 * far:.3f}")
    yield from close("bake")
    yield from bake()
    assert found().is_believable and displacement() < 0.8 * far and settings().targets[0].frequency == before
    settings().simulation.max_displacement = settings().simulation.max_thickness = 0.0
    settings().targets[0].bounce = 0.25 * before
    yield from bake()
    assert found().is_too_large
    yield from sidebar.press("dynamorph.stiffen")
    yield from job_done()
    assert settings().targets[0].bounce > 0.25 * before


# Presets and Amount --------------------------------------------------------------------------------------------------


@step("Cartoon, Subtle and Natural")
def presets():
    swings, feel = {}, addon("core.material.feel")
    chosen = lambda: feel.active(settings().targets[0], settings().simulation)  # noqa: E731
    for key in ("CARTOON", "SUBTLE", "NATURAL"):
        yield from sidebar.press(f"dynamorph.apply_feel(feel='{key}')")
        yield from until(lambda key=key: chosen() == key, f"the preset {key}")
        assert abs(settings().targets[0].bounce - feel.FEELS[key].frequency) < 1e-5
        yield from bake()
        swings[key] = swinging()
    assert swings["CARTOON"] > swings["NATURAL"] > swings["SUBTLE"] > 0.0, f"they swing {swings}"


@step("Amount")
def amount():
    simulation, whole = settings().simulation, wobble()
    x, row = yield from sidebar.find("simulation.amount")
    yield from driver.drag([(x + away, row) for away in range(0, 60, 10)])
    yield from until(lambda: simulation.amount > 1.1, "the slider to follow the mouse")
    for value, expected in ((0.5, 0.5), (1.0, 1.0)):
        yield from sidebar.enter("simulation.amount", str(value))
        assert simulation.amount == value
        yield from bake()
        assert abs(wobble() - expected * whole) < 0.02 * whole


@step("Delete Bake")
def delete_bake():
    yield from sidebar.press("dynamorph.delete_bake")
    yield from until(lambda: not baked(), "the bake to be freed")
    assert keys() == ["Basis", "flexed"] and wobble() == 0.0
