# SPDX-License-Identifier: GPL-3.0-or-later
"""A soft skin without targets, and what new targets get from their sculpts: material, bones, regions; real bakes."""

import json
import re
from math import pi

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets.cli import main as cli_main
from bl_ext.user_default.dynamic_morph_targets.core.settings import Material
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.tools import weight_curves
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.write.authoring import mirror
from bl_ext.user_default.dynamic_morph_targets.write.authoring import regions as authoring_regions
from bl_ext.user_default.dynamic_morph_targets.write.authoring.targets import blended_shape, set_shape
from bl_ext.user_default.dynamic_morph_targets.write.bake import reading
from builders import (
    activate,
    add_key,
    assert_shows,
    evaluated_points,
    make_mesh,
    make_rig,
    refused,
    rig_of,
    skinning_of,
)
from layout import drawn

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
OPS = bpy.ops.dynamorph
LENGTH = 4.0
MOVES = 0.005  # meters, of a bar 4 m long
EXACT = 1e-6  # of weights: poses are stored in single precision
CHAIN = ("upper", "lower", "hand", "finger")  # a joint at each whole x


def bump(vertices, center, width=0.3, amount=0.1):
    """A swelling (V, 3) of a bar along x round x = center, of limited width."""
    near = np.clip(1.0 - ((vertices[:, 0] - center) / width) ** 2, 0.0, None) ** 2
    return amount * near[:, None] * vertices * [0.0, 1.0, 1.0] / 0.3


def bar_along_x():
    vertices, faces = scenes.tube(rings=65, length=LENGTH)
    return vertices[:, [2, 0, 1]], faces


def weight(obj, bones, blend=0.15):
    """Weights of a chain of bones with a joint at each whole x, smooth over +-blend."""
    x = np.array([vertex.co.x for vertex in obj.data.vertices])
    past = [np.clip((x - joint) / (2 * blend) + 0.5, 0.0, 1.0) for joint in range(1, len(bones))]
    carried = np.array([np.ones(len(x)), *past, np.zeros(len(x))])
    for bone, weights in zip(bones, carried[:-1] - carried[1:], strict=True):
        group = obj.vertex_groups.new(name=bone)
        for index in np.flatnonzero(weights > 0.0):
            group.add([int(index)], float(weights[index]), "REPLACE")


@pytest.fixture
def bar(scene):
    """A bar along x of four bones, a new soft skin with a coarse cage, that waves in the frames 1 to 20."""
    rig = make_rig(scene, "Bar Rig", bones=4)
    bpy.ops.object.mode_set(mode="EDIT")
    for i, bone in enumerate(rig.data.edit_bones):
        bone.head, bone.tail = (i, 0, 0), (i + 1, 0, 0)
    bpy.ops.object.mode_set(mode="OBJECT")
    obj = make_mesh(scene, "Bar", *bar_along_x())
    weight(obj, CHAIN)
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    for frame, height in ((1, 0.0), (5, 0.05), (9, -0.05), (13, 0.05), (20, 0.0)):
        rig.pose.bones["upper"].location.z = height
        rig.pose.bones["upper"].keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 20
    scene.frame_set(1)
    activate(obj)
    OPS.add_soft_skin()
    return as_new(obj)


def as_new(obj):
    """Give a soft skin a fixed stiffness in pascals and a coarse cage, whatever Add Soft Skin has chosen."""
    settings = obj.dynamorph
    settings.model.hold, settings.simulation.substeps = "THICKNESS", 3
    settings.model.cage_nodes, settings.model.modes, settings.model.pin_radius = 500, 20, 0.3
    settings.simulation.max_displacement = settings.simulation.max_thickness = 0.0
    settings.targets[0].set_material(Material(stiffness=1e5))
    settings.targets[0].frequency, settings.targets[0].by_hand = 0.0, True
    return obj


def pose(obj, **turned):
    """Bones turned about their z axis, in radians; the others are at rest."""
    for bone in rig_of(obj).pose.bones:
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = (0.0, 0.0, turned.get(bone.name, 0.0))
    bpy.context.view_layer.update()


def rest(obj):
    return mesh_data.rest_points(obj)


def add(obj, key, center, **turned):
    """A target, sculpted round x = center, at a pose."""
    add_key(obj, key, bump(rest(obj), center))
    pose(obj, **turned)
    OPS.add_target(key=key)
    pose(obj)
    return obj.dynamorph.active_target


