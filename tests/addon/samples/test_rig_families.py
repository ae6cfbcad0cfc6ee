# SPDX-License-Identifier: GPL-3.0-or-later
"""What docs/rigs.md says of rig families: one click on a human of each, a bake, and Delete Bake."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
import rig_families
import soft_parts
from bl_ext.user_default.dynamic_morph_targets.scene.check import body_checks, checks
from bl_ext.user_default.dynamic_morph_targets.ui import messages
from builders import activate, fingerprint, shown

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph
SCALP = 0.1  # meters below the top
HEADS = {"Rigify": "MCH-ROT-head"}  # the bone found as the head, where the family does not say
NOTES = {  # what is in Messages after the click
    "Rigify": "skinned with bendy bones",
    "Daz": "skinned with Preserve Volume",
    "MMD": "which Rigid Body moves: bake that to keyframes",
    "Auto-Rig Pro": "skinned with several Armature modifiers",
    "MPFB": "skinned with several Armature modifiers",
}
ATTACHED = {
    "Mixamo": {"Tops": "WITH_BODY", "Eyes": "RIGID"},
    "VRM": {"Face": "WITH_BODY", "Hair001": "WITH_BODY"},
    "Daz": {"Genesis 8 Female Graft": "WITH_BODY", "Genesis 8 Female Eyelashes Mesh": "RIGID"},
    "Human Generator": {
        "HG_Shirt": "WITH_BODY",
        "HG_Eyes": "RIGID",
        "HG_TeethUpper": "RIGID",
        "HG_TeethLower": "RIGID",
    },
    "Auto-Rig Pro": {"Eyes": "RIGID"},
    "MPFB": {"Human": "RIGID", "Human.low-poly": "RIGID"},  # its helper geometry, and its eyes
    "Character Creator": {"CC_Base_Eye": "RIGID", "CC_Base_Teeth": "RIGID", "Tight_shirt": "WITH_BODY"},
    "MetaHuman": {
        "head_lod0_mesh": "WITH_BODY",
        "head_lod1_mesh": "WITH_BODY",
        "body_lod1_mesh": "WITH_BODY",
        "eyeLeft_lod0_mesh": "RIGID",
    },
}


@pytest.fixture(scope="module", params=rig_families.FAMILIES)
def tried(addon, request):
    """A family's human: as it was, after one click, baked, and after Delete Bake."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    figure = rig_families.make(request.param)
    body, face = figure.body, figure.face or figure.body
    plain = shown([body, face])
    OPS.add_soft_skin()
    body_checks.look(body)  # as a timer does in a window
    found = SimpleNamespace(
        name=request.param,
        figure=figure,
        plain=plain,
        said=[problem.text for problem, _ in messages.messages(body)],
        problems=list(checks.problems(body)),
        soft=bool(body.dynamorph.targets),
        head=body.dynamorph.model.head,
        attached={(each.object or body).name: each.attached_by for each in body.dynamorph.attachments},
        before=fingerprint(body),
    )
    body.dynamorph.model.cage_nodes, body.dynamorph.model.modes = 400, 20
    OPS.bake()
    found.baked = shown([body, face])
    OPS.delete_bake()
    found.after, found.restored = fingerprint(body), shown([body, face])
    found.parts = soft_parts.found_right(body, [body] if face == body else [body, face])
    return found


def test_one_click_makes_the_body_soft_and_holds_its_head(tried):
    assert tried.soft and tried.problems == []
    assert tried.head == HEADS.get(tried.name, tried.figure.family.head)
    assert tried.attached == ATTACHED.get(tried.name, {})


def test_its_soft_parts_are_found(tried):
    assert tried.parts == ["Chest", "Belly", "Glutes", "Thighs", "Upper Arms", "Cheeks"]


def test_what_is_worth_knowing_is_in_the_messages(tried):
    """Of the others sizes and scales are right."""
    if tried.name in NOTES:
        assert NOTES[tried.name] in " ".join(tried.said)
    else:
        assert tried.said == []


def test_the_bake_moves_the_body_and_not_the_head(tried):
    body, face = (baked - plain for baked, plain in zip(tried.baked, tried.plain, strict=True))
    assert np.isfinite(body).all()
    assert 0.01 < np.linalg.norm(body, axis=2).max() < 0.2
    height = tried.plain[1][0, :, 2]
    assert np.linalg.norm(face[:, height > height.max() - SCALP], axis=2).max() < 0.004


def test_delete_bake_restores_it(tried):
    assert tried.after == tried.before
    for restored, plain in zip(tried.restored, tried.plain, strict=True):
        np.testing.assert_array_equal(restored, plain)


def test_the_armature_finds_its_body(scene):
    """The artist selects the armature, or an eye, and presses the button all the same."""
    figure = rig_families.make("Character Creator")
    for chosen in (figure.rig, figure.others["CC_Base_Eye"]):
        activate(chosen)
        OPS.add_soft_skin()
        assert figure.body.dynamorph.targets
        OPS.remove_soft_skin()


@pytest.mark.parametrize("name", ["Mixamo", "Unreal", "Character Creator"])
def test_one_click_is_enough_after_fbx_too(scene, tmp_path, name):
    """Blender's own exporter and importer make the scales, rotations and keys that users have."""
    figure = rig_families.make(name)
    bpy.ops.export_scene.fbx(filepath=str(tmp_path / "it.fbx"), add_leaf_bones=False)
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.ops.import_scene.fbx(filepath=str(tmp_path / "it.fbx"))
    body = bpy.data.objects[figure.family.body]
    activate(body)
    OPS.add_soft_skin()
    body_checks.look(body)
    assert [problem.text for problem, _ in messages.messages(body)] == []
    assert body.dynamorph.model.head == figure.family.head
    assert {each.object.name: each.attached_by for each in body.dynamorph.attachments} == ATTACHED.get(name, {})
