# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from the pop-up; the setup saved as a file, and loaded from it."""

from __future__ import annotations

import json

import bpy
import driver
from driver import WORK, Region, step, until
from editors import addon, baked, select_target, settings, sidebar

browser = Region("FILE_BROWSER", "WINDOW")
SETUP = WORK / "arm.json"
sections = {}  # that a later step closes


@step("A measured material")
def material():
    yield from sidebar.unfold("dynamorph.new_from_pose", above="dynamorph.build")
    yield from select_target(1)
    yield from driver.drawn()  # its properties have come
    x, y, width, _ = sidebar.box
    _, row = yield from sidebar.find("dynamorph.fit_material")
    button = (x + width * 0.3, row)
    yield from driver.click(button)
    for _ in range(2):  # the second of the list
        yield from driver.tap("DOWN_ARROW", button)
        yield 0.1
    yield from driver.drawn()
    driver.photograph("material", (x - 80, int(row) - 20, width + 60, 400))
    driver.result["pictures"].append("material")
    yield from driver.tap("RET", button)
    _, second, *_ = addon("materials").PRESETS.values()
    yield from until(lambda: settings().active_target.stiffness == second.material.stiffness, "the material")
    yield from driver.tap("ESC", button)
    yield from driver.rest()


@step("Save Setup")
def save_setup():
    yield from sidebar.press("dynamorph.free_bake")
    yield from until(lambda: not baked(), "the bake to be freed")
    yield from sidebar.fold("dynamorph.new_from_pose")
    sections["setup"] = yield from sidebar.unfold_last("dynamorph.save_setup", below="dynamorph.bake_all")
    yield from sections["setup"].keep("setup")
    SETUP.unlink(missing_ok=True)
    yield from choose_file("dynamorph.save_setup")
    yield from until(SETUP.exists, "the file")
    assert len(json.loads(SETUP.read_text())["targets"]) == len(settings().targets)


@step("Load Setup")
def load_setup():
    target = settings().targets[1]
    stiffness = target.stiffness
    target.stiffness = 4 * stiffness
    yield from choose_file("dynamorph.load_setup")
    yield from until(lambda: settings().targets[1].stiffness == stiffness, "the setup of the file")
    yield from sections["setup"].fold()
    yield from sidebar.unfold("dynamorph.new_from_pose", above="dynamorph.build")


def choose_file(button: str):
    """Press a button, and choose SETUP in the file browser that it opens."""
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"  # nobody is here to manage another window
    yield from sidebar.press(button)
    opened = lambda: any(area.type == "FILE_BROWSER" for area in driver.window().screen.areas)  # noqa: E731
    yield from until(lambda: opened() and browser.area.spaces.active.params, "the file browser")
    chosen = browser.area.spaces.active.params
    chosen.directory = str(SETUP.parent).encode()
    chosen.filename = SETUP.name
    yield from driver.drawn()
    yield from browser.key("RET")
    yield from until(lambda: not opened(), "the file browser to close")
    yield from driver.drawn()