def group(obj, name):
    return mesh_data.group_weights(obj, [name])[:, 0]


def weights_at(obj, **turned):
    """Every target's weight at a pose, by name."""
    pose(obj, **turned)
    return weights_now(obj)


def weights_now(obj):
    bpy.context.view_layer.update()
    now = weight_curves.weights_now(obj, bpy.context.evaluated_depsgraph_get())
    names = [target.name for target_set in now.sets for target in target_set.targets]
    return dict(zip(names, now.weights[0], strict=True))


def motion(obj):
    """How far the skin (F, V) is from its place without motion, after a bake, in meters; the bake is deleted."""
    OPS.bake()
    bake = reading.read_back(obj)
    moved = np.tensordot(bake.coordinates - bake.static, bake.modes, 1)
    OPS.delete_bake()
    return moved


# No target needed --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["DYNAMIC", "SHAPE", "SINGLE"])
def test_the_neutral_target_alone_is_a_soft_body(bar, method):
    bar.dynamorph.model.method = method
    assert not list(checks.next_steps(bar))
    job = Job(bar, goal="BAKE")
    batch.run(job)
    bake = job.outcome.bake
    assert np.abs(np.tensordot(bake.coordinates, bake.modes, 1)).max() > MOVES
    assert_shows(bar, bake)
    OPS.delete_bake()
    OPS.live()
    shown = []
    for frame in range(1, 8):
        bpy.context.scene.frame_set(frame)
        shown.append(references.key_points(bar.data.shape_keys.key_blocks["Dynamorph Live"]))
    assert np.abs(shown - rest(bar)).max() > MOVES and live.problem(bar) == ""
    OPS.live()


def test_all_methods_alone_are_the_same(bar):
    moved = {}
    for method in ("SINGLE", "DYNAMIC", "SHAPE"):
        bar.dynamorph.model.method = method
        moved[method] = motion(bar)
    np.testing.assert_array_equal(moved["DYNAMIC"], moved["SINGLE"])
    np.testing.assert_allclose(moved["SHAPE"], moved["SINGLE"], atol=1e-9)


def test_static_alone_has_nothing_to_move(bar):
    bar.dynamorph.model.method = "STATIC"
    text = "'Bar' has no targets, so nothing moves with the Method Static: add a target, or choose the Method Dynamic"
    refused(OPS.bake, text)
    assert text in " ".join(drawn(bar))


def test_what_a_target_would_add_is_said_beside_the_list(bar):
    hint = "A target changes its shape and stiffness in a pose"
    assert hint in " ".join(drawn(bar))
    assert not list(checks.problems(skinning_of(bar)))
    add(bar, "flexed", 1.0, lower=1.0)
    assert hint not in " ".join(drawn(bar))


def test_without_any_shape_key(bar):
    """The bake makes the Basis; only the artist removes it."""
    bar.shape_key_clear()
    assert not list(checks.problems(skinning_of(bar)))
    assert np.abs(motion(bar)).max() > MOVES
    bar.shape_key_clear()
    OPS.live()
    OPS.live()
    bar.shape_key_clear()
    OPS.build()


def test_on_the_command_line(bar, tmp_path, capfd):
    path, output = tmp_path / "bar.blend", tmp_path / "baked.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))

    def main(arguments):
        return cli_main.main(arguments, opens_file=True)

    assert main(["check", str(path)]) == 0 and "Bar: can be built" in capfd.readouterr().out
    assert main(["bake", str(path), "--all", "-o", str(output)]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(output))
    assert len(bpy.data.objects["Bar"].dynamorph.bake.keys) > 3
    assert main(["bake", str(path), "--all", "--method", "static", "-o", str(output)]) == 2
    assert "nothing moves with the Method Static" in capfd.readouterr().err


# Material ----------------------------------------------------------------------------------------------------------


