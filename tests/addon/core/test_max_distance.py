# SPDX-License-Identifier: GPL-3.0-or-later
"""The Max Distance map: 0 follows the rig to the last bit, in between a part keeps near it, and no map is no change."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, max_distance
from bl_ext.user_default.dynamic_morph_targets.core.motion.baked import surfaces
from bl_ext.user_default.dynamic_morph_targets.run.tools import heat
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.references import key_points
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport
from bl_ext.user_default.dynamic_morph_targets.write.authoring import setups, transfer
from builders import activate, refused, rig_of, soon
from robustness import bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph


@pytest.fixture
def shaken(soft_arm):
    """The arm with its target 'flexed', on a rig that is shaken up and down while it bends."""
    activate(soft_arm)
    model = soft_arm.dynamorph.model
    model.cage_nodes, model.modes, model.method, model.hold = 300, 24, "DYNAMIC", "THICKNESS"
    soft_arm.dynamorph.simulation.gravity = 0.0
    limit(soft_arm, 0.03)
    rig = rig_of(soft_arm)
    for frame in range(1, 21):
        rig.location.x = 0.2 * (frame // 3 % 2)
        rig.keyframe_insert("location", frame=frame)
    return soft_arm


def limit(obj, displacement):
    simulation = obj.dynamorph.simulation
    simulation.max_displacement, simulation.max_thickness = displacement, 0.0


def heights(obj) -> np.ndarray:
    return np.array([vertex.co.z for vertex in obj.data.vertices])


def paint(obj, weights):
    """Weights (V,) of the map; where they are 1, no vertex is in the group."""
    group = obj.vertex_groups.get("Near") or obj.vertex_groups.new(name="Near")
    group.remove(range(len(weights)))
    for vertex in np.flatnonzero(weights < 1.0).tolist():
        group.add([vertex], weights[vertex], "REPLACE")
    obj.dynamorph.max_distance_group = group.name


def moved(job) -> np.ndarray:
    """The motion (F, V, 3) about the targets' shapes, bind space, meters."""
    made = job.outcome.bake
    return np.tensordot(made.coordinates - made.static, made.modes @ job.outcome.character.to_bind.T, 1)


def sculpted(job) -> np.ndarray:
    """What the targets' shapes alone displace at each frame: (F, V, 3), local space."""
    shapes = np.array([target.shape for target in job.outcome.character.targets])
    return np.tensordot(job.outcome.bake.weights, shapes, 1)


# What a weight does ----------------------------------------------------------------------------------------------


def test_both_factors_together_are_the_weight(addon):
    weights = np.linspace(0.0, 1.0, 101)
    pulled, shown = max_distance.pulled(weights), max_distance.shown(weights)
    np.testing.assert_allclose(pulled * shown, weights, atol=1e-15)
    assert pulled.min() == max_distance.NEAREST and shown[0] == 0.0 and (shown[10:] == 1.0).all()


def test_what_is_not_painted_counts_as_one(soft_arm):
    np.testing.assert_array_equal(extract.character(soft_arm).max_distance, 1.0)
    soft_arm.vertex_groups.new(name="Near").add([1, 2], 0.25, "REPLACE")
    soft_arm.dynamorph.max_distance_group = "Near"
    np.testing.assert_array_equal(extract.character(soft_arm).max_distance[:4], [1.0, 0.25, 0.25, 1.0])
    soft_arm.dynamorph.max_distance_group = "Gone"
    with pytest.raises(errors.SceneError, match="'Arm'.*'Gone' of Max Distance is gone"):
        extract.character(soft_arm)


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_map_of_ones_changes_nothing(shaken, solver):
    shaken.dynamorph.model.solver = solver
    plain = bake(shaken).outcome.bake
    paint(shaken, np.ones(len(shaken.data.vertices)))
    painted = bake(shaken).outcome.bake
    for name in ("coordinates", "weights", "static", "modes", "residual_shapes"):
        np.testing.assert_array_equal(getattr(painted, name), getattr(plain, name))


