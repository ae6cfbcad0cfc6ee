# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/panels has every setting that a panel shows, by its name there and with its default."""

import math
import re
from pathlib import Path

import bpy
from builders import activate
from layout import controls

PAGES = Path(__file__).parents[3] / "docs" / "panels"
PANELS = ("DYNAMORPH_PT_sidebar", "DYNAMORPH_PT_physics")
# The pages name no default of these: the preset of Feel sets them, or a build measures them.
OPEN = {"Bounce", "Mass", "Mass Damping", "Settle Time", "Stiffness", "Stiffness Damping"}
SETTING = re.compile(r"^\| ([^|]+) \| [^|]+ \| ?([^|]*?) ?\|$", re.MULTILINE)


def described() -> dict[str, set[str]]:
    """The settings in the tables of all pages, each with the defaults that they name."""
    found: dict[str, set[str]] = {}
    for page in PAGES.glob("*.md"):
        for name, default in SETTING.findall(page.read_text(encoding="utf-8")):
            found.setdefault(name, set()).add(default)
    return found


def settings_of(obj) -> set:
    """What the panels show of a soft skin: RNA properties of the add-on's own groups."""
    names = {name for panel in PANELS for name in controls(obj, panel) if re.match(r"Dynamorph\w*\.", name)}
    registered = bpy.types.PropertyGroup.bl_rna_get_subclass_py  # others of these names may be left by other tests
    return {registered(group).bl_rna.properties[name] for group, name in (each.split(".") for each in names)}


def all_settings(soft_arm) -> set:
    """Those of every state in which a panel shows others."""
    settings = soft_arm.dynamorph
    found = settings_of(soft_arm)
    settings.active_target_index = 1
    settings.simulation.use_scene_range = False
    settings.grips.add()
    settings.collision.use = settings.collision.use_friction = True
    bpy.ops.object.effector_add(type="WIND")
    settings.attachments.add()
    activate(soft_arm)
    return found | settings_of(soft_arm)


def as_written(setting) -> str:
    """A default as the pages write it."""
    if setting.type == "BOOLEAN":
        return "on" if setting.default else "off"
    if setting.type == "ENUM":
        return setting.enum_items[setting.default].name
    return f"{math.degrees(setting.default):g} °" if setting.subtype == "ANGLE" else f"{setting.default:g}"


def test_every_setting_is_described(soft_arm):
    missing = {setting.name for setting in all_settings(soft_arm)} - described().keys()
    assert not missing


def test_defaults_are_those_of_the_add_on(soft_arm):
    defaults: dict[str, set[str]] = {}
    for setting in all_settings(soft_arm):
        empty = setting.type in ("POINTER", "STRING") or setting.name in OPEN
        defaults.setdefault(setting.name, set()).add("" if empty else as_written(setting))
    assert {name: written for name, written in described().items() if name in defaults} == defaults