def test_a_new_target_has_the_neutral_material(bar):
    neutral = bar.dynamorph.targets[0]
    neutral.set_material(Material(5e3, 0.3, 900.0, 0.5, 0.02))
    neutral.frequency, neutral.by_hand = 2.5, True
    added = [add(bar, "flexed", 1.0, lower=1.0).name]
    add_key(bar, "driven", bump(rest(bar), 3.0))
    driver = bar.data.shape_keys.key_blocks["driven"].driver_add("value").driver
    driver.expression = "a"
    variable = driver.variables.new()
    variable.name, variable.type = "a", "TRANSFORMS"
    variable.targets[0].id, variable.targets[0].bone_target = rig_of(bar), "finger"
    variable.targets[0].transform_type, variable.targets[0].transform_space = "ROT_X", "LOCAL_SPACE"
    OPS.suggest_targets()
    pose(bar, hand=1.0)
    OPS.new_from_pose(key="new")
    OPS.finish_sculpt()
    added += ["driven", "new"]
    for name in added:
        target = bar.dynamorph.targets[name]
        assert target.material() == bar.dynamorph.targets[0].material(), name
        assert (target.frequency, target.by_hand) == (2.5, True)
    bar.dynamorph.targets["flexed"].stiffness = 7e4
    bar.dynamorph.active_target_index = 1
    OPS.duplicate_target()
    assert bar.dynamorph.active_target.stiffness == 7e4


# Bones -------------------------------------------------------------------------------------------------------------

ANIMATED = {"upper": 0.3, "lower": 1.0, "hand": 0.9, "finger": 0.8}


@pytest.mark.parametrize(
    "center, turned, bones",
    [
        (1.0, ANIMATED, ("lower",)),
        (2.0, ANIMATED, ("hand",)),
        (3.0, ANIMATED, ("finger",)),
        (0.8, ANIMATED, ("lower",)),
        (1.5, {"lower": 1.0}, ("lower",)),
        (1.5, {"upper": 1.0, "hand": 1.0}, ("hand",)),
        (0.5, {"hand": 1.0, "finger": 1.0}, ("hand",)),  # no joint of the sculpt is turned: the nearest one
        (1.0, {"upper": 1.0}, ("upper",)),
    ],
)
def test_the_joints_that_bend_the_sculpt_place_the_target(bar, center, turned, bones):
    assert add(bar, "sculpt", center, **turned).bone_names() == bones


def test_a_key_that_moves_nothing_yet_takes_all_that_are_turned(bar):
    add_key(bar, "empty", 0.0)
    pose(bar, **ANIMATED)
    OPS.add_target(key="empty")
    target = bar.dynamorph.active_target
    assert target.bone_names() == CHAIN and target.region == ""
    set_shape(bar.data.shape_keys.key_blocks["empty"], bump(rest(bar), 2.0))
    OPS.capture_pose()
    assert target.bone_names() == ("hand",) and target.region


def sculpt(obj, key, center):
    """Change the points of the key as sculpting strokes do."""
    block = obj.data.shape_keys.key_blocks[key]
    before = mesh_data.target_shape(obj, key)
    bpy.ops.object.mode_set(mode="OBJECT")
    set_shape(block, before + bump(rest(obj), center))


def test_finish_sculpting_chooses_bones_unless_the_artist_did(bar):
    for key, center, by_hand in (("first", 2.0, False), ("second", 3.0, True)):
        pose(bar, **{bone: 0.5 * angle if by_hand else angle for bone, angle in ANIMATED.items()})
        OPS.new_from_pose(key=key)
        target = bar.dynamorph.active_target
        assert target.bone_names() == CHAIN
        if by_hand:
            OPS.remove_bone(bone="finger")
        sculpt(bar, key, center)
        OPS.finish_sculpt()
        target = bar.dynamorph.targets[key]
        assert target.bone_names() == (CHAIN[:3] if by_hand else ("hand",))


# Regions -----------------------------------------------------------------------------------------------------------


def test_a_region_is_one_on_the_sculpt_and_fades_smoothly(bar):
    shape = bump(rest(bar), 2.0)
    triangles = mesh_data.mesh_triangles(bar.data)
    weights = authoring_regions.region(rest(bar), triangles, shape)
    moved = np.linalg.norm(shape, axis=1)
    assert (weights[moved > 0.02 * moved.max()] == 1.0).all()
    assert weights.min() == 0.0 and 0.1 < (weights > 0.0).mean() < 0.6
    x = rest(bar)[:, 0]
    rings = np.array([weights[np.isclose(x, at)].mean() for at in np.unique(np.round(x, 6))])
    assert np.ptp([weights[np.isclose(x, 2.0 + off)].mean() for off in (-0.5, 0.5)]) < 0.05
    assert np.abs(np.diff(rings)).max() < 0.3  # of ring to ring, LENGTH / 64 apart


