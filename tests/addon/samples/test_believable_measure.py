# SPDX-License-Identifier: GPL-3.0-or-later
"""The measure behind docs/believable.md, on motions whose figures are known, and as its own program on a saved file;
the page's limits."""

import json
import subprocess
import sys
from pathlib import Path

import believable
import believable_measure
import bpy
import numpy as np
import pytest
import scenes
from builders import add_key, make_mesh, make_rig

EVIDENCE = Path(believable.__file__).parent
FRAMES = np.arange(1, 49)
FAR = 0.02  # of size


def swing(hertz, rate=24.0):
    return np.sin(2 * np.pi * hertz * (FRAMES - 1) / rate + 0.3)


def make_baked(scene, name, values, thickness=1.0, away=0.0):
    """A tube on a rig of two bones, whose one baked key moves all of it by FAR of its size; values (F,): of the key.
    thickness: relative to the tube's own; away: to its side.
    """
    rig = make_rig(scene, f"{name} Rig")
    vertices, faces = scenes.tube()
    vertices = vertices * [thickness, thickness, 1.0] + [away, 0.0, 0.0]
    obj = make_mesh(scene, name, vertices, faces)
    obj.parent = rig
    for bone, weights in zip(("upper", "lower"), scenes.two_bone_weights(vertices).T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for index in range(len(vertices)):
            group.add([index], float(weights[index]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    obj.shape_key_add(name="Basis", from_mix=False)
    key = add_key(obj, "Dynamorph 1", FAR * np.linalg.norm(np.ptp(vertices, axis=0)) * np.array([1.0, 0.0, 0.0]))
    key.slider_min = -1.0
    scene.frame_start, scene.frame_end = int(FRAMES[0]), int(FRAMES[-1])
    for frame, value in zip(FRAMES, values, strict=True):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    return obj


def flicker(values):
    """Of two points. One has an area of 3 and moves along an axis."""
    moved = np.zeros((len(values), 2, 3))
    moved[:, 0, 2] = FAR * np.asarray(values, float)
    return believable_measure.flicker(moved, np.array([3.0, 1.0]))


def test_flicker_of_known_motions():
    assert flicker(swing(0.5)) == pytest.approx(-1.0, abs=0.03)
    assert flicker(swing(6.0)) == pytest.approx(0.0, abs=0.03)  # a quarter of the frame rate
    assert flicker((-1.0) ** FRAMES) == pytest.approx(1.0)  # every other frame
    assert flicker(swing(8.0)) == pytest.approx(-np.cos(2 * np.pi * 8.0 / 24.0), abs=0.03)
    assert flicker(np.zeros(48)) == flicker(np.ones(48)) == flicker([0.0, 1.0]) == -1.0


def test_rounding_of_a_body_that_does_not_move_is_no_flicker():
    noise = np.random.default_rng(1).normal(size=(48, 20, 3)) * 1e-7
    assert believable_measure.flicker(noise, np.ones(20)) == -1.0


def test_flicker_is_weighted_by_area():
    moved = np.zeros((48, 2, 3))
    moved[:, 0, 0], moved[:, 1, 0] = swing(0.5), (-1.0) ** FRAMES
    calm, nervous = (believable_measure.flicker(moved, np.array(areas)) for areas in ([1e6, 1.0], [1.0, 1e6]))
    assert calm < -0.9
    assert nervous > 0.9


def test_jitter_is_what_is_above_a_third_of_the_frame_rate():
    moved = np.zeros((48, 1, 3))
    for hertz, expected in ((3.0, 0.0), (10.5, 1.0)):
        moved[:, 0, 0] = swing(hertz)
        assert believable_measure.jitter(moved, np.ones(1)) == pytest.approx(expected, abs=0.01)
    slow, fast = swing(3.0), swing(10.5)
    moved[:, 0, 0] = slow / np.diff(slow, 2).std() + fast / np.diff(fast, 2).std()  # the same acceleration
    assert believable_measure.jitter(moved, np.ones(1)) == pytest.approx(0.5, abs=0.05)
    assert believable_measure.jitter(moved[:15], np.ones(1)) is None


def test_a_swing_of_the_whole_skin(scene):
    """It moves as one, so that nothing is stretched, and its motion is that of the key."""
    values = swing(3.0)
    obj = make_baked(scene, "Body", values)
    found = believable_measure.measure(scene)
    assert found["disp_max"] == found["disp_p999"] == pytest.approx(FAR * np.abs(values).max(), abs=1e-4)
    assert found["alive"] == pytest.approx(FAR * values.std(), abs=1e-5)
    assert found["alive_area"] == 1.0
    assert found["thin_moves"] is None  # it is of one thickness
    assert found["stretch_lo"] == found["stretch_hi"] == found["plain_stretch_lo"] == found["stretch_kept"] == 1.0
    assert found["flipped"] == found["shaken"] == 0.0
    assert found["flicker"] == pytest.approx(-np.cos(2 * np.pi * 3.0 / 24.0), abs=0.03)
    assert found["flicker_plain"] == -1.0
    assert found["jitter"] == found["jitter_24"] < 0.01
    assert found["seam"] is None
    assert not obj.data.shape_keys.key_blocks["Dynamorph 1"].mute
    assert obj.modifiers["Armature"].show_viewport


def test_jitter_at_24_frames_a_second(scene):
    """A swing of 10 Hz is jitter in a film, but not at 60 frames a second."""
    scene.render.fps = 60
    make_baked(scene, "Body", swing(10.0, rate=60.0))
    found = believable_measure.measure(scene)
    assert found["jitter"] < 0.02
    assert found["jitter_24"] > 0.9


def test_thickness_of_a_tube(scene):
    """Twice its radius, or a little more, because rays spread."""
    obj = make_baked(scene, "Body", swing(3.0))
    skin = believable_measure.Skin.of([obj])
    middle = np.abs(skin.rest[:, 2] - 1.0) < 0.5
    assert np.median(skin.thickness[middle]) == pytest.approx(0.6, rel=0.1)
    assert skin.areas.sum() == pytest.approx(2 * np.pi * 0.3 * (2.0 + 0.3), rel=0.03)


@pytest.mark.parametrize(("values", "expected"), [(np.zeros(48), 0.0), (swing(3.0), 1.0)])
def test_how_much_a_thin_part_moves(scene, values, expected):
    """A third as thick, beside a body that swings; each by FAR of its own size."""
    body = make_baked(scene, "Body", swing(3.0))
    finger = make_baked(scene, "Finger", values, thickness=0.33, away=1.0)
    of_finger, of_body = (believable_measure.diagonal(believable_measure.rest(obj)) for obj in (finger, body))
    expected *= of_finger / of_body
    assert believable_measure.measure(scene)["thin_moves"] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("joined", [True, False])
@pytest.mark.parametrize(("away", "outside", "expected"), [(0.3, 0.32, (0.54, 0.66)), (0.1, -1.0, (0.25, 0.5))])
def test_what_is_sunk_into_the_body_is_as_thick_as_that(scene, joined, away, outside, expected):
    """Like an eye, or the root of a fin, wholly inside; as a part of the body's mesh or as one of its own. Alone it is
    0.12 thick."""
    body, eye = (make_baked(scene, "Body", swing(3.0)), make_baked(scene, "Eye", swing(3.0), thickness=0.2, away=away))
    first = len(body.data.vertices)
    if joined:
        scene.view_layers[0].objects.active = body
        for obj in (body, eye):
            obj.shape_key_clear()
            obj.select_set(True)
        bpy.ops.object.join()
    skin = believable_measure.Skin.of([body] if joined else [body, eye])
    of_eye = (np.arange(len(skin.rest)) >= first) & (np.abs(skin.rest[:, 2] - 1.0) < 0.5)
    low, high = expected
    assert low < np.nanmedian(skin.thickness[of_eye & (skin.rest[:, 0] > outside)]) < high


def test_a_sheet_in_the_body_does_not_make_it_thin(scene):
    """Like a fin without thickness that goes on inside: nothing has been entered where rays leave it."""
    body = make_baked(scene, "Body", swing(3.0))
    first = len(body.data.vertices)
    corners = [(0.2, -0.15, 0.2), (0.2, 0.15, 0.2), (0.2, 0.15, 1.8), (0.2, -0.15, 1.8)]
    for facing in (1, -1):
        sheet = make_mesh(scene, "Sheet", corners, [(0, 1, 2, 3)[::facing]])
        skin = believable_measure.Skin.of([body, sheet])
        near = (skin.rest[:, 0] > 0.25) & (np.abs(skin.rest[:, 2] - 1.0) < 0.5) & (np.arange(len(skin.rest)) < first)
        assert np.nanmedian(skin.thickness[near]) == pytest.approx(0.6, rel=0.15)


@pytest.mark.parametrize(("away", "low", "high"), [(0.32, 0.5, 0.7), (0.45, 0.02, 0.04)])
def test_what_lies_on_the_body_is_as_thick_as_that(scene, away, low, high):
    """Like a pocket; with a wider gap below it, it is a part of its own."""
    body, other = (make_baked(scene, "Body", swing(3.0)), make_baked(scene, "Other", swing(3.0), 0.05, away))
    skin = believable_measure.Skin.of([body, other])
    outside = (np.arange(len(skin.rest)) >= len(body.data.vertices)) & (skin.rest[:, 0] > away + 0.01)
    assert low < np.nanmedian(skin.thickness[outside & (np.abs(skin.rest[:, 2] - 1.0) < 0.5)]) < high


def test_skin_turned_inside_out(scene):
    """Half of the tube has changed sides: stretched at the border, where the other half stays."""
    obj = make_baked(scene, "Body", np.ones(48))
    key = obj.data.shape_keys.key_blocks["Dynamorph 1"]
    points = believable_measure.rest(obj)
    points[points[:, 2] > 1.0, :2] *= -1.0
    key.points.foreach_set("co", points.astype(np.float32).ravel())
    found = believable_measure.measure(scene)
    assert found["flipped"] > 0.4
    assert found["stretch_hi"] > 1.5
    assert found["alive"] < 1e-5  # it stays there


def test_edges_that_the_bones_shorten_are_compared_with_those(scene):
    obj = make_baked(scene, "Body", np.zeros(48))
    bone = obj.parent.pose.bones["lower"]
    for frame, angle in ((1, 0.0), (48, 2.4)):
        bone.rotation_euler.x = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    found = believable_measure.measure(scene)
    assert found["plain_stretch_lo"] == found["stretch_lo"] < 0.9
    assert found["stretch_kept"] == 1.0
    assert found["flicker"] == -1.0  # nothing is baked but a key that stays 0
    assert found["flicker_plain"] < -0.9
    assert found["shaken"] > 0.0


def test_gap_between_meshes_that_coincide(scene):
    make_baked(scene, "Body", swing(3.0))
    other = make_baked(scene, "Shirt", swing(3.0))
    assert believable_measure.measure(scene)["seam"] == 0.0
    other.data.shape_keys.key_blocks["Dynamorph 1"].points.foreach_set(
        "co", believable_measure.rest(other).astype(np.float32).ravel()
    )
    found = believable_measure.measure(scene)
    assert found["seam"] == pytest.approx(found["disp_max"], abs=1e-4)
    assert found["meshes"] == 2


def test_program_prints_one_line_or_says_why_not(scene, tmp_path):
    make_baked(scene, "Body", swing(3.0))
    expected = believable_measure.measure(scene)

    def run(name):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / name), copy=True)
        command = [sys.executable, EVIDENCE / "believable_measure.py", tmp_path / name]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = run("body.blend")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == {"file": "body.blend", **expected}
    bpy.data.objects["Body"].shape_key_clear()
    refused = run("plain.blend")
    assert refused.returncode != 0
    assert "nothing is baked" in refused.stderr


# The page -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flicker", "plain", "within"),
    [
        (-0.4, -0.9, True),
        (0.0, -0.9, True),
        (0.05, -0.9, False),
        (0.05, -0.05, True),
        (0.3, 0.25, True),
        (0.3, 0.1, False),
    ],
)
def test_flicker_may_be_a_little_above_that_of_the_bones(flicker, plain, within):
    limit = next(limit for limit in believable.LIMITS if limit.key == "flicker")
    assert limit.is_within({"measured": {"flicker": flicker, "flicker_plain": plain, "shaken": 0.0}}) == within


def test_rows_of_an_earlier_page_are_those_of_the_liveliest_clips():
    head = ("", "clip, frames", "alive")
    rows = [("Cow", "Death, 25", "0.015"), ("Cow", "Walk, 20", "0.001"), ("Man Suit", "hop, 48", "**0.04**")]
    page = f"# Page\n\n{believable.grid(head, rows[1:])}\n## Characters\n\n{believable.grid(head, rows)}\n## Seconds\n"
    found = believable.rows_of(page)
    assert found["Cow"] == {"": "Cow", "clip, frames": "Death, 25", "alive": "0.015"}
    assert found["Man Suit"]["alive"] == "0.04"
    assert len(found) == 2
