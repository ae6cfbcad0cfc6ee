# SPDX-License-Identifier: GPL-3.0-or-later
"""Dialogs, presets of one's own, copies, and where else the extension shows: below Shape Keys and in Preferences."""

from __future__ import annotations

from pathlib import Path

import bpy
import driver
from driver import ASIDE, Task, step, until
from editors import ADDON, close, from_menu, job_done, physics, properties, select_target, settings, sidebar, skin, view
from files import arrows, open_materials, open_presets


@step("Fit Bounce, and what a region can be")
def fit():
    yield from select_target(1)
    yield from sidebar.press("dynamorph.build")
    yield from job_done()
    yield from sidebar.look_into("targets[1].region")
    yield from sidebar.fold("DYNAMORPH_PT_targets")
    yield from sidebar.unfold("DYNAMORPH_PT_material")
    yield from sidebar.pop_up("dynamorph.fit_material")
    yield from sidebar.key("RET")
    yield from job_done()


# Presets -------------------------------------------------------------------------------------------------------------


def preset_file(kind: str) -> Path:
    folder = bpy.utils.user_resource("SCRIPTS", path=f"presets/dynamorph/{kind}")
    return Path(folder, "New_Preset.py")


def save_choose_and_remove(opening, kind: str, change, is_as_saved):
    """In a pop-up of presets, whose last buttons are: the preset, its removal, the name of another, its addition."""
    saved = preset_file(kind)
    button = yield from opening()
    yield from arrows(button, "UP_ARROW", 1)
    yield from driver.tap("RET", button)
    yield from until(saved.exists, "the file of the preset")
    yield from driver.tap("ESC", button)
    change()
    assert not is_as_saved()
    button = yield from opening()
    yield from arrows(button, "UP_ARROW", 4)
    yield from driver.tap("RET", button)
    yield from until(is_as_saved, "the settings of the preset")
    yield from driver.tap("ESC", button)
    button = yield from opening()
    yield from arrows(button, "UP_ARROW", 3)
    yield from driver.tap("RET", button)
    yield from until(lambda: not saved.exists(), "the file of the preset to be removed")
    yield from driver.tap("ESC", button)
    yield from driver.rest()


@step("A material saved as a preset")
def material_preset():
    target = settings().active_target
    stiffness = target.stiffness

    def change():
        target.stiffness = 2.0 * stiffness

    yield from save_choose_and_remove(open_materials, "material", change, lambda: target.stiffness == stiffness)


@step("A setup saved as a preset")
def setup_preset():
    yield from physics()
    model = settings().model
    modes = model.modes

    def change():
        model.modes = modes + 1

    yield from save_choose_and_remove(open_setups, "setup", change, lambda: model.modes == modes)


def open_setups():
    """The pop-up; returns where its button is."""
    return (yield from open_presets(properties, "DYNAMORPH_PT_setup"))


# Copies, and other places --------------------------------------------------------------------------------------------


@step("Copy to Selected, which asks")
def copy_to_selected():
    body = skin()
    other = add_a_copy()  # not by hand
    yield from driver.drawn()
    yield from properties.pop_up("dynamorph.copy_to_selected")
    yield from sidebar.key("RET")
    names = [target.name for target in body.dynamorph.targets]
    yield from until(lambda: [target.name for target in other.dynamorph.targets] == names, "the copy")
    bpy.data.objects.remove(other)
    yield from close("setup")


def add_a_copy():
    """A second mesh on the armature, with the same shape keys: those would be overwritten."""
    other = skin().copy()
    other.data = skin().data.copy()
    other.name = "Copy"
    other.dynamorph.targets.clear()
    bpy.context.scene.collection.objects.link(other)
    other.select_set(True)
    return other


@step("The panel below Shape Keys")
def object_data():
    properties.area.spaces.active.context = "DATA"
    skin().active_shape_key_index = 1
    yield from driver.drawn()
    _, row = yield from properties.find("relative_key")
    x = properties.box[0] + ASIDE
    for header in range(int(row) - 16, int(row) - 80, -8):
        yield from driver.click((x, header))
        yield from driver.drawn()
        if "DYNAMORPH_PT_object_data" in driver.opened:
            break
    driver.photograph("opened_DYNAMORPH_PT_object_data")
    yield from driver.click((x, header))


@step("A slider that flexes without a bone")
def add_channel():
    """By the menu of a slider of Blender's: here a shape key's value, in the Data tab."""
    yield from select_target(1)
    task = Task("a slider that flexes without a bone", 2)
    value = yield from properties.find('key_blocks["flexed"].value')
    yield from driver.move(value)
    yield from driver.tap("RIGHTMOUSE", value)
    yield from driver.drawn()
    driver.photograph("menu_of_a_slider")
    yield from arrows(value, "UP_ARROW", 1)  # the last entry
    yield from driver.tap("RET", value)
    target = settings().targets[1]
    yield from until(lambda: target.channel == "flexed", "the channel")
    task.done()
    skin().data.shape_keys.key_blocks["flexed"].value = 0.5
    yield from until(lambda: settings().channels[0].value == 0.5, "the slider to follow")
    yield from sidebar.find("channels[0].value")
    yield from sidebar.find("targets[1].reached_at")
    driver.photograph("opened_channel")
    skin().data.shape_keys.key_blocks["flexed"].value = 0.0
    yield from sidebar.press("dynamorph.remove_channel")
    yield from until(lambda: not settings().channels, "the channel to be removed")


@step("Add Tension")
def add_tension():
    yield from from_menu("DOWN_ARROW", "DOWN_ARROW")
    yield from until(lambda: len(settings().channels) == 1, "the slider")
    yield from sidebar.find("channels[0].value")
    yield from sidebar.press("dynamorph.remove_target")
    yield from until(lambda: not settings().channels, "the target to be removed")
    skin().shape_key_remove(skin().data.shape_keys.key_blocks["Tension"])
    yield from sidebar.fold("DYNAMORPH_PT_targets")


@step("The extension's preferences")
def preferences():
    area = view.area
    area.type = "PREFERENCES"
    try:
        bpy.context.preferences.active_section = "ADDONS"
        bpy.context.window_manager.addon_search = "Dynamorph"
        bpy.ops.preferences.addon_expand(module=ADDON)
        yield from driver.drawn()
        yield from until(lambda: "DynamorphPreferences" in driver.opened, "the preferences")
        driver.photograph("opened_DynamorphPreferences")
    finally:
        area.type = "VIEW_3D"
    yield from driver.drawn()


@step("The interface at a scale of 1.5")
def scaled():
    """Pictures of the sidebar and of the Physics tab, for the eye: a cut-off label has three dots."""
    preferences = bpy.context.preferences.view
    yield from physics()
    preferences.ui_scale = 1.5
    try:
        yield from driver.drawn(passes=8)
        for name, region in (("sidebar", sidebar), ("physics", properties)):
            driver.photograph(f"scale_1.5_{name}", region.box)
    finally:
        preferences.ui_scale = 1.0
    yield from driver.drawn(passes=8)


@step("The interface in German")
def german():
    preferences = bpy.context.preferences.view
    before = preferences.language
    preferences.language = "de_DE"
    try:
        assert bpy.app.translations.pgettext_iface("Build Model", "Operator") == "Modell aufbauen"
        hold = settings().model.bl_rna.properties["hold"]
        assert bpy.app.translations.pgettext_iface(hold.name, hold.translation_context) == "Halt"
        yield from driver.drawn()
        driver.photograph("german", sidebar.box)
    finally:
        preferences.language = before
    yield from driver.drawn()
