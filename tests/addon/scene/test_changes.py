# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists of what has changed since the build and the bake, in sentences that disappear when the change is undone."""

import json

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import live as run_live
from bl_ext.user_default.dynamic_morph_targets.run.tools import preview
from bl_ext.user_default.dynamic_morph_targets.scene import animation, events
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import activate, make_rig, refused, rig_of, soon
from costs import cost
from layout import drawn


@pytest.fixture
def baked(soft_arm, stand_in):
    """The arm with a bake that is up to date."""
    bpy.ops.dynamorph.bake()
    assert outdated(soft_arm) == [] and model_changes(soft_arm) == []
    return soft_arm


def outdated(obj):
    return staleness.outdated(obj)


def model_changes(obj):
    return staleness.model_changes(obj)


def with_modes(obj):
    obj.dynamorph.modes[2].gain = 0.5


SETTINGS = [
    ("targets[1].stiffness", 5e5, 'Stiffness of "flexed" changed'),
    ("targets[0].mass_damping", 3.0, 'Mass Damping of "Neutral" changed'),
    ("targets[1].fade_out_angle", 0.5, 'Fade-Out Angle of "flexed" changed'),
    ("targets[1].region", "lower", 'Region of "flexed" changed'),
    ("model.modes", 7, "Detail (Modes) changed"),
    ("model.blending", "FORCES", "Between Targets changed"),
    ("simulation.speed", 0.9, "Speed changed"),  # with as many substeps
    ("simulation.speed", 0.2, "Speed changed"),  # with fewer: nobody set them
    ("simulation.samples", 7, "Samples Per Frame changed"),
    ("simulation.substeps", 9, "Substeps Per Frame changed"),
    ("simulation.integrator", "EULER", "Integrator changed"),
    ("simulation.gravity", 0.5, "Gravity changed"),
    ("simulation.fields", 0.5, "Force Fields changed"),
    ("simulation.initial_state", "REST_SHAPE", "Initial State changed"),
    ("simulation.amount", 0.5, "Amount changed"),
    ("simulation.loop", True, "Loop changed"),
]


@pytest.mark.parametrize("path, value, sentence", SETTINGS)
def test_a_setting_is_named_until_it_is_reset(baked, path, value, sentence):
    owner, _, name = path.rpartition(".")
    group = baked.dynamorph.path_resolve(owner) if owner else baked.dynamorph
    before = getattr(group, name)
    setattr(group, name, value)
    assert outdated(baked) == [sentence]
    setattr(group, name, before)
    assert outdated(baked) == []


@pytest.mark.parametrize("collides", [False, True])
@pytest.mark.parametrize("group, title", [("max_distance_group", "Max Distance"), ("excluded_group", "Exclude")])
def test_a_map_is_named_once_it_says_something(baked, group, title, collides):
    """Another vertex group alone changes nothing, as where Paint has just made it."""
    if collides:
        baked.dynamorph.collision.use = True
        bpy.ops.dynamorph.bake()
    baked.vertex_groups.new(name="Same")
    for name in ("Same", "lower", ""):
        with soon():
            setattr(baked.dynamorph, group, name)
        counts = name == "lower" and (collides or title == "Max Distance")
        assert outdated(baked) == [f"{title} changed"] * counts


SCENE = [
    ("frame_end", 30, "Frame End changed"),
    ("frame_start", -3, "Frame Start changed"),
    ("render.fps", 24_000, "Frame rate changed"),
    ("use_gravity", False, "Gravity changed"),
]


@pytest.mark.fault("A06")
@pytest.mark.parametrize("path, value, sentence", SCENE)
def test_the_scene_counts(scene, baked, path, value, sentence):
    owner, _, name = path.rpartition(".")
    group = scene.path_resolve(owner) if owner else scene
    before = getattr(group, name)
    setattr(group, name, value)
    assert sentence in outdated(baked)
    setattr(group, name, before)
    assert outdated(baked) == []


