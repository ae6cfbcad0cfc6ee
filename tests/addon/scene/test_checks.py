# SPDX-License-Identifier: GPL-3.0-or-later
"""Problems are named, and a button fixes those that it can fix; the cage and its painted groups."""

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene import skinning as scene_skinning
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.check import body_checks, checks
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.read.source import Source
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.write.authoring.fixes import FIXES
from builders import activate, make_mesh, make_rig, refused, rig_of, soon, warnings_of
from layout import drawn
from pins import with_pins
from test_extract import (
    absolute_keys,
    bendy,
    edit_mode,
    empty_armature_modifier,
    envelopes,
    hidden_modifier,
    no_armature,
    no_keys,
    preserve_volume,
    rest_position,
    subdivided_first,
    two_armatures,
)

OPS = bpy.ops.dynamorph


def found(obj):
    skinning = scene_skinning.Skinning.of(obj)
    return [*checks.problems(skinning), *checks.next_steps(obj), *checks.notes(skinning)]


def fixes(obj):
    return [problem.fix for problem in found(obj) if problem.fix]


# What a button puts right ------------------------------------------------------------------------------------------


def rig_in_edit_mode(obj):
    activate(rig_of(obj))
    bpy.ops.object.mode_set(mode="EDIT")
    activate(obj)


def disabled_armature(obj):
    rig_of(obj).hide_viewport = True


def envelope_multiply(obj):
    for bone in rig_of(obj).data.bones:
        bone.use_envelope_multiply = True


def parent_that_deforms(obj):
    obj.parent, obj.parent_type = rig_of(obj), "ARMATURE"


def shared_mesh(obj):
    other = bpy.data.objects.new("Other", obj.data)
    bpy.context.scene.collection.objects.link(other)


def masked_first(obj):
    obj.modifiers.new("Mask", "MASK").vertex_group = "upper"
    obj.modifiers.move(1, 0)


def pinned_key(obj):
    obj.show_only_shape_key = True


PUT_RIGHT = [
    (edit_mode, "LEAVE_EDIT_MODE"),
    (rig_in_edit_mode, "LEAVE_EDIT_MODE"),
    (rest_position, "POSE_POSITION"),
    (disabled_armature, "ENABLE_ARMATURE"),
    (hidden_modifier, "ENABLE_MODIFIER"),
    (envelopes, "ENVELOPES"),
    (envelope_multiply, "ENVELOPE_MULTIPLY"),
    (masked_first, "MOVE_BELOW"),
    (absolute_keys, "RELATIVE_KEYS"),
    (no_armature, "ADD_ARMATURE"),
    (empty_armature_modifier, "ADD_ARMATURE"),
    (parent_that_deforms, "PARENT_OBJECT"),
    (shared_mesh, "SINGLE_USER"),
    (pinned_key, "UNPIN"),
]


def test_a_shared_mesh_is_made_single_user_in_edit_mode_too(soft_arm):
    shared_mesh(soft_arm)
    activate(soft_arm)
    bpy.ops.object.mode_set(mode="EDIT")
    meshes = set(bpy.data.meshes)
    OPS.fix(problem="SINGLE_USER")
    assert found(soft_arm) == [] and {soft_arm.data} == set(bpy.data.meshes) - meshes


