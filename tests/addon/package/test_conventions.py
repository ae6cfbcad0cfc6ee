# SPDX-License-Identifier: GPL-3.0-or-later
"""What the whole interface has in common: names, descriptions, texts that can be translated. What all tests have."""

import ast
import inspect
import types
from pathlib import Path

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets import preferences as preferences_module
from bl_ext.user_default.dynamic_morph_targets.core import engine
from bl_ext.user_default.dynamic_morph_targets.ui.operators import transfer
from installed import MODULE, PACKAGE
from layout import Layout


def ours(*kinds):
    """The registered classes of the add-on of these kinds, whichever module they are in."""
    found, pending = set(), list(kinds)
    while pending:
        for kind in pending.pop().__subclasses__():
            pending.append(kind)
            if kind.__module__.startswith(MODULE) and getattr(kind, "is_registered", False):
                found.add(kind)
    return sorted(found, key=lambda kind: kind.__name__)


def rna(kind):
    """Blender's description of a class; for an operator it is not in the class itself."""
    if not issubclass(kind, bpy.types.Operator):
        return kind.bl_rna
    module, name = kind.bl_idname.split(".")
    return getattr(getattr(bpy.ops, module), name).get_rna_type()


def own_properties(kind):
    """The properties of a class, without those that come from Blender's own classes."""
    foreign = [base for base in kind.__mro__ if not base.__module__.startswith(MODULE)]
    inherited = {"rna_type", "name"}.union(*map(inspect.get_annotations, foreign), *map(dir, foreign))
    return [prop for prop in rna(kind).properties if prop.identifier not in inherited and prop.identifier[:3] != "bl_"]


def is_good_description(text):
    return len(text.split()) > 1 and not text.endswith(".") and text[0].isupper() and "\n" not in text


@pytest.fixture
def operators(addon):
    return ours(bpy.types.Operator)


def test_operators_are_found(operators):
    names = {operator.bl_idname for operator in operators}
    assert {"dynamorph.bake", "dynamorph.save_setup", "dynamorph.add_target"} <= names
    assert len(names) == len(operators)


def test_every_operator_has_a_label_that_makes_sense_alone(operators):
    """In the search, which omits internal operators, no panel gives a label its context."""
    found = [operator for operator in operators if "INTERNAL" not in getattr(operator, "bl_options", ())]
    assert not [operator.bl_idname for operator in found if len(operator.bl_label.split()) < 2]
    labels = [operator.bl_label for operator in operators]
    assert len(set(labels)) == len(labels)


def test_every_operator_has_a_description(operators):
    texts = {operator.bl_idname: rna(operator).description for operator in operators}
    assert {name: text for name, text in texts.items() if not is_good_description(text)} == {}


def test_every_property_has_a_description(addon):
    kinds = ours(bpy.types.Operator, bpy.types.PropertyGroup, bpy.types.AddonPreferences)
    assert {
        f"{kind.__name__}.{prop.identifier}": prop.description
        for kind in kinds
        for prop in own_properties(kind)
        if not is_good_description(prop.description)
    } == {}


def test_names_are_in_title_case(operators):
    small = {"a", "an", "and", "at", "by", "for", "from", "in", "of", "on", "or", "the", "to", "with"}
    for operator in operators:
        assert [w for w in operator.bl_label.split() if w[0].islower() and w not in small] == [], operator.bl_label


def test_operators_that_change_data_are_undone(operators):
    """This covers all operators except those that only write files, start or stop something, or read the animation."""
    without = {operator.bl_idname for operator in operators if "UNDO" not in getattr(operator, "bl_options", ())}
    assert without <= {
        "dynamorph.cancel",
        "dynamorph.export",
        "dynamorph.export_actions",
        "dynamorph.export_check",
        "dynamorph.grab",
        "dynamorph.let_go",
        "dynamorph.play_mode",
        "dynamorph.save_setup",
        "dynamorph.shake_test",
        "dynamorph.material_preset",
        "dynamorph.setup_preset",
        "dynamorph.update_target_weights",
    }


