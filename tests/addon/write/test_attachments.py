# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes, eyes and other pieces of a character: other meshes that the tissue carries along, and parts of the mesh."""

from dataclasses import replace
from itertools import pairwise

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets.core import errors, geometry
from bl_ext.user_default.dynamic_morph_targets.core.model import build
from bl_ext.user_default.dynamic_morph_targets.run.bake.batch import Batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write import reconcile
from bl_ext.user_default.dynamic_morph_targets.write.authoring import attachments, setups
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence, writer
from builders import (
    activate,
    evaluated_points,
    fingerprint,
    keys_of,
    make_mesh,
    make_rig,
    refused,
    rig_of,
    skinned,
    soon,
    with_pins,
)
from layout import drawn
from mathutils import Matrix
from robustness import bake, coarse, state

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph


def skin(obj, rig, weights):
    """Vertex groups of the arm's bones with these weights (V, 2), and an Armature modifier."""
    for bone, column in zip(["upper", "lower"], weights.T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for index in np.flatnonzero(column):
            group.add([int(index)], float(column[index]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig


def make_sleeve(arm, name="Sleeve", away=1.1):
    """A tube a little wider than the arm, whose object has a place, a turn and a size of its own."""
    vertices, faces = scenes.tube()
    weights = scenes.two_bone_weights(vertices)
    vertices = np.asarray(vertices) * [away, away, 1.0]
    world = Matrix.Translation((0.3, -0.2, 0.1)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Diagonal((2.0, 2.0, 0.5, 1.0))
    back = np.array(world.inverted())
    sleeve = make_mesh(bpy.context.scene, name, vertices @ back[:3, :3].T + back[:3, 3], faces)
    sleeve.matrix_world = world
    skin(sleeve, rig_of(arm), weights)
    bpy.context.view_layer.update()
    return sleeve


def add_attachment(obj, piece, choice="WITH_BODY"):
    item = obj.dynamorph.attachments.add()
    item.object, item.name, item.attached_by = piece, piece.name, choice
    return item


@pytest.fixture
def dressed(soft_arm):
    """The soft arm and its sleeve, which is a piece of it."""
    sleeve = make_sleeve(coarse(soft_arm))
    add_attachment(soft_arm, sleeve)
    activate(soft_arm)
    return soft_arm, sleeve


def motion(obj, frames=(1, 9, 20)):
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated_points(obj))
    return np.array(shown)


# Other meshes ------------------------------------------------------------------------------------------------------


def test_a_sleeve_shows_what_the_tissue_around_it_does(dressed):
    """Blender's sleeve is the embedded displacement, skinned by the sleeve's own weights."""
    arm, sleeve = dressed
    stiff = motion(sleeve)
    job = bake(arm)
    assert sleeve.dynamorph.follows == arm and len(sleeve.dynamorph.bake.keys) == len(arm.dynamorph.bake.keys)
    character = job.input.character
    members = character.attachments[0].members
    vertices = character.vertices[members] @ character.to_bind.T
    modes = np.moveaxis(job.outcome.bake.node_modes, 0, 1)
    engine = pytest.importorskip("dynamorph")
    model = job.outcome.model
    embedding = engine.embed(engine.TetMesh(model.nodes, model.tets), vertices)
    bind = embedding.interpolate(modes.reshape(len(modes), -1)).reshape(len(vertices), -1, 3)
    weights = scenes.two_bone_weights(scenes.tube()[0])
    weights = np.hstack([weights, 1.0 - weights.sum(axis=1, keepdims=True)])
    for frame, shown, before in zip((1, 9, 20), motion(sleeve), stiff, strict=True):
        moved = np.einsum("k,pkc->pc", job.outcome.bake.coordinates[frame - 1], bind)
        residual = np.tensordot(job.outcome.bake.weights[frame - 1], job.outcome.bake.residual_shapes[:, members], 1)
        moved += residual @ character.to_bind.T
        local = (vertices + moved) @ np.linalg.inv(character.to_bind).T
        worn = replace(character, vertices=local, weights=weights)
        expected = skinned(worn, job.computation.rig[(frame - 1) * job.input.settings.substeps :][:1])[0]
        assert np.abs(shown - expected).max() < 1e-5
        assert frame == 1 or np.abs(shown - before).max() > 0.01


def test_a_piece_that_is_the_skin_itself_stays_on_it(soft_arm):
    """The same surface as a separate object: the residual shapes of a coarse cage are there, too."""
    twin = make_sleeve(coarse(soft_arm), away=1.0)
    add_attachment(soft_arm, twin)
    bake(soft_arm)
    assert np.abs(motion(twin) - motion(soft_arm)).max() < 1e-5


@pytest.mark.parametrize("change", [{"solver": "FULL", "modes": 3}, {"method": "STATIC"}])
def test_with_other_methods(soft_arm, change):
    twin = make_sleeve(coarse(soft_arm), away=1.0)
    add_attachment(soft_arm, twin)
    for name, value in change.items():
        setattr(soft_arm.dynamorph.model, name, value)
    bake(soft_arm)
    assert np.abs(motion(twin) - motion(soft_arm)).max() < 1e-5


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_live_and_a_shake_test_show_the_sleeve_too(dressed, solver):
    arm, sleeve = dressed
    arm.dynamorph.model.solver, arm.dynamorph.model.modes = solver, 20
    OPS.build()
    OPS.shake_test(kind="TWIST")
    assert keys_of(sleeve) is None and sleeve.dynamorph.follows is None
    OPS.live()
    live = motion(sleeve, range(1, 21))
    assert sleeve.dynamorph.follows == arm
    OPS.live()
    assert keys_of(sleeve) is None
    bake(arm)
    assert np.abs(motion(sleeve, range(1, 21)) - live).max() < 1e-5


def test_a_bake_of_two_is_undone_and_freed_as_one(dressed):
    arm, sleeve = dressed
    sleeve.shape_key_add(name="Basis")
    worn = sleeve.shape_key_add(name="flexed", from_mix=False)  # named like a target, so the bake contains it
    worn.value = 0.5
    before = fingerprint(arm), fingerprint(sleeve)
    bake(arm)
    assert worn.mute and fingerprint(sleeve) != before[1]
    bake(arm)
    OPS.delete_bake()
    assert (fingerprint(arm), fingerprint(sleeve)) == before and sleeve.dynamorph.follows is None


def test_one_undo_takes_both_bakes_back(dressed):
    reconcile.reconcile(dressed[0])
    bpy.ops.ed.undo_push(message="before")
    before = state()
    assert OPS.bake("EXEC_DEFAULT", True) == {"FINISHED"}
    after = state()
    assert after["Sleeve"] != before["Sleeve"]
    bpy.ops.ed.undo()
    assert state() == before
    bpy.ops.ed.redo()
    assert state() == after


def test_a_basis_that_the_bake_made_goes_with_it(dressed):
    arm, sleeve = dressed
    bake(arm)
    assert keys_of(sleeve)
    OPS.delete_bake()
    assert keys_of(sleeve) is None


def test_nothing_is_written_unless_all_can_be(dressed):
    arm, sleeve = dressed
    before = fingerprint(arm)
    job = Job(arm, goal="BAKE")
    batch = Batch([job], "BAKE")
    list(batch.read())
    list(batch.compute())
    sleeve.data.vertices.add(1)
    with pytest.raises(errors.SceneError, match="'Sleeve' changed while the job ran"):
        list(batch.write())
    assert fingerprint(arm) == before and keys_of(sleeve) is None


def test_the_influence_of_the_body_is_that_of_its_pieces(dressed):
    arm, sleeve = dressed
    bake(arm)
    influence.influence_strip(arm).influence = 0.25
    influence.show_influence(arm)
    assert influence.influence_strip(sleeve).influence == 0.25
    strip = influence.influence_strip(arm)
    with soon():
        for frame, value in ((1, 0.0), (20, 1.0)):
            strip.influence = value
            strip.keyframe_insert("influence", frame=frame)
        bpy.context.view_layer.update()
    bpy.context.scene.frame_set(10)
    assert 0.0 < influence.influence_strip(arm).influence < 1.0
    assert influence.influence_strip(sleeve).influence == influence.influence_strip(arm).influence


def drop_armature(arm, sleeve):
    sleeve.modifiers.clear()


def other_armature(arm, sleeve):
    sleeve.modifiers["Armature"].object = bpy.data.objects.new("Other", rig_of(arm).data)


def soft_already(arm, sleeve):
    activate(sleeve)
    OPS.add_soft_skin()
    activate(arm)


def edited(arm, sleeve):
    activate(sleeve)
    bpy.ops.object.mode_set(mode="EDIT")
    activate(arm)


def shared(arm, sleeve):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Twin", sleeve.data))


def bound(arm, sleeve):
    sleeve.modifiers.new("Cling", "SURFACE_DEFORM").target = arm


def endless(arm, sleeve):
    sleeve.data.vertices[3].co.x = float("nan")


def absolute(arm, sleeve):
    sleeve.shape_key_add(name="Basis")
    keys_of(sleeve).use_relative = False


@pytest.mark.parametrize(
    "spoil, words",
    [
        (drop_armature, "'Sleeve' has no Armature modifier.*or choose Rigid"),
        (other_armature, "'Sleeve' is moved by another armature: choose 'Arm Rig'"),
        (soft_already, "'Sleeve' is a soft skin of its own: choose Own Cage"),
        (edited, "'Sleeve' is in Edit Mode"),
        (shared, "Mesh 'Sleeve' is shared by 2 objects"),
        (bound, "'Sleeve' follows 'Arm' by its modifier 'Cling' already: choose Rigid"),
        (endless, "'Sleeve' has vertices whose coordinates are not numbers"),
        (absolute, "'Sleeve' uses absolute shape keys"),
    ],
)
def test_what_cannot_follow_is_refused_by_name(dressed, spoil, words):
    arm, sleeve = dressed
    spoil(arm, sleeve)
    refused(OPS.bake, words)
    assert not arm.dynamorph.bake.keys
    arm.dynamorph.attachments[0].attached_by = "RIGID"
    if spoil in (edited, endless):  # seams with what the bones alone move are looked for too
        refused(OPS.bake, words)
        return
    OPS.bake()
    assert arm.dynamorph.bake.keys and not sleeve.dynamorph.bake.keys


def test_the_bake_says_which_pieces_it_lacks(dressed):
    arm, sleeve = dressed
    bake(arm)
    assert staleness.outdated(arm) == []
    add_attachment(arm, make_sleeve(arm, "Cuff"))
    assert staleness.outdated(arm) == ["Attachments changed", 'attachment "Cuff" is new']
    arm.dynamorph.attachments[0].attached_by = "RIGID"
    assert staleness.outdated(arm) == [
        "Attachments changed", 'attachment "Cuff" is new', 'attachment "Sleeve" is not with the body any more'
    ]  # fmt: skip
    bake(arm)
    assert staleness.outdated(arm) == [] and not sleeve.dynamorph.bake.keys and keys_of(sleeve) is None


def test_a_removed_piece_has_no_bake_any_more(dressed):
    arm, sleeve = dressed
    bake(arm)
    OPS.remove_attachment()
    assert keys_of(sleeve) is None and not arm.dynamorph.attachments and arm.dynamorph.bake.keys
    assert not OPS.remove_attachment.poll()


@pytest.mark.fault("P04")
def test_a_deleted_piece_is_named_and_left_out(dressed):
    arm, sleeve = dressed
    with bpy.context.temp_override(selected_objects=[sleeve]):
        bpy.ops.object.delete()
    assert "'Sleeve' is gone: remove the attachment" in " ".join(drawn(arm, "DYNAMORPH_PT_physics"))
    OPS.bake()
    assert arm.dynamorph.bake.keys


def test_a_piece_alone_is_freed_when_its_body_is_gone(dressed):
    arm, sleeve = dressed
    bake(arm)
    bpy.data.objects.remove(arm)
    activate(sleeve)
    assert "dynamorph.delete_bake" in drawn(sleeve)
    OPS.delete_bake()
    assert keys_of(sleeve).key_blocks.keys() == ["Basis"] and not OPS.delete_bake.poll()


def test_a_duplicate_of_the_character_has_pieces_of_its_own(dressed):
    arm, sleeve = dressed
    bake(arm)
    for obj in (arm, sleeve, rig_of(arm)):
        obj.select_set(True)
    bpy.ops.object.duplicate()
    other, worn = bpy.data.objects["Arm.001"], bpy.data.objects["Sleeve.001"]
    assert other.dynamorph.attachments[0].object == worn and worn.dynamorph.follows == other
    writer.free(other)
    assert keys_of(worn) is None and sleeve.dynamorph.bake.keys


@pytest.mark.parametrize("was_baked", [False, True])
def test_pieces_of_a_library_override_play_point_caches(dressed, tmp_path, was_baked):
    """They follow the body's Influence, also in the file that is saved. was_baked: in the file they are linked from."""
    obj, _ = dressed
    (OPS.bake if was_baked else OPS.build)()
    character = bpy.data.collections.new("Character")
    bpy.context.scene.collection.children.link(character)
    for each in list(bpy.context.scene.collection.objects):
        bpy.context.scene.collection.objects.unlink(each)
        character.objects.link(each)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "asset.blend"))
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "asset.blend"), link=True) as (_, wanted):
        wanted.collections = ["Character"]
    bpy.context.scene.collection.children.link(wanted.collections[0])
    wanted.collections[0].override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    bpy.context.scene.frame_end = 20
    file = str(tmp_path / "shot.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)

    def overrides():
        found = {each.name.split(".")[0]: each for each in bpy.data.objects if each.override_library}
        return found["Arm"], found["Sleeve"]

    obj, sleeve = overrides()
    plain = motion(sleeve)
    activate(obj)
    obj.dynamorph.output.format = "PC2"
    obj.dynamorph.simulation.gravity = -3.0
    bake(obj)
    shown = motion(obj), motion(sleeve)
    assert np.abs(shown[1] - plain).max() > 1e-3
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=file)
    obj, sleeve = overrides()
    assert sleeve.dynamorph.follows == obj and staleness.outdated(obj) == []
    for each, before in zip((obj, sleeve), shown, strict=True):
        np.testing.assert_allclose(motion(each), before, atol=1e-6)
    (modifier, name) = influence.influence(obj)
    setattr(modifier, name, 0.0)
    np.testing.assert_allclose(motion(sleeve), plain, atol=1e-6)
    activate(obj)
    assert OPS.delete_bake() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=file)
    obj, sleeve = overrides()
    assert sleeve.dynamorph.follows == (obj if was_baked else None) and len(sleeve.modifiers) == 1
    np.testing.assert_allclose(motion(sleeve), plain, atol=1e-6)


