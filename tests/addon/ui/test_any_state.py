# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever state the scene is in, no button and no panel of the add-on fails with a Python error."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.live import is_on
from builders import activate, make_arm, make_soft
from layout import Layout, drawn, is_there
from robustness import CALLS, CHANGING_NOTHING, OPS, coarse, motion


def mesh():
    return bpy.data.objects["Arm"]


def rig():
    return bpy.data.objects["Arm Rig"]


def plain():
    pass


def no_soft_skin():
    mesh().dynamorph.targets.clear()


def no_active_object():
    bpy.context.view_layer.objects.active = None


def camera_active():
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    activate(camera)


def other_scene():
    bpy.context.window.scene = bpy.data.scenes.new("Other")


def armature_object_deleted():
    bpy.data.objects.remove(rig())


def armature_data_deleted():
    bpy.data.armatures.remove(rig().data)


def mesh_deleted():
    activate(rig())
    bpy.data.objects.remove(mesh())


def bones_deleted():
    activate(rig())
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in list(rig().data.edit_bones):
        rig().data.edit_bones.remove(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(mesh())


def shape_keys_deleted():
    mesh().shape_key_clear()


def target_keys_deleted():
    for name in mesh().data.shape_keys.key_blocks.keys()[1:]:
        mesh().shape_key_remove(mesh().data.shape_keys.key_blocks[name])


def geometry_deleted():
    mesh().data.clear_geometry()


def groups_deleted():
    mesh().vertex_groups.clear()


def modifiers_deleted():
    mesh().modifiers.clear()


def mesh_not_in_the_scene():
    bpy.context.scene.collection.objects.unlink(mesh())
    activate(rig())


def rig_not_in_the_scene():
    bpy.context.scene.collection.objects.unlink(rig())


def both_hidden():
    mesh().hide_set(True)
    rig().hide_set(True)


def collection_excluded():
    hidden = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(hidden)
    for obj in (mesh(), rig()):
        hidden.objects.link(obj)
        bpy.context.scene.collection.objects.unlink(obj)
    bpy.context.view_layer.layer_collection.children["Hidden"].exclude = True


def enter(obj, mode):
    activate(obj)
    bpy.ops.object.mode_set(mode=mode)


def mesh_in_edit_mode():
    enter(mesh(), "EDIT")


def mesh_in_sculpt_mode():
    enter(mesh(), "SCULPT")


def mesh_in_weight_paint():
    enter(mesh(), "WEIGHT_PAINT")


def target_in_sculpt_mode():
    OPS.delete_bake()
    OPS.sculpt_target(mode="SCULPT")


def target_in_edit_mode():
    OPS.delete_bake()
    OPS.sculpt_target(mode="EDIT")


def painting_firmness():
    OPS.paint_firmness()


def live():
    OPS.delete_bake()
    OPS.live()
    bpy.context.scene.frame_set(2)


def live_in_edit_mode():
    live()
    mesh_in_edit_mode()


def live_without_armature():
    live()
    armature_object_deleted()


def live_without_its_key():
    live()
    shape_keys_deleted()


def rig_in_pose_mode():
    enter(rig(), "POSE")


def rig_in_edit_mode():
    enter(rig(), "EDIT")


def rig_in_edit_mode_below_the_active_mesh():
    enter(rig(), "EDIT")
    activate(mesh())


STATES = [
    plain, no_soft_skin, no_active_object, camera_active, other_scene, armature_object_deleted, armature_data_deleted,
    mesh_deleted, bones_deleted, shape_keys_deleted, target_keys_deleted, geometry_deleted, groups_deleted,
    modifiers_deleted, mesh_not_in_the_scene, rig_not_in_the_scene, both_hidden, collection_excluded,
    mesh_in_edit_mode, mesh_in_sculpt_mode, mesh_in_weight_paint, target_in_sculpt_mode, target_in_edit_mode,
    painting_firmness, live, live_in_edit_mode, live_without_armature, live_without_its_key, rig_in_pose_mode,
    rig_in_edit_mode, rig_in_edit_mode_below_the_active_mesh,
]  # fmt: skip
NOBODY = [no_active_object, camera_active, other_scene, mesh_deleted, mesh_not_in_the_scene, collection_excluded]
WORKING = [plain, rig_not_in_the_scene, both_hidden, mesh_in_sculpt_mode, mesh_in_weight_paint, rig_in_pose_mode]
BUTTONS = CALLS | CHANGING_NOTHING


def press(name):
    """A button is grayed out, or does its work, or says in words what is missing."""
    button = getattr(OPS, name)
    if not button.poll():
        return "gray"
    try:
        button("EXEC_DEFAULT", True, **BUTTONS[name][1])
    except RuntimeError as error:  # this is how an error report reaches Python
        assert "Traceback" not in str(error)
        return str(error)
    return "done"


def draw_panels(*names):
    for name in names:
        if is_there(getattr(bpy.types, name), bpy.context):
            assert drawn(bpy.context.object, name)


@pytest.fixture(scope="module")
def baked_file(addon, tmp_path_factory):
    """A file with a small character, built and baked by the real engine."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    obj = coarse(make_soft(make_arm(bpy.context.scene)))
    bpy.context.scene.frame_end = 5
    obj.dynamorph.simulation.substeps = 1
    OPS.bake()
    obj.dynamorph.active_target_index = 1
    path = str(tmp_path_factory.mktemp("states") / "arm.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    return path


@pytest.mark.parametrize("state", STATES)
def test_every_button_and_panel_in_every_state(baked_file, state):
    """Each button from the same file, brought into the state; after a gray one it still is in that state."""
    answers = {}
    for name in BUTTONS:
        if "gray" not in list(answers.values())[-1:]:
            bpy.ops.wm.open_mainfile(filepath=baked_file)
            state()
            draw_panels("DYNAMORPH_PT_sidebar", "DYNAMORPH_PT_physics", "DYNAMORPH_PT_object_data")
        answers[name] = press(name)
        if answers[name] != "gray":
            draw_panels("DYNAMORPH_PT_sidebar")
            bpy.context.scene.frame_set(3)
    if state in NOBODY:
        assert {answers[name] for name in CALLS if name != "bake_all"} == {"gray"}
    if state in WORKING:
        assert answers["bake"] == answers["build"] == answers["delete_bake"] == "done"


@pytest.mark.fault("G07")
@pytest.mark.parametrize(
    "state, words",
    [
        (mesh_in_edit_mode, "'Arm' is in Edit Mode: leave it first"),
        (rig_in_edit_mode, "Armature 'Arm Rig' is in Edit Mode: leave it first"),
        (armature_object_deleted, "'Arm' has no Armature modifier with an armature"),
        (armature_data_deleted, "'Arm' has no Armature modifier with an armature"),
        (shape_keys_deleted, "'Arm' has no shape keys"),
        (target_keys_deleted, "shape key of target 'flexed' is gone"),
        (geometry_deleted, "'Arm' has no faces"),
        (groups_deleted, "'Arm' has no vertex group"),
    ],
)
def test_bake_says_what_is_missing(scene, stand_in, state, words):
    make_soft(make_arm(scene))
    state()
    assert words in press("bake")


@pytest.mark.fault("G07", "P07")
@pytest.mark.parametrize("state", [mesh_in_sculpt_mode, mesh_in_weight_paint, rig_in_pose_mode, both_hidden])
def test_states_in_which_baking_works(scene, stand_in, state):
    """The mode is kept, and afterward the bake shows."""
    make_soft(make_arm(scene))
    still = motion(mesh(), frames=(5, 15))
    state()
    mode = bpy.context.object.mode
    assert press("bake") == "done"
    assert bpy.context.object.mode == mode
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    mesh().hide_set(False)
    assert np.abs(motion(mesh(), frames=(5, 15)) - still).max() > 1e-3


@pytest.mark.fault("G03")
def test_armature_deleted_while_its_bake_plays(scene, stand_in):
    """The skin keeps moving about the rest pose; nothing else is lost, and a new armature takes over."""
    obj = make_soft(make_arm(scene))
    OPS.bake()
    armature_object_deleted()
    moved = motion(obj, frames=(5, 15))
    assert np.abs(moved[0] - moved[1]).max() > 1e-3
    assert len(obj.dynamorph.targets) == 2 and len(obj.dynamorph.bake.keys) == 3
    other = make_arm(scene, "Other")
    obj.modifiers["Armature"].object = bpy.data.objects["Other Rig"]
    bpy.data.objects.remove(other)
    activate(obj)
    assert press("bake") == press("delete_bake") == "done"


def test_panels_refuse_what_does_not_exist(addon):
    """The stand-in for Blender's layout would notice it."""
    with pytest.raises(AssertionError):
        Layout([]).prop(bpy.context.scene, "no such property")
    with pytest.raises(KeyError):
        Layout([]).operator("dynamorph.no_such_operator")
    with pytest.raises(AssertionError, match="is not registered"):
        Layout([]).menu("DYNAMORPH_MT_no_such_menu")
    with pytest.raises(AssertionError, match="is not registered"):
        drawn(bpy.context.object, "DYNAMORPH_PT_no_such_panel")


@pytest.mark.parametrize("button", ["live", "remove_target"])
def test_live_is_not_half_ended(baked_file, button):
    """Blender removes no shape keys in Edit Mode, and without its soft skin nothing could turn Live off."""
    bpy.ops.wm.open_mainfile(filepath=baked_file)
    live_in_edit_mode()
    mesh().dynamorph.active_target_index = 0
    keys = mesh().data.shape_keys.key_blocks
    assert "'Arm' is in Edit Mode" in press(button)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert keys.keys() == ["Basis", "flexed", "smile", "Dynamorph Live"] and keys["flexed"].mute
    assert is_on(mesh()) and len(mesh().dynamorph.targets) == 2
    assert press(button) == "done"
    assert keys.keys() == ["Basis", "flexed", "smile"] and not keys["flexed"].mute
    assert not is_on(mesh())