@pytest.mark.parametrize("displacement", [0.0, 0.03])
@pytest.mark.parametrize("solver, basis", [("REDUCED", "MODES"), ("REDUCED", "RESPONSES"), ("FULL", "MODES")])
def test_weight_0_follows_the_rig_to_the_last_bit(shaken, solver, basis, displacement):
    """Also without a limit: there is nothing but the target's shape."""
    shaken.dynamorph.model.solver, shaken.dynamorph.model.basis = solver, basis
    limit(shaken, displacement)
    still = np.abs(heights(shaken) - 0.6) < 0.35
    paint(shaken, np.where(still, 0.0, 1.0))
    job = bake(shaken)
    made = job.outcome.bake
    assert np.abs(sculpted(job)[:, still]).max() > 0.05 and np.abs(moved(job)[:, ~still]).max() > 0.003
    assert (made.modes[:, still] == 0.0).all()
    np.testing.assert_array_equal(next(surfaces(made, 0.0))[:, still], sculpted(job)[:, still])
    built = job.outcome.model.residual_shapes[:, ~still]
    np.testing.assert_array_equal(made.residual_shapes[:, ~still], built)


@pytest.mark.parametrize("output", [{}, {"keys": 4}])
def test_what_is_written_follows_the_rig_too(shaken, output):
    """As shape keys and their curves, read back from Blender, with the animation of the rig."""
    for name, value in output.items():
        setattr(shaken.dynamorph.output, name, value)
    still = np.abs(heights(shaken) - 0.6) < 0.35
    paint(shaken, np.where(still, 0.0, 1.0))
    job = bake(shaken)
    keys, off = shaken.data.shape_keys, 2e-6 + job.outcome.report["keys_error"]  # single precision, and the Key Limit
    for k, frame in enumerate(range(1, 21)):
        bpy.context.scene.frame_set(frame)
        blocks = [block for block in keys.key_blocks[1:] if not block.mute]
        basis = key_points(keys.reference_key).astype(float)
        shown = sum(block.value * (key_points(block) - basis) for block in blocks)[still]
        np.testing.assert_allclose(shown, sculpted(job)[k, still], atol=off)


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_live_shows_what_a_bake_does(shaken, solver):
    shaken.dynamorph.model.solver = solver
    height = heights(shaken)
    still = height > 0.7
    paint(shaken, np.interp(height, [0.3, 0.7], [1.0, 0.0]))
    job = bake(shaken)
    OPS.delete_bake()
    OPS.live()
    keys, farthest = shaken.data.shape_keys, np.abs(moved(job)).max()
    for k, frame in enumerate(range(1, 21)):
        bpy.context.scene.frame_set(frame)
        shown = key_points(keys.key_blocks["Dynamorph Live"]).astype(float) - key_points(keys.reference_key)
        np.testing.assert_allclose(shown, job.outcome.bake.displacement(k), atol=2e-3 * farthest)
        np.testing.assert_allclose(shown[still], sculpted(job)[k, still], atol=3e-7)


# What has changed --------------------------------------------------------------------------------------------------


def test_a_stroke_makes_the_bake_old_and_not_the_model(shaken):
    bake(shaken)
    assert staleness.outdated(shaken) == []
    OPS.paint_max_distance()
    assert shaken.mode == "WEIGHT_PAINT" and (weights(shaken) == 1.0).all()
    OPS.paint_max_distance()
    assert staleness.outdated(shaken) == []
    OPS.paint_max_distance()
    shaken.vertex_groups["Max Distance"].add([*range(40)], 0.5, "REPLACE")
    OPS.paint_max_distance()
    assert staleness.outdated(shaken) == ["Max Distance changed"]
    assert staleness.model_age(shaken) == []
    job = bake(shaken)
    assert job.input.reasons == [] and staleness.outdated(shaken) == []
    shaken.vertex_groups["Max Distance"].add([*range(40)], 1.0, "REPLACE")
    OPS.paint_max_distance()
    OPS.paint_max_distance()
    assert staleness.outdated(shaken) == ["Max Distance changed"]
    again = bake(shaken)
    assert again.outcome.content_id != job.outcome.content_id


def weights(obj) -> np.ndarray:
    return mesh_data.group_weights(obj, ["Max Distance"])[:, 0]


