# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo, save, append, link, library override, turning the add-on off and on: a soft skin survives all of them."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.material import presets
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_time, batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.ui.operators import jobs
from bl_ext.user_default.dynamic_morph_targets.write import reconcile, storage
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence, writer
from builders import activate, fingerprint, rig_of
from installed import MODULE, PACKAGE
from robustness import BY_MOUSE, CALLS, CHANGING_NOTHING, OPS, bake, coarse, motion, names, settings, state
from test_baking import assert_shows
from test_operators import refused
from test_panels import drawn

ROOT = Path(__file__).parents[3]


@pytest.fixture
def skin(soft_arm):
    """A soft arm for the real engine."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    return coarse(soft_arm)


# Undo and redo of every button -------------------------------------------------------------------------------------


def test_every_button_is_tried(addon):
    """A new operator must be listed in `robustness.CALLS`."""
    assert set(dir(OPS)) == BY_MOUSE | set(CALLS | CHANGING_NOTHING)


@pytest.mark.parametrize("name", CALLS)
def test_undo_and_redo(skin, name):
    prepare, arguments = CALLS[name]
    prepare(skin)
    reconcile.reconcile(skin)
    bpy.ops.ed.undo_push(message="before")
    before = state()
    assert getattr(OPS, name)("EXEC_DEFAULT", True, **arguments) == {"FINISHED"}
    after = state()
    assert after != before
    bpy.ops.ed.undo()
    assert state() == before
    bpy.ops.ed.redo()
    assert state() == after


@pytest.mark.parametrize("name", CHANGING_NOTHING)
def test_buttons_that_change_nothing(skin, name):
    prepare, arguments = CHANGING_NOTHING[name]
    prepare(skin)
    before = state()
    assert getattr(OPS, name)(**arguments) == {"FINISHED"}
    assert state() == before


def test_many_steps_undone_and_redone(skin):
    """A session adds a target, changes settings, builds, bakes and deletes the bake; then all of it is undone and
    redone.
    """
    bpy.ops.ed.undo_push(message="start")
    steps = [state()]
    for name, arguments in (("apply_material", {"preset": "SKIN"}), ("build", {}), ("bake", {}), ("delete_bake", {})):
        getattr(OPS, name)("EXEC_DEFAULT", True, **arguments)
        steps.append(state())
    for expected in steps[-2::-1]:
        bpy.ops.ed.undo()
        assert state() == expected
    for expected in steps[1:]:
        bpy.ops.ed.redo()
        assert state() == expected
    assert bake(bpy.data.objects["Arm"]).input.reasons == []


# Save, append, link, override --------------------------------------------------------------------------------------


@pytest.fixture
def asset(skin, tmp_path):
    """Saves the character, built, baked or live, in a collection: where, how it moves, what Delete Bake restores."""

    def save(goal):
        before = fingerprint(skin)
        if goal == "live":
            OPS.build()
        getattr(OPS, goal)()
        character = bpy.data.collections.new("Character")
        for obj in (skin, rig_of(skin)):
            bpy.context.scene.collection.objects.unlink(obj)
            character.objects.link(obj)
        bpy.context.scene.collection.children.link(character)
        shown = motion(skin)
        bpy.context.scene.frame_set(1)
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "asset.blend"))
        return SimpleNamespace(path=tmp_path / "asset.blend", shown=shown, before=before)

    return save


def open_shot(asset, link: bool):
    """The character in a new file; returns its mesh object."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with bpy.data.libraries.load(str(asset.path), link=link) as (_, wanted):
        wanted.collections = ["Character"]
    scene = bpy.context.scene
    scene.collection.children.link(wanted.collections[0])
    scene.frame_end = 20
    activate(bpy.data.objects["Arm"])
    return bpy.data.objects["Arm"]


def open_override(asset):
    open_shot(asset, link=True)
    return override()


def override():
    """Of the whole character; returns its mesh object."""
    character = bpy.data.collections["Character"]
    character.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    return the_override()


def the_override():
    obj = next(obj for obj in bpy.data.objects if obj.override_library and obj.type == "MESH")
    activate(obj)
    return obj


def reload(tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))


@pytest.mark.fault("F16")
def test_an_appended_character_plays_and_is_freed(asset, tmp_path):
    saved = asset("bake")
    obj = open_shot(saved, link=False)
    np.testing.assert_allclose(motion(obj), saved.shown, atol=1e-6)
    bpy.context.scene.frame_set(1)
    reload(tmp_path)
    obj = bpy.data.objects["Arm"]
    np.testing.assert_allclose(motion(obj), saved.shown, atol=1e-6)
    bpy.context.scene.frame_set(1)
    OPS.delete_bake()
    assert {**fingerprint(obj), "scenes": 0} == {**saved.before, "scenes": 0}


