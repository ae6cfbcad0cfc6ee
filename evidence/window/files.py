# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from the pop-up; the bake as a file of another format; the setup saved as a file, and loaded from it."""

from __future__ import annotations

import json
import struct

import bpy
import driver
import frames
from driver import WORK, Region, Task, measure, step, until
from editors import addon, baked, close, physics, properties, select_target, settings, sidebar, skin, viewport

browser = Region("FILE_BROWSER", "WINDOW")
options = Region("FILE_BROWSER", "TOOL_PROPS")
SETUP, GLB = WORK / "arm.json", WORK / "arm.glb"
EXPORT = 39  # pixels: the middle of its menu, from the top of the header
PRESETS = {sidebar: 67, properties: 47}  # pixels: the button of presets in a header, from the right of the region
OPTIONS = {"format": 15, "clips": 41}  # pixels: the middles of the export's drop-downs, from the top of their region


@step("A measured material")
def material():
    yield from select_target(1)
    yield from sidebar.fold("DYNAMORPH_PT_targets")
    yield from driver.drawn()  # its properties have come
    button = yield from open_materials()
    yield from arrows(button, "DOWN_ARROW", 2)  # the second of the list
    yield from driver.tap("RET", button)
    _, second, *_ = addon("core.material.presets").PRESETS.values()
    yield from until(lambda: settings().active_target.stiffness == second.material.stiffness, "the material")
    yield from driver.tap("ESC", button)
    yield from driver.rest()


def open_materials():
    """The pop-up; returns where its button is."""
    return (yield from open_presets(sidebar, "DYNAMORPH_PT_material"))


def open_presets(region, panel: str):
    """The pop-up at the right end of a section's header, whose button has no name that could be looked for."""
    yield from region.fold(panel)
    _, row = yield from region.unfold(panel)
    x, _, width, _ = region.box
    button = (x + width - PRESETS[region], row - 4)  # a header is met near its top
    yield from driver.pop_up(button, f"{panel}_presets")
    return button


def arrows(position, key: str, count: int):
    for _ in range(count):
        yield from driver.tap(key, position)
        yield 0.1
    yield from driver.drawn()


@step("Export the bake as glTF")
def export():
    GLB.unlink(missing_ok=True)
    task = Task("the bake as glTF", 2)
    yield from choose_file(sidebar.press("dynamorph.export"), "dynamorph.export", GLB)
    task.done()
    yield from until(GLB.exists, "the file")
    data = GLB.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)  # of the JSON in it, after two headers
    document = json.loads(data[20 : 20 + length])
    (mesh,) = document["meshes"]
    assert len(mesh["primitives"][0]["targets"]) >= len(baked()) > 0 and len(document["animations"]) == 1
    measure("Arm as glTF", f"{len(data) / 1e6:.1f} MB")
    yield from driver.tap("ESC", viewport.middle)  # close what the export says, which lies over the sidebar


@step("Export of other formats")
def export_others():
    yield from choose_file(export_menu(), "dynamorph.export", GLB, choose_options())


def export_menu(operator="dynamorph.export", across=0.45):
    """Choose glTF by its letter in a menu below the header of Export, which has no name that could be looked for."""
    yield from physics()
    yield from close("export")
    _, row = yield from properties.unfold("DYNAMORPH_PT_export")
    x, _, width, _ = properties.box
    menu = (x + width * across, row - EXPORT)
    yield from driver.drop_down(menu, f"{operator}.format")
    yield from driver.tap("G", menu)


def choose_options():
    """Each drop-down of the export, in the file browser; they have no names either."""
    x, y, width, height = options.box
    for name, below in OPTIONS.items():
        asked = browser.area.spaces.active.active_operator.properties
        yield from driver.choose_other((x + width * 0.75, y + height - below), asked, name)


@step("File > Export > Soft Skin")
def export_from_file_menu():
    """The entry is the last of the menu."""
    clip = WORK / "clip.glb"
    clip.unlink(missing_ok=True)
    yield from choose_file(file_menu(), "dynamorph.export", clip)
    yield from until(clip.exists, "the file")
    yield from driver.tap("ESC", viewport.middle)


