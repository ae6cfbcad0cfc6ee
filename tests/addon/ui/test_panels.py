# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels draw without error, where it belongs and only what exists. Their look is tested in a window."""

import types

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import engine
from bl_ext.user_default.dynamic_morph_targets.core.motion.contact import TooDeep, Touched
from bl_ext.user_default.dynamic_morph_targets.core.motion.limits import Held
from bl_ext.user_default.dynamic_morph_targets.core.result import judge
from bl_ext.user_default.dynamic_morph_targets.run import live, remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch as run_batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.work import job_data
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.scene.properties import object_properties as properties
from bl_ext.user_default.dynamic_morph_targets.scene.properties import scripted
from bl_ext.user_default.dynamic_morph_targets.ui import widgets
from bl_ext.user_default.dynamic_morph_targets.ui.panels import sections
from bl_ext.user_default.dynamic_morph_targets.write import storage
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import activate, hand_made_bake, rig_of
from layout import Layout, controls, drawn, layout_of, region
from settings_shown import settings_shown

SIDEBAR, PHYSICS, DATA = "DYNAMORPH_PT_sidebar", "DYNAMORPH_PT_physics", "DYNAMORPH_PT_object_data"
BUTTONS = ["dynamorph.live", "Live", "dynamorph.bake", "Bake", "dynamorph.build", "dynamorph.delete_bake"]


def test_through_the_workflow(arm, stand_in):
    assert "dynamorph.add_soft_skin" in drawn(arm) and "dynamorph.bake" not in drawn(arm)
    bpy.ops.dynamorph.add_soft_skin()
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    assert {"Neutral", "flexed", "lower", "stiffness"} <= set(drawn(arm))
    assert not bpy.ops.dynamorph.delete_bake.poll() and "dynamorph.show_worst" not in drawn(arm)
    bpy.ops.dynamorph.bake()
    assert bpy.ops.dynamorph.delete_bake.poll() and "dynamorph.export" in drawn(arm)
    assert arm.dynamorph.model.summary[:40] in " ".join(drawn(arm, PHYSICS))
    arm.dynamorph.model.modes = 5
    for panel in (SIDEBAR, PHYSICS):
        texts = drawn(arm, panel)
        assert "Bake out of date" in texts and "Out of date: Detail (Modes) changed" in " ".join(texts)


@pytest.mark.parametrize("panel", [SIDEBAR, PHYSICS])
def test_no_button_at_the_top_ever_moves(soft_arm, stand_in, panel):
    """One row says what happens, whatever that is; all messages are below everything else."""

    def top():
        texts = drawn(soft_arm, panel)
        assert len(texts[0]) <= 18, "it does not fit into the Physics tab at a scale of 1.5"
        return texts[0], texts[1:7]

    seen = [top()]
    soft_arm.modifiers["Armature"].use_bone_envelopes = True
    seen.append(top())
    soft_arm.modifiers["Armature"].use_bone_envelopes = False
    bpy.ops.dynamorph.build()
    seen.append(top())
    soft_arm.dynamorph.model.modes = 5
    seen.append(top())
    bpy.ops.dynamorph.bake()
    seen.append(top())
    soft_arm.dynamorph.simulation.substeps = 9
    seen.append(top())
    bpy.ops.dynamorph.show_plain()
    seen.append(top())
    assert [text for text, _ in seen] == [
        "Not built yet",
        "See Messages",
        "Ready",
        "Model out of date",
        "Baked",
        "Bake out of date",
        "Plain skinning",
    ]
    assert all(buttons == BUTTONS for _, buttons in seen)