def test_a_region_goes_on_across_seams(bar):
    """Imported meshes are split at seams: each face has points of its own."""
    points, triangles = rest(bar), mesh_data.mesh_triangles(bar.data)
    region = authoring_regions.region
    whole = region(points, triangles, bump(points, 2.0))
    split = points[triangles.ravel()]
    apart = region(split, np.arange(len(split)).reshape(-1, 3), bump(split, 2.0))
    np.testing.assert_allclose(apart, whole[triangles.ravel()], atol=1e-9)


def test_a_target_of_a_new_soft_skin_has_its_region(bar):
    target = add(bar, "flexed", 1.0, lower=1.0)
    assert target.region == "Dynamorph Region flexed" and target.auto_region
    moved = np.linalg.norm(bump(rest(bar), 1.0), axis=1)
    assert (group(bar, target.region)[moved > 0.02 * moved.max()] == 1.0).all()
    bar.dynamorph.model.hold = "BONES"  # as files from before have it
    assert add(bar, "old", 3.0, finger=1.0).region == ""


def test_targets_that_share_a_bone_form_one_set(bar):
    first, second = add(bar, "first", 1.0, lower=1.0).name, add(bar, "second", 1.4, lower=0.5).name
    other = add(bar, "other", 3.0, finger=1.0).name
    targets = bar.dynamorph.targets
    assert targets[first].region == targets[second].region != targets[other].region
    region, points = authoring_regions.region, rest(bar)
    triangles = mesh_data.mesh_triangles(bar.data)
    union = np.maximum(*(region(points, triangles, bump(points, center)) for center in (1.0, 1.4)))
    np.testing.assert_allclose(group(bar, targets[first].region), union, atol=1e-6)
    targets[second].set_bones(["hand"])
    authoring_regions.update(bar)
    assert len({target.region for target in targets[1:]}) == 3
    bar.dynamorph.active_target_index = 2
    left = targets[second].region
    OPS.remove_target()
    assert left not in bar.vertex_groups and "upper" in bar.vertex_groups


def test_a_region_that_was_painted_outlives_its_target(bar):
    """Other things of the artist's may use it by now."""
    region = add(bar, "flexed", 1.0, lower=1.0).region
    bar.vertex_groups[region].add(list(range(40)), 0.37, "REPLACE")
    painted = group(bar, region)
    bar.dynamorph.active_target_index = 1
    OPS.remove_target()
    np.testing.assert_array_equal(group(bar, region), painted)
    other = add(bar, "flexed", 1.0, lower=1.0).region
    bar.vertex_groups[other].add(list(range(40)), 0.37, "REPLACE")
    bar.dynamorph.active_target_index = 0
    OPS.remove_target()
    assert not bar.dynamorph.targets and {region, other} <= set(bar.vertex_groups.keys())


def test_a_target_counts_in_full_at_its_own_pose_whatever_other_limbs_do(bar):
    add(bar, "root", 1.0, lower=1.0, finger=-0.8)
    add(bar, "half", 1.0, lower=0.5)
    add(bar, "tip", 3.0, lower=1.0, finger=-0.8)  # in the same pose: each has its own limb
    assert extract.character(bar)
    rng = np.random.default_rng(1)
    for _ in range(20):
        upper, hand, other = rng.uniform(-2.0, 2.0, 3)
        at_root = weights_at(bar, lower=1.0, upper=upper, hand=hand, finger=other)
        at_tip = weights_at(bar, finger=-0.8, upper=upper, hand=hand, lower=other)
        assert (at_root["root"], at_root["half"]) == pytest.approx((1.0, 0.0), abs=EXACT)
        assert at_tip["tip"] == pytest.approx(1.0, abs=EXACT)
        assert weights_at(bar, lower=0.5, finger=other)["half"] == pytest.approx(1.0, abs=EXACT)