def test_pieces_survive_saving(dressed, tmp_path):
    bake(dressed[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    arm, sleeve = bpy.data.objects["Arm"], bpy.data.objects["Sleeve"]
    assert arm.dynamorph.attachments[0].object == sleeve and sleeve.dynamorph.follows == arm
    sleeve.name = "Renamed"
    assert "Renamed" in drawn(arm, "DYNAMORPH_PT_physics") and staleness.outdated(arm) == []
    assert "'Renamed' moves with 'Arm'" in " ".join(drawn(sleeve))


def test_a_sleeve_does_not_follow_a_cage_in_its_way(soft_arm):
    """A buckle with a cage of its own, in the sleeve: the sleeve stays with the arm."""
    add_attachment(soft_arm, make_sleeve(coarse(soft_arm)))
    with_buckle = soft_arm.dynamorph.attachments.add()
    group = soft_arm.vertex_groups.new(name="Buckle")
    upper = [v.index for v in soft_arm.data.vertices if v.co.z > 1.5]
    group.add(upper, 1.0, "REPLACE")
    with_buckle.group, with_buckle.attached_by = "Buckle", "OWN_CAGE"
    job = bake(soft_arm)
    model, character = job.outcome.model, job.outcome.character
    parts = geometry.connected_parts(model.tets, len(model.nodes))
    cages = parts[model.embedding_nodes[:, 0]]
    own, sleeve = character.own_vertices, character.attachments[0].members
    buckle = character.cage_index[own] > 0
    assert not np.isin(cages[sleeve], cages[own][buckle]).any() and np.isin(cages[sleeve], cages[own][~buckle]).all()


# What Find Attachments finds -----------------------------------------------------------------------------------


def test_other_meshes_are_found(soft_arm):
    make_sleeve(soft_arm)
    eye = make_sleeve(soft_arm, "Eye", away=0.1)
    for group in eye.vertex_groups:
        group.add(range(len(eye.data.vertices)), float(group.name == "lower"), "REPLACE")
    glove = make_sleeve(soft_arm, "Glove")
    activate(glove)
    OPS.add_soft_skin()
    bpy.data.objects.new("Elsewhere", eye.data).modifiers.new("Armature", "ARMATURE").object = rig_of(soft_arm)
    activate(soft_arm)
    OPS.find_attachments()
    assert {piece.object.name: piece.attached_by for piece in soft_arm.dynamorph.attachments} == {
        "Sleeve": "WITH_BODY", "Eye": "RIGID", "Glove": "OWN_CAGE"
    }  # fmt: skip
    assert OPS.find_attachments() == {"CANCELLED"} and len(soft_arm.dynamorph.attachments) == 3


def make_arm_with(*blobs):
    """An arm whose mesh also has boxes, each given as (center, size, weight of the lower bone, material slot)."""
    rig = make_rig(bpy.context.scene, "Arm Rig")
    vertices, faces = scenes.tube()
    points, weights, polygons = [np.asarray(vertices)], [scenes.two_bone_weights(vertices)], [list(f) for f in faces]
    slots = [0] * len(faces)
    for center, size, lower, slot in blobs:
        first = sum(map(len, points))
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
        points.append(corners + center)
        weights.append(np.tile([1.0 - lower, lower], (8, 1)))
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        polygons += [[first + corner for corner in side] for side in sides]
        slots += [slot] * 6
    arm = make_mesh(bpy.context.scene, "Arm", np.concatenate(points), polygons)
    for name in ("Skin", "Hair"):
        arm.data.materials.append(bpy.data.materials.new(name))
    arm.data.polygons.foreach_set("material_index", slots)
    skin(arm, rig, np.concatenate(weights))
    activate(arm)
    OPS.add_soft_skin()
    return with_pins(arm)


def test_few_loose_parts_are_a_piece_each(scene):
    arm = make_arm_with(((0, 0, 1.9), 0.1, 1.0, 0), ((0.4, 0, 0.3), 0.2, 0.5, 1))
    OPS.find_attachments()
    found = [(piece.group, piece.attached_by) for piece in arm.dynamorph.attachments]
    assert found == [("Dynamorph Attachment Hair", "RIGID"), ("Dynamorph Attachment Skin", "RIGID")]
    groups = mesh_data.group_weights(arm, [group for group, _ in found])
    body = len(scenes.tube()[0])
    assert (
        groups[:body].sum() == 0 and (groups[body : body + 8] == [0, 1]).all() and (groups[body + 8 :] == [1, 0]).all()
    )
    assert OPS.find_attachments() == {"CANCELLED"}


def test_many_loose_parts_are_grouped_by_material(scene):
    hair = [((0.05 * k, 0.5, 1.5), 0.02, 1.0, 1) for k in range(20)]
    teeth = [((0.05 * k, -0.5, 1.5), 0.02, 0.5, 0) for k in range(10)]
    arm = make_arm_with(*hair, *teeth, ((0.6, 0, 1.9), 0.3, 1.0, 0))
    OPS.find_attachments()
    found = [
        (piece.group.removeprefix("Dynamorph Attachment "), piece.attached_by) for piece in arm.dynamorph.attachments
    ]
    assert found == [("Skin", "RIGID"), ("Hair", "RIGID"), ("Skin.001", "RIGID")]
    counts = [int(attachments.members(arm, piece.group).sum()) for piece in arm.dynamorph.attachments]
    assert counts == [8, 160, 80]


CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
BOX_SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def box(x, y, z, along_x, along_y, along_z):
    """From a corner, with these sides, at the skin of the arm, which is at x = 0.3."""
    return CORNERS * [along_x, along_y, along_z] + [x, y, z], BOX_SIDES


def card(x, y, z, out, wide):
    return np.array([(x, y, z), (x, y + wide, z), (x + out, y + wide, z), (x + out, y, z)]), [(0, 1, 2, 3)]


@pytest.mark.parametrize(
    "part, rides",
    [
        (card(0.302, 0.0, 0.6, 0.05, 0.02), True),  # a hair, a feather, a scale: just above the skin
        (box(0.302, -0.02, 0.4, 0.004, 0.04, 0.5), True),  # a strap
        (card(0.4, 0.0, 0.6, 0.05, 0.02), False),  # away from it
        (box(0.302, -0.005, 0.6, 0.3, 0.01, 0.02), False),  # a dagger, which stands out
        (box(0.302, -0.01, 0.6, 0.01, 0.02, 0.02), False),  # a buckle
    ],
    ids=["card", "strap", "away", "dagger", "buckle"],
)
@pytest.mark.parametrize("own_mesh", [False, True])
def test_thin_parts_ride_on_the_skin_below(scene, part, rides, own_mesh):
    """Whichever bone moves them: here the lower one alone, on skin of the upper one."""
    points, faces = part
    vertices, polygons = scenes.tube()
    weights = scenes.two_bone_weights(vertices)
    rig, hard = make_rig(scene, "Arm Rig"), np.tile([0.0, 1.0], (len(points), 1))
    if own_mesh:
        arm, other = make_mesh(scene, "Arm", vertices, polygons), make_mesh(scene, "Part", points, faces)
        skin(arm, rig, weights)
        skin(other, rig, hard)
    else:
        moved = [[len(vertices) + corner for corner in face] for face in faces]
        arm = make_mesh(scene, "Arm", np.concatenate([vertices, points]), [*polygons, *moved])
        skin(arm, rig, np.concatenate([weights, hard]))
    activate(arm)
    OPS.add_soft_skin()
    attached = [piece.attached_by for piece in arm.dynamorph.attachments]
    assert attached == (["WITH_BODY"] if own_mesh else []) if rides else attached == ["RIGID"]


@pytest.mark.fault("M21")
def test_loose_parts_that_a_mask_hides_are_outside_the_cage(scene):
    """As MakeHuman's geometry for fitting clothes. What a mask hides of the body itself stays in the cage."""
    arm = make_arm_with(((0, 0, 1.0), 0.9, 1.0, 0))
    body = len(scenes.tube()[0])
    arm.vertex_groups["lower"].remove(range(body, body + 4))  # the box is soft
    arm.vertex_groups["upper"].add(range(body, body + 4), 1.0, "REPLACE")
    arm.vertex_groups.new(name="body").add(range(10, body), 1.0, "REPLACE")
    mask = arm.modifiers.new("Hide helpers", "MASK")
    mask.show_render = False
    mask.vertex_group = "body"
    assert OPS.find_attachments() == {"CANCELLED"}
    mask.show_render = True
    OPS.find_attachments()
    (hidden,) = arm.dynamorph.attachments
    assert (hidden.attached_by, hidden.reason) == ("RIGID", "Mask modifiers hide this loose part")
    cages = extract.character(arm, without_targets=True).cage_index
    assert (cages[:body] == 0).all() and (cages[body:] == -1).all()
    assert OPS.find_attachments() == {"CANCELLED"}


def test_seams_do_not_part_a_mesh():
    """Imported meshes may have separate vertices for each face."""
    vertices, faces = scenes.tube()
    points = np.concatenate([np.asarray(vertices)[list(face)] for face in faces])
    first = np.cumsum([0, *(len(face) for face in faces)])
    edges = [(a + k, a + (k + 1) % (b - a)) for a, b in pairwise(first) for k in range(b - a)]
    loose_parts = geometry.loose_parts
    assert loose_parts(points, np.array(edges)).max() == 0
    two = np.concatenate([points, points + np.array([9.0, 0.0, 0.0])])
    labels = loose_parts(two, np.concatenate([edges, np.array(edges) + len(points)]))
    assert np.array_equal(labels, np.repeat([0, 1], len(points)))


def test_a_long_chain_is_one_part():
    order = np.random.default_rng(1).permutation(5000)
    points = np.arange(15000.0).reshape(-1, 3)
    edges = np.column_stack([order[:-1], order[1:]])
    loose_parts = geometry.loose_parts
    assert loose_parts(points, edges).max() == 0
    assert loose_parts(points, np.delete(edges, 2000, axis=0)).max() == 1


def test_the_choice_of_parts_goes_into_the_character(scene):
    arm = make_arm_with(*(((0.4, 0, 0.2 + 0.2 * k), 0.1, 0.5, 1) for k in range(4)))
    body = len(scenes.tube()[0])
    for k, choice in enumerate(("OWN_CAGE", "RIGID", "OWN_CAGE", "WITH_BODY")):
        group = arm.vertex_groups.new(name=f"Box {k}")
        group.add(range(body + 8 * k, body + 8 * k + 8), 1.0, "REPLACE")
        piece = arm.dynamorph.attachments.add()
        piece.group, piece.attached_by = group.name, choice
    reconcile.reconcile(arm)
    character = extract.character(arm, without_targets=True)
    assert not character.cage_index[:body].any() and sorted(character.cage_index[body::8]) == [-1, 0, 1, 2]
    other = replace(character, cage_index=None)
    assert build.dependencies(character)["attachments"] != build.dependencies(other)["attachments"]
    arm.vertex_groups[arm.dynamorph.attachments[0].group].name = "Buckle"
    reconcile.reconcile(arm)
    assert arm.dynamorph.attachments[0].group == "Buckle"
    arm.vertex_groups.remove(arm.vertex_groups["Buckle"])
    assert "The vertex group 'Buckle' is gone" in " ".join(drawn(arm, "DYNAMORPH_PT_physics"))
    refused(OPS.build_cage, "the vertex group 'Buckle' of an attachment is gone")


def test_a_part_is_selected_in_edit_mode(scene):
    arm = make_arm_with(((0.4, 0, 0.3), 0.2, 0.5, 1))
    OPS.find_attachments()
    OPS.select_attachment()
    bpy.ops.object.mode_set(mode="OBJECT")
    selected = [vertex.select for vertex in arm.data.vertices]
    assert sum(selected) == 8 and all(selected[-8:])
    OPS.remove_attachment()
    assert not arm.dynamorph.attachments and "Dynamorph Attachment Hair" not in arm.vertex_groups


def test_what_is_left_alone_is_said(soft_arm):
    rig = rig_of(soft_arm)
    for name, kind, bone in (("Sword", "BONE", "lower"), ("Hat", "OBJECT", "")):
        other = make_mesh(bpy.context.scene, name, np.eye(3), [(0, 1, 2)])
        other.parent, other.parent_type, other.parent_bone = rig, kind, bone
    assert sorted(attachments.left_alone(soft_arm)) == [
        "'Hat' is parented to 'Arm Rig': it moves with it as a whole and is left alone",
        "'Sword' is parented to bone 'lower': it moves with the bone and is left alone",
    ]
    assert "'Sword' is parented to bone" in " ".join(drawn(soft_arm, "DYNAMORPH_PT_physics"))
    for k in range(4):
        make_mesh(bpy.context.scene, f"Badge {k}", np.eye(3), [(0, 1, 2)]).parent = rig
    assert "And 3 more like them" in drawn(soft_arm, "DYNAMORPH_PT_physics")


# Setups ------------------------------------------------------------------------------------------------------------


def test_setups_have_the_pieces(dressed, tmp_path):
    arm, sleeve = dressed
    path = str(tmp_path / "arm.json")
    arm.vertex_groups.new(name="Dynamorph Attachment Hair")
    hair = arm.dynamorph.attachments.add()
    hair.group, hair.attached_by = "Dynamorph Attachment Hair", "OWN_CAGE"
    add_attachment(arm, make_sleeve(arm, "Cuff"), "RIGID")
    OPS.save_setup(filepath=path)
    arm.dynamorph.attachments.clear()
    bpy.data.objects["Cuff"].name = "Other"
    OPS.load_setup(filepath=path)
    found = [(piece.object, piece.group, piece.attached_by) for piece in arm.dynamorph.attachments]
    assert found == [(sleeve, "", "WITH_BODY"), (None, "Dynamorph Attachment Hair", "OWN_CAGE")]


@pytest.mark.parametrize(
    "piece", [7, {}, {"object": 3, "group": "x"}, {"object": "", "group": ""}, {"object": "Sleeve", "choice": "UP"}]
)
def test_a_setup_with_wrong_pieces_changes_nothing(dressed, piece):
    setup = setups.of_object(dressed[0]) | {"attachments": [piece]}
    with pytest.raises(errors.SetupError, match="Attachment 1"):
        setups.check(setup)


def test_a_copy_leaves_the_clothes_where_they_are(dressed):
    """An object can follow only one soft skin."""
    arm, sleeve = dressed
    arm.vertex_groups.new(name="Dynamorph Attachment Hair").add(range(100), 1.0, "REPLACE")
    arm.dynamorph.attachments.add().group = "Dynamorph Attachment Hair"
    other = make_sleeve(arm, "Other", away=1.0)
    arm.select_set(True)
    other.select_set(True)
    OPS.copy_to_selected()
    assert [piece.group for piece in other.dynamorph.attachments] == ["Dynamorph Attachment Hair"]
    assert attachments.members(other, "Dynamorph Attachment Hair").sum() == 100