def test_an_appended_model_needs_no_new_build(asset):
    job = bake(open_shot(asset("build"), link=False))
    assert job.input.reasons == []
    assert_shows(bpy.data.objects["Arm"], job.outcome.bake)


@pytest.mark.fault("F15", "F16")
def test_a_large_model_stays_behind_and_is_built_again(asset, tmp_path, monkeypatch):
    """Its file lies beside the .blend that it came from."""
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "asset.blend"))
    obj = open_shot(asset("build"), link=False)
    refused(OPS.bake, "'Arm' is large.*save the .blend first")
    assert obj.dynamorph.model.content_id and not obj.dynamorph.bake.keys
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "elsewhere.blend"))  # now its file has a place
    assert bake(obj).input.reasons == []
    (tmp_path / "far").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "far" / "shot.blend"))
    opened.models.clear()
    assert "is missing" in bake(obj).input.reasons[0]


@pytest.mark.fault("R08")
def test_a_linked_character_plays_and_cannot_be_changed(asset):
    saved = asset("bake")
    obj = open_shot(saved, link=True)
    np.testing.assert_allclose(motion(obj), saved.shown, atol=1e-6)
    bpy.context.scene.frame_set(1)
    before = state()
    assert "flexed" in drawn(obj)
    for name in CALLS:
        assert not getattr(OPS, name).poll(), name
    for goal in ("BUILD", "BAKE"):  # as the command line does it
        with pytest.raises(errors.WriteError, match="Object 'Arm' is linked.*make it local"):
            batch.run(Job(obj, goal=goal, rebuild=True))
    assert state() == before


def test_a_linked_character_that_is_live_plays(asset):
    """It plays as it is, an override too; only the file that it comes from can turn it off."""
    obj = open_shot(asset("live"), link=True)
    for overridden in (False, True):
        playing = override() if overridden else obj
        moved = motion(playing, frames=range(1, 12))
        assert live.is_on(playing) and not live.problem(playing)
        assert np.isfinite(moved).all() and np.abs(np.diff(moved, axis=0)).max() > 1e-3
        assert not OPS.live.poll() and names(playing)[-1] == "Dynamorph Live"


def test_a_local_object_with_a_linked_mesh_is_refused(asset):
    """Its settings would be saved, but nothing that is made of its mesh."""
    linked = open_shot(asset("build"), link=True)
    obj = linked.copy()
    bpy.context.scene.collection.objects.link(obj)
    activate(obj)
    assert obj.library is None and obj.data.library
    before = state()
    for name in set(CALLS) - {"apply_feel", "apply_material", "fit_bounce", "fit_material", "fix"}:
        assert not getattr(OPS, name).poll(), name
    why = jobs.DYNAMORPH_OT_bake.disabled_reason(bpy.context)
    assert why.startswith(f"The mesh of '{obj.name}' is linked") and "make it local" in why
    with pytest.raises(errors.WriteError, match="Mesh 'Arm' is linked.*make it local"):
        bake(obj)
    assert state() == before


@pytest.mark.fault("R08")
def test_an_override_keeps_materials_alone(asset, tmp_path):
    saved = asset("build")
    obj = open_override(saved)
    stored = model_store.stored_model(obj)
    obj.dynamorph.active_target_index = 1
    assert OPS.apply_material(preset="FAT") == {"FINISHED"}
    obj.dynamorph.targets[0].stiffness = 4321.0
    obj.dynamorph.simulation.substeps = 7
    before = state()
    assert {"flexed", "stiffness"} <= set(drawn(obj))
    for name in set(CALLS) - {"apply_feel", "apply_material", "fit_bounce", "fit_material"}:
        assert not getattr(OPS, name).poll(), name
    for goal in ("BUILD", "BAKE"):
        with pytest.raises(errors.WriteError, match="'Arm' is a library override.*make it local"):
            batch.run(Job(obj, goal=goal, rebuild=True))
    assert state() == before
    reload(tmp_path)
    obj = the_override()
    neutral, flexed = obj.dynamorph.targets
    assert (neutral.name, flexed.name, flexed.bone_names()) == ("Neutral", "flexed", ("lower",))
    assert vars(flexed.material()) == pytest.approx(vars(presets.PRESETS["FAT"].material))
    assert (neutral.stiffness, obj.dynamorph.simulation.substeps) == (4321.0, 7)
    assert model_store.stored_model(obj) == stored
    assert model_store.stale_reasons(obj, extract.character(obj)) == []