def test_the_artist_s_regions_stay(bar):
    mine = bar.vertex_groups.new(name="Mine")
    mine.add(range(100), 1.0, "REPLACE")
    target = add(bar, "flexed", 1.0, lower=1.0)
    made = target.region
    target.region = "Mine"
    assert not target.auto_region
    pose(bar, lower=1.0)
    OPS.capture_pose()
    assert bar.dynamorph.targets["flexed"].region == "Mine"
    add(bar, "beside", 1.5, lower=0.5)  # of the same joint: it competes with the other target, in the same region
    assert bar.dynamorph.targets["beside"].region == "Mine" and (group(bar, "Mine") > 0).sum() == 100
    bar.dynamorph.active_target_index = 1
    OPS.region_from_sculpt()
    targets = bar.dynamorph.targets
    assert targets["flexed"].auto_region and targets["flexed"].region == targets["beside"].region != "Mine"
    bar.vertex_groups[targets["flexed"].region].add([0], 0.7, "REPLACE")  # painted
    painted = group(bar, targets["flexed"].region)
    add(bar, "third", 1.3, lower=-0.5)
    assert not targets["flexed"].auto_region and made
    np.testing.assert_array_equal(group(bar, targets["flexed"].region), painted)


def test_the_other_side_has_a_region_of_its_own(scene):
    from test_targets import make_two_arms

    obj = make_two_arms(scene)
    OPS.add_soft_skin()
    as_new(obj)
    pose(obj, **{"lower.L": 1.0})
    OPS.add_target(key="flexed.L")
    OPS.mirror_target()
    left, right = obj.dynamorph.targets[1:]
    assert (left.bone_names(), right.bone_names()) == (("lower.L",), ("lower.R",))
    partners = mirror.mirror_partners(rest(obj))
    np.testing.assert_allclose(group(obj, right.region), group(obj, left.region)[partners], atol=0.1)  # faces differ
    OPS.go_to_pose()
    for bone, angle in (("lower.L", 1.0), ("upper.L", 0.7), ("upper.R", 2.0)):
        rig_of(obj).pose.bones[bone].rotation_euler = (0.0, 0.0, angle)
    both = weights_now(obj)
    assert both["flexed.L"] == pytest.approx(1.0, abs=EXACT) == both["flexed.R"]


def test_a_setup_brings_regions_to_a_mesh_that_has_none(bar, tmp_path, capfd):
    add(bar, "flexed", 1.0, lower=1.0)
    name, made = bar.dynamorph.active_target.region, group(bar, bar.dynamorph.active_target.region)
    OPS.save_setup(filepath=str(tmp_path / "bar.json"))
    bar.vertex_groups.remove(bar.vertex_groups[name])
    OPS.load_setup(filepath=str(tmp_path / "bar.json"))
    target = bar.dynamorph.targets["flexed"]
    assert (target.region, target.auto_region, target.auto_bones) == (name, True, True)
    np.testing.assert_array_equal(group(bar, name), made)
    assert "vertex group" not in capfd.readouterr().out


# What a build makes of it ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("second", [3.0, 1.7], ids=["apart", "overlapping"])
def test_targets_are_met_exactly(bar, second):
    add(bar, "first", 1.0, lower=1.0, hand=0.4)
    add(bar, "second", second, **({"finger": 1.0} if second == 3.0 else {"hand": 1.0, "finger": 0.4}))
    regions = [group(bar, target.region) for target in bar.dynamorph.targets[1:]]
    assert bool((regions[0] * regions[1]).any()) == (second != 3.0)
    OPS.build()
    OPS.check_targets()
    missed = [float(line.split(":")[1].split()[0]) for line in bar.dynamorph.live.checks.split("\n")]
    assert len(missed) == 5 and max(missed) < 1e-3  # millimeters, of a bar of 4 m


def test_targets_and_keys_are_counted_as_the_panel_lists_them(bar, tmp_path, capfd):
    """Each region is simulated with a neutral target of its own, and most residual shapes need no key."""
    add(bar, "first", 1.0, lower=1.0)
    add(bar, "second", 3.0, finger=1.0)
    path, output, report = (tmp_path / name for name in ("bar.blend", "baked.blend", "report.json"))
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    arguments = ["bake", str(path), "--all", "-o", str(output), "--report", str(report)]
    assert cli_main.main(arguments, opens_file=True) == 0
    printed = dict(re.findall(r"^  (\w+) +(\d+)$", capfd.readouterr().out, re.MULTILINE))
    bpy.ops.wm.open_mainfile(filepath=str(output))
    baked = bpy.data.objects["Bar"]
    (found,) = json.loads(report.read_text())["characters"]
    assert found["summary"]["targets"] == int(printed["Targets"]) == len(baked.dynamorph.targets) == 3
    assert "3 targets" in baked.dynamorph.model.summary
    written = [key for key in baked.data.shape_keys.key_blocks if key.name.startswith("Dynamorph ")]
    assert found["bake"]["keys"] == int(printed["keys"]) == len(written)


