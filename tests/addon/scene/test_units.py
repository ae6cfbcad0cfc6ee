# SPDX-License-Identifier: GPL-3.0-or-later
"""One character moves alike in meters, whatever units, scales, rotations and parents the scene has."""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi

import bpy
import numpy as np
import pytest
import real_character
from bl_ext.user_default.dynamic_morph_targets.core.model import build
from bl_ext.user_default.dynamic_morph_targets.core.model.cage import Stages, make_cage
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch, job
from bl_ext.user_default.dynamic_morph_targets.run.playing.tissue import Tissue
from bl_ext.user_default.dynamic_morph_targets.run.tools import preview
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion, run_settings
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.ui.operators.transfer import length
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport
from bl_ext.user_default.dynamic_morph_targets.write import reconcile
from bl_ext.user_default.dynamic_morph_targets.write.authoring import transfer
from builders import make_arm, make_rig, make_soft, rig_of, skinned, warnings_of
from mathutils import Matrix

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

SUBSTEPS = 5
TRAVEL = ((1, 0.0), (12, 0.5), (20, 0.2))  # frame, meters
SAME = 1e-6  # body sizes
STILL = np.eye(4)


# One shot of a character -------------------------------------------------------------------------------------------


@dataclass
class Shot:
    """A baked shot: its model, the object's world transform at its start, and the skin (F, V, 3), all in meters."""

    model: object
    world: np.ndarray
    skin: np.ndarray


def shot(obj, original: Shot | None = None, moved=STILL) -> Shot:
    """original: the shot of the same character, whose cage serves, where that character is `moved` in the world."""
    bpy.context.scene.frame_set(1)
    bpy.context.view_layer.update()
    reconcile.reconcile(obj)
    character = extract.character(obj)
    settings = run_settings.simulation_settings(obj, bpy.context.scene, substeps=SUBSTEPS)
    rig = rig_motion.sample_rig(obj, settings.frame_start, settings.frame_end, SUBSTEPS)
    world = rig.object_world[0] @ np.linalg.inv(affine(character.to_bind))
    previous = original and carried(original, np.linalg.inv(world) @ moved @ original.world, character)
    model = build.build(character, previous=previous)
    bake, report = simulate.bake(model, character, rig, settings)
    assert np.isfinite(bake.coordinates).all()
    frames = rig[::SUBSTEPS]
    skin = [skinned(character, frames[f : f + 1], bake.displacement(f))[0] for f in range(len(frames))]
    return Shot(model, world, np.array(skin))


def carried(original: Shot, transform: np.ndarray, character):
    """The original's model with its nodes moved to another bind space: it has the cage that `character` asks for."""
    model = original.model
    nodes = model.nodes @ transform[:3, :3].T + transform[:3, 3]
    tets = model.tets if np.linalg.det(transform) > 0 else model.tets[:, [0, 2, 1, 3]]
    return replace(model, nodes=nodes, tets=tets, dependencies=build.dependencies(character))


