# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of docs/command_line.md and docs/scripting.md: options, operators and properties of the extension.

python evidence/reference.py     writes them again, below what is written by hand

It needs Blender's module of VERSION, the extension on the path, and the compiled engine.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
from collections.abc import Iterable, Iterator
from types import ModuleType

from project import ROOT

import bpy

VERSION = (5, 2)  # of Blender
SAMPLE = ROOT / "sample_blends" / "bulging_cylinder.blend"
MARK = "<!-- evidence/reference.py makes what follows. -->\n"
# Modules of operators, in the order of the page.
FAMILIES = {
    "setup": "The soft skin",
    "jobs": "Build and bake",
    "bake_options": "The dialog of a bake",
    "targets": "Targets",
    "poses": "Poses of targets",
    "channels": "Channels of targets",
    "sculpting": "Sculpting",
    "feel": "Feel and verdict",
    "materials": "Materials",
    "painting": "Painted maps",
    "attachments": "Attachments",
    "collision": "Collision",
    "playback": "Live and previews",
    "grips": "Grips and recorded drags",
    "compare": "Comparisons",
    "weights": "Target weights",
    "export": "Export",
    "transfer": "Setups",
}
UNITS = {"LENGTH": "Blender units", "ROTATION": "radians", "MASS": "kg", "TIME_ABSOLUTE": "s", "FREQUENCY": "Hz"}
# Where the groups of settings are, by class.
SETTINGS = {
    "DynamorphSettings": "obj.dynamorph",
    "DynamorphTarget": "obj.dynamorph.targets[i]",
    "DynamorphChannel": "obj.dynamorph.channels[i]",
    "DynamorphGrip": "obj.dynamorph.grips[i]",
    "DynamorphPart": "obj.dynamorph.parts[name]",
    "DynamorphModel": "obj.dynamorph.model",
    "DynamorphSimulation": "obj.dynamorph.simulation",
    "DynamorphCollision": "obj.dynamorph.collision",
    "DynamorphOutput": "obj.dynamorph.output",
    "DynamorphMode": "obj.dynamorph.modes[i]",
    "DynamorphAttachment": "obj.dynamorph.attachments[i]",
    "DynamorphDisplay": "bpy.context.window_manager.dynamorph",
    "DynamorphPreferences": "bpy.context.preferences.addons[package].preferences",
}
# Where the groups are, below `obj.dynamorph`, in which the extension records something.
RECORDED = {
    "DynamorphSettings": "",
    "DynamorphTarget": "targets[i].",
    "DynamorphModel": "model.",
    "DynamorphSimulation": "simulation.",
    "DynamorphBake": "bake.",
    "DynamorphLive": "live.",
    "DynamorphSculpt": "sculpt.",
}


def part(name: str) -> ModuleType:
    """A module of the extension, under the name that Blender has registered it with."""
    package = bpy.types.DYNAMORPH_OT_bake.__module__.partition(".ui.")[0]
    return importlib.import_module(f"{package}.{name}")


# Text ----------------------------------------------------------------------------------------------------------------


def table(head: tuple[str, ...], rows: Iterable[Iterable[str]]) -> str:
    lines = [head, ["---" for _ in head], *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def sentence(text: str) -> str:
    """With a capital and a period, as tooltips and helps have none."""
    text = " ".join(text.split())
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', ')')) else '.'}" if text else ""


def number(value: float) -> str:
    return f"{value:.6g}"


def limits(prop: bpy.types.Property) -> str:
    """Which numbers a property takes, with their unit."""
    unit = UNITS.get(prop.unit, "") or UNITS.get(prop.subtype, "")
    low, high = (value if abs(value) < 2e9 else None for value in (prop.hard_min, prop.hard_max))
    if low is None:
        text = "" if high is None else f"up to {number(high)}"
    else:
        text = f"{number(low)} or more" if high is None else f"{number(low)} to {number(high)}"
    return " ".join(filter(None, (text, unit))) or {"INT": "a whole number", "FLOAT": "a number"}[prop.type]


# The command line ----------------------------------------------------------------------------------------------------