def test_a_mesh_of_its_own_does_not_make_an_override_safe(asset):
    """The record of the bake would be lost, and Delete Bake with it."""
    obj = open_override(asset("build"))
    obj.data = obj.data.copy()
    before = fingerprint(obj)
    assert not OPS.bake.poll()
    with pytest.raises(errors.WriteError, match="'Arm' is a library override"):
        bake(obj)
    assert fingerprint(obj) == before


@pytest.mark.fault("R08")
def test_the_remedy_for_overrides_works(asset, tmp_path):
    obj = open_override(asset("build"))
    for each in bpy.context.scene.objects:
        each.select_set(each == obj)
    bpy.ops.object.make_local(type="SELECT_OBDATA")
    obj = bpy.context.object
    before = names(obj)
    job = bake(obj)
    assert job.input.reasons == []
    assert_shows(obj, job.outcome.bake)
    name = obj.name
    reload(tmp_path)
    obj = bpy.data.objects[name]
    assert_shows(obj, job.outcome.bake)
    writer.free(obj)
    assert names(obj) == before


@pytest.fixture
def overridden(asset, tmp_path):
    """An override of the built character in a saved shot, whose bakes go to point caches."""
    obj = open_override(asset("build"))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj.dynamorph.output.format = "PC2"
    return obj


@pytest.mark.fault("R08")
def test_an_override_is_baked_to_a_point_cache_that_stays(overridden, tmp_path):
    obj = overridden
    plain, linked = motion(obj), fingerprint(obj.override_library.reference)
    modifiers = [modifier.name for modifier in obj.modifiers]
    obj.dynamorph.targets[0].stiffness = 4321.0
    assert not OPS.delete_bake.poll() and OPS.bake() == {"FINISHED"}
    reload(tmp_path)
    obj = the_override()
    job = bake(obj)  # with what was saved, from the linked model
    assert job.input.reasons == [] and staleness.outdated(obj) == []
    assert obj.modifiers[0].type == "MESH_CACHE" and not any("is shared" in text for text in job.warnings)
    reload(tmp_path)
    obj = the_override()
    assert staleness.outdated(obj) == [] and obj.dynamorph.bake.summary
    assert_shows(obj, job.outcome.bake)
    assert np.abs(motion(obj) - plain).max() > 1e-3
    assert fingerprint(obj.override_library.reference) == linked
    obj.dynamorph.targets[0].stiffness = 5000.0
    assert staleness.outdated(obj) == ['Stiffness of "Neutral" changed']
    assert OPS.delete_bake() == {"FINISHED"}
    reload(tmp_path)
    obj = the_override()
    assert [modifier.name for modifier in obj.modifiers] == modifiers
    assert not obj.dynamorph.bake.exists and not OPS.delete_bake.poll()
    np.testing.assert_allclose(motion(obj), plain, atol=1e-6)


def test_the_influence_of_an_override_s_bake_can_be_keyed(overridden, tmp_path):
    obj = overridden
    plain = motion(obj, (1, 20))
    OPS.bake()
    full = motion(obj, (1, 20))
    (modifier, name) = influence.influence(obj)
    for frame, value in ((1, 1.0), (20, 0.0)):
        setattr(modifier, name, value)
        modifier.keyframe_insert(name, frame=frame)
    reload(tmp_path)
    shown = motion(the_override(), (1, 20))
    np.testing.assert_allclose(shown[0], full[0], atol=1e-6)
    np.testing.assert_allclose(shown[1], plain[1], atol=1e-6)


def test_a_bake_of_an_override_that_fails_leaves_the_earlier_one(overridden, monkeypatch):
    obj = overridden
    OPS.bake()
    shown, before = motion(obj), state()
    obj.dynamorph.simulation.substeps = 7
    monkeypatch.setattr(bake_time, "learn", lambda *_: 1 / 0)  # in the last step that can fail
    with pytest.raises(ZeroDivisionError):
        bake(obj)
    obj.dynamorph.simulation.substeps = 0
    assert state() == before
    np.testing.assert_array_equal(motion(obj), shown)


def test_a_bake_of_an_override_over_that_of_its_own_file(asset, tmp_path):
    """The linked shape keys play again when it is deleted."""
    saved = asset("bake")
    obj = open_override(saved)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj.dynamorph.output.format = "PC2"
    obj.dynamorph.simulation.gravity = -3.0
    assert not OPS.delete_bake.poll()
    job = bake(obj)
    reload(tmp_path)
    obj = the_override()
    assert_shows(obj, job.outcome.bake)
    assert np.abs(motion(obj) - saved.shown).max() > 1e-3
    bpy.context.scene.frame_set(1)
    OPS.delete_bake()
    reload(tmp_path)
    obj = the_override()
    assert len(obj.dynamorph.bake.keys) == len(obj.override_library.reference.dynamorph.bake.keys)
    np.testing.assert_allclose(motion(obj), saved.shown, atol=1e-6)