def test_regions_are_named_as_an_artist_would(bar):
    add(bar, "first", 1.0, lower=1.0, hand=0.4)
    bar.vertex_groups.new(name="tip").add(range(4), 1.0, "REPLACE")
    add(bar, "second", 3.0, finger=1.0).region = "tip"
    OPS.build()
    OPS.check_targets()
    lines = bar.dynamorph.live.checks.split("\n")
    checked = ["Neutral", "Neutral (Region first)", "first", "Neutral (Region tip)", "second"]
    assert [line.split(":")[0] for line in lines] == checked
    texts = " ".join(drawn(bar))
    assert "Region first" in texts and "Region tip" in texts and "Dynamorph Region" not in texts


def test_a_target_leaves_the_motion_of_the_rest_alone(bar):
    """A flexed biceps does not stop a belly from jiggling."""

    def swing(where):
        """Root mean square of the motion in the target's pose, meters."""
        pose(bar, lower=1.0)
        return np.sqrt((motion(bar)[:, where] ** 2).sum(axis=2).mean())

    everywhere = np.ones(len(rest(bar)), bool)
    target = add(bar, "biceps", 0.6, lower=1.0)
    outside = group(bar, target.region) == 0.0
    target.mute = True
    before, on_the_whole = swing(outside), swing(everywhere)
    target = bar.dynamorph.targets["biceps"]
    target.mute, target.stiffness = False, 10 * target.stiffness
    assert before > MOVES / 2 and outside.mean() > 0.5
    assert swing(outside) == pytest.approx(before, rel=0.1)
    bar.dynamorph.targets["biceps"].region = ""  # the whole body is as stiff
    assert swing(everywhere) < 0.6 * on_the_whole


def test_a_pose_serves_as_many_targets_as_limbs_are_turned(bar):
    turned = {"lower": 1.0, "finger": 0.8}
    for key, center, bones in (("root", 1.0, ("lower",)), ("tip", 3.0, ("finger",))):
        pose(bar, **turned)
        OPS.new_from_pose(key=key)
        sculpt(bar, key, center)
        OPS.finish_sculpt()
        assert bar.dynamorph.targets[key].bone_names() == bones
        assert mesh_data.target_shape(bar, key) == pytest.approx(bump(rest(bar), center), abs=1e-6)
    now = weights_at(bar, **turned)
    assert now["root"] == pytest.approx(1.0, abs=EXACT) == now["tip"]
    pose(bar, lower=1.0)
    refused(OPS.new_from_pose, "in the pose of 'root'")


def test_a_new_target_takes_over_nothing_of_other_limbs(bar):
    """New from Pose starts as the blend of all targets in that pose. What the others still show is removed from its
    key.
    """
    add(bar, "tip", 3.0, finger=1.0)
    pose(bar, lower=1.0, finger=1.0)
    OPS.new_from_pose(key="root")
    assert mesh_data.target_shape(bar, "root") == pytest.approx(bump(rest(bar), 3.0), abs=1e-6)
    sculpt(bar, "root", 1.0)
    OPS.finish_sculpt()
    target = bar.dynamorph.targets["root"]
    assert target.bone_names() == ("lower",) and target.region != bar.dynamorph.targets["tip"].region
    assert mesh_data.target_shape(bar, "root") == pytest.approx(bump(rest(bar), 1.0), abs=1e-6)
    both = bump(rest(bar), 1.0) + bump(rest(bar), 3.0)
    assert blended_shape(bar, rig_motion.current_pose(bar)[1]) == pytest.approx(both, abs=1e-5)
    assert not group(bar, target.region)[rest(bar)[:, 0] > 2.2].any()


# A sculpt before the build -----------------------------------------------------------------------------------------


def value(obj, key):
    return obj.data.shape_keys.key_blocks[key].value