def command_line() -> str:
    """The commands, the options that several have, and the settings."""
    root = part("cli.main").parser(opens_file=True)
    (subparsers,) = (each for each in root._actions if isinstance(each, argparse._SubParsersAction))
    texts = {each.dest: each.help or "" for each in subparsers._choices_actions}
    options = {}  # by what tells them from others: -o of two commands is two options
    owners: dict[str, list[str]] = {}
    for name, parser in subparsers.choices.items():
        for option in _options(parser):
            options.setdefault(f"{_name(option)}: {option.help}", option)
            owners.setdefault(f"{_name(option)}: {option.help}", []).append(name)
    several = {key for key, names in owners.items() if len(names) > 1 and not _setting(options[key])}
    parts = ["\n## Commands\n"]
    for name, parser in subparsers.choices.items():
        parts.append(f"\n### {name}\n\n{sentence(texts[name])}\n\n```\n{_example(name)}\n```\n")
        found = {key: option for key, option in options.items() if name in owners[key]}
        if own := [option for key, option in found.items() if key not in several and not _setting(option)]:
            parts.append("\n" + table(("Option", "Meaning"), (row for option in own for row in _rows(option))))
        also = [f"`{_name(found[key])}`" for key in found if key in several]
        also += dict.fromkeys(
            f"[{group} settings](#{group}-settings)" for group in map(_part_of, found.values()) if group
        )
        rules = [f"Also: {', '.join(also)}.", *_rules(parser)]
        parts.append(f"\n{' '.join(rules)}\n")
    parts.append("\n## Options of several commands\n\n")
    shared = ((cell, text, ", ".join(owners[key])) for key in options if key in several
              for cell, text in _rows(options[key]))  # fmt: skip
    parts.append(table(("Option", "Meaning", "Commands"), shared))
    for group in _setting_groups():
        found = {key: option for key, option in options.items() if _part_of(option) == group}
        names = " and ".join(f"`{name}`" for name in owners[next(iter(found))])
        parts.append(f"\n## {group.capitalize()} settings\n\nOptions of {names}; in a script, properties of ")
        parts.append(f"`obj.dynamorph.{group}`.\n\n")
        rows = (row for option in found.values() for row in _setting_rows(option))
        parts.append(table(("Option", "In the interface", "Values", "Default", "Meaning"), rows))
    parts.append("\n## Target properties\n\nWhat `--set TARGET.PROPERTY=VALUE` sets.\n\n")
    known = _property_group("DynamorphTarget").bl_rna.properties
    rows = (row for name in part("cli.commands").SETTABLE for row in _property_rows(known[name]))
    return "".join([*parts, table(("Property", "In the interface", "Values", "Default", "Meaning"), rows)])


