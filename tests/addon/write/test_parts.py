# SPDX-License-Identifier: GPL-3.0-or-later
"""The sliders of a body's soft parts: what they write into the Firmness map, and what that does to the motion."""

import bpy
import numpy as np
import pytest
import rig_families
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.model import body_parts
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.read.source import Source
from bl_ext.user_default.dynamic_morph_targets.write.authoring import parts, setups
from builders import activate, shown, soon
from layout import drawn

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
OPS = bpy.ops.dynamorph


@pytest.fixture
def body(scene):
    """A human whose arms and legs have plain bones, just made soft."""
    figure = rig_families.make("Unreal")
    OPS.add_soft_skin()
    return figure.body


def firmness(obj) -> np.ndarray:
    return mesh_data.group_weights(obj, [obj.dynamorph.firmness_group], 0.5)[:, 0]


def points(obj) -> np.ndarray:
    return mesh_data.rest_points(obj) @ np.array(obj.matrix_world.to_3x3()).T


def test_a_body_begins_with_its_parts_and_without_a_map(body):
    assert body.dynamorph.parts.keys() == list(body_parts.PARTS)
    assert {part.firmness for part in body.dynamorph.parts} == {0.5}
    assert body.dynamorph.firmness_group == ""
    assert drawn(body).count("firmness") >= len(body_parts.PARTS)


def test_a_slider_softens_both_sides_alike_and_nothing_else(body):
    body.dynamorph.parts["Thighs"].firmness = 0.1
    weights, place = firmness(body), points(body)
    assert weights.min() == pytest.approx(0.1, abs=2e-3)
    height = place[:, 2]
    assert (weights[(height < 0.4) | (height > 1.1)] == 0.5).all() and (
        weights[np.abs(height - 0.7) < 0.05] < 0.15
    ).all()
    left, right = (weights[sign * place[:, 0] > 0.01].sum() for sign in (1, -1))
    assert left == pytest.approx(right, rel=1e-3)
    edges = np.array([edge.vertices for edge in body.data.edges])
    assert np.abs(np.diff(weights[edges])).max() < 0.3  # no step at its border


def test_what_is_painted_stays_and_the_slider_shifts_it(body):
    part = body.dynamorph.parts["Belly"]
    part.firmness = 0.3
    before = firmness(body)
    inside = int(before.argmin())
    body.vertex_groups["Firmness"].add([inside], 0.45, "REPLACE")
    part.firmness = 0.4
    after = firmness(body)
    others = (before < 0.32) & (np.arange(len(before)) != inside)
    assert after[inside] - after[others].mean() == pytest.approx(0.15, abs=0.01)
    part.firmness = 0.3
    np.testing.assert_allclose(firmness(body)[others], before[others], atol=0.01)
    assert firmness(body)[inside] == pytest.approx(0.45, abs=0.01)


def test_back_in_the_middle_the_map_changes_nothing(body):
    for value in (0.0, 0.8, 0.5):
        body.dynamorph.parts["Glutes"].firmness = value
    assert np.ptp(firmness(body)) < 3e-3 and firmness(body).mean() == pytest.approx(0.5, abs=1e-3)


def test_a_softer_belly_moves_more_and_a_held_one_hardly(body):
    body.dynamorph.model.cage_nodes, body.dynamorph.model.modes = 400, 20
    place, (plain,) = points(body), shown([body])
    belly = (np.abs(place[:, 2] - 1.07) < 0.06) & (place[:, 1] < -0.08)
    motion = []
    for value in (0.1, 0.5, 1.0):
        body.dynamorph.parts["Belly"].firmness = value
        OPS.bake()
        motion.append(np.sqrt(((shown([body])[0] - plain)[:, belly] ** 2).sum(axis=2).mean()))
    assert motion[0] > 1.15 * motion[1] and motion[2] < 0.6 * motion[1], motion


def test_live_follows_a_slider(body):
    body.dynamorph.model.cage_nodes, body.dynamorph.model.modes = 400, 20
    OPS.build()
    OPS.live()
    (before,) = shown([body])
    with soon():
        body.dynamorph.parts["Belly"].firmness = 0.0
        bpy.context.view_layer.update()
    assert np.abs(shown([body])[0] - before).max() > 1e-3 and not live.problem(body)


def test_undo_takes_the_slider_and_the_map_back(body):
    bpy.ops.ed.undo_push(message="before")
    body.dynamorph.parts["Chest"].firmness = 0.2
    bpy.ops.ed.undo_push(message="Firmness")
    name = body.name
    bpy.ops.ed.undo()
    body = bpy.data.objects[name]
    assert body.dynamorph.parts["Chest"].firmness == 0.5 and body.dynamorph.firmness_group == ""


