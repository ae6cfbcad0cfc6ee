# SPDX-License-Identifier: GPL-3.0-or-later
"""Each question about a mesh is asked of Blender once while a character is read, whoever needs the answer."""

import sys
from collections import Counter
from contextlib import contextmanager

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input, job
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.ui import messages
from bl_ext.user_default.dynamic_morph_targets.write.authoring import attachments
from figures import make_figure
from installed import PACKAGE
from robustness import coarse

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

READINGS = {
    "armature_modifiers", "deforming_bones", "mesh_triangles", "rest_points", "rest_skeleton", "rig_of",
    "VertexGroups.__init__", "worlds_at_start",
}  # fmt: skip


@contextmanager
def counted():
    """How often each of READINGS is called, by its name and the name of what it is about."""
    counts = Counter()

    def count(frame, event, _argument):
        code = frame.f_code
        if event == "call" and code.co_qualname in READINGS and PACKAGE.name in code.co_filename:
            about = frame.f_locals["obj" if "obj" in frame.f_locals else code.co_varnames[0]]
            counts[code.co_qualname, getattr(about, "name", "")] += 1

    sys.setprofile(count)
    try:
        yield counts
    finally:
        sys.setprofile(None)


def read_for_a_bake(obj):
    with counted() as counts:
        bake_input.read(job.Job(obj, "BAKE").request)
    print(*(f"{name} of {about}: {count}" for (name, about), count in sorted(counts.items())), sep="\n")
    print("calls:", counts.total())
    return counts


def test_a_body_of_several_meshes_is_read_once(scene):
    found = make_figure(scene)
    bpy.ops.dynamorph.add_soft_skin()
    counts = read_for_a_bake(coarse(found["Body"]))
    assert {about for _, about in counts} >= {"Body", "Top", "Cap", "Eye", "Figure Rig"}
    # References follow renames before anything is read.
    first = {("armature_modifiers", "Body"), ("rest_skeleton", "Figure Rig")}
    assert {key: count for key, count in counts.items() if count > 1} == dict.fromkeys(first, 2)
    assert counts.total() <= 29


def test_attachments_are_found_in_one_reading(scene):
    body = make_figure(scene)["Body"]
    bpy.ops.dynamorph.add_soft_skin()
    body.dynamorph.attachments.clear()
    with counted() as counts:
        assert attachments.find(body)
    assert {about for _, about in counts} >= {"Body", "Top", "Cap", "Eye", "Figure Rig"}
    once = ("mesh_triangles", "rest_points", "worlds_at_start", "VertexGroups.__init__")
    assert {key: count for key, count in counts.items() if key[0] in once and count > 1} == {}


def test_a_mesh_with_two_armature_modifiers_is_read_once(soft_arm):
    second = soft_arm.modifiers["Armature"].object.copy()
    bpy.context.scene.collection.objects.link(second)
    soft_arm.modifiers.new("Second", "ARMATURE").object = second
    counts = read_for_a_bake(soft_arm)
    assert max(count for key, count in counts.items() if key[0] not in ("rig_of", "rest_skeleton")) <= 2
    assert counts["armature_modifiers", soft_arm.name] == 2  # references follow renames before anything is read
    assert counts["VertexGroups.__init__", soft_arm.name] == counts["rig_of", soft_arm.name] == 1


def test_live_reads_a_character_once(soft_arm):
    """Whether its Firmness was painted since the build or not."""
    coarse(soft_arm)
    bpy.ops.dynamorph.build()
    with counted() as counts:
        model_store.live_model(soft_arm)
    assert counts["rest_points", soft_arm.name] == counts["VertexGroups.__init__", soft_arm.name] == 1


def test_the_messages_of_a_panel_read_the_modifiers_once(soft_arm):
    with counted() as counts:
        list(messages.messages(soft_arm))
    assert counts["armature_modifiers", soft_arm.name] == counts["deforming_bones", soft_arm.name] == 1
    assert not {name for name, _ in counts} & {"VertexGroups.__init__", "worlds_at_start", "rest_points"}
