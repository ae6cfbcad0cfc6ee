# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of a character is a soft skin of its own, with its own attachments; or one sentence says what to press."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from builders import activate, refused, rig_of, skinning_of
from robustness import bake, coarse
from test_attachments import add_attachment, make_sleeve

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph


@pytest.fixture
def character(soft_arm):
    """The arm with a sleeve, baked, in a scene of few frames."""
    bpy.context.scene.frame_end = 8
    sleeve = make_sleeve(coarse(soft_arm))
    add_attachment(soft_arm, sleeve)
    activate(soft_arm)
    bake(soft_arm)
    return soft_arm, sleeve, rig_of(soft_arm)


def select(*objects):
    for each in bpy.context.view_layer.objects:
        each.select_set(each in objects)
    bpy.context.view_layer.objects.active = objects[0]


def problems_of(obj):
    return [(problem.text, problem.fix) for problem in checks.problems(skinning_of(obj))]


def works(obj, worn=None):
    """Whether a soft skin bakes and is live, and moves the sleeve `worn`, or none."""
    activate(obj)
    bake(obj)
    assert [each.object for each in obj.dynamorph.attachments] == ([worn] if worn else [])
    assert not worn or worn.dynamorph.follows == obj
    OPS.live()
    playing = live.is_on(obj) and not live.problem(obj)
    OPS.live()
    return playing


def here(name):
    """The object of that name in this scene, whatever number it has got."""
    return next(each for each in bpy.context.scene.objects if each.name.split(".")[0] == name)


def full_scene(_folder, *_objects):
    bpy.ops.scene.new(type="FULL_COPY")


def duplicated(_folder, *objects):
    select(*objects)
    bpy.ops.object.duplicate()
    for each in objects:
        bpy.context.scene.collection.objects.unlink(each)


def appended(folder, *_objects):
    path = str(folder / "character.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.context.scene.frame_end = 8
    bpy.ops.wm.append(filepath=f"{path}/Object/Arm", directory=f"{path}/Object/", filename="Arm")


def pasted(_folder, *objects):
    select(*objects)
    bpy.ops.view3d.copybuffer()
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.context.scene.frame_end = 8
    bpy.ops.view3d.pastebuffer()


@pytest.mark.parametrize("copy", [duplicated, full_scene, appended, pasted])
def test_a_whole_copy_works_with_its_own_attachments(character, tmp_path, copy):
    arm, sleeve, _ = character
    copy(tmp_path, *character)
    assert problems_of(here("Arm")) == [] and works(here("Arm"), here("Sleeve"))
    if copy in (duplicated, full_scene):
        assert sleeve.dynamorph.follows == arm and here("Sleeve") != sleeve


def body_and_rig(arm, _sleeve, rig):
    select(arm, rig)
    bpy.ops.object.duplicate()


def body_alone(arm, _sleeve, _rig):
    select(arm)
    bpy.ops.object.duplicate()


def by_script(arm, _sleeve, _rig):
    copy = arm.copy()
    copy.data = arm.data.copy()
    bpy.context.scene.collection.objects.link(copy)


def separated(arm, _sleeve, _rig):
    activate(arm)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    for vertex in arm.data.vertices:
        vertex.select = vertex.co.z > 0.8
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="VERT")
    bpy.ops.mesh.separate(type="SELECTED")
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("copy", [body_and_rig, body_alone, by_script, separated])
def test_a_copy_without_its_clothes_says_what_to_press(character, copy):
    arm, sleeve, _ = character
    copy(*character)
    other = bpy.data.objects["Arm.001"]
    text = "'Sleeve' belongs to 'Arm': leave it there, or delete 'Arm.001' and duplicate all of 'Arm'"
    assert problems_of(other) == [(text, "LEAVE_ATTACHMENTS")] and problems_of(arm) == []
    activate(other)
    refused(OPS.bake, "'Sleeve' belongs to 'Arm': leave it there")
    OPS.fix(problem="LEAVE_ATTACHMENTS")
    assert works(other) and sleeve.dynamorph.follows == arm and sleeve.dynamorph.bake.keys
    if copy is not separated:
        assert works(arm, sleeve)


def test_of_two_bodies_on_one_rig_the_first_keeps_the_clothes(character):
    """Without a bake nothing else tells which of them is the copy."""
    arm, _, _ = character
    OPS.delete_bake()
    body_alone(*character)
    assert problems_of(arm) == []
    assert [fix for _, fix in problems_of(bpy.data.objects["Arm.001"])] == ["LEAVE_ATTACHMENTS"]


@pytest.mark.parametrize("baked", [False, True])
def test_a_copy_takes_the_clothes_over_when_the_original_is_deleted(character, baked):
    arm, sleeve, _ = character
    if not baked:
        OPS.delete_bake()
    body_alone(*character)
    copy = bpy.data.objects["Arm.001"]
    select(arm)
    bpy.ops.object.delete()
    activate(copy)
    assert problems_of(copy) == [] and works(copy, sleeve) and sleeve.dynamorph.follows == copy


def backup_of_clothes(_arm, sleeve, _rig):
    select(sleeve)
    bpy.ops.object.duplicate()
    bpy.context.object.hide_render = True


def source_of_weights(arm, _sleeve, rig):
    proxy = bpy.data.objects.new("Proxy", arm.data.copy())
    bpy.context.scene.collection.objects.link(proxy)
    proxy.parent = rig


@pytest.mark.parametrize("add", [backup_of_clothes, source_of_weights])
def test_a_copy_at_the_skin_holds_nothing(character, add):
    arm, _, _ = character
    before = extract.character(arm)
    add(*character)
    after = extract.character(arm)
    np.testing.assert_array_equal(after.cage_index, before.cage_index)
    np.testing.assert_array_equal(after.rigidity, before.rigidity)


def test_clothes_with_a_modifier_above_their_armature_are_refused(character):
    arm, sleeve, _ = character
    sleeve.modifiers.new("Mirror", "MIRROR")
    sleeve.modifiers.move(len(sleeve.modifiers) - 1, 0)
    activate(arm)
    refused(OPS.bake, "'Sleeve': modifier 'Mirror' comes before the Armature: apply it")


def test_a_linked_duplicate_says_what_to_press(character):
    select(*character)
    bpy.ops.object.duplicate(linked=True)
    other = bpy.data.objects["Arm.001"]
    activate(other)
    refused(OPS.bake, "Mesh 'Arm' is shared by 2 objects.*make it single-user")
    OPS.fix(problem="SINGLE_USER")
    activate(bpy.data.objects["Sleeve.001"])
    bpy.data.objects["Sleeve.001"].data = bpy.data.objects["Sleeve.001"].data.copy()
    assert works(other, bpy.data.objects["Sleeve.001"])
