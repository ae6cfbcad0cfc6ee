# SPDX-License-Identifier: GPL-3.0-or-later
"""The comparison of methods, on a bending tube made of plain arrays."""

import json
import os

import dynamorph
import numpy as np
import pytest
import scenes
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.result import compare
from dynamic_morph_targets.core.settings import VARIANTS, Material, ModelSettings, SimulationSettings

SKELETON = Skeleton(("upper", "lower"), np.array([-1, 0]), np.array([np.eye(4), np.eye(4)]))
SKELETON.rest[1, 2, 3] = 1.0
SHOT = SimulationSettings(1, 8, substeps=3, gravity=(0.0, 0.0, -9.81))


def bent(angle):
    """Local transforms (2, 4, 4) with the lower bone turned about X."""
    local = np.tile(np.eye(4), (2, 1, 1))
    local[1, 1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return local


@pytest.fixture(scope="module")
def character():
    """A tube of two bones, 'flexed' at 90 degrees: bulged, and ten times as stiff."""
    vertices, faces = scenes.tube()
    triangles = [[face[0], face[k], face[k + 1]] for face in faces for k in range(1, len(face) - 1)]
    weights = np.column_stack([scenes.two_bone_weights(vertices), np.zeros(len(vertices))])
    targets = (
        Target("Neutral", np.zeros_like(vertices), (), bent(0.0), np.eye(4), Material()),
        Target("flexed", scenes.bulge(vertices), ("lower",), bent(np.pi / 2), np.eye(4), Material(stiffness=2e5)),
    )
    every = np.ones(len(vertices))
    return Character(
        name="Tube",
        vertices=vertices,
        triangles=np.array(triangles, np.int32),
        to_bind=np.eye(3),
        weights=weights,
        bone_segments=np.array([[[0, 0, 0], [0, 0, 1]], [[0, 0, 1], [0, 0, 2]]], float),
        skeleton=SKELETON,
        authored_sets=(TargetSet("Tube", targets, every),),
        settings=ModelSettings(**scenes.PINNED, modes=8, cage_nodes=150),
    )


@pytest.fixture(scope="module")
def rig():
    angles = np.linspace(0, np.pi / 2, 1 + (SHOT.frame_end - SHOT.frame_start) * SHOT.substeps)
    still = np.tile(np.eye(4), (len(angles), 1, 1))
    return RigSamples(SKELETON.pose(np.array([bent(angle) for angle in angles])), still, still)


@pytest.fixture(scope="module")
def compared(character, rig):
    return compare.compare(character, rig, SHOT)


def test_every_variant_has_its_figures(compared):
    assert list(compared["variants"]) == list(VARIANTS)
    assert json.loads(json.dumps(compared)) == compared
    for name, row in compared["variants"].items():
        assert (row["modes"] > 0) == (row["dofs"] > 0 and "full" not in name)
        assert row["targets"] == (1 if "single" in name else 2)
        assert (row["steps"] == 7 * 3 and row["steps_per_second"] > 0) == (name != "static morphs")
        assert ("error" in row) == ("reduced" in name)
        assert ("compression_error" in row) == ("full" in name)
        assert all(np.isfinite([row[key] for key in ("smallest_det", "dynamic_max", "dynamic_rms")]))


def test_only_a_single_material_misses_the_sculpted_target(compared, character):
    bulge = np.linalg.norm(character.targets[1].shape, axis=1).max()
    for name, row in compared["variants"].items():
        assert row["residuals"]["flexed"] == pytest.approx(bulge if "single" in name else 0.0, abs=1e-6)


def test_every_method_is_compared_whichever_the_scene_has_chosen(character, rig, compared):
    name = "DMT StVK reduced"
    single = character.with_settings(method="SINGLE")
    assert [target.name for target in single.targets] == ["Neutral"]
    row = compare.compare(single, rig, SHOT, {name: VARIANTS[name]})["variants"][name]
    for key in ("dofs", "targets", "residuals", "dynamic_rms"):
        assert row[key] == compared["variants"][name][key], key


def test_static_morphs_do_not_move_by_themselves(compared):
    assert compared["variants"]["static morphs"]["dynamic_max"] < 1e-12
    assert compared["variants"]["DMT StVK full"]["dynamic_max"] > 1e-3


def test_one_cage_and_its_meshing_are_shared(compared):
    seconds = {row["precompute"].get("meshing") for name, row in compared["variants"].items() if row["dofs"]}
    assert len(seconds) == 1 and seconds.pop() > 0.01
    assert len({row["dofs"] for row in compared["variants"].values()}) == 2  # static morphs have none


def test_more_modes_come_closer_to_the_full_model(character, rig):
    variants = {"full": {"solver": "FULL"}, "few": {"modes": 4}, "many": {"modes": 40}}
    done = dict(compare.runs(character, rig, SHOT, variants))
    full = done["full"]
    errors = [compare.motion_error(done[name].motion, full.motion, full.static) for name in ("few", "many")]
    assert errors[1].rms_dynamic < 0.5 * errors[0].rms_dynamic
    assert compare.motion_error(full.motion, full.motion, full.static).max == 0


def test_motion_error_is_relative_to_the_motion():
    rng = np.random.default_rng(1)
    static = rng.standard_normal((5, 7, 3))
    reference = static + 0.1 * rng.standard_normal((5, 7, 3))
    still = compare.motion_error(static, reference, static)
    assert (still.rms_dynamic, still.max_dynamic) == pytest.approx((1, 1))
    assert still.rms_total == pytest.approx(still.rms / np.sqrt((reference**2).sum(axis=2).mean()))
    assert compare.motion_error(static, 0 * static, 0 * static).rms > 0


def test_a_push_gives_as_the_pose_s_stiffness_says(character, rig):
    """Ten times as stiff gives a tenth; pose-dependent shape gives the same; geometric targets give nothing."""
    push = np.zeros_like(character.vertices)
    push[character.vertices[:, 2] > 1.6, 0] = 0.01
    bones = np.repeat(np.eye(3, 4)[None], 3, axis=0)
    variants = {name: VARIANTS[name] for name in ("static morphs", "pose-dependent shape", "DMT linear full")}
    given = {}
    for name, run in compare.runs(character, rig, SHOT, variants):
        statics = compare.Statics(run.model, run.character)
        given[name] = [
            np.abs(statics.surface(weights, bones, push) - statics.surface(weights)).max() for weights in np.eye(2)
        ]
    assert given["static morphs"] == [0, 0]
    assert given["pose-dependent shape"][0] == pytest.approx(given["pose-dependent shape"][1], rel=0.05)
    assert given["DMT linear full"][0] / given["DMT linear full"][1] == pytest.approx(10, rel=0.3)


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system does not pin threads")
def test_cores_are_given_back():
    before = os.sched_getaffinity(0)
    with compare.one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before


def test_progress_can_cancel(character, rig):
    heard = []

    def progress(fraction, message):
        heard.append((fraction, message))
        return not message.startswith("pose-dependent shape: ")

    with pytest.raises(dynamorph.Cancelled):
        compare.compare(character, rig, SHOT, progress=progress)
    assert heard[-1][1].startswith("pose-dependent shape: ")
    assert [fraction for fraction, _ in heard] == sorted(fraction for fraction, _ in heard)


def test_table_names_every_variant(compared):
    lines = compare.table(compared).splitlines()
    assert [line[:27].strip() for line in lines[1 : 1 + len(VARIANTS)]] == list(VARIANTS)
    assert max(map(len, lines)) <= 125
