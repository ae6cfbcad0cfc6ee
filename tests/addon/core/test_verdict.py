# SPDX-License-Identifier: GPL-3.0-or-later
"""The verdict on a bake: read whatever it contains, drawn, shown at the worst place, and repaired by one button."""

import json
from dataclasses import fields, replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, records
from bl_ext.user_default.dynamic_morph_targets.core.motion.contact import TooDeep, Touched
from bl_ext.user_default.dynamic_morph_targets.core.motion.limits import Held
from bl_ext.user_default.dynamic_morph_targets.core.result.judge import Limits, Verdict, judge, parsed, quantiles
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.tools import heat
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.ui.operators import jobs
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import activate, hand_made_bake, refused
from layout import drawn
from pressed import Pressed

OPS = bpy.ops.dynamorph

FAR = Verdict(
    Limits(0.05, 0.6), Held("thigh_r", 20.3, (45, 47), 1.25),
    displacement=0.09, percentile=0.08, over_thickness=0.5, stretch=(0.7, 1.2), flipped=1e-4,
    inverted=2e-4, flicker=-0.25, frame=7.0, vertices=(3, 5, 8),
    touched=Touched(0.00012, (TooDeep("thigh_r", "Bench", 0.018, 40, 52),), (("Ball", 3, 5),), ((40, 52),)),
)  # fmt: skip
TEXT = "The skin moves farther than Max Displacement allows at frame 7"


def wrong_record(**changes) -> str:
    return json.dumps(json.loads(FAR.record) | changes)


@pytest.fixture
def baked(soft_arm, stand_in):
    OPS.bake()
    soft_arm.dynamorph.bake.verdict = FAR.record
    return soft_arm


def text_of(obj) -> str:
    return " ".join(drawn(obj))


# Reading -----------------------------------------------------------------------------------------------------------


def test_a_verdict_is_read(addon):
    assert all(getattr(FAR, field.name) != field.default for field in fields(Verdict))
    assert parsed(FAR.record) == FAR and parsed("") is None
    assert not FAR.is_believable and FAR.text == TEXT
    assert FAR.figures == {
        "Displacement": "9.0% of size", "Of Thickness": "0.50", "Inverted Volume": "0.02%", "Flipped Skin": "0.01%",
        "Stretch": "0.70 to 1.20", "Flicker": "38%",
        "Largest Load": "20.3 of limit", "Between Frames": "125% of limit", "Penetration": "0.12 mm",
    }  # fmt: skip
    without = {"Largest Load", "Between Frames", "Penetration"}  # of no limits, and without Collision
    assert FAR.figures.keys() - Verdict().figures.keys() == without
    assert FAR.contact_texts == [
        "Bone 'thigh_r' pushes the skin 18 mm too deep into 'Bench' at frames 40 to 52: pose it farther out",
        "'Ball' does not stop anything at frames 3 to 5, because it is scaled to zero there",
    ]
    assert Verdict().contact_texts == replace(FAR, touched=Touched(0.001)).contact_texts == []
    older = {name: value for name, value in json.loads(FAR.record).items() if name != "touched"}
    assert parsed(json.dumps(older)) == replace(FAR, touched=None)
    assert FAR.factor == pytest.approx((0.08 / 0.05) ** 0.75)


QUIET = replace(FAR, displacement=0.028, percentile=0.028, stretch=(0.9, 1.1), touched=None)


