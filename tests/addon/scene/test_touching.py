# SPDX-License-Identifier: GPL-3.0-or-later
"""A real body whose arms hang at its sides: the cage joins them to it, and is cut so that it no longer does."""

import math

import bpy
import numpy as np
import pytest
import real_character
from mathutils import Quaternion

dynamorph = pytest.importorskip("dynamorph")

pytestmark = pytest.mark.skipif(
    not real_character.CHARACTER.exists(), reason="needs ../shared/assets/mh_male_53bones.blend"
)

LOWERED = 40  # degrees from the A-pose


@pytest.fixture(scope="module")
def body():
    bpy.ops.wm.open_mainfile(filepath=str(real_character.CHARACTER))
    rig, body = bpy.data.objects["Rig"], bpy.data.objects["Body"]
    rig.animation_data.action = body.data.shape_keys.animation_data.action = None
    return rig, body


def posed(rig, body, degrees):
    """The body (V, 3), triangles (T, 3), with its arms turned down about the front-back axis."""
    for bone in rig.pose.bones:
        bone.matrix_basis.identity()
    for name, turn in (("upperarm_l", degrees), ("upperarm_r", -degrees)):
        bone = rig.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = Quaternion(bone.bone.matrix_local.to_3x3().row[1], math.radians(turn))
    mesh = body.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    vertices, triangles = np.empty((len(mesh.vertices), 3)), np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.vertices.foreach_get("co", vertices.ravel())
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    return vertices, triangles


def weight(body, *names):
    """The sum (V,) of some bones' weights."""
    wanted = {body.vertex_groups[name].index for name in names}
    return np.array([sum(g.weight for g in v.groups if g.group in wanted) for v in body.data.vertices])


def test_arms_at_the_sides_are_cut_free(body):
    vertices, triangles = posed(*body, LOWERED)
    *_, mesh = dynamorph.mesh_body(vertices, triangles, 2000)
    mesh_cut = dynamorph.MeshCut(mesh, vertices, triangles)
    assert mesh_cut.glued.sum() > 50
    cut = mesh_cut.cut()
    arm = weight(body[1], "lowerarm_l", "lowerarm_r") > 0.9
    trunk = weight(body[1], "pelvis", "spine_01", "spine_02", "spine_03") > 0.9

    def shared(embedding):
        return np.isin(embedding.nodes[arm], embedding.nodes[trunk]).any(axis=1).mean()

    assert shared(dynamorph.embed(mesh, vertices)) > 0.2
    assert shared(mesh_cut.embed(cut)) == 0
    assert mesh_cut.embed(cut).distances.max() < 0.03
    np.testing.assert_array_equal(cut.volumes, mesh.volumes)


def test_arms_spread_leave_the_mesh_as_it_is(body):
    vertices, triangles = posed(*body, 0)
    *_, mesh = dynamorph.mesh_body(vertices, triangles, 2000)
    mesh_cut = dynamorph.MeshCut(mesh, vertices, triangles)
    assert not mesh_cut.glued.any()
    np.testing.assert_array_equal(mesh_cut.cut().nodes, mesh.nodes)