def test_a_stroke_shows_in_live(shaken):
    OPS.build()
    OPS.live()
    OPS.paint_max_distance()
    scene, keys = bpy.context.scene, shaken.data.shape_keys
    for frame in range(1, 8):
        scene.frame_set(frame)
    with soon():
        shaken.vertex_groups["Max Distance"].add(range(len(shaken.data.vertices)), 0.0, "REPLACE")
        shaken.data.update()
        bpy.context.view_layer.update()
    for frame in range(1, 8):
        scene.frame_set(frame)
        assert heat.displacements(shaken)[shaken.session_uid].max() == 0.0
    assert keys.key_blocks["Dynamorph Live"].value == 1.0
    OPS.paint_max_distance()


def test_renaming_and_removing_the_group(soft_arm):
    paint(soft_arm, np.full(len(soft_arm.data.vertices), 0.5))
    bpy.context.view_layer.update()
    extract.character(soft_arm)
    OPS.paint_max_distance()
    OPS.paint_max_distance()
    assert soft_arm.dynamorph.max_distance_group == "Near" and "Max Distance" not in soft_arm.vertex_groups


def test_a_setup_and_a_copy_keep_the_map(scene, shaken):
    paint(shaken, np.where(heights(shaken) > 1.0, 0.0, 1.0))
    setup = setups.of_object(shaken)
    assert setup["skin"]["max_distance_group"] == "Near"
    shaken.dynamorph.max_distance_group = ""
    setups.apply(shaken, setup)
    assert shaken.dynamorph.max_distance_group == "Near"
    other = shaken.copy()
    other.data = shaken.data.copy()
    scene.collection.objects.link(other)
    other.shape_key_clear()
    other.vertex_groups.remove(other.vertex_groups["Near"])
    bpy.context.view_layer.update()
    transfer.write(other, transfer.copy(shaken, other), overwrite=True)
    copied = mesh_data.group_weights(other, ["Near"], max_distance.NEUTRAL)[:, 0]
    np.testing.assert_allclose(copied, np.where(heights(shaken) > 1.0, 0.0, 1.0), atol=1e-3)


# In the interface ---------------------------------------------------------------------------------------------------


def test_the_map_colors_the_skin(soft_arm):
    display, context = context_display(), bpy.context
    display.firmness = True
    display.max_distance = True
    assert not display.firmness
    with pytest.raises(errors.SceneError, match="press Paint beside Max Distance"):
        viewport.painted(context, soft_arm)
    OPS.paint_max_distance()
    values, title, texts = viewport.painted(context, soft_arm)
    assert (title, texts) == ("Max Distance", ["bones only", "50%", "as set"])
    assert (values[soft_arm.session_uid] == 1.0).all()
    soft_arm.vertex_groups["Max Distance"].add([0], 0.25, "REPLACE")
    heat.edited()
    assert viewport.painted(context, soft_arm)[0][soft_arm.session_uid][0] == 0.25
    display.max_distance = False
    OPS.paint_max_distance()


def context_display():
    return bpy.context.window_manager.dynamorph


def test_one_map_after_the_other_is_painted(soft_arm):
    OPS.paint_firmness()
    OPS.paint_max_distance()
    assert soft_arm.vertex_groups.active.name == "Max Distance" and not OPS.mirror_firmness.poll()
    soft_arm.vertex_groups["Max Distance"].add(
        [v.index for v in soft_arm.data.vertices if v.co.x > 0.0], 0.5, "REPLACE"
    )
    OPS.mirror_max_distance(to="RIGHT")
    x = np.array([vertex.co.x for vertex in soft_arm.data.vertices])
    assert (weights(soft_arm)[np.abs(x) > 1e-6] == 0.5).all()
    OPS.paint_max_distance()
    assert soft_arm.mode == "OBJECT"
    assert (mesh_data.group_weights(soft_arm, ["Firmness"])[:, 0] == 0.5).all()
    assert not OPS.mirror_max_distance.poll()
    soft_arm.hide_viewport = True
    refused(OPS.paint_max_distance, "'Arm' is hidden: show it")