def test_a_sculpt_shows_in_its_pose_until_something_else_does(bar):
    pose(bar, lower=1.0)
    OPS.new_from_pose(key="flexed")
    sculpt(bar, "flexed", 1.0)
    OPS.finish_sculpt()
    assert value(bar, "flexed") == 1.0
    before = evaluated_points(bar)
    bar.dynamorph.active_target_index = 0
    OPS.go_to_pose()
    assert value(bar, "flexed") == 0.0
    bar.dynamorph.active_target_index = 1
    OPS.go_to_pose()
    assert value(bar, "flexed") == 1.0 and evaluated_points(bar) == pytest.approx(before, abs=1e-5)
    add(bar, "other", 3.0, finger=1.0)
    OPS.go_to_pose()
    assert (value(bar, "flexed"), value(bar, "other")) == (0.0, 1.0)
    OPS.build()
    assert value(bar, "other") == 1.0
    OPS.live()
    assert value(bar, "other") == 0.0
    OPS.go_to_pose()
    assert value(bar, "other") == 0.0  # Live shows it
    OPS.live()
    OPS.go_to_pose()
    OPS.bake()
    OPS.go_to_pose()
    assert value(bar, "other") == 0.0 and bar.data.shape_keys.key_blocks["other"].mute
    OPS.delete_bake()
    OPS.go_to_pose()
    OPS.remove_target()
    assert value(bar, "other") == 0.0


def test_a_sculpt_is_hidden_by_the_frames_that_have_another_pose(bar):
    """Without that, it would show over the whole timeline, in every pose."""
    bone = rig_of(bar).pose.bones["lower"]
    bone.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (5, 1.0), (8, 1.0), (10, 0.0)):
        bone.rotation_euler.y = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_set(5)
    OPS.new_from_pose(key="flexed")
    sculpt(bar, "flexed", 1.0)
    OPS.finish_sculpt()
    for frame in (5, 6, 8):  # the pose stays while something else moves
        bpy.context.scene.frame_set(frame)
        assert value(bar, "flexed") == 1.0
    bpy.context.scene.frame_set(10)
    assert value(bar, "flexed") == 0.0 and bar.dynamorph.sculpt.shown.name == ""
    bpy.context.scene.frame_set(5)
    assert value(bar, "flexed") == 0.0
    bar.data.shape_keys.key_blocks["flexed"].value = 1.0  # the artist's own look
    bpy.context.scene.frame_set(10)
    assert value(bar, "flexed") == 1.0


def test_live_shows_a_new_sculpt_too(bar):
    """Add Soft Skin ends with Live on, so most targets are made while it runs."""
    OPS.build()
    OPS.live()
    pose(bar, lower=1.0)
    OPS.new_from_pose(key="flexed")
    sculpt(bar, "flexed", 1.0)
    OPS.finish_sculpt()
    assert value(bar, "flexed") == 1.0  # Live does not show it yet
    OPS.build()
    bpy.context.scene.frame_set(2)
    pose(bar, lower=1.0)
    bpy.context.scene.frame_set(2)
    assert live.is_on(bar) and live.problem(bar) == "" and value(bar, "flexed") == 0.0
    points = references.key_points(bar.data.shape_keys.key_blocks["Dynamorph Live"])
    assert np.abs(points - rest(bar)).max() == pytest.approx(np.abs(bump(rest(bar), 1.0)).max(), rel=0.3)
    OPS.live()


def test_values_that_the_artist_sets_stay(bar):
    add(bar, "flexed", 1.0, lower=1.0)
    bar.data.shape_keys.key_blocks["flexed"].value = 0.4
    OPS.go_to_pose()
    assert value(bar, "flexed") == pytest.approx(0.4)
    bar.data.shape_keys.key_blocks["flexed"].value = 0.0
    OPS.go_to_pose()
    bar.data.shape_keys.key_blocks["flexed"].value = 0.7
    bar.dynamorph.active_target_index = 0
    OPS.go_to_pose()
    assert value(bar, "flexed") == pytest.approx(0.7)


def test_what_is_shown_is_undone_and_saved(bar, tmp_path):
    add(bar, "flexed", 1.0, lower=pi / 3)
    bpy.ops.ed.undo_push(message="before")
    OPS.go_to_pose()
    bpy.ops.ed.undo_push(message="shown")
    bpy.ops.ed.undo()
    assert value(bpy.data.objects["Bar"], "flexed") == 0.0
    bpy.ops.ed.redo()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "bar.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "bar.blend"))
    bar = bpy.data.objects["Bar"]
    assert value(bar, "flexed") == 1.0
    bar.data.shape_keys.key_blocks["flexed"].name = "renamed"
    bpy.context.view_layer.update()
    bar.dynamorph.active_target_index = 0
    OPS.go_to_pose()
    assert value(bar, "renamed") == 0.0