@pytest.mark.fault("K01", "M17")
@pytest.mark.parametrize("spoil, fix", PUT_RIGHT, ids=lambda value: getattr(value, "__name__", ""))
def test_one_button_puts_it_right_and_undo_brings_it_back(soft_arm, spoil, fix):
    before = extract.character(soft_arm)
    spoil(soft_arm)
    assert fixes(soft_arm) == [fix]
    assert drawn(soft_arm).count("dynamorph.fix") == 1
    bpy.ops.ed.undo_push(message="spoiled")
    assert OPS.fix(problem=fix) == {"FINISHED"}
    assert found(soft_arm) == [] and "dynamorph.fix" not in drawn(soft_arm)
    after = extract.character(soft_arm)
    for name in ("vertices", "weights", "to_bind", "bone_segments"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    bpy.ops.ed.undo_push(message="fixed")
    bpy.ops.ed.undo()
    if fix != "LEAVE_EDIT_MODE":  # Blender uses other undo steps within Edit Mode
        assert fixes(bpy.data.objects["Arm"]) == [fix]


def test_every_fix_is_tried_here():
    tried = {fix for _, fix in PUT_RIGHT} | {"ADD_BASIS", "PERSON_SIZE", "WEIGHT_LIKE_NEAREST", "LOCK_INTERFACE"}
    # test_collision_section.py, test_cuts.py, test_bodies.py, test_applying.py, test_copies.py
    elsewhere = {"FULL_QUALITY", "COLLIDE", "NO_HEAD", "APPLY", "LEAVE_ATTACHMENTS"}
    assert tried | elsewhere == set(FIXES)


@pytest.mark.fault("K01")
def test_a_missing_basis_is_added(soft_arm):
    no_keys(soft_arm)
    assert fixes(soft_arm) == ["ADD_BASIS"]
    OPS.fix(problem="ADD_BASIS")
    assert soft_arm.data.shape_keys.reference_key.name == "Basis"
    assert [problem.text for problem in found(soft_arm)] == [
        "'Arm': the shape key of target 'flexed' is gone: remove the target"
    ]


def test_fixes_without_their_problem_do_nothing(soft_arm):
    for fix in FIXES:
        refused(OPS.fix, "does not have this problem", problem=fix)
    assert len(soft_arm.modifiers) == 1 and len(soft_arm.data.shape_keys.key_blocks) == 3


def test_moving_below_keeps_the_order_of_the_others(soft_arm):
    for name, kind in (("Some", "MASK"), ("Squeeze", "CAST"), ("Others", "MASK")):
        soft_arm.modifiers.new(name, kind)
        soft_arm.modifiers.move(len(soft_arm.modifiers) - 1, len(soft_arm.modifiers) - 2)
    soft_arm.modifiers.new("Last", "SUBSURF")
    assert [m.name for m in soft_arm.modifiers] == ["Some", "Squeeze", "Others", "Armature", "Last"]
    OPS.fix(problem="MOVE_BELOW")
    assert [m.name for m in soft_arm.modifiers] == ["Squeeze", "Armature", "Some", "Others", "Last"]
    assert [problem.text for problem in found(soft_arm)] == [
        "'Arm': modifier 'Squeeze' before the Armature is not simulated"
    ]


def test_the_armature_is_found_by_parent_or_by_bones_of_the_groups_names(scene, arm):
    skinning = scene_skinning
    other = make_rig(scene, "Other", bones=1)
    activate(arm)
    no_armature(arm)
    assert skinning.armature_for(arm) is None and fixes(arm) == []  # it is not clear which one is meant
    assert not OPS.add_soft_skin.poll() and "dynamorph.add_soft_skin" in drawn(arm)
    arm.parent = other
    assert skinning.armature_for(arm) == other
    arm.parent_type, arm.parent_bone = "BONE", "upper"  # it already moves with the armature
    assert skinning.armature_for(arm) is None
    arm.parent = None
    other.data.bones["upper"].name = "pole"
    assert skinning.armature_for(arm) == bpy.data.objects["Arm Rig"]
    arm.modifiers.new("Subdivision", "SUBSURF")
    OPS.fix(problem="ADD_ARMATURE")
    assert [m.name for m in arm.modifiers] == ["Armature", "Subdivision"] and OPS.add_soft_skin.poll()


def test_a_linked_armature_is_left_alone(scene, soft_arm, tmp_path):
    rest_position(soft_arm)
    envelope_multiply(soft_arm)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "arm.blend"), link=True) as (_, data):
        data.objects = ["Arm"]
    obj = data.objects[0].make_local()
    bpy.context.scene.collection.objects.link(obj)
    activate(obj)
    for fix in fixes(obj):
        refused(OPS.fix, "Armature 'Arm Rig' is linked.*make it local", problem=fix)
    assert fixes(obj) == ["POSE_POSITION", "ENVELOPE_MULTIPLY"]


# Order, cost, and the button that begins ---------------------------------------------------------------------------


