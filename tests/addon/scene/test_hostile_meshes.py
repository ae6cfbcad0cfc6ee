# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of meshes and shape keys that nothing else here is about: see tests/faults.toml."""

import os

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import activate, assert_shows, keys_of, make_mesh, make_rig, refused
from layout import drawn
from robustness import OPS, bake, coarse, motion

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

FACES = int(os.environ.get("DYNAMORPH_FACES", "20000"))


def limb(scene, name, vertices, faces, edges=()):
    """A soft skin on two bones whose joint is at a height of 1, and that bends over frames 1 to 20."""
    rig = make_rig(scene, f"{name} Rig")
    obj = make_mesh(scene, name, vertices, faces, edges)
    heights = np.asarray(vertices)[:, 2]
    for bone, members in (("upper", heights <= 1.0), ("lower", heights > 1.0)):
        obj.vertex_groups.new(name=bone).add(np.flatnonzero(members).tolist(), 1.0, "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    for frame, angle in ((1, 0.0), (20, 1.2)):
        rig.pose.bones["lower"].rotation_euler.x = angle
        rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, 20
    scene.frame_set(1)
    activate(obj)
    OPS.add_soft_skin()
    return coarse(obj)


@pytest.mark.fault("M12")
def test_concave_ngons_and_what_is_loose(scene):
    """A prism on a dented pentagon, with an edge and a vertex that belong to no face."""
    outline = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.1, 0.0)])
    sides, heights = len(outline), np.linspace(0.0, 2.0, 9)
    prism = [(x, y, z) for z in heights for x, y in outline]
    loose = [(0.6, 0.6, 1.9), (0.7, 0.7, 2.1), (0.0, 0.9, 1.5)]
    first, last = range(sides), range(len(prism) - sides, len(prism))
    faces = [[*reversed(first)], [*last]]
    for low in range(0, len(prism) - sides, sides):
        faces += [[low + i, low + (i + 1) % sides, low + sides + (i + 1) % sides, low + sides + i] for i in first]
    obj = limb(scene, "Prism", prism + loose, faces, edges=[(len(prism), len(prism) + 1)])
    job = bake(obj)
    moved = np.array([job.outcome.bake.displacement(k) for k in range(20)])
    assert np.isfinite(moved).all() and np.abs(moved).max() > 1e-3
    assert np.abs(moved[:, len(prism) + 2]).max() > 1e-3  # beside soft tissue, which carries it along
    assert_shows(obj, job.outcome.bake)


@pytest.mark.fault("M13")
def test_very_many_faces(scene, tmp_path):
    """As many as DYNAMORPH_FACES says: two million in `make -C evidence reliability`."""
    resource = pytest.importorskip("resource", reason="needs a system that counts the memory of a process")
    around = round(np.sqrt(FACES / 2.0))
    turn, height = np.meshgrid(np.arange(around) * 2.0 * np.pi / around, np.linspace(0.0, 2.0, around))
    radius = 0.3 * np.sqrt(np.maximum(1.0 - (height - 1.0) ** 2, 1e-4))
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=-1).reshape(-1, 3)
    index = np.arange(around * around).reshape(around, around)
    corners = (index[:-1], np.roll(index, -1, axis=1)[:-1], np.roll(index, -1, axis=1)[1:], index[1:])
    a, b, c, d = (corner.ravel() for corner in corners)
    triangles = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    obj = limb(scene, "Large", vertices, triangles.tolist())
    scene.frame_end = 5
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "large.blend"))  # the model goes beside it
    job = bake(obj, substeps=1)
    assert np.isfinite(job.outcome.bake.coordinates).all() and len(obj.dynamorph.bake.keys) > 0
    used = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    assert used < 2**28 + 3000 * len(triangles)


@pytest.mark.fault("M20")
def test_a_weight_that_is_not_a_number(soft_arm):
    soft_arm.vertex_groups["upper"].add([3], float("nan"), "REPLACE")
    refused(OPS.bake, "'Arm': vertex group 'upper' has weights that are not numbers")
    assert not soft_arm.dynamorph.bake.exists


@pytest.mark.fault("K02")
def test_a_key_with_another_number_of_vertices(soft_arm):
    """Scripts and importers can make such a mesh; Blender itself rebuilds its keys when Edit Mode is left."""
    coarse(soft_arm)
    OPS.build()
    soft_arm.data.vertices.add(3)
    assert [len(block.points) for block in keys_of(soft_arm).key_blocks] == [272] * 3
    words = "'Arm': shape key 'Basis' has 272 points and the mesh 275 vertices: enter Edit Mode and leave it"
    for button in (OPS.build, OPS.bake):
        refused(button, words)
    storage.show_stale(soft_arm)
    assert words in soft_arm.dynamorph.model.stale or "275 vertices" in " ".join(drawn(soft_arm))
    for mode in ("EDIT", "OBJECT"):
        bpy.ops.object.mode_set(mode=mode)
    for block in keys_of(soft_arm).key_blocks:
        for point in block.points[272:]:  # where Blender leaves what was in memory
            point.co = (0.0, 0.0, 0.0)
    assert np.isfinite(bake(soft_arm).outcome.bake.coordinates).all()


@pytest.mark.fault("K03")
@pytest.mark.parametrize("driver", ["float('nan')", "1e30", "-5"])
def test_key_values_that_no_slider_has(soft_arm, driver):
    """Blender shows them, without a bake and of keys that are not the bake's: what is driven, within the slider."""
    coarse(soft_arm)
    calm = bake(soft_arm).outcome.bake
    OPS.delete_bake()
    for name in ("flexed", "smile"):
        keys_of(soft_arm).key_blocks[name].driver_add("value").driver.expression = driver
    job = bake(soft_arm)
    np.testing.assert_array_equal(job.outcome.bake.coordinates, calm.coordinates)
    assert np.isfinite(motion(soft_arm)).all()


@pytest.mark.fault("K03")
def test_a_key_value_that_is_not_a_number_is_named(soft_arm):
    """Blender shows nothing of such a mesh, whether it is baked or not."""
    coarse(soft_arm)
    keys_of(soft_arm).key_blocks["smile"].value = float("nan")
    job = bake(soft_arm)
    assert [text for text in job.warnings if "'Arm': the value of shape key 'smile' is not a number" in text]
    assert np.isfinite(job.outcome.bake.coordinates).all()