def test_substeps_that_nobody_set_follow_the_frame_rate(scene, baked):
    scene.render.fps = 12
    assert outdated(baked) == ["Frame rate changed"]
    baked.dynamorph.simulation.substeps = 9
    assert outdated(baked) == ["Frame rate changed", "Substeps Per Frame changed"]


def test_targets_that_are_added_removed_renamed_or_muted(scene, baked):
    baked.data.shape_keys.key_blocks["flexed"].name = "biceps"
    bpy.context.view_layer.update()
    assert baked.dynamorph.targets[1].name == "biceps" and outdated(baked) == []
    scene.frame_set(15)
    bpy.ops.dynamorph.add_target(key="smile")
    assert outdated(baked) == ['target "smile" is new']
    baked.dynamorph.active_target_index = 2
    bpy.ops.dynamorph.remove_target()
    assert outdated(baked) == []
    baked.dynamorph.targets[1].mute = True
    assert outdated(baked) == ['Mute of "biceps" changed'] == model_changes(baked)
    baked.dynamorph.targets[1].mute = False
    baked.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()
    assert outdated(baked) == ['Pose of "biceps" changed']
    bpy.ops.dynamorph.remove_target()
    assert outdated(baked) == ['target "flexed" is gone']


def test_a_target_that_replaces_another_is_no_rename(scene, baked):
    """Both change at the same time, as in a rename."""
    baked.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.remove_target()
    scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="smile")
    assert outdated(baked) == ['target "smile" is new', 'target "flexed" is gone'] == model_changes(baked)
    bpy.ops.dynamorph.remove_target()
    bpy.ops.dynamorph.add_target(key="flexed")
    assert outdated(baked) == [] == model_changes(baked)


def test_gains_of_modes_count_once_they_are_not_one(baked):
    with_modes(baked)
    assert outdated(baked) == ["Gains changed"]
    baked.dynamorph.modes[2].gain = 1.0
    assert outdated(baked) == []


def test_another_build_is_another_model(baked, stand_in):
    stand_in.bytes = 1600
    bpy.ops.dynamorph.build()
    assert outdated(baked) == ["the model was built again"]
    bpy.ops.dynamorph.bake()
    assert outdated(baked) == []


def test_a_sculpt_makes_both_old(baked):
    block = baked.data.shape_keys.key_blocks["flexed"]
    block.points[0].co.x += 0.1
    storage.show_stale(baked)
    assert baked.dynamorph.model.stale == "shape of 'flexed' changed"
    assert outdated(baked) == ["shape of 'flexed' changed"]
    block.points[0].co.x -= 0.1
    storage.show_stale(baked)
    assert outdated(baked) == [] and not baked.dynamorph.model.stale


@pytest.mark.parametrize("name, value", [("modes", 7), ("material_model", "LINEAR"), ("cage_nodes", 900)])
def test_the_model_s_settings_are_named_until_they_are_reset(baked, name, value):
    model = baked.dynamorph.model
    before = getattr(model, name)
    setattr(model, name, value)
    assert model_changes(baked) == [f"{model.bl_rna.properties[name].name} changed"]
    setattr(model, name, before)
    assert model_changes(baked) == []
    model.blending = "FORCES"
    baked.dynamorph.targets[1].stiffness = 1e5
    assert model_changes(baked) == []


@pytest.mark.parametrize(
    "path, value, kept",
    [
        ("model.cage_nodes", 900, "rebuilds everything"),
        ("model.method", "STATIC", "rebuilds everything"),
        ("model.hold_head", True, "keeps the cage and rebuilds its hold and the modes"),
        ("model.modes", 7, "keeps the cage and its hold, and rebuilds the modes"),
        ("targets[1].region", "lower", "keeps the cage and its hold, and rebuilds the modes"),
    ],
)
def test_messages_say_which_part_is_built_again(baked, path, value, kept):
    owner, _, name = path.rpartition(".")
    setattr(baked.dynamorph.path_resolve(owner) if owner else baked.dynamorph, name, value)
    assert f"changed. Build Model {kept}" in " ".join(drawn(baked))
    assert kept in bpy.types.DYNAMORPH_OT_build.description(bpy.context, None)