def affine(linear: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = linear
    return out


def difference(found: Shot, expected: Shot, moved=STILL) -> float:
    """The largest distance between the skins of two shots, in body sizes."""
    size = np.linalg.norm(np.ptp(expected.skin[0], axis=0))
    aim = expected.skin @ moved[:3, :3].T + moved[:3, 3]
    return float(np.linalg.norm(found.skin - aim, axis=2).max() / size)


def limb(scene):
    """The arm with a coarse cage, bending while its first bone travels."""
    arm = make_soft(make_arm(scene))
    arm.dynamorph.model.cage_nodes, arm.dynamorph.model.modes = 200, 8
    travel(rig_of(arm).pose.bones["upper"])
    scene.frame_set(1)
    return arm


def travel(mover):
    for frame, x in TRAVEL:
        mover.location.x = x
        mover.keyframe_insert("location", frame=frame)


@lru_cache
def original() -> Shot:
    return shot(limb(clear()))


def clear():
    """An empty scene."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return bpy.context.scene


# The same character, placed otherwise --------------------------------------------------------------------------------


def reframe(placed, frame: Matrix):
    """Give an object another transform, and undo it in its data."""
    if placed.type == "MESH":
        placed.data.transform(frame.inverted(), shape_keys=True)
    else:
        placed.data.transform(frame.inverted())
        placed.data.update_tag()
        _scale_travel(placed, 1.0 / frame.median_scale)
    placed.matrix_basis = placed.matrix_basis @ frame


def _scale_travel(rig, factor: float):
    """Bones travel in the armature's own units."""
    data = rig.animation_data
    for curve in animation.curves(data.action, data.action_slot):
        if curve.data_path.endswith("location"):
            for key in curve.keyframe_points:
                for point in (key.co, key.handle_left, key.handle_right):
                    point.y *= factor


def scaled(obj, mesh: float, rig: float):
    reframe(obj, Matrix.Scale(mesh, 4))
    reframe(rig_of(obj), Matrix.Scale(rig, 4))


def in_units(obj, meters: float):
    """Make a unit of the scene this many meters, and scale all numbers accordingly."""
    bpy.context.scene.unit_settings.scale_length = meters
    scaled(obj, meters, meters)
    for placed in (obj, rig_of(obj)):
        placed.matrix_basis = Matrix.Scale(1.0 / meters, 4) @ placed.matrix_basis


def holder(transform: Matrix):
    empty = bpy.data.objects.new("Holder", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.matrix_world = transform
    bpy.context.view_layer.update()
    return empty


def parented(child, parent):
    """Parent with the inverse matrix, so that the child stays where it is."""
    bpy.context.view_layer.update()
    child.parent = parent
    child.matrix_parent_inverse = parent.matrix_world.inverted()


def turned(angle: float, axis: str) -> Matrix:
    return Matrix.Rotation(angle, 4, axis)


def both_on(parent, obj):
    for placed in (obj, rig_of(obj)):
        parented(placed, parent)
    return parent


def placed_by_fbx(obj):
    """Leave the object as an importer does: y is up and the data is in centimeters, which a parent undoes."""
    frame = turned(pi / 2, "X") @ Matrix.Scale(0.01, 4)
    empty = holder(frame)
    for placed in (obj, rig_of(obj)):
        reframe(placed, frame)
        placed.parent, placed.matrix_basis = empty, Matrix()


PLACED = {
    "0.01": lambda obj: scaled(obj, 0.01, 0.01),
    "100": lambda obj: scaled(obj, 100.0, 100.0),
    "mesh 1, rig 0.01": lambda obj: scaled(obj, 1.0, 0.01),
    "mesh 0.3, rig 100": lambda obj: scaled(obj, 0.3, 100.0),
    "millimeters": lambda obj: in_units(obj, 0.001),
    "centimeters": lambda obj: in_units(obj, 0.01),
    "hundreds of meters": lambda obj: in_units(obj, 100.0),
    "stretched mesh": lambda obj: reframe(obj, Matrix.Diagonal((1.0, 1.0, 3.0, 1.0))),
    "turned rig": lambda obj: reframe(rig_of(obj), turned(0.4, "Y")),
    "mesh on the rig": lambda obj: parented(obj, rig_of(obj)),
    "mesh on an empty": lambda obj: parented(obj, holder(turned(0.5, "X") @ Matrix.Scale(0.3, 4))),
    "both on an empty": lambda obj: both_on(holder(turned(0.5, "X") @ Matrix.Scale(0.01, 4)), obj),
}
PLACED_WITH_OTHER_AXES = {
    "turned mesh": lambda obj: reframe(obj, Matrix.Translation((0.1, 0.3, 0.0)) @ turned(0.7, "X")),
    "mirrored mesh": lambda obj: reframe(obj, Matrix.Scale(-1.0, 4, (1, 0, 0))),
    "FBX": placed_by_fbx,
}


@pytest.mark.fault("M04")
@pytest.mark.parametrize("name", PLACED)
def test_the_same_motion(scene, name):
    """The character is built and baked again, including the cage."""
    expected = original()
    obj = limb(clear())
    PLACED[name](obj)
    assert difference(shot(obj), expected) < SAME


@pytest.mark.parametrize("name", PLACED_WITH_OTHER_AXES)
def test_the_same_motion_in_the_same_cage(scene, name):
    """A cage depends on the axes of the mesh's data, and the motion with it, as much as on the number of nodes: these
    are compared in one cage.
    """
    expected = original()
    obj = limb(clear())
    PLACED_WITH_OTHER_AXES[name](obj)
    assert difference(shot(obj, expected), expected) < SAME


def traveling(scene):
    """The limb on an armature object that travels too."""
    obj = limb(scene)
    parented(obj, rig_of(obj))
    travel(rig_of(obj))
    scene.frame_set(1)
    return obj


@lru_cache
def traveled() -> Shot:
    return shot(traveling(clear()))


@pytest.mark.parametrize("distance, same", [(0.0, SAME), (10.3, SAME), (100.3, 1e-5), (1000.3, 1e-3)])
def test_the_same_motion_elsewhere(scene, distance, same):
    """Blender's transforms are in single precision: at a kilometer 3e-5 m, which the simulation feels as a jerk."""
    expected = traveled()
    obj = traveling(clear())
    moved = Matrix.Translation((distance, 0.0, 0.0)) @ turned(0.6, "Z")
    rig_of(obj).parent = holder(moved)
    assert difference(shot(obj), expected, np.array(moved)) < same


def test_the_same_motion_on_a_bone_that_travels(scene):
    """The armature hangs on a bone of another armature, which travels in its place."""
    expected = traveled()
    obj = limb(clear())
    rig = rig_of(obj)
    parented(obj, rig)
    carrier = make_rig(bpy.context.scene, "Carrier", 1)
    mover = carrier.pose.bones["upper"]
    rig.parent, rig.parent_type, rig.parent_bone = carrier, "BONE", "upper"
    rig.matrix_parent_inverse = (mover.matrix @ Matrix.Translation((0.0, 1.0, 0.0))).inverted()
    travel(mover)
    assert difference(shot(obj), expected) < SAME


@pytest.mark.skipif(not real_character.CHARACTER.exists(), reason="needs ../shared/assets")
def test_the_same_motion_of_a_real_character(scene):
    """They are compared in one cage: so many coordinates, rounded at another scale, may lead to another cage."""
    shots = []
    for scale in (1.0, 0.01, 100.0):
        body = real_character.open_character("cmu_131_03_hop")
        body.dynamorph.model.cage_nodes = 600
        bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 8
        scaled_family(body, scale)
        shots.append(shot(body, *shots[:1]))
        assert difference(shots[-1], shots[0]) < SAME


def scaled_family(body, size: float):
    """A rig with its child: only the rig is scaled."""
    frame = Matrix.Scale(size, 4)
    reframe(rig_of(body), frame)
    body.data.transform(frame.inverted(), shape_keys=True)


# The mesh of tetrahedra --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [0.001, 0.01, 0.3937, 10.0, 100.0])
def test_the_cage_does_not_depend_on_the_scale(scene, scale):
    """It is meshed on a grid of its own size: other scales differ in the digits that single precision cuts off."""
    expected = original().model
    obj = limb(clear())
    scaled(obj, scale, scale)
    volume = make_cage(extract.character(obj), None, Stages(None))
    np.testing.assert_array_equal(volume.mesh.tets, expected.tets)
    np.testing.assert_allclose(volume.mesh.nodes, expected.nodes, atol=1e-6)


# Everything else that is a length ----------------------------------------------------------------------------------


@pytest.fixture
def in_centimeters(scene):
    """The arm, 200 units long, in a scene whose unit is a centimeter."""
    obj = limb(scene)
    in_units(obj, 0.01)
    bpy.context.view_layer.update()
    return obj


def test_sizes_are_reported_in_meters(in_centimeters):
    scene = bpy.context.scene
    assert warnings_of(in_centimeters) == []
    assert transfer.size(in_centimeters) == pytest.approx(2.17, abs=0.01)
    assert length(0.0123) == "1.23 cm"
    scene.unit_settings.scale_length = 1.0
    (warning,) = warnings_of(in_centimeters)
    assert (
        "'Arm' is 200 m long, weighs 551,064,175 kg and will move like something of that size: check the scale"
        in warning
    )


def test_without_a_unit_system_a_unit_is_a_meter(in_centimeters):
    bpy.context.scene.unit_settings.system = "NONE"
    np.testing.assert_allclose(extract.character(in_centimeters).to_bind, np.eye(3))


def test_another_unit_scale_makes_a_model_old(in_centimeters):
    units = bpy.context.scene.unit_settings
    batch.run(job.Job(in_centimeters, goal="BUILD"))
    assert staleness.model_changes(in_centimeters) == []
    units.scale_length = 0.1
    assert staleness.model_changes(in_centimeters) == ["Unit scale changed"]
    assert "object scale changed" in model_store.stale_reasons(in_centimeters, extract.character(in_centimeters))


def test_force_fields_are_in_meters(in_centimeters):
    bpy.ops.object.effector_add(type="WIND", location=(300.0, 0.0, 0.0))
    field = bpy.context.object.field
    field.use_max_distance, field.distance_max = True, 250.0
    (found,) = rig_motion.sample_rig(in_centimeters, 1, 2, 1).fields
    assert found.farthest == pytest.approx(2.5)
    np.testing.assert_allclose(found.world[0, :3, 3], (3.0, 0.0, 0.0), rtol=1e-6)


def test_what_is_drawn_is_in_blender_units(in_centimeters):
    batch.run(job.Job(in_centimeters, goal="BUILD"))
    bpy.context.scene.frame_set(1)
    bones = viewport.skin_matrices(in_centimeters, bpy.context.evaluated_depsgraph_get())
    cage = viewport.cage_of(model_store.load_model(in_centimeters))
    assert 200.0 < np.ptp(cage.posed(bones)[:, 2]) < 260.0


def test_a_shake_moves_the_rig_in_blender_units(in_centimeters):
    batch.run(job.Job(in_centimeters, goal="BUILD"))
    tissue = Tissue(in_centimeters, bpy.context.scene)
    samples, transforms = preview.shaken(in_centimeters, tissue, "HOP")
    assert np.ptp(samples.rig_world[:, 2, 3]) == pytest.approx(0.12 * 2.17, rel=0.05)
    np.testing.assert_allclose(transforms[:, 2, 3], 100.0 * samples.rig_world[:, 2, 3], rtol=1e-5, atol=1e-6)