def test_there_are_no_key_bindings_but_those_of_tools(addon):
    configurations = bpy.context.window_manager.keyconfigs
    for configuration in filter(None, (configurations.addon, configurations.user)):
        for keymap in (each for each in configuration.keymaps if not each.name.startswith("3D View Tool: ")):
            assert not [item.idname for item in keymap.keymap_items if item.idname.startswith("dynamorph.")]


# Translation: Blender itself translates literal texts; formatted texts go through its functions first. The
# wheels come without languages, so that these functions are replaced here.


def translate(monkeypatch, module, function, texts):
    monkeypatch.setattr(module, function, lambda text: texts.get(text, text))


def test_reports_can_be_translated(soft_arm, monkeypatch, tmp_path, capfd):
    german = {"Setup of '{name}' saved as '{file}'": "'{file}' enthält die Einstellungen von '{name}'"}
    translate(monkeypatch, transfer, "rpt_", german)
    bpy.ops.dynamorph.save_setup(filepath=str(tmp_path / "arm.json"))
    assert "'arm.json' enthält die Einstellungen von 'Arm'" in capfd.readouterr().out


def test_labels_can_be_translated(addon, monkeypatch):
    translate(monkeypatch, preferences_module, "iface_", {"Engine: version {version}": "Rechenkern {version}"})
    monkeypatch.setattr(preferences_module, "installed_version", lambda: "1.2.3")
    monkeypatch.setattr(engine, "engine_problem", lambda: "")
    preferences, drawn = bpy.context.preferences.addons[MODULE].preferences, []
    shown = types.SimpleNamespace(layout=Layout(drawn), bl_rna=preferences.bl_rna)
    type(preferences).draw(shown, bpy.context)
    assert drawn == ["model_folder", "threads", "Rechenkern 1.2.3"]


# The tests -----------------------------------------------------------------------------------------------------------

TESTS = Path(__file__).parents[2]
ENGINE = TESTS.parent / "cpp" / "bindings" / "dynamorph"


def is_private(name):
    return name.startswith("_") and not name.startswith("__") and name.strip("_") != ""


def nodes(path):
    """The syntax of a module, without the constant parts of formatted texts."""
    found = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    parts = {id(part) for node in found if isinstance(node, ast.JoinedStr) for part in node.values}
    return [node for node in found if not (isinstance(node, ast.Constant) and id(node) in parts)]


def private_names(*folders):
    """What the modules in these folders define for themselves alone: functions, classes, variables and attributes."""
    found = set()
    for node in (node for folder in folders for path in folder.rglob("*.py") for node in nodes(path)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.id if isinstance(node, ast.Name) else node.attr)
    return {name for name in found if is_private(name)}


def named_in(node):
    """The names that a test may take from another module in this place: imported, as an attribute, or as a text."""
    if isinstance(node, ast.ImportFrom):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.Attribute) and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")):
        return [node.attr]
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value.split()) == 1:
        return node.value.split(".")  # for getattr and setattr
    return []


def private_uses(path, private):
    return [f"{path.name}:{node.lineno} {name}" for node in nodes(path) for name in named_in(node) if name in private]


def test_scenes_are_not_removed_while_the_artist_scrubs():
    """Blender 5.2 crashes then; see `sampling_scene.remove_scene`."""
    assert [path.name for path in PACKAGE.rglob("*.py") if "scenes.remove(" in path.read_text("utf-8")] == []


def test_tests_use_no_private_names():
    """They go by what a user or another module can see."""
    private = private_names(PACKAGE, ENGINE)
    assert len(private) > 200
    files = [*TESTS.rglob("*.py"), *(TESTS.parent / "evidence").rglob("*.py")]
    assert [use for path in sorted(files) for use in private_uses(path, private)] == []


def test_private_names_are_found(tmp_path):
    lines = (
        "from run import _hid",
        "run._hid()",
        "getattr(run, '_hid')",
        "set('run.Player._hid', 1)",
        "self._hid(f'{1}_hid')",
    )
    path = tmp_path / "test.py"
    path.write_text("\n".join(lines))
    assert private_uses(path, {"_hid"}) == [f"test.py:{line} _hid" for line in (1, 2, 3, 4)]
