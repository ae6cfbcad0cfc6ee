# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension remembers from one call to the next is in few places, and begins again with each file."""

import ast
from dataclasses import dataclass

import addon_utils
import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import states
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from builders import activate
from installed import MODULE
from pressed import Pressed
from test_imports import PACKAGE, modules

OPS = bpy.ops.dynamorph
# All variables of modules that change, or whose value does.
VARIABLES = {
    "core/engine": {"threads"},
    "core/motion/prepared": {"kept"},
    "core/states": {"all"},
    "run/remembered": {"live", "work"},
    "scene/events": {"listeners"},
    "scene/registration": {"taken_back"},
    "scene/remembered": {"opened"},
}
CALLS = {"dict", "list", "set", "of", "iter"}  # that make what changes


def changes(value) -> bool:
    """Whether an expression makes a value that changes."""
    if isinstance(value, ast.Dict | ast.List | ast.Set | ast.DictComp | ast.ListComp | ast.SetComp):
        return True
    name = getattr(value, "func", None)
    return isinstance(value, ast.Call) and getattr(name, "attr", getattr(name, "id", "")) in CALLS


def variables(tree) -> set[str]:
    """Those of a module that are no constants, and those that functions set, without leading underscores."""
    found = {name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names}
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and changes(node.value):
            named = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {each.id for each in named if isinstance(each, ast.Name) and not each.id.strip("_").isupper()}
    return {name.strip("_") for name in found}


def test_few_variables_of_modules_change():
    found = {module: names for module, tree in modules(PACKAGE).items() if (names := variables(tree))}
    assert found == VARIABLES and sum(map(len, found.values())) <= 8


@pytest.fixture
def used(soft_arm):
    """A soft skin that was built, baked, and plays in Live; panels have looked at it."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    activate(soft_arm)
    assert Pressed(soft_arm).result == {"FINISHED"}
    OPS.live()
    bpy.context.scene.frame_set(3)
    remembered.work.seconds[soft_arm.session_uid] = 1.0
    opened.asked.add((print, soft_arm.session_uid))
    changed = states.changed()
    assert {"OpenFile.models", "Live.sessions", "Work.seconds", "OpenFile.asked"} <= {*changed}
    return soft_arm


@pytest.mark.parametrize("how", ["other file", "switched off"])
def test_each_state_is_as_at_first(used, how):
    if how == "other file":
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
        assert states.changed() in ([], ["Live.asleep"])  # Live has looked, and there is none
    else:
        addon_utils.disable(MODULE)
        assert states.changed() == []
        addon_utils.enable(MODULE)


def test_undo_leaves_no_work(used):
    bpy.ops.ed.undo_push(message="before")
    used.location.x = 1.0
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()
    assert remembered.work.running is None and remembered.live.preview is None and remembered.live.hands is None


@dataclass
class Owner:
    """What somebody remembers."""


def test_what_is_read_of_blender_goes_with_its_owner():
    owner, other, calls = states.of(Owner), states.of(Owner), []
    read = states.cached(owner, 2)(lambda number: calls.append(number) or number)
    assert [read(1), read(1)] == [1, 1] and calls == [1]
    states.reset(other)
    assert read(1) == 1 and calls == [1]
    states.reset(owner)
    assert read(1) == 1 and calls == [1, 1]


def test_other_caches_are_of_values_alone():
    """No owner has to empty those."""
    caching = {
        module
        for module, tree in modules(PACKAGE).items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and node.module == "functools"
        and {"cache", "lru_cache"} & {a.name for a in node.names}
    }
    assert caching == {
        "core/engine",
        "core/logger",
        "core/records",
        "core/result/judge",
        "core/states",
        "scene/check/animation_checks",
        "scene/references",
    }