def test_a_problem_is_not_also_why_the_model_is_out_of_date(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    soft_arm.modifiers["Armature"].use_bone_envelopes = True
    storage.show_stale(soft_arm)
    problem = "'Arm' is skinned by bone envelopes"
    assert soft_arm.dynamorph.model.stale.startswith(problem)
    said = " ".join(drawn(soft_arm))
    assert said.count(problem) == 1 and "Out of date" not in said
    soft_arm.dynamorph.model.modes = 5
    said = " ".join(drawn(soft_arm))
    assert said.count(problem) == 1 and "Out of date: Detail (Modes) changed" in said


def test_the_row_below_the_buttons_says_what_is_next(soft_arm, stand_in, monkeypatch):
    playing = False
    monkeypatch.setattr(events, "is_playing", lambda: playing)
    seen = [next_step(soft_arm)]
    bpy.ops.dynamorph.build()
    seen.append(next_step(soft_arm))
    with monkeypatch.context() as patch:
        patch.setattr(live, "is_on", lambda _obj: True)
        seen.append(next_step(soft_arm))
        playing = True
        seen.append(next_step(soft_arm))
        soft_arm.dynamorph.model.modes = 5
        seen.append(next_step(soft_arm))
    playing = False
    bpy.ops.dynamorph.bake()
    seen.append(next_step(soft_arm))
    soft_arm.dynamorph.simulation.substeps = 9
    seen.append(next_step(soft_arm))
    soft_arm.modifiers["Armature"].use_bone_envelopes = True
    seen.append(next_step(soft_arm))
    assert seen == [
        "Live builds it, Bake too",
        "Live shows it, Bake keeps it",
        "Space plays, Bake keeps it",
        "Grab it, or Space stops it",
        "Build updates Live",
        "Space plays it",
        "Bake updates it",
        "",
    ]
    assert max(map(len, seen)) <= 28, "it does not fit into a sidebar of 250 pixels"


def test_in_a_narrow_region_half_a_hint_is_shown_and_long_names_are_above_their_fields(soft_arm, monkeypatch):
    assert next_step(soft_arm) == "Live builds it, Bake too"
    assert "Max Displacement" not in drawn(soft_arm, PHYSICS)  # but in its field
    monkeypatch.setattr(widgets, "line_length", lambda: 19)
    assert next_step(soft_arm) == "Live builds it"
    texts = drawn(soft_arm, PHYSICS)
    assert texts[texts.index("Max Displacement") + 1] == "max_displacement"


def test_the_stages_of_a_build_are_in_an_artists_words(soft_arm, monkeypatch):
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    batch, seen = run_batch.Batch([Job(soft_arm, "BUILD")], "BUILD"), []
    batch.tick = lambda work: seen.append(work.message)
    monkeypatch.setattr(run_batch, "OFTEN", 0.0)
    for _ in batch.steps():
        pass
    stages = job_data.STAGES
    assert not set(seen) & set(stages) and set(seen) & set(stages.values())


def next_step(obj) -> str:
    texts = drawn(obj)
    return texts[texts.index("dynamorph.delete_bake") + 1]


def test_progress_takes_the_row_of_the_state(soft_arm, stand_in):
    batch, job = run_batch, Job(soft_arm, goal="BAKE")
    remembered.work.running, job.progress.message = batch.Batch([job], "BAKE"), "Frame 7"
    try:
        for panel in (SIDEBAR, PHYSICS):
            assert drawn(soft_arm, panel)[:8] == ["0%  Frame 7", "dynamorph.cancel", *BUTTONS]
        assert not bpy.ops.dynamorph.build.poll() and not bpy.ops.dynamorph.bake.poll()
        job.progress.fraction, remembered.work.running.time_left.seconds = 0.38, 11.4
        assert "38%  0:12 left  Frame 7" in drawn(soft_arm)
    finally:
        remembered.work.running = None


def test_what_live_plays_is_not_out_of_date_in_live(soft_arm):
    """A stroke of Firmness, and opening the map to paint it, which changes nothing yet."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 6
    soft_arm.dynamorph.model.hold = "THICKNESS"
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    bpy.ops.dynamorph.paint_firmness()
    bpy.ops.dynamorph.paint_firmness()
    assert drawn(soft_arm)[0] == "Live is on"
    group = soft_arm.vertex_groups[soft_arm.dynamorph.firmness_group]
    group.add([0, 1, 2], 0.9, "REPLACE")
    assert drawn(soft_arm)[0] == "Live is on" and "Build updates Live" not in drawn(soft_arm)
    soft_arm.dynamorph.model.modes += 1
    assert drawn(soft_arm)[0] == "Live out of date" and "Build updates Live" in drawn(soft_arm)


def test_without_other_targets_the_settings_are_of_the_whole_body(soft_arm):
    soft_arm.dynamorph.active_target_index = 0
    assert "Neutral" in drawn(soft_arm) and "Whole Body" not in drawn(soft_arm)
    soft_arm.dynamorph.targets.remove(1)
    assert drawn(soft_arm).count("Whole Body") == 2  # of Feel and Material


# Where things are ----------------------------------------------------------------------------------------------------


TOP = ["dynamorph.live", "dynamorph.bake", "dynamorph.build", "dynamorph.delete_bake"]


def test_a_new_soft_skin_shows_twelve_controls_at_most(arm, stand_in):
    assert controls(arm, unfolded=False) == ["dynamorph.add_soft_skin"]
    bpy.ops.dynamorph.add_soft_skin()
    bpy.ops.dynamorph.build()
    shown = controls(arm, unfolded=False)
    assert shown[:4] == TOP and shown[4:7] == ["dynamorph.apply_feel"] * 3
    names = [name.rpartition(".")[2] for name in shown[7:]]
    assert names == ["amount", "bounce", "settle_time", "DYNAMORPH_PT_material_presets"]
    assert len(shown) <= 12
    assert controls(arm, PHYSICS, unfolded=False) == [*TOP, "DynamorphCollision.use", "DYNAMORPH_PT_setup_presets"]


# Settings of a new soft skin that stay in sight, section by section; Advanced and Material have the others.
IN_SIGHT = {
    "feel": ["amount", "bounce", "settle_time"],
    "firmness": ["firmness_group"],
    "max_distance": ["max_distance_group"],
    "attachments": ["hold_head"],
    "collision": ["use", "collection", "use_self", "distance", "excluded_group", "use_friction"],
    "bake": ["quality", "max_displacement", "use_scene_range", "loop", "format"],
}
SCRIPTED = {  # what no panel has, as a script sets it, and what Advanced then says
    "hold": ("BONES", "Hold: Bones"),
    "pin_radius": (0.25, "Bone Pinning: 0.25"),
    "basis": ("MODES", "Modes From: Vibration"),
    "fit_to_shot": (True, "Fit Modes to Shot: on"),
    "material_model": ("LINEAR", "Material Model: Linear"),
    "blending": ("FORCES", "Between Targets: Stiffer Wins"),
    "integrator": ("EULER", "Integrator: Implicit Euler"),
}
ADVICE = "Raise", "Lower", "Turn", "Choose", "Change", "Paint", "Set", "suit", "where", "sets"  # it says when


def test_few_settings_are_in_sight(arm, stand_in):
    bpy.ops.dynamorph.add_soft_skin()
    shown = settings_shown(arm)
    rest = {section.name for section in sections.PHYSICS_SECTIONS if section.parent == "advanced"} | {"material"}
    in_sight = {name: [each.split(".")[1] for each in found] for name, found in shown.items() if name not in rest}
    print({name: len(found) for name, found in shown.items()})
    assert in_sight == IN_SIGHT


@pytest.mark.parametrize("name", scripted.SCRIPTED)
def test_what_a_script_has_set_is_said_and_reset(soft_arm, name):
    """And not otherwise drawn."""
    for each in scripted.SCRIPTED:  # the test's own script has set some
        scripted.reset(soft_arm, each)
    owner, (value, said) = getattr(soft_arm.dynamorph, scripted.SCRIPTED[name]), SCRIPTED[name]
    assert name not in drawn(soft_arm, PHYSICS) and "dynamorph.reset_setting" not in drawn(soft_arm, PHYSICS)
    before = getattr(owner, name)
    setattr(owner, name, value)
    texts = drawn(soft_arm, PHYSICS)
    assert f"Set by a script: {said}" in " ".join(texts) and texts.count("dynamorph.reset_setting") == 1
    assert name not in texts
    assert bpy.ops.dynamorph.reset_setting(setting=name) == {"FINISHED"}
    assert getattr(owner, name) == before and "dynamorph.reset_setting" not in drawn(soft_arm, PHYSICS)


def test_the_dialog_of_a_bake_says_where_its_curves_go(soft_arm, stand_in):
    output = soft_arm.dynamorph.output
    assert not {"bake_to_action", "to_action"} & set(drawn(soft_arm, PHYSICS))
    bpy.ops.dynamorph.bake_options(to_action=True)
    assert output.bake_to_action and soft_arm.dynamorph.bake.action == rig_of(soft_arm).animation_data.action
    assert "Bakes to the armature's Action" in " ".join(drawn(soft_arm, PHYSICS))
    bpy.ops.dynamorph.bake_options(to_action=False)
    assert not output.bake_to_action and soft_arm.dynamorph.bake.action != rig_of(soft_arm).animation_data.action
    assert "Bakes to" not in " ".join(drawn(soft_arm, PHYSICS))


@pytest.mark.parametrize("width", [33, 19])
def test_a_limit_of_0_reads_none(soft_arm, monkeypatch, width):
    """In one place each, whether the region is narrow or not."""
    monkeypatch.setattr(widgets, "line_length", lambda: width)
    skin = soft_arm.dynamorph
    skin.active_target_index, target = 1, skin.targets[1]
    for panel, owner, name, value in (
        (PHYSICS, skin.simulation, "max_displacement", 0.05),
        (PHYSICS, skin.output, "keys", 8),
        (SIDEBAR, target, "fade_out_angle", 1.0),
    ):
        setattr(owner, name, 0)
        texts = drawn(soft_arm, panel)
        assert texts.count(name) == 1 and texts[texts.index(name) + 1] == "none"
        setattr(owner, name, value)
        texts = drawn(soft_arm, panel)
        assert texts[texts.index(name) + 1] != "none"


MOST = 36  # settings


def test_few_settings_are_drawn(soft_arm, stand_in):
    """With every section open, for a target of a body that collides and is baked. Frames, friction, force fields and
    grips are drawn only where they do something.
    """
    soft_arm.dynamorph.active_target_index, soft_arm.dynamorph.collision.use = 1, True
    bpy.ops.dynamorph.bake()
    shown = settings_shown(soft_arm)
    drawn_once = [each for found in shown.values() for each in found]
    print(len(drawn_once), "settings:", shown)
    assert len(drawn_once) == len(set(drawn_once)) <= MOST


def test_force_fields_and_friction_are_drawn_where_they_do_something(soft_arm):
    texts = drawn(soft_arm, PHYSICS)
    assert not {"fields", "friction"} & set(texts) and "N/m²" not in " ".join(texts)
    bpy.ops.object.effector_add(type="WIND")
    activate(soft_arm)
    soft_arm.dynamorph.collision.use_friction = True
    texts = drawn(soft_arm, PHYSICS)
    assert {"fields", "friction"} <= set(texts) and "N/m²" in " ".join(texts)


def test_a_message_stands_once_and_has_one_icon(soft_arm, stand_in, monkeypatch):
    """In each of the two places, whatever is wrong."""
    monkeypatch.setattr(widgets, "line_length", lambda: 1000)
    settings = soft_arm.dynamorph
    settings.collision.use = settings.collision.use_self = True
    bpy.ops.dynamorph.bake()
    touched = Touched(left_inside=(TooDeep("lower", "Ball", 0.01, 3, 4),), unusable=(("Cube", 5, 6),))
    held = Held("lower", 5.0, (3, 4))
    verdict = judge.Verdict(judge.Limits(0.05), held, percentile=0.1, frame=7.0, touched=touched)
    settings.bake.verdict = verdict.record
    settings.bake.warnings = "\n".join((verdict.text, *verdict.contact_texts, "The disk is nearly full"))
    settings.bake.off_full = 0.2
    settings.model.modes = 5
    attachment = settings.attachments.add()
    attachment.object, attachment.name = soft_arm, "Arm"  # which cannot be
    icons: dict[str, set[str]] = {}
    for panel in (SIDEBAR, PHYSICS):
        labels = [(text, icon) for text, icon in layout_of(soft_arm, panel).labels if len(text.split()) > 3]
        texts = [text for text, _ in labels]
        assert len(texts) == len(set(texts)), sorted(texts)
        for text, icon in labels:
            icons.setdefault(text, set()).add(icon)
    assert {text: found for text, found in icons.items() if len(found) > 1} == {}
    assert "The disk is nearly full" in icons and len(icons) > 5


def test_what_shows_of_the_motion_has_two_names_with_one_place_each(soft_arm, stand_in):
    """Amount in Feel, of the whole skin and of the selected target, and Influence in Result."""
    bpy.ops.dynamorph.bake()
    skin = soft_arm.dynamorph
    for index in range(2):
        skin.active_target_index = index
        shown = settings_shown(soft_arm)
        amounts = [each for found in shown.values() for each in found if each.endswith(".amount")]
        assert amounts == ["DynamorphSimulation.amount", "DynamorphTarget.amount"]
        assert set(amounts) < set(shown["feel"])
        assert drawn(soft_arm).count("influence") == 1
    bpy.ops.dynamorph.remove_target()
    assert "DynamorphTarget.amount" not in settings_shown(soft_arm)["feel"]  # it would be the whole skin's


def test_reset_to_default_changes_nothing_of_a_new_soft_skin(arm, stand_in):
    bpy.ops.dynamorph.add_soft_skin()
    skin = arm.dynamorph
    parts = skin, skin.model, skin.simulation, skin.collision, skin.output, skin.targets[0]
    groups = {type(each).__name__: each for each in parts}
    for group, name in (each.split(".") for found in settings_shown(arm).values() for each in found):
        before = getattr(groups[group], name)
        groups[group].property_unset(name)
        assert getattr(groups[group], name) == before, name


def test_every_setting_says_when_to_change_it(soft_arm, stand_in):
    soft_arm.dynamorph.active_target_index = 1
    soft_arm.dynamorph.simulation.use_scene_range = False  # which shows the frames
    groups, silent = {group.__name__: group for group in properties.CLASSES}, []
    for group, name in (each.split(".") for found in settings_shown(soft_arm).values() for each in found):
        tooltip = groups[group].bl_rna.properties[name].description
        if not any(word in tooltip for word in ADVICE):
            silent.append(f"{group}.{name}: {tooltip}")
    assert silent == []


def test_nothing_but_state_live_and_bake_is_in_both_places(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    both = set(controls(soft_arm)) & set(controls(soft_arm, PHYSICS))
    assert both == {*TOP, "dynamorph.export"}  # glTF has a button of its own beside the bake's result


def test_the_order_of_the_sections(soft_arm):
    titles = [section.label for section in sections.SIDEBAR_SECTIONS if section.parent == "sidebar"]
    assert titles[:4] == ["Feel", "Firmness", "Max Distance", "Targets"] and titles[-1] == "Messages"
    parents = {section.label: section.parent for section in sections.PHYSICS_SECTIONS}
    assert {parents[label] for label in ("Cage", "Detail", "Solver")} == {"advanced"}


def test_what_compares_is_in_one_section(soft_arm, stand_in):
    """All of it, and nothing else."""
    compares = ["show_plain", "swap_slot", "copy_slot", "compare_beside", "compare_full"]
    bpy.ops.dynamorph.bake()
    soft_arm.dynamorph.bake.off_full = 0.123
    layout = Layout([])
    section = next(each for each in sections.SIDEBAR_SECTIONS if each.name == "compare")
    section.draw(layout, bpy.context, soft_arm)
    assert layout.controls == [f"dynamorph.{name}" for name in compares]
    said = "Measured error: 12.3 % of the motion"
    assert said in " ".join(layout.drawn)
    everywhere = [*controls(soft_arm), *controls(soft_arm, PHYSICS)]
    assert all(everywhere.count(each) == 1 for each in layout.controls)
    assert f"{' '.join(drawn(soft_arm))} {' '.join(drawn(soft_arm, PHYSICS))}".count(said) == 1


def test_the_shape_keys_panel_is_about_the_active_key(soft_arm, stand_in):
    settings, keys = soft_arm.dynamorph, soft_arm.data.shape_keys.key_blocks
    settings.active_target_index = 0
    soft_arm.active_shape_key_index = keys.find("flexed")
    assert drawn(soft_arm, DATA) == ["dynamorph.select_target"]
    bpy.ops.dynamorph.select_target()
    assert settings.active_target_index == 1
    shown = drawn(soft_arm, DATA)
    assert {"dynamorph.capture_pose", "region", "fade_out_angle", "stiffness", "flexed"} <= set(shown)
    assert not {"dynamorph.live", "dynamorph.bake", "dynamorph.apply_feel", "Neutral"} & set(shown)
    soft_arm.active_shape_key_index = keys.find("smile")
    assert drawn(soft_arm, DATA) == ["dynamorph.add_target"]
    soft_arm.active_shape_key_index = 0
    bpy.ops.dynamorph.select_target()
    assert "Neutral" in drawn(soft_arm, DATA) and "region" not in drawn(soft_arm, DATA)


def test_a_button_among_those_of_blenders_physics(arm):
    panel = types.SimpleNamespace(layout=Layout([]))
    sections.draw_add(panel, bpy.context)
    assert panel.layout.drawn == ["dynamorph.add_soft_skin", "Soft Skin"]
    physics = bpy.types.DYNAMORPH_PT_physics
    assert not physics.poll(bpy.context)
    bpy.ops.dynamorph.add_soft_skin()
    assert physics.poll(bpy.context)
    panel = types.SimpleNamespace(layout=Layout([]))
    sections.draw_add(panel, bpy.context)
    assert panel.layout.drawn == ["dynamorph.remove_soft_skin", "Soft Skin"]
    bpy.ops.dynamorph.remove_soft_skin()
    assert not arm.dynamorph.targets and not physics.poll(bpy.context)
    bpy.context.view_layer.objects.active = None
    panel = types.SimpleNamespace(layout=Layout([]))
    sections.draw_add(panel, bpy.context)
    assert panel.layout.drawn == []


def status() -> list[str]:
    out = []
    sections.draw_status(types.SimpleNamespace(layout=Layout(out)), None)
    return out


def test_the_status_bar_says_what_runs(soft_arm, stand_in, monkeypatch):
    """It looks when it draws, so nothing is left behind in a workspace or window that the artist has left."""
    assert status() == []
    job = Job(soft_arm, goal="BAKE")
    job.progress.fraction, job.progress.message = 0.4, "Frame 7"
    running = run_batch.Batch([job], "BAKE")
    monkeypatch.setattr(remembered.work, "running", running)
    assert status() == ["40%  Frame 7    Esc: cancel"]
    running.time_left.seconds = 72.0
    assert status() == ["40%  1:12 left  Frame 7    Esc: cancel"]
    monkeypatch.setattr(remembered.work, "running", None)
    shake = types.SimpleNamespace(label="Shake Test", seconds_left=1.5)
    monkeypatch.setattr(remembered.live, "preview", shake)
    assert status() == ["Shake Test  0:02 left    Esc: stop"]
    shake.seconds_left = None
    assert status() == ["Shake Test    Esc: stop"]


def test_a_narrow_list_has_room_for_names_only(soft_arm):
    assert "20 kPa" not in drawn(soft_arm) and "20 kPa" in drawn(soft_arm, place=region(400))


def test_many_bones_are_folded_away(soft_arm):
    target = soft_arm.dynamorph.targets[1]
    target.set_bones([f"bone {i}" for i in range(12)])
    assert "Bones (12)" in drawn(soft_arm) and "bone 3" in drawn(soft_arm)
    assert "bone 3" not in drawn(soft_arm, unfolded=False)


@pytest.mark.fault("V01")
def test_a_missing_engine_is_shown(soft_arm, monkeypatch):
    monkeypatch.setattr(engine, "engine_problem", lambda: "The engine cannot be loaded (no wheel). Install it")
    assert "The engine cannot be loaded (no wheel)." in " ".join(drawn(soft_arm))


@pytest.mark.parametrize("kind", [None, "CAMERA"])
def test_the_tab_says_what_to_select(soft_arm, kind):
    other = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye") if kind else None)
    assert drawn(other) == ["Select 'Arm' or its armature"]
    assert not bpy.types.DYNAMORPH_PT_physics.poll(types.SimpleNamespace(object=other))
    soft_arm.dynamorph.targets.clear()
    assert " ".join(drawn(other)) == "Select a character's mesh or its armature" == " ".join(drawn(None))


@pytest.mark.parametrize("mode", ["OBJECT", "POSE"])
def test_on_the_rig_for_its_skin(soft_arm, mode):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode=mode)
    assert {"Arm: Not built yet", "Neutral", "flexed"} <= set(drawn(rig))
    soft_arm.dynamorph.targets.clear()
    assert not bpy.ops.dynamorph.capture_pose.poll()


def test_a_target_without_its_key_is_marked(soft_arm):
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.shape_key_clear()
    assert "flexed" in drawn(soft_arm)
    writer.free(soft_arm)
    assert not bpy.ops.dynamorph.delete_bake.poll() and "See Messages" in drawn(soft_arm)