def test_what_an_override_cannot_keep_is_refused(overridden):
    obj = overridden
    obj.dynamorph.model.modes = 5
    refused(OPS.bake, "'Arm' is a library override, which keeps no model: open the file")
    obj.dynamorph.model.modes = 6
    obj.dynamorph.output.format = "MODES"
    assert not OPS.bake.poll()
    assert "choose the Format Point Cache" in jobs.DYNAMORPH_OT_bake.disabled_reason(bpy.context)
    with pytest.raises(errors.WriteError, match="keeps no shape keys: choose the Format Point Cache"):
        bake(obj)


# The add-on itself -------------------------------------------------------------------------------------------------


def handlers():
    """The functions of the add-on that Blender calls, each with when."""
    lists = {name: getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)}
    called = [(name, each) for name, functions in lists.items() if isinstance(functions, list) for each in functions]
    ours = [(name, each) for name, each in called if "dynamic_morph_targets" in each.__module__]
    return sorted(f"{name} {each.__module__}.{each.__qualname__}" for name, each in ours)


@pytest.mark.fault("G06")
def test_add_on_off_and_on_again_with_a_bake(scene, skin, tmp_path):
    before, installed = fingerprint(skin), handlers()
    job = bake(skin)
    shown, kept = motion(skin), settings(skin.dynamorph)
    addon_utils.disable(MODULE)
    assert handlers() == []
    np.testing.assert_array_equal(motion(skin), shown)
    reload(tmp_path)  # saved and opened without the add-on
    for _ in range(3):
        addon_utils.disable(MODULE)
        addon_utils.enable(MODULE)
    assert handlers() == installed
    obj = bpy.data.objects["Arm"]
    assert settings(obj.dynamorph) == kept
    assert bake(obj).input.reasons == []
    assert_shows(obj, job.outcome.bake)
    bpy.context.scene.frame_set(1)
    assert bpy.ops.dynamorph.delete_bake() == {"FINISHED"}
    assert fingerprint(obj) == before


@pytest.mark.fault("G06")
def test_opening_files_does_not_add_handlers(scene, skin, tmp_path):
    installed = handlers()
    assert len(installed) == len(set(installed)) > 0
    for _ in range(3):
        reload(tmp_path)
    assert handlers() == installed


ENABLE_AND_END = """
import sys
from pathlib import Path
import bpy, addon_utils
folder = Path(bpy.utils.user_resource("EXTENSIONS", path="user_default", create=True))
(folder / "dynamic_morph_targets").symlink_to(sys.argv[1])
assert addon_utils.enable("bl_ext.user_default.dynamic_morph_targets", default_set=True)
"""


def test_python_ends_quietly_with_the_add_on_enabled(tmp_path, monkeypatch):
    monkeypatch.setenv("BLENDER_USER_RESOURCES", str(tmp_path))
    run = subprocess.run([sys.executable, "-c", ENABLE_AND_END, PACKAGE], capture_output=True, text=True, check=False)
    assert run.returncode == 0 and "Traceback" not in run.stdout + run.stderr, run.stdout + run.stderr


# The other Blender -------------------------------------------------------------------------------------------------


@pytest.mark.fault("V05")
def test_the_other_blender_bakes_with_the_stored_model_and_alike(skin, tmp_path):
    """A process of the other Blender bakes a file of this one again, without a build, and its bake plays here."""
    environment = "3.11" if sys.version_info[:2] == (3, 13) else "3.13"
    other = ROOT / ".venv" / environment / "bin" / "python"
    if not other.exists():
        pytest.skip(f"needs the environment of Python {environment}: make build")
    bake(skin)
    here = motion(skin)
    shot, baked, report = (tmp_path / name for name in ("shot.blend", "baked.blend", "report.json"))
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    command = [other, "-m", "dynamic_morph_targets", "bake", shot, "--all", "-o", baked, "--report", report]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (character,) = json.loads(report.read_text())["characters"]
    assert character["built"] == []
    bpy.ops.wm.open_mainfile(filepath=str(baked))
    size = np.linalg.norm(np.ptp(here[0], axis=0))
    assert np.abs(here - here[0]).max() > 0.05 * size
    assert np.abs(motion(bpy.data.objects["Arm"]) - here).max() < 1e-6 * size