def test_problems_come_in_the_order_of_work(soft_arm):
    spoiling = pinned_key, absolute_keys, envelope_multiply, rest_position, envelopes, subdivided_first, edit_mode
    for spoil in spoiling:
        spoil(soft_arm)
    assert fixes(soft_arm) == [
        "LEAVE_EDIT_MODE", "APPLY", "ENVELOPES", "POSE_POSITION", "ENVELOPE_MULTIPLY", "RELATIVE_KEYS", "UNPIN",
    ]  # fmt: skip
    while fixes(soft_arm):
        OPS.fix(problem=fixes(soft_arm)[0])
    assert found(soft_arm) == []


def two_armatures_disabled(obj):
    """The same armature twice, so that each of its problems is reported once."""
    two_armatures(obj)
    obj.modifiers["Second"].show_viewport = False
    rig_of(obj).hide_viewport = True


@pytest.mark.parametrize(
    "change, words",
    [(preserve_volume, "Preserve Volume"), (bendy, "bendy bones"), (two_armatures, "several Armature modifiers")],
)
def test_what_blender_skins_itself_is_no_problem_but_a_note(soft_arm, change, words):
    change(soft_arm)
    (note,) = found(soft_arm)
    assert words in note.text and "takes longer" in note.text and not note.fix
    assert extract.character(soft_arm).probed


def test_an_armature_modifier_that_is_off_does_not_count(soft_arm):
    """As imports leave them. One that is off in the viewport alone would be seen in renders."""
    left = soft_arm.modifiers.new("Left", "ARMATURE")
    left.object = rig_of(soft_arm)
    left.show_viewport = left.show_render = False
    assert found(soft_arm) == [] and not extract.character(soft_arm).probed
    left.show_render = True
    assert fixes(soft_arm) == ["ENABLE_MODIFIER"]


def test_the_state_of_an_armature_that_skins_nothing_does_not_count(soft_arm):
    """As the second one of Auto-Rig Pro, which it disables."""
    other = make_rig(bpy.context.scene, "Other", bones=1)
    other.data.bones["upper"].name = "unused"
    soft_arm.modifiers.new("Other", "ARMATURE").object = other
    other.hide_viewport = True
    (note,) = found(soft_arm)
    assert "several Armature modifiers" in note.text
    other.data.bones["unused"].name = "upper"
    assert fixes(soft_arm) == ["ENABLE_ARMATURE"]