def _options(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return [each for each in parser._actions if not isinstance(each, argparse._HelpAction)]


def _name(option: argparse.Action) -> str:
    return next((each for each in option.option_strings if each.startswith("--")), "") or option.dest.upper()


def _example(command: str) -> str:
    return part("cli.help").epilog(command, True).split("\n")[1].strip()


def _rules(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Which options must be given, and which exclude each other."""
    for group in parser._mutually_exclusive_groups:
        names = " and ".join(f"`{_name(option)}`" for option in group._group_actions)
        yield f"One of {names} is required." if group.required else f"{names} exclude each other."
    for option in _options(parser):
        if option.required and option.option_strings:
            yield f"`{_name(option)}` is required."


def _setting_groups() -> dict[str, tuple[str, ...]]:
    """The settings that are options, by the group of properties."""
    return part("cli.commands").SETTINGS


def _part_of(option: argparse.Action) -> str:
    """The group whose property an option sets, or ''."""
    return next((group for group, names in _setting_groups().items() if option.dest in names), "")


def _setting(option: argparse.Action) -> bpy.types.Property | None:
    """The property that an option sets."""
    group = _part_of(option)
    return _group(group)[option.dest] if group else None


def _group(name: str) -> bpy.types.bpy_prop_collection:
    """The properties of `obj.dynamorph.<name>`."""
    return bpy.types.Object.bl_rna.properties["dynamorph"].fixed_type.properties[name].fixed_type.properties


def _meanings(option: argparse.Action) -> dict[str, tuple[str, str]]:
    """Name in the interface and meaning of the values of an option."""
    if option.dest == "format":
        files = {key: (each.label, each.description) for key, each in part("write.export.exports").FORMATS.items()}
        return _lower(_items(_group("output")["format"]) | files)
    if option.dest == "clips":
        return _lower(_items(bpy.ops.dynamorph.export.get_rna_type().properties["clips"]))
    return {}


def _lower(items: dict) -> dict:
    return {name.lower(): meaning for name, meaning in items.items()}


def _items(prop: bpy.types.Property) -> dict[str, tuple[str, str]]:
    """Name and meaning of the values of an enum; nothing for other properties."""
    return {item.identifier: (item.name, item.description) for item in getattr(prop, "enum_items", ())}


def _rows(option: argparse.Action) -> Iterator[tuple[str, str]]:
    """The rows of an option, and of its values."""
    names, meanings = option.option_strings, _meanings(option)
    shown = names or [_name(option)]
    if names and option.nargs != 0 and not isinstance(option, argparse.BooleanOptionalAction):
        value = " ".join(option.metavar) if isinstance(option.metavar, tuple) else option.metavar or option.dest.upper()
        if option.choices and not meanings and not option.metavar:
            value = f"{{{','.join(option.choices)}}}"
        shown = [f"{name} {value}{' ...' if option.nargs == '+' else ''}" for name in names]
    yield ", ".join(f"`{each}`" for each in shown), sentence((option.help or "") % {"default": option.default})
    for value, (label, meaning) in meanings.items():
        yield f"`{names[-1]} {value}`", f"*{label}*: {sentence(meaning)}"


def _setting_rows(option: argparse.Action) -> Iterator[tuple[str, ...]]:
    prop, names = _setting(option), ", ".join(f"`{name}`" for name in option.option_strings)
    if prop.type == "ENUM":
        values, default = "", f"`{prop.default.lower()}`"
    elif prop.type == "BOOLEAN":
        values, default = "", "on" if prop.default else "off"
    else:
        values, default = limits(prop), number(prop.default)
    yield names, prop.name, values, default, sentence(prop.description)
    for value, (label, meaning) in _lower(_items(prop)).items():
        yield f"`{_name(option)} {value}`", label, "", "", sentence(meaning)


# Scripting in Blender ------------------------------------------------------------------------------------------------


def scripting() -> str:
    """The operators, the settings, and what the extension records."""
    needed = needs()
    families: dict[str, list] = {}
    for name in operators():
        families.setdefault(_class(name).__module__.rpartition(".")[2], []).append(name)
    parts = ["\n## Operators\n\n", OPERATORS]
    for family, title in FAMILIES.items():
        rows = (row for name in families.pop(family) for row in _operator_rows(name, needed[name]))
        parts.append(f"\n### {title}\n\n" + table(("Operator", "In the interface", "What it does", "Needs"), rows))
    if families:
        raise KeyError(f"FAMILIES lacks {list(families)}")
    parts += ["\n## Settings\n\n", PROPERTIES]
    head = "Property", "In the interface", "Values", "Default", "Meaning"
    for name, path in SETTINGS.items():
        group = _property_group(name)
        rows = (row for prop in _properties(group, True) for row in _property_rows(prop))
        parts.append(f"\n### `{path}`\n\n" + table(head, rows))
    parts += ["\n## Records\n\n", KEPT, table(("Property", "Meaning"), _record_rows())]
    return "".join(parts)


OPERATORS = """\
All operators are in `bpy.ops.dynamorph`. They work on the active object, or on the soft skin of the active armature.
*Needs* says what that object must have. Without it, `poll()` returns `False` and a call raises `RuntimeError`. A text
in quotes is what Blender reports on an operator that needs something else. Below each operator (in bold) are its
keyword arguments with their defaults, and the values of enums. Operators that only the interface calls are left out.
"""
PROPERTIES = """\
`obj` is the mesh object. An enum takes one of the identifiers in quotes below it. A property without a default follows
from others and from the built model. Lengths are in Blender units, angles in radians.
"""
KEPT = """\
The extension writes these properties itself. You can read them, but do not write them. They may change in any version.

"""


def operators() -> list[str]:
    """The names of the operators that a script has use for."""
    names = dir(bpy.ops.dynamorph)
    return [name for name in names if "INTERNAL" not in getattr(_class(name), "bl_options", ())]


def _class(operator: str) -> type:
    return getattr(bpy.types, f"DYNAMORPH_OT_{operator}")


def needs() -> dict[str, str]:
    """What each operator needs: the first state of a character in which it can be called, or else what it says."""
    found: dict[str, str] = {}
    for state in _states():
        for name in operators():
            if getattr(bpy.ops.dynamorph, name).poll():
                found.setdefault(name, state)
    for name in operators():
        if name not in found:
            found[name] = f"“{_class(name).disabled_reason(bpy.context)}”"
    return found


def _states() -> Iterator[str]:
    """Bring the sample from a mesh to a bake, one step after the other, and name what it has then."""
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLE))
    obj = bpy.data.objects["Limb"]
    layer = bpy.context.view_layer
    layer.objects.active = obj
    bpy.ops.dynamorph.remove_soft_skin()
    layer.objects.active = None
    yield ""
    layer.objects.active = obj
    yield "a mesh with an armature"
    bpy.ops.dynamorph.add_soft_skin()
    obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = 100, 8
    bpy.context.scene.frame_end = 10
    yield "a soft skin"
    bpy.context.scene.frame_set(50)  # where it is bent
    bpy.ops.dynamorph.add_target(key="Flexed")
    yield "a selected target"
    bpy.ops.dynamorph.build()
    yield "a model"
    bpy.ops.dynamorph.bake()
    yield "a bake"


def _operator_rows(name: str, needed: str) -> Iterator[tuple[str, ...]]:
    described = getattr(bpy.ops.dynamorph, name).get_rna_type()
    yield f"**`{name}`**", described.name, sentence(described.description), needed
    for prop in described.properties:
        if prop.identifier == "rna_type" or prop.is_hidden:
            continue
        yield f"`{prop.identifier}={_default(prop)}`", prop.name, sentence(prop.description), ""
        for value, (label, meaning) in _items(prop).items():
            is_source = len(meaning) > 200  # of a material, which docs/materials.md has
            yield f"`{value!r}`", label, "" if is_source else sentence(meaning), ""


def _default(prop: bpy.types.Property) -> str:
    """As Python writes it."""
    if prop.type in ("INT", "FLOAT"):
        return number(prop.default)
    return "None" if prop.type == "POINTER" else repr(prop.default)


def _property_group(name: str) -> type:
    """A class of the extension."""
    return getattr(
        part("preferences" if name == "DynamorphPreferences" else "scene.properties.object_properties"), name
    )


def _properties(group: type, settings: bool) -> list[bpy.types.Property]:
    """The properties of a group: settings, or what the extension records. Settings are what a setup has, which entry of
    a list is active, pointers that can be chosen, and numbers that follow from others but can be set.
    """
    declared = (inspect.get_annotations(base, eval_str=True).items() for base in group.__mro__)
    given = {name: each.keywords for pairs in declared for name, each in pairs if hasattr(each, "keywords")}
    results = part("write.authoring.setups").NOT_AUTHORED.get(group, ())

    def is_setting(prop: bpy.types.Property) -> bool:
        if {"set", "poll"} & given[prop.identifier].keys() or prop.identifier.startswith("active_"):
            return True
        if prop.type == "POINTER":
            return prop.fixed_type.identifier == "Collection"
        computed = prop.is_hidden or prop.is_skip_save or prop.identifier in results
        return not (computed or prop.type == "COLLECTION" or getattr(prop, "is_array", False))

    return [prop for prop in group.bl_rna.properties if prop.identifier in given and is_setting(prop) == settings]


def _property_rows(prop: bpy.types.Property) -> Iterator[tuple[str, ...]]:
    """The rows of a property, and of its values."""
    if prop.type == "POINTER":
        values = prop.fixed_type.name.lower()
    else:
        values = limits(prop) if prop.type in ("INT", "FLOAT") else "text" if prop.type == "STRING" else ""
    default = "" if prop.is_skip_save else f"`{_default(prop)}`"
    yield f"`{prop.identifier}`", prop.name, values, default, sentence(prop.description)
    for value, (label, meaning) in _items(prop).items():
        yield f"`{value!r}`", label, "", "", sentence(meaning)


def _record_rows() -> Iterator[tuple[str, str]]:
    for name, path in RECORDED.items():
        group = _property_group(name)
        found = _properties(group, False) if name in SETTINGS else group.bl_rna.properties
        for prop in found:
            inner = prop.fixed_type.identifier if prop.type in ("POINTER", "COLLECTION") else ""
            if prop.identifier not in ("rna_type", "name") and inner not in (*SETTINGS, *RECORDED):
                yield f"`{path}{prop.identifier}`", sentence(prop.description)


# Pages ---------------------------------------------------------------------------------------------------------------

PAGES = {"command_line.md": command_line, "scripting.md": scripting}


def renewed(name: str) -> str:
    """A page with its tables as they should be."""
    by_hand, mark, _ = (ROOT / "docs" / name).read_text(encoding="utf-8").partition(MARK)
    if not mark:
        raise ValueError(f"docs/{name} has no line {MARK!r}")
    return by_hand + mark + PAGES[name]()


def main() -> None:
    import dynamic_morph_targets

    if bpy.app.version[:2] != VERSION:
        sys.exit(f"reference: the pages are made with Blender {'.'.join(map(str, VERSION))}")
    dynamic_morph_targets.register()
    for name in PAGES:
        (ROOT / "docs" / name).write_text(renewed(name), encoding="utf-8")


if __name__ == "__main__":
    main()
