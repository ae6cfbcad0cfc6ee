# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake replaces another. Whatever step fails, one of the two plays: the old one with everything that belonged to it,
or the new one.
"""

import sys

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import logger
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_result, batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.write import reconcile, storage
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence, muting, writer
from bl_ext.user_default.dynamic_morph_targets.write.display import comparison, live_key
from builders import evaluated_points, fingerprint, hand_made_bake, make_arm, make_soft
from test_attachments import make_sleeve
from test_outputs import written

KEYS = (writer, influence, muting)  # modules that write the keys of one mesh
JOBS = (bake_result, live_key, comparison, storage)


class Fault:
    """Within it, the add-on raises MemoryError before it executes one line of these modules for the first time.

    lines: those that were executed until then, as (file, number).
    """

    def __init__(self, modules, at=None):
        self.at = at
        self.lines = []
        self._files = {module.__file__ for module in modules}

    def __enter__(self):
        self._outer = sys.gettrace()
        sys.settrace(self._called)
        return self

    def __exit__(self, *_error):
        sys.settrace(self._outer)

    def _called(self, frame, _event, _argument):
        return self._traced if frame.f_code.co_filename in self._files else None

    def _traced(self, frame, event, _argument):
        line = frame.f_code.co_filename, frame.f_lineno
        if event == "line" and line not in self.lines:
            self.lines.append(line)
            if line == self.at:
                raise MemoryError
        return self._traced


def picture() -> np.ndarray:
    """What all meshes look like at one frame."""
    bpy.context.scene.frame_set(9)
    return np.concatenate([evaluated_points(obj) for obj in bpy.data.objects if obj.type == "MESH"])


def stored(group) -> dict:
    """All properties of a group, with those of the groups and lists within it."""
    values = {}
    for name, prop in group.bl_rna.properties.items():
        value = getattr(group, name)
        if prop.type == "COLLECTION":
            values[name] = [stored(each) for each in value]
        elif prop.type == "POINTER" and name != "rna_type" and isinstance(value, bpy.types.PropertyGroup):
            values[name] = stored(value)
        elif name not in ("rna_type", "key_index"):  # places in the list of keys are looked up again
            values[name] = tuple(value) if getattr(prop, "is_array", False) else getattr(value, "name", value)
    return values


def state() -> dict:
    """Everything that a replacement may change."""
    bpy.context.scene.frame_set(1)
    meshes = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    for obj in meshes:
        reconcile.reconcile(obj)
    return {obj.name: (keys(obj), stored(obj.dynamorph), modifiers(obj), packed(obj)) for obj in meshes}


def keys(obj):
    return obj.data.shape_keys and fingerprint(obj)


def modifiers(obj) -> list[tuple]:
    shown = [(each.name, each.show_viewport, each.show_render, getattr(each, "filepath", "")) for each in obj.modifiers]
    return [*shown, *(driver.data_path for driver in (obj.animation_data.drivers if obj.animation_data else ()))]


def packed(obj):
    value = obj.get("dynamorph_model")
    return value if value is None else list(value)


def assert_one_of_both_plays(write, modules, file, monkeypatch, every=1):
    """`write` replaces a bake in a saved .blend; it is tried with a fault at each line, or some, that it executes."""
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    errors = []
    monkeypatch.setattr(logger, "log_bug", errors.append)

    def opened():
        bpy.ops.wm.open_mainfile(filepath=str(file))
        return picture(), state()

    before, whole = opened()
    with Fault(modules) as none:
        write()
    after = picture()
    assert np.abs(after - before).max() > 1e-3 and not errors
    opened()
    new = 0
    for line in none.lines[::every]:
        errors.clear()
        with Fault(modules, line):
            try:
                write()
                failed = False
            except MemoryError:
                failed = True
        where = f"{line[0].rsplit('/')[-1]}:{line[1]}"
        if np.abs(picture() - after).max() < 1e-5:
            new += 1
            opened()
        else:
            assert failed and np.abs(picture() - before).max() < 1e-5, where
            assert state() == whole, where
    assert 0 < new < len(none.lines)  # the fault came before and after the new bake played


@pytest.fixture
def file(tmp_path):
    (tmp_path / "shots").mkdir()
    return tmp_path / "shots" / "arm.blend"


# One mesh ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first, second", [("MODES", "PC2"), ("PC2", "MODES")])
def test_keys_and_point_caches(soft_arm, file, monkeypatch, first, second):
    soft_arm.data.shape_keys.key_blocks["flexed"].value = 0.5
    written(soft_arm, hand_made_bake(soft_arm), file.parent, format=first)

    def write():
        arm = bpy.data.objects["Arm"]
        written(arm, hand_made_bake(arm, seed=2), file.parent, format=second)

    assert_one_of_both_plays(write, KEYS, file, monkeypatch)


def test_a_mesh_that_follows(soft_arm, file, monkeypatch):
    sleeve = make_sleeve(soft_arm)
    for obj, skin in ((soft_arm, None), (sleeve, soft_arm)):
        written(obj, hand_made_bake(obj), file.parent, skin, format="PC2")

    def write():
        body, piece = bpy.data.objects["Arm"], bpy.data.objects["Sleeve"]
        written(piece, hand_made_bake(piece, seed=2), file.parent, body, format="PC2")

    assert_one_of_both_plays(write, KEYS, file, monkeypatch)


# Jobs ----------------------------------------------------------------------------------------------------------------


def bake_all(folder):
    job, objs = Job, [bpy.data.objects[name] for name in ("Arm", "Leg") if name in bpy.data.objects]
    batch.run_all(batch.Batch([job(obj, "BAKE", folder=folder) for obj in objs], "BAKE_ALL"))


def prepared(folder, kind):
    """A scene in which a job will replace what its name says."""
    arm = bpy.data.objects["Arm"]
    sleeve = make_sleeve(arm)
    if kind == "live":
        live_key.add(arm, ["flexed"], [sleeve])
        for obj in (arm, sleeve):
            obj.data.shape_keys.key_blocks["Dynamorph Live"].points[3].co.z += 0.2
        return
    bake_all(folder)
    make_soft(make_arm(bpy.context.scene, "Leg"))
    arm.data.shape_keys.key_blocks["flexed"].points[3].co.z += 0.1  # the model is out of date
    for obj, skin in ((arm, None), (sleeve, arm)):  # the sleeve is no attachment any more
        written(obj, hand_made_bake(obj), folder, skin, format="PC2")
    comparison.show(arm, True)


@pytest.mark.parametrize("kind", ["live", "bakes"])
def test_jobs(soft_arm, stand_in, file, monkeypatch, kind):
    soft_arm.data.shape_keys.key_blocks["flexed"].mute = True
    prepared(file.parent, kind)
    assert_one_of_both_plays(lambda: bake_all(file.parent), JOBS, file, monkeypatch, every=3)