@pytest.mark.fault("R10")
@pytest.mark.parametrize("by_bone", [True, False])
def test_what_moves_with_a_rigid_body_is_in_the_messages(scene, soft_arm, by_bone):
    """The rig is read in a scene of its own, where no physics runs."""
    rig, ball = rig_of(soft_arm), make_mesh(scene, "Ball", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    if by_bone:
        rig.pose.bones["upper"].constraints.new("CHILD_OF").target = ball
    else:
        rig.parent = ball
    assert found(soft_arm) == []
    with bpy.context.temp_override(object=ball, active_object=ball, selected_objects=[ball]):
        bpy.ops.rigidbody.object_add(type="ACTIVE")
    (note,) = found(soft_arm)
    assert "'Arm' moves with 'Ball', which Rigid Body moves" in note.text and "bake that to keyframes" in note.text
    ball.rigid_body.kinematic = True
    assert found(soft_arm) == []


def test_all_armature_modifiers_are_put_right(soft_arm):
    two_armatures_disabled(soft_arm)
    assert fixes(soft_arm) == ["ENABLE_MODIFIER", "ENABLE_ARMATURE"]
    for fix in fixes(soft_arm):
        OPS.fix(problem=fix)
    assert fixes(soft_arm) == [] and soft_arm.modifiers["Second"].show_viewport


def test_drawing_reads_no_points_and_no_weights(soft_arm, monkeypatch):
    monkeypatch.setattr(references, "key_points", None)
    monkeypatch.setattr(mesh_data.VertexGroups, "__init__", None)
    assert found(soft_arm) == [] and checks.outgrown(soft_arm) == ""


def test_nothing_but_the_button_where_nothing_is_wrong(arm):
    shown = ["Not a soft skin yet", "dynamorph.add_soft_skin", "Nothing needs attention"]
    assert drawn(arm) == shown
    stone = drawn(make_mesh(bpy.context.scene, "Stone", *scenes.tube()))
    assert stone[:2] == ["See Messages", "dynamorph.add_soft_skin"] and shown[2] not in stone


def added(capfd):
    """The warnings of Add Soft Skin."""
    capfd.readouterr()
    assert OPS.add_soft_skin() == {"FINISHED"}
    said = capfd.readouterr().out.splitlines()
    return [line.removeprefix("Warning: ") for line in said if line.startswith("Warning: ")]


def test_a_soft_skin_is_added_whatever_can_be_solved_later(arm, capfd):
    for spoil in (envelopes, rest_position, envelope_multiply):
        spoil(arm)
    for group in arm.vertex_groups:
        group.remove([3, 4, 5])
    arm.scale = (100.0, 100.0, 100.0)
    bpy.context.view_layer.update()
    warnings = " ".join(added(capfd))
    for words in (
        "bone envelopes",
        "rest position",
        "Envelope Multiply",
        " kg and will move like something of that size: check the scale",
        "3 of the 272 vertices of 'Arm' have no",
    ):
        assert words in warnings
    assert len(arm.dynamorph.targets) == 1
    shown = " ".join(drawn(arm))  # each is reported once, so that the report stays readable
    assert (
        shown.count("check the scale") == shown.count("have no bone weight") == shown.count("'Arm' is skinned by") == 1
    )


def test_a_sound_mesh_is_added_without_a_word(arm, capfd):
    assert added(capfd) == []


def test_a_soft_skin_is_added_in_edit_mode(arm, capfd):
    arm.shape_key_clear()
    edit_mode(arm)
    assert added(capfd) == ["'Arm' is in Edit Mode: leave it first"]
    assert fixes(arm) == ["LEAVE_EDIT_MODE"]
    OPS.fix(problem="LEAVE_EDIT_MODE")
    assert found(arm) == []


@pytest.mark.fault("M19")
def test_vertices_that_stay_behind_are_counted(soft_arm):
    for group in soft_arm.vertex_groups:
        group.remove([3, 4, 5])
    (warning,) = warnings_of(soft_arm)
    assert warning.startswith("3 of the 272 vertices of 'Arm' have no bone weight and stay behind")


# A body that looks unintended, before the click ----------------------------------------------------------------------


def after_a_look(obj) -> str:
    """The tab, once what it asks about the body has been answered: by a timer in a window."""
    with soon():
        drawn(obj)
    return " ".join(drawn(obj))


def unweight(obj, vertices):
    for group in obj.vertex_groups:
        group.remove(vertices)


def scaled(obj, factor: float):
    """As a character that was modeled in other units: its rig with it."""
    for each in (obj, rig_of(obj)):
        each.scale = (factor, factor, factor)
    bpy.context.view_layer.update()


@pytest.mark.parametrize(
    "factor, words",
    [(10.0, "'Arm' is 20 m long, weighs 551,064 kg"), (1.6, "'Arm' is 3.2 m long, weighs 2,257 kg"), (0.01, "0.02 m")],
)
def test_an_unlikely_size_or_mass_is_told_before_the_click_and_mended(arm, factor, words):
    assert "check the scale" not in after_a_look(arm)
    scaled(arm, factor)
    shown = after_a_look(arm)
    assert words in shown and shown.count("check the scale") == 1 and "dynamorph.fix" in shown
    assert OPS.fix(problem="PERSON_SIZE") == {"FINISHED"}
    assert body_checks.size_now(arm) == pytest.approx(1.7)
    assert "check the scale" not in after_a_look(arm)


def test_the_fix_of_the_scale_turns_units_on(arm):
    units = bpy.context.scene.unit_settings
    units.system = "NONE"
    scaled(arm, 10.0)
    OPS.fix(problem="PERSON_SIZE")
    assert units.system == "METRIC" and units.scale_length == pytest.approx(1.7 / 20.0)


def test_the_size_stays_among_the_messages_through_live_and_bake(arm, stand_in):
    scaled(arm, 10.0)
    for press in (OPS.add_soft_skin, OPS.build, OPS.bake):
        press()
        assert after_a_look(arm).count("check the scale") == 1
    OPS.fix(problem="PERSON_SIZE")
    assert "check the scale" not in after_a_look(arm)


def test_vertices_without_weights_are_told_before_the_click_and_weighted_like_their_neighbors(arm):
    before = Source.of(scene_skinning.Skinning.of(arm)).weights
    unweight(arm, [3, 4, 5])
    assert "3 of the 272 vertices of 'Arm' have no bone weight" in after_a_look(arm)
    assert OPS.fix(problem="WEIGHT_LIKE_NEAREST") == {"FINISHED"}
    after = Source.of(scene_skinning.Skinning.of(arm)).weights
    np.testing.assert_allclose(after, before, atol=0.2)  # as smooth as the weights were
    assert (np.delete(after, [3, 4, 5], axis=0) == np.delete(before, [3, 4, 5], axis=0)).all()
    assert "no bone weight" not in after_a_look(arm)


def test_weights_that_are_painted_are_looked_at_again(arm):
    assert "no bone weight" not in after_a_look(arm)
    unweight(arm, [3])
    arm.data.update()
    bpy.context.view_layer.update()
    assert "1 of the 272 vertices" in after_a_look(arm)


def test_a_pose_asks_for_no_other_look(soft_arm, monkeypatch):
    after_a_look(soft_arm)
    monkeypatch.setattr(body_checks, "unintended", None)
    bpy.context.scene.frame_set(10)
    rig_of(soft_arm).pose.bones["lower"].rotation_euler.x = 0.3
    bpy.context.view_layer.update()
    after_a_look(soft_arm)


# The mesh edited after the build -----------------------------------------------------------------------------------


def test_a_mesh_with_other_vertices_is_built_again_and_loses_nothing(soft_arm, stand_in):
    OPS.build()
    assert checks.outgrown(soft_arm) == ""
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    texts = drawn(soft_arm)
    assert f"'Arm' has {len(soft_arm.data.vertices)} vertices now, its model was built for 272." in " ".join(texts)
    assert "Model out of date" in texts and "dynamorph.build" in texts
    assert [target.name for target in soft_arm.dynamorph.targets] == ["Neutral", "flexed"]
    assert soft_arm.dynamorph.model.content_id
    OPS.build()
    assert checks.outgrown(soft_arm) == "" and "Model out of date" not in drawn(soft_arm)


# The cage ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def coarse_arm(arm):
    """A soft skin without targets, with a coarse cage that builds in a second."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    activate(arm)
    OPS.add_soft_skin()
    with_pins(arm)
    arm.dynamorph.model.cage_nodes = 200
    arm.dynamorph.model.modes = 6
    return arm


def with_target(obj):
    bpy.context.scene.frame_set(20)
    OPS.add_target(key="flexed")
    bpy.context.scene.frame_set(1)


def test_cage_then_model_then_bake(coarse_arm):
    record = coarse_arm.dynamorph.model
    assert OPS.build_cage() == {"FINISHED"}
    cage = model_store.load_model(coarse_arm)
    assert 150 < len(cage.nodes) < 250 and 0 < cage.pinned.sum() < len(cage.nodes)
    assert record.cage.startswith(f"{len(cage.nodes)} nodes, {len(cage.tets)} tetrahedra, ")
    assert (
        record.cage in " ".join(drawn(coarse_arm, "DYNAMORPH_PT_physics")) and record.stale == "only the cage is built"
    )
    with_target(coarse_arm)
    assert model_store.stale_reasons(coarse_arm, extract.character(coarse_arm)) == ["only the cage is built"]
    with pytest.raises(errors.SceneError, match="only the cage is built.*press Build Model"):
        model_store.fit_input(coarse_arm, coarse_arm.dynamorph.targets[1])
    assert OPS.bake() == {"FINISHED"}
    np.testing.assert_array_equal(model_store.load_model(coarse_arm).tets, cage.tets)
    assert record.stale == "" and len(coarse_arm.dynamorph.bake.keys) > 0


def test_a_finished_model_outlives_build_cage(coarse_arm):
    record = coarse_arm.dynamorph.model
    with_target(coarse_arm)
    OPS.build()
    content_id, summary = record.content_id, record.summary
    job = Job(coarse_arm, goal="BUILD_CAGE")
    batch.run(job)
    assert job.summary() == "the cage is up to date"
    assert (record.content_id, record.summary, record.stale) == (content_id, summary, "")
    record.cage_nodes = 300
    OPS.build_cage()
    assert record.content_id != content_id and record.summary == "" and record.stale == "only the cage is built"


def test_fitting_to_the_shot_needs_no_shot_for_the_cage(coarse_arm):
    with_target(coarse_arm)
    coarse_arm.dynamorph.model.fit_to_shot = True
    job = Job(coarse_arm, goal="BUILD_CAGE")
    list(batch.Batch([job], "BUILD_CAGE").read())
    assert not job.input.has_shot


# Firmness ----------------------------------------------------------------------------------------------------------


def weights(obj):
    return mesh_data.group_weights(obj, ["Firmness"])[:, 0]


@pytest.mark.parametrize("mode", ["OBJECT", "SCULPT", "EDIT"])
def test_paint_and_back(soft_arm, mode):
    bpy.ops.object.mode_set(mode=mode)
    groups = [*soft_arm.vertex_groups.keys()]
    assert OPS.paint_firmness() == {"FINISHED"}
    assert soft_arm.mode == "WEIGHT_PAINT" and soft_arm.vertex_groups.active.name == "Firmness"
    assert [*soft_arm.vertex_groups.keys()] == [*groups, "Firmness"]
    assert soft_arm.dynamorph.firmness_group == "Firmness"
    assert (weights(soft_arm) == 0.5).all() and "paint.weight_set" in drawn(soft_arm)
    assert OPS.paint_firmness() == {"FINISHED"}
    assert soft_arm.mode == mode and "paint.weight_set" not in drawn(soft_arm)
    OPS.paint_firmness()  # the group that exists
    assert [*soft_arm.vertex_groups.keys()] == [*groups, "Firmness"]


def test_paint_from_pose_mode_and_back(soft_arm):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode="POSE")
    OPS.paint_firmness()
    assert bpy.context.object == soft_arm and soft_arm.mode == "WEIGHT_PAINT"
    OPS.paint_firmness()
    assert bpy.context.object == rig and rig.mode == "POSE" and soft_arm.mode == "OBJECT"
    activate(soft_arm)
    OPS.paint_firmness()
    OPS.paint_firmness()
    assert bpy.context.object == soft_arm and soft_arm.mode == "OBJECT"


def test_a_hidden_mesh_is_not_painted(soft_arm):
    activate(rig_of(soft_arm))
    soft_arm.hide_viewport = True
    refused(OPS.paint_firmness, "'Arm' is hidden: show it")
    assert "Firmness" not in soft_arm.vertex_groups


def test_what_is_not_painted_stays_as_it_is(soft_arm):
    np.testing.assert_array_equal(extract.character(soft_arm).firmness, 0.5)
    soft_arm.vertex_groups.new(name="Firm").add([1, 2], 0.25, "REPLACE")
    soft_arm.vertex_groups["Firm"].add([3], 1.0, "REPLACE")
    soft_arm.dynamorph.firmness_group = "Firm"
    np.testing.assert_array_equal(extract.character(soft_arm).firmness[:5], [0.5, 0.25, 0.25, 1.0, 0.5])
    soft_arm.dynamorph.firmness_group = "Gone"
    with pytest.raises(errors.SceneError, match="'Arm'.*'Gone' of Firmness is gone"):
        extract.character(soft_arm)


def test_painting_makes_the_model_old(coarse_arm):
    with_target(coarse_arm)
    OPS.build()
    OPS.paint_firmness()
    OPS.paint_firmness()
    assert staleness.model_age(coarse_arm) == []  # nothing is painted
    OPS.paint_firmness()
    coarse_arm.vertex_groups["Firmness"].add([*range(100)], 0.9, "REPLACE")
    OPS.paint_firmness()
    assert coarse_arm.dynamorph.model.stale == "Firmness changed"
    OPS.build()
    for chosen, said in (("lower", "Firmness changed"), ("Firmness", "")):
        with soon():
            coarse_arm.dynamorph.firmness_group = chosen
        assert coarse_arm.dynamorph.model.stale == said
        assert ("Build Model keeps the cage and rebuilds its hold" in " ".join(drawn(coarse_arm))) == bool(said)
    model = model_store.load_model(coarse_arm)
    assert model.stiffness.min() == pytest.approx(1.0, rel=0.1)
    assert model.stiffness.max() == pytest.approx(4.0, rel=0.1) and (model.stiffness <= 4.0 + 1e-6).all()
    np.testing.assert_array_equal(model.unpainted.stiffness, 1.0)