@pytest.mark.parametrize(
    "changes, fault",
    [
        ({}, ""),
        ({"stretch": (0.61, 1.1)}, "is squeezed too far"),  # the limit is .6, and the bones take a part of it
        ({"stretch": (0.5, 1.1)}, "is squeezed too far"),
        ({"stretch": (0.9, 1.64)}, "is stretched too far"),
        ({"percentile": 0.06}, "moves farther than Max Displacement allows"),
        ({"displacement": 0.1}, "moves farther than Max Displacement allows"),
        ({"over_thickness": 0.7}, "moves farther than its thickness allows"),
        ({"percentile": 0.06, "over_thickness": 1.2}, "moves farther than its thickness allows"),
        ({"inverted": 0.01}, "is pressed inside out"),
    ],
)
def test_a_verdict_names_what_is_exceeded(addon, changes, fault):
    found = replace(QUIET, **changes)
    expected = f"The skin {fault} at frame 7" if fault else "The skin moves believably, most at frame 7"
    assert found.text == expected and found.is_believable == (not fault)


def test_edges_are_measured_as_they_are_posed(soft_arm):
    """A shear, which slants edges by little in bind space, squeezes those that bones have folded flat."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 6
    job = Job(soft_arm, "BAKE")
    batch.run(job)
    outcome, settings = job.outcome, job.input.settings
    character, count = outcome.character, len(outcome.bake.frames)
    shear = np.zeros_like(character.bind_points)
    shear[:, 0] = -character.bind_points[:, 2]
    coordinates = np.zeros((count, 1))
    coordinates[count // 2] = 0.5
    modes = shear[None] @ np.linalg.inv(character.to_bind.T)
    bake = replace(outcome.bake, modes=modes, coordinates=coordinates, static=0.0 * coordinates, node_modes=None)
    unfolded = np.tile(np.eye(3, 4), (count, character.weights.shape[1], 1, 1))
    flat = unfolded.copy()
    flat[:, :, 2, 2] = 0.1
    verdicts = [
        judge(outcome.model, character, bake, settings, Held(), None, poses) for poses in (None, unfolded, flat)
    ]
    bind, same, posed = (verdict.stretch[0] for verdict in verdicts)
    assert bind > 0.65 and same == pytest.approx(bind, abs=0.05)
    assert posed < 0.55 and "is squeezed too far" in verdicts[2].text


@pytest.mark.parametrize("count", [1, 2, 49, 50, 5000])
@pytest.mark.parametrize("kinds", [1, 7, 10**6])
def test_quantiles_are_those_of_all_values_in_order(addon, count, kinds):
    random = np.random.default_rng(count)
    values, weights = random.integers(0, kinds, count).astype(float), random.integers(1, 9, count).astype(float)
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    shares = (0.0, 0.001, 0.02, 0.3, 0.5, 0.9, 0.98, 0.99, 0.999, 1.0)
    at = np.searchsorted(sums, np.array(shares) * sums[-1]).clip(max=count - 1)
    assert quantiles(values, weights, shares) == values[order][at].tolist()


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "7",
        "null",
        '"ok"',
        "{}",
        '{"version": 1, "ok": true}',
        '{"version": 1, "text": 3}',
        "[" * 100_000,
        '{"text": "x"}',
        "\0",
    ],
)
def test_what_is_no_verdict_is_a_sentence(baked, text):
    baked.dynamorph.bake.verdict = text
    if text == "\0":  # not one of Blender's texts
        assert baked.dynamorph.bake.verdict == ""
        return
    assert records.VERDICT in text_of(baked)
    assert "dynamorph.delete_bake" in drawn(baked)


@pytest.mark.parametrize(
    "wrong",
    [
        {"frame": None}, {"frame": "seven"}, {"frame": float("nan")}, {"frame": True}, {"frame": [7]}, {"frame": 1e300},
        {"vertices": None}, {"vertices": "all"}, {"vertices": [-1, 2.5, "x", None, True]}, {"vertices": {}},
        {"limits": None}, {"limits": {}}, {"limits": [0.1, 0.6]}, {"limits": {"displacement": 0.1, "thickness": "x"}},
        {"limits": {"displacement": 0.1, "thickness": 0.6, "width": 1}}, {"held": {}}, {"held": None},
        {"held": {"bone": 3, "excess": 1.0, "frames": [1, 2], "reached": 0.0, "pulled": 0.0}}, {"flicker": "often"},
        {"held": {"bone": "a", "excess": 1.0, "frames": [1e300, 2], "reached": 0.0, "pulled": 0.0}},
        {"stretch": [1.0]}, {"stretch": None}, {"stretch": ["a", "b"]}, {"displacement": "far"}, {"inverted": []},
        {"displacement": 10**400}, {"touched": {}}, {"touched": [0.1]}, {"touched": {"penetration": 1.0}},
        {"touched": {"penetration": "x", "left_inside": [], "unusable": [], "pressed": []}},
        *(
            {"touched": {"penetration": 0, "left_inside": [], "unusable": each, "pressed": []}}
            for each in ({}, [7], [[]], [["a"]], [["a", 1, "b"]], [[3, 1, 2]])
        ),
        *(
            {"touched": {"penetration": 0, "left_inside": [], "unusable": [], "pressed": each}}
            for each in ({}, [7], [[1]], [["a", 2]], [[1e300, 2]])
        ),
        *(
            {"touched": {"penetration": 0, "left_inside": each, "unusable": [], "pressed": []}}
            for each in ({}, [7], [[]], [["a", "b", 1, 2]], [["a", 3, 1, 2, 3]], [["a", "b", "x", 2, 3]])
        ),
    ],
)  # fmt: skip
def test_a_wrong_part_is_a_sentence(baked, wrong):
    baked.dynamorph.bake.verdict = wrong_record(**wrong)
    assert records.VERDICT in text_of(baked) and "dynamorph.delete_bake" in drawn(baked)
    with pytest.raises(errors.RecordError, match="cannot be read"):
        parsed(baked.dynamorph.bake.verdict)
    for button in (OPS.show_worst, OPS.stiffen):
        refused(button, "cannot be read: bake again")


def test_unknown_parts_are_left_out(addon):
    assert parsed(wrong_record(text="Well done", warmth=3)) == FAR


# The panel ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes, repairs",
    [
        ({}, True),
        ({"touched": Touched(pressed=((2, 4), (6, 9)))}, False),  # something presses there
        ({"limits": Limits()}, False),
        ({"limits": Limits(), "flicker": 0.5}, False),
    ],  # no stiffness repairs that
)
def test_one_button_repairs_it(baked, changes, repairs):
    baked.dynamorph.bake.verdict = replace(FAR, **changes).record
    assert ("dynamorph.stiffen" in drawn(baked)) == repairs
    assert "Show Frame 7" in drawn(baked) and "heat" in drawn(baked)


def test_the_figures_are_folded_away(baked):
    """What is open at first: a sentence and a button."""
    shown = drawn(baked, unfolded=False)
    assert TEXT in " ".join(shown) and "dynamorph.stiffen" in shown
    assert not {"Displacement", "Stretch", "dynamorph.show_worst", "heat"} & set(shown)
    assert {"Displacement", "Stretch", "dynamorph.show_worst", "heat"} <= set(drawn(baked))


@pytest.mark.parametrize(
    "held, words",
    [
        (FAR.held, "'thigh_r' moves 20 times faster than its tissue can follow at frames 45 to 47: held back"),
        (replace(FAR.held, frames=(45, 45)), "than its tissue can follow at frame 45: held back"),
        (replace(FAR.held, excess=1.5), None),
    ],
)
def test_where_a_rig_is_too_fast_is_reported(baked, held, words):
    baked.dynamorph.bake.verdict = replace(FAR, held=held).record
    assert words in text_of(baked) if words else "held back" not in text_of(baked)


@pytest.mark.parametrize(
    "found, words",
    [
        ({}, "The skin moves believably, most at frame 7"),
        ({"inverted": 0.2, "flipped": 0.1}, "The skin is pressed inside out at frame 7"),
        ({"flipped": 0.1, "stretch": (0.2, 2.0)}, "The skin is turned over at frame 7"),
        ({"stretch": (0.5, 1.7)}, "The skin is stretched too far at frame 7"),
        ({"stretch": (0.5, 1.1)}, "The skin is squeezed too far at frame 7"),
        ({"flicker": 0.4}, "The skin flickers: it turns at every other frame, or more often"),
        ({"percentile": 0.06}, "The skin moves farther than Max Displacement allows at frame 7"),
    ],
)
def test_a_verdict_is_one_sentence_about_the_worst(addon, found, words):
    verdict = Verdict(Limits(0.05, 0.6), frame=7.0, **found)
    assert verdict.text == words and verdict.is_believable == (not found)


def test_what_the_verdict_says_is_said_once(baked):
    baked.dynamorph.bake.warnings = f"{TEXT}. Raise Bounce\nThe sleeve is torn"
    text = text_of(baked)
    assert text.count(TEXT) == 1 and "The sleeve is torn" in text
    baked.dynamorph.bake.verdict = ""
    assert TEXT in text_of(baked)


def test_a_deleted_bake_takes_its_verdict_along(baked):
    assert TEXT in text_of(baked)
    OPS.delete_bake()
    assert baked.dynamorph.bake.verdict == ""
    refused(OPS.show_worst, "no verdict: press Bake first")


def test_a_bake_without_a_verdict_says_nothing(baked):
    baked.dynamorph.bake.verdict = ""
    assert "dynamorph.show_worst" not in drawn(baked) and "dynamorph.delete_bake" in drawn(baked)


# Buttons -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_show_goes_there(scene, baked, mode):
    bpy.ops.object.mode_set(mode=mode)
    assert OPS.show_worst() == {"FINISHED"}
    assert scene.frame_current == 7 and baked.mode == "OBJECT"
    assert [vertex.index for vertex in baked.data.vertices if vertex.select] == [3, 5, 8]
    assert bpy.context.window_manager.dynamorph.heat
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert [vertex.index for vertex in baked.data.vertices if vertex.select] == [3, 5, 8]


def test_show_on_a_mesh_that_lost_vertices(scene, baked):
    baked.dynamorph.bake.verdict = replace(FAR, vertices=(4, 5000)).record
    assert OPS.show_worst() == {"FINISHED"}
    assert [vertex.index for vertex in baked.data.vertices if vertex.select] == [4]


def test_stiffen_raises_bounce_everywhere(baked):
    neutral, flexed = baked.dynamorph.targets
    baked.dynamorph.model.set_reference(0.5, neutral.poisson)
    for target in (neutral, flexed):
        target.set_swing(3.0, replace(target.material(), mass_damping=0.0, stiffness_damping=0.01))
    neutral.bounce, neutral.by_hand = 3.0, False
    flexed.bounce = 4.0
    settle = neutral.settle_time
    baked.dynamorph.bake.verdict = replace(FAR, percentile=0.05 * 1.5 ** (4 / 3)).record
    assert OPS.stiffen() == {"FINISHED"}
    assert neutral.bounce == pytest.approx(4.5, rel=1e-4) and flexed.bounce == pytest.approx(6.0, rel=1e-4)
    assert neutral.settle_time == pytest.approx(settle, rel=1e-4)
    assert (neutral.by_hand, flexed.by_hand) == (False, True)


def test_stiffen_by_more_than_there_is(baked):
    """A limit of next to nothing gives an infinite factor."""
    baked.dynamorph.bake.verdict = replace(FAR, limits=Limits(1e-320)).record
    neutral = baked.dynamorph.targets[0]
    baked.dynamorph.model.set_reference(0.5, neutral.poisson)
    OPS.stiffen()
    assert np.isfinite(neutral.bounce) and np.isfinite(neutral.stiffness)


def test_stiffen_needs_a_bounce(baked):
    baked.dynamorph.model.set_reference(0.0, 0.0)
    refused(OPS.stiffen, "press Build Model first")


def test_in_a_window_the_remedy_goes_on_to_a_bake(baked, monkeypatch):
    """In the background `bpy.ops` cannot be called as in a window, so the test looks at what is asked of it."""
    goes_on = []
    monkeypatch.setattr(jobs, "press", lambda _operator, name: goes_on.append(name))
    neutral = baked.dynamorph.targets[0]
    baked.dynamorph.model.set_reference(0.5, neutral.poisson)
    before = neutral.bounce
    assert Pressed(baked, operator="DYNAMORPH_OT_stiffen").result == {"FINISHED"}
    assert goes_on == ["dynamorph.bake"] and neutral.bounce > before


# The heat map ------------------------------------------------------------------------------------------------------


def test_colors_go_from_cold_to_hot(addon):
    colors = heat.colors(np.array([0.0, 0.5, 1.0, 1.1, -0.1]))
    np.testing.assert_allclose(colors[[0, 1, 2]], heat.RAMP[[0, 2, 4]], atol=1e-6)
    np.testing.assert_allclose(colors[3], heat.BEYOND, atol=1e-6)
    np.testing.assert_allclose(colors[4], heat.RAMP[0], atol=1e-6)
    assert colors.dtype == np.float32 and heat.colors(np.zeros(0)).shape == (0, 3)


@pytest.mark.parametrize("frame", [1, 9, 20])
def test_a_bake_is_as_hot_as_it_moves(scene, soft_arm, frame):
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    soft_arm.scale = (2.0, 1.0, 1.0)
    scene.frame_set(frame)
    rest = mesh_data.rest_points(soft_arm)
    moved = np.tensordot(bake.coordinates[frame - 1] - bake.static[frame - 1], bake.modes, 1)
    size = np.linalg.norm(np.ptp(rest * [2.0, 1.0, 1.0], axis=0))
    expected = np.linalg.norm(moved * [2.0, 1.0, 1.0], axis=1) / size
    for limit, allowed in ((0.0, 0.05), (0.1, 0.1)):
        soft_arm.dynamorph.simulation.max_displacement = limit
        shown = heat.displacements(soft_arm)
        assert list(shown) == [soft_arm.session_uid]
        np.testing.assert_allclose(shown[soft_arm.session_uid], expected / allowed, rtol=1e-3, atol=1e-4)


def test_what_cannot_be_colored_is_said(soft_arm):
    with pytest.raises(errors.SceneError, match="turn Live on or press Bake"):
        heat.displacements(soft_arm)
    with pytest.raises(errors.SceneError, match="has no model: press Build Model, or Paint"):
        heat.firmness(soft_arm)


def test_the_colored_surface_lies_on_the_mesh(scene, soft_arm):
    """Modifiers that add vertices put them after the mesh's own."""
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    scene.frame_set(12)
    before = mesh_data.shown_points(soft_arm, bpy.context.evaluated_depsgraph_get())
    soft_arm.modifiers.new("Solidify", "SOLIDIFY").offset = 1.0
    points = mesh_data.shown_points(soft_arm, bpy.context.evaluated_depsgraph_get())
    assert points.shape == before.shape
    corners = viewport.triangles(soft_arm)
    assert corners.shape == (2 * len(soft_arm.data.polygons), 3) or (len(corners) and corners.max() < len(points))
    soft_arm.modifiers.remove(soft_arm.modifiers["Solidify"])
    soft_arm.modifiers.new("Decimate", "DECIMATE").ratio = 0.2
    with pytest.raises(errors.SceneError, match="take vertices of 'Arm' away"):
        mesh_data.shown_points(soft_arm, bpy.context.evaluated_depsgraph_get())


def test_only_one_thing_colors_the_surface(addon):
    display = bpy.context.window_manager.dynamorph
    display.heat = True
    display.firmness = True
    assert display.firmness and not display.heat
    display.heat = True
    assert display.heat and not display.firmness
    display.heat = False
    activate(bpy.context.object)