def test_messages_say_which_part_an_edit_of_the_mesh_concerns(baked):
    baked.data.shape_keys.key_blocks["flexed"].points[0].co.x += 0.1
    storage.show_stale(baked)
    assert "shape of 'flexed' changed. Build Model keeps the cage and its hold" in " ".join(drawn(baked))
    baked.data.vertices[0].co.x += 0.1
    baked.data.shape_keys.key_blocks[0].points[0].co.x += 0.1
    storage.show_stale(baked)
    assert "Build Model rebuilds everything" in " ".join(drawn(baked))


def test_another_quality_makes_only_the_bake_old(baked):
    baked.dynamorph.model.solver = "FULL"
    assert model_changes(baked) == [] and outdated(baked) == ["Quality changed"]
    baked.dynamorph.model.solver = "REDUCED"
    assert outdated(baked) == []


# Animation ---------------------------------------------------------------------------------------------------------


def curve_of(rig):
    return animation.curves(rig.animation_data.action, rig.animation_data.action_slot)[0]


def looked(obj):
    staleness.look_at_animation(obj)
    return outdated(obj)


@pytest.mark.fault("A10")
def test_the_rig_s_animation_is_named_until_it_is_as_before(baked):
    rig = rig_of(baked)
    point = curve_of(rig).keyframe_points[1]
    before = point.co.y
    point.co.y += 0.1
    assert outdated(baked) == []  # drawing does not examine it
    assert looked(baked) == ['animation of "Arm Rig" changed']
    point.co.y = before
    assert looked(baked) == []
    rig.keyframe_insert("location", frame=3)
    assert looked(baked) == ['animation of "Arm Rig" changed']
    rig.keyframe_delete("location", frame=3)
    assert looked(baked) == []


def copied_rotation(rig):
    source = make_rig(bpy.context.scene, "Source")
    source.pose.bones["lower"].keyframe_insert("rotation_euler", frame=1)
    constraint = rig.pose.bones["lower"].constraints.new("COPY_ROTATION")
    constraint.target, constraint.subtarget = source, "lower"
    return source


def goal_of_ik(rig):
    goal = bpy.data.objects.new("Source", None)
    bpy.context.scene.collection.objects.link(goal)
    goal.keyframe_insert("location", frame=1)
    rig.pose.bones["lower"].constraints.new("IK").target = goal
    return goal


def driver_of_a_bone(rig):
    goal = goal_of_ik(rig)
    rig.pose.bones["lower"].constraints.remove(rig.pose.bones["lower"].constraints[0])
    driver = rig.pose.bones["upper"].driver_add("location", 0).driver
    driver.variables.new().targets[0].id = goal
    return goal


@pytest.mark.parametrize("follow", [copied_rotation, goal_of_ik, driver_of_a_bone])
def test_the_animation_of_what_the_rig_follows_counts(soft_arm, stand_in, follow):
    source = follow(rig_of(soft_arm))
    parent = bpy.data.objects.new("Above", None)
    bpy.context.scene.collection.objects.link(parent)
    source.parent = parent
    activate(soft_arm)
    bpy.ops.dynamorph.bake()
    assert looked(soft_arm) == []
    source.keyframe_insert("location", frame=7)
    assert looked(soft_arm) == ['animation of "Source" changed']
    source.keyframe_delete("location", frame=7)
    parent.keyframe_insert("location", frame=7)
    assert 'animation of "Above" changed' in looked(soft_arm)


def posed_and_keyed(rig):
    rig.pose.bones["lower"].rotation_euler.x = 0.3
    rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=4)


def another_action(rig):
    rig.animation_data.action = bpy.data.actions.new("Other")


def as_a_strip(rig):
    data = rig.animation_data
    data.nla_tracks.new().strips.new("walk", 1, data.action)