def file_menu():
    yield from driver.move(viewport.middle)
    with viewport.context():
        bpy.ops.wm.call_menu("INVOKE_DEFAULT", name="TOPBAR_MT_file_export")
    yield from driver.drawn()
    driver.photograph("opened_TOPBAR_MT_file_export")
    yield from arrows(viewport.middle, "UP_ARROW", 1)
    yield from driver.tap("RET", viewport.middle)


@step("Export Check")
def export_check():
    loses = skin().modifiers.new("Smooth", "SMOOTH")  # not by hand
    yield from driver.drawn()
    with frames.timed(addon("ui.operators.export"), "draw_losses") as drawn:
        yield from export_menu("dynamorph.export_check", 0.91)
        yield from until(lambda: drawn, "what the format leaves out")
    driver.opened.add("dynamorph.export_check")
    yield from driver.drawn()
    driver.photograph("opened_dynamorph.export_check")
    yield from driver.tap("ESC", sidebar.middle)
    skin().modifiers.remove(loses)
    yield from close("export")


@step("Save Setup")
def save_setup():
    yield from sidebar.press("dynamorph.delete_bake")
    yield from until(lambda: not baked(), "the bake to be freed")
    yield from physics("setup")
    SETUP.unlink(missing_ok=True)
    yield from choose_file(properties.press("dynamorph.save_setup"), "dynamorph.save_setup", SETUP)
    yield from until(SETUP.exists, "the file")
    assert len(json.loads(SETUP.read_text())["targets"]) == len(settings().targets)


@step("Load Setup")
def load_setup():
    target = settings().targets[1]
    stiffness = target.stiffness
    target.stiffness = 4 * stiffness
    yield from choose_file(properties.press("dynamorph.load_setup"), "dynamorph.load_setup", SETUP)
    yield from until(lambda: settings().targets[1].stiffness == stiffness, "the setup of the file")


@step("Drop a setup, and another JSON file")
def drop_setup():
    target = settings().targets[1]
    stiffness = target.stiffness
    target.stiffness = 4 * stiffness
    bpy.ops.ed.undo_push(message="Another stiffness")
    other = WORK / "other.json"
    other.write_text('{"format": "scene"}')
    yield from drop(other)
    driver.photograph("dropped_another_json")
    yield from driver.tap("ESC", viewport.middle)  # close what it says
    assert settings().targets[1].stiffness == 4 * stiffness, "a file that is no setup was applied"
    yield from drop(SETUP)
    yield from until(lambda: settings().targets[1].stiffness == stiffness, "the setup that was dropped")
    yield from viewport.key("Z", ctrl=True)
    yield from until(lambda: settings().targets[1].stiffness == 4 * stiffness, "the drop to be undone")
    yield from drop(SETUP)
    yield from until(lambda: settings().targets[1].stiffness == stiffness, "the setup again")


def drop(path):
    """Events cannot drop files: this calls what Blender calls then, with an undo step."""
    yield from driver.move(viewport.middle)
    driver.actions += 1
    with viewport.context():
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", True, directory=str(path.parent), files=[{"name": path.name}])
    yield from driver.drawn()


def choose_file(opening, operator: str, path, within=()):
    """Open the file browser of an operator by a generator, and choose a file in it; within: what to do there first."""
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"  # nobody is here to manage another window
    yield from opening
    opened = lambda: any(area.type == "FILE_BROWSER" for area in driver.window().screen.areas)  # noqa: E731
    yield from until(lambda: opened() and browser.area.spaces.active.params, "the file browser")
    yield from driver.drawn()
    driver.photograph(f"opened_{operator}")
    yield from within
    chosen = browser.area.spaces.active.params
    chosen.directory = str(path.parent).encode()
    chosen.filename = path.name
    yield from driver.drawn()
    yield from browser.key("RET")
    yield from until(lambda: not opened(), "the file browser to close")
    yield from driver.drawn()