def test_a_face_of_its_own_gets_the_cheeks(scene):
    figure = rig_families.make("VRM")
    OPS.add_soft_skin()
    figure.body.dynamorph.parts["Cheeks"].firmness = 0.0
    assert mesh_data.group_weights(figure.face, ["Firmness"], 0.5).min() < 0.2
    figure.body.dynamorph.parts["Belly"].firmness = 0.0
    assert firmness(figure.body).min() < 0.01


def test_clothes_follow_the_skin_below(scene):
    """They inherit its map, so that what is painted later shows on both."""
    figure = rig_families.make("Mixamo")
    OPS.add_soft_skin()
    figure.body.dynamorph.parts["Chest"].firmness = 0.2
    assert "Firmness" not in figure.others["Tops"].vertex_groups


def test_what_is_in_the_way_changes_nothing(body):
    body.dynamorph.parts["Chest"].firmness = 0.4
    group = body.vertex_groups["Firmness"]
    before, group.lock_weight = firmness(body), True
    with pytest.raises(errors.SceneError, match="locked"):
        parts.set_firmness(body, "Chest", 0.1)
    group.lock_weight = False
    activate(body)
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(errors.WriteError, match="Edit Mode"):
        parts.set_firmness(body, "Chest", 0.1)
    bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_array_equal(firmness(body), before)


def test_an_edited_mesh_is_looked_at_again(body):
    """Its vertices are others; the slider goes on."""
    body.dynamorph.parts["Belly"].firmness = 0.4
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    body.dynamorph.parts["Belly"].firmness = 0.2
    place = points(body)
    belly = (np.abs(place[:, 2] - 1.07) < 0.04) & (place[:, 1] < -0.1)
    assert firmness(body)[belly].mean() < 0.26


def test_sticks_have_no_soft_parts(body):
    """Arms and legs that are bone alone, as of a drawn figure, keep only the trunk's and the head's."""
    source = Source.of(checks.skinned(body))
    rest, mesh = (source.skeleton, source.bone_heads), (source.triangles, source.weights)
    place = source.points @ source.to_bind.T
    none = np.zeros(len(place))
    found = body_parts.find(body_parts.RiggedSkin(*rest, place, *mesh), none)
    assert {"Thighs", "Upper Arms"} <= set(found)
    thin, (x, _, z) = place.copy(), place.T
    arms, legs = np.abs(x) > 0.2, (np.abs(x) < 0.2) & (z < 0.93)
    thin[arms, 1:] = [0.0, 1.41] + 0.1 * (place[arms, 1:] - [0.0, 1.41])
    middles = np.column_stack([0.11 * np.sign(x[legs]), np.zeros(legs.sum())])
    thin[legs, :2] = middles + 0.1 * (place[legs, :2] - middles)
    found = body_parts.find(body_parts.RiggedSkin(*rest, thin, *mesh), none)
    assert set(found).isdisjoint({"Thighs", "Upper Arms"})


def test_fists_as_thick_as_the_trunk_are_held(scene):
    """As of a stout cartoon; thin hands are held anyway."""
    figure = rig_families.make("Human Generator")
    body = figure.body
    fist = np.array([0.74, 0.0, 1.41])
    for block in body.data.shape_keys.key_blocks:
        place = np.array([point.co for point in block.data])
        away = np.abs(place) - np.abs(fist)
        hands = np.abs(place[:, 0]) > 0.66
        place[hands] = np.sign(place[hands]) * (np.abs(fist) + 3.0 * away[hands])
        block.data.foreach_set("co", place.ravel())
    OPS.add_soft_skin()
    found = extract.character(body)
    own = np.arange(len(body.data.vertices))
    x = np.abs(found.vertices[own, 0])
    assert (found.rigidity[own][x > 0.72] == 1.0).all() and not found.rigidity[own][(x > 0.2) & (x < 0.5)].any()
    body.dynamorph.model.hold_head = False
    assert not extract.character(body).rigidity[own][x > 0.72].any()


def test_an_animal_has_no_such_parts(soft_arm):
    OPS.find_attachments()
    assert len(soft_arm.dynamorph.parts) == 0


def test_a_setup_brings_the_sliders_to_another_body(body):
    body.dynamorph.parts["Belly"].firmness = 0.25
    setup = setups.of_object(body)
    setups.check(setup)
    other = rig_families.make("Mixamo").body
    OPS.add_soft_skin()
    setup["skin"]["firmness_group"] = ""
    lacking = setups.apply(other, setup)
    assert other.dynamorph.parts["Belly"].firmness == 0.25 and firmness(other).min() == pytest.approx(0.25, abs=2e-3)
    assert "parts of the body" not in lacking
    other.dynamorph.parts.clear()
    assert setups.apply(other, setup)["parts of the body"] == ["Belly"]  # those at 0.5 ask for nothing