@pytest.mark.parametrize("edit", [posed_and_keyed, another_action, as_a_strip])
def test_an_edit_in_pose_mode_outdates_the_bake_at_once(baked, edit, monkeypatch):
    """With the armature active, and the panels draw again without the mouse over them."""
    rig, redrawn = rig_of(baked), []
    activate(rig)
    bpy.ops.object.mode_set(mode="POSE")
    assert "Arm: Baked" in drawn(rig)
    with soon():
        edit(rig)
        bpy.context.view_layer.update()
        monkeypatch.setattr(events, "redraw", redrawn.append)
    assert redrawn == [events.PANELS]
    assert "Arm: Bake out of date" in drawn(rig)
    assert 'animation of "Arm Rig" changed' in " ".join(drawn(rig))


def test_panels_follow_what_starts_and_stops(soft_arm, monkeypatch):
    """Also in the Properties editor, which Blender does not draw again after a button in the sidebar."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    redrawn = []
    monkeypatch.setattr(events, "redraw", redrawn.append)
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    bpy.ops.dynamorph.build()
    for change in (
        lambda: run_live.turn_on(soft_arm, bpy.context.scene),
        lambda: preview.begin_preview(soft_arm, bpy.types.DYNAMORPH_OT_shake_test),
        preview.end_preview,
        bpy.ops.dynamorph.show_plain,
        lambda: run_live.turn_off(soft_arm),
    ):
        redrawn.clear()
        change()
        assert events.PANELS in redrawn


def test_strips_count_and_so_do_parents(scene, soft_arm, stand_in):
    rig = rig_of(soft_arm)
    rig.parent = bpy.data.objects.new("Cart", None)
    scene.collection.objects.link(rig.parent)
    data = rig.animation_data
    strip = data.nla_tracks.new().strips.new("walk", 1, data.action)
    strip.action_slot = data.action_slot
    data.action = None
    bpy.ops.dynamorph.bake()
    assert looked(soft_arm) == []
    strip.scale = 1.5
    assert looked(soft_arm) == ['animation of "Arm Rig" changed']
    strip.scale = 1.0
    strip.frame_end = 20
    rig.parent.keyframe_insert("location", frame=1)
    assert looked(soft_arm) == ['animation of "Cart" changed']
    rig.parent = None
    assert looked(soft_arm) == ["parents, or what the rig follows, changed"]


def add_noise(data):
    curve_of(data.id_data).modifiers.new("NOISE").strength = 2.0


def fade(data):
    data.action_influence = 0.5


def fade_strip(data):
    data.nla_tracks[0].strips[0].fcurves.find("influence").keyframe_points[0].co.y = 0.5


def solo(data):
    data.nla_tracks[0].is_solo = True


def turn_off(data):
    data.use_nla = False


@pytest.mark.parametrize("change", [add_noise, fade, fade_strip, solo, turn_off])
def test_whatever_else_changes_what_the_rig_plays_counts(soft_arm, stand_in, change):
    data = rig_of(soft_arm).animation_data
    strip = data.nla_tracks.new().strips.new("walk", 1, data.action)
    strip.action_slot, strip.use_animated_influence, strip.influence = data.action_slot, True, 1.0
    strip.keyframe_insert("influence", frame=1)
    bpy.ops.dynamorph.bake()
    assert looked(soft_arm) == []
    change(data)
    assert looked(soft_arm) == ['animation of "Arm Rig" changed']


def test_an_animated_influence_counts_as_it_is_keyed(scene, soft_arm, stand_in):
    """Not as it is at the present frame."""
    data = rig_of(soft_arm).animation_data
    strip = data.nla_tracks.new().strips.new("walk", 1, data.action)
    strip.action_slot, strip.use_animated_influence = data.action_slot, True
    for frame, strip.influence in ((1, 0.2), (20, 0.9)):
        strip.keyframe_insert("influence", frame=frame)
    bpy.ops.dynamorph.bake()
    scene.frame_set(10)
    assert looked(soft_arm) == []


def test_a_renamed_rig_is_the_same(baked):
    rig_of(baked).name = "Skeleton"
    assert looked(baked) == []


def test_edits_are_looked_at_soon(baked):
    with soon():
        rig_of(baked).keyframe_insert("location", frame=3)
        bpy.context.view_layer.update()
        assert outdated(baked) == []
    assert outdated(baked) == ['animation of "Arm Rig" changed']


# Where it is shown, and kept ---------------------------------------------------------------------------------------


def test_the_badge_names_three(baked):
    badge = "Out of date: "
    assert not any(text.startswith(badge) for text in drawn(baked))
    baked.dynamorph.targets[1].stiffness = 5e5
    assert 'Out of date: Stiffness of "flexed" changed' in " ".join(drawn(baked))
    simulation = baked.dynamorph.simulation
    simulation.substeps, simulation.integrator, simulation.gravity, simulation.loop = 9, "EULER", 0.5, True
    assert "Substeps Per Frame changed, Integrator changed, and 2 more" in " ".join(drawn(baked))


def test_a_bake_is_up_to_date_after_loading(baked, tmp_path):
    for _ in range(2):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
        assert looked(bpy.data.objects["Arm"]) == []


def test_delete_bake_and_older_bakes_say_nothing(baked):
    baked.dynamorph.bake.inputs = ""
    assert outdated(baked) == []
    bpy.ops.dynamorph.bake()
    baked.dynamorph.targets[1].stiffness = 5e5
    bpy.ops.dynamorph.delete_bake()
    assert outdated(baked) == []


def test_drawing_is_cheap(soft_arm, stand_in):
    """The cost depends neither on the size of the mesh nor on the number of keyframes."""

    def drawing():
        bpy.ops.dynamorph.bake()
        assert outdated(soft_arm) == []
        return cost(lambda: (outdated(soft_arm), model_changes(soft_arm)))

    small = drawing()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=9)
    bpy.ops.object.mode_set(mode="OBJECT")
    for frame in range(1000, 2000):
        rig_of(soft_arm).keyframe_insert("scale", frame=frame)
    assert len(soft_arm.data.vertices) > 20_000
    assert drawing() < 3 * small


def test_a_bake_says_what_it_was_made_from_and_what_came_of_it(scene, baked):
    """The hashes are equal for the same scene."""
    record = baked.dynamorph.bake
    before = record.content_id, record.digest
    assert all(len(digest) == 64 for digest in before)
    bpy.ops.dynamorph.bake()
    assert (record.content_id, record.digest) == before
    baked.dynamorph.simulation.gravity = 0.5
    bpy.ops.dynamorph.bake()
    assert record.content_id != before[0]


def test_another_engine_counts(monkeypatch, baked):
    monkeypatch.setattr(staleness, "ENGINE", 2)
    assert outdated(baked) == ["Engine changed"] == model_changes(baked)


# Out of date, or not -----------------------------------------------------------------------------------------------


def test_a_range_within_the_baked_one_is_no_change(scene, baked):
    scene.frame_start, scene.frame_end = 5, 15
    assert outdated(baked) == []
    scene.frame_end = 25
    assert outdated(baked) == ["Frame End changed"]
    scene.frame_start, scene.frame_end = 0, 15
    assert outdated(baked) == ["Frame Start changed"]
    simulation = baked.dynamorph.simulation
    simulation.use_scene_range, simulation.frame_start, simulation.frame_end = False, 3, 4
    assert outdated(baked) == []


def test_the_range_of_a_loop_is_part_of_it(scene, soft_arm, stand_in):
    soft_arm.dynamorph.simulation.loop = True
    bpy.ops.dynamorph.bake()
    assert outdated(soft_arm) == []
    scene.frame_start = 5
    assert outdated(soft_arm) == ["Frame Start changed"]


# What the .blend says of itself ------------------------------------------------------------------------------------


BAD = [
    "nonsense", "null", "[]", "{}", "7", '"text"', "[" * 100_000,
    '{"version": 1, "targets": 3}',
    '{"version": 1, "targets": {"": []}}',
    '{"targets": {}, "animation": [], "content_id": ""}',
    '{"version": 99, "targets": {}, "animation": [], "content_id": ""}',
    '{"version": "1", "targets": {}, "animation": [], "content_id": ""}',
    '{"version": 1, "targets": {}, "animation": [[1, 2, 3]], "content_id": ""}',
    '{"version": 1, "targets": {}, "animation": [], "content_id": 5}',
    '{"version": 1, "targets": {}, "simulation": [], "animation": [], "content_id": ""}',
]  # fmt: skip


@pytest.mark.parametrize("text", BAD)
def test_a_record_of_a_bake_that_cannot_be_read_is_a_sentence(baked, text):
    unreadable = "The record of the last bake cannot be read: bake again"
    baked.dynamorph.bake.inputs = text
    assert outdated(baked) == [unreadable] and unreadable in " ".join(drawn(baked)).replace("  ", " ")
    bpy.ops.dynamorph.bake()
    assert outdated(baked) == []


@pytest.mark.parametrize(
    "text", ["nonsense", "null", "{}", "[[1]]", '[["a", "b", "c"]]', '{"version": 1, "animation": 3}', "9" * 999]
)
def test_a_record_of_an_animation_that_cannot_be_read_is_a_sentence(baked, text):
    baked.dynamorph.bake.animation = text
    assert outdated(baked) == ["The record of the last bake cannot be read: bake again"]
    assert looked(baked) == []


@pytest.mark.parametrize("text", [text for text in BAD if '"version": 1, "targets": {}' not in text])
def test_a_record_of_a_build_that_cannot_be_read_is_a_sentence(baked, text):
    unreadable = "The record of the last build cannot be read: press Build Model"
    baked.dynamorph.model.built = text
    assert model_changes(baked) == [unreadable] and unreadable in " ".join(drawn(baked))
    storage.show_stale(baked)
    bpy.ops.dynamorph.build()
    assert model_changes(baked) == []


@pytest.mark.parametrize("text", BAD)
def test_a_verdict_that_cannot_be_read_is_a_sentence(baked, text):
    baked.dynamorph.bake.verdict = text
    assert "The verdict on this bake cannot be read: bake again" in " ".join(drawn(baked))


def test_records_have_a_version(baked):
    model, bake = baked.dynamorph.model, baked.dynamorph.bake
    looked(baked)
    for record, name in ((model, "built"), (bake, "inputs"), (bake, "animation"), (bake, "verdict")):
        assert json.loads(getattr(record, name))["version"] == 1


def test_a_set_of_settings_with_unknown_fields_is_put_without_them(baked):
    settings = baked.dynamorph
    bpy.ops.dynamorph.copy_slot()
    other = json.loads(settings.live.other)
    assert other["version"] == 1
    other["materials"]["flexed"] |= {"stiffness": 7e4, "warmth": 3.0, "density": "heavy"}
    del other["materials"]["flexed"]["poisson"]
    other["simulation"] |= {"substeps": 9, "speed": 1, "integrator": "RK4", "amount": [1]}
    settings.live.other = json.dumps(other)
    before = settings.targets[1].material()
    bpy.ops.dynamorph.swap_slot()
    after = settings.targets[1].material()
    assert after.stiffness == 7e4 and (after.density, after.poisson) == (before.density, before.poisson)
    simulation = settings.simulation
    assert (simulation.substeps, simulation.integrator, simulation.amount) == (9, "BDF2", 1.0)


@pytest.mark.parametrize(
    "text",
    [
        "nonsense", "[]", "{}", '{"version": 99}',
        '{"version": 1, "materials": [], "frequencies": {}, "simulation": {}, "gains": []}',
        '{"version": 1, "materials": {}, "frequencies": {}, "simulation": {}, "gains": ["a"]}',
    ],
)  # fmt: skip
def test_a_set_of_settings_that_cannot_be_read_is_refused(baked, text):
    live = baked.dynamorph.live
    live.other = text
    refused(bpy.ops.dynamorph.swap_slot, "The other set of settings cannot be read: press Copy")
    assert live.slot == "A" and live.other == text
    bpy.ops.dynamorph.copy_slot()
    bpy.ops.dynamorph.swap_slot()
    assert live.slot == "B"
