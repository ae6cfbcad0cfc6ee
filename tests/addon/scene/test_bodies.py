# SPDX-License-Identifier: GPL-3.0-or-later
"""A body of several meshes is one body: one cage and closed seams; all meshes are written, shown, removed and exported
together.
"""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.model import rigid
from bl_ext.user_default.dynamic_morph_targets.run.bake import export_actions
from bl_ext.user_default.dynamic_morph_targets.run.bake.batch import Batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.live import problem
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.ui import messages as ui_messages
from bl_ext.user_default.dynamic_morph_targets.write.export import exports, losses
from builders import (
    activate,
    add_key,
    evaluated_points,
    fingerprint,
    keys_of,
    make_mesh,
    refused,
    select_bones,
)
from figures import ball, make_figure, skin, tube_between, weights_at
from layout import drawn
from mathutils import Matrix
from robustness import bake, coarse

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph
JOINED = (("Body", "Top"), ("Top", "Cap"))
SIZE = 2.3  # meters, about


@pytest.fixture
def figure(scene):
    """The meshes of a figure, whose body is a soft skin."""
    found = make_figure(scene)
    OPS.add_soft_skin()
    prepare(found["Body"])
    return found


def prepare(body):
    coarse(body).dynamorph.model.method = "SINGLE"
    simulation = body.dynamorph.simulation
    simulation.max_displacement = simulation.max_thickness = 0.0


def attachments(obj):
    return [
        (piece.object.name if piece.object else "", piece.group, piece.attached_by)
        for piece in obj.dynamorph.attachments
    ]


def rest(obj):
    points = mesh_data.rest_points(obj)
    world = np.array(obj.matrix_world)
    return points @ world[:3, :3].T + world[:3, 3]


def positions(found, frames):
    """The points of all meshes at some frames, {name: (F, V, 3)}."""
    out = {name: [] for name, obj in found.items() if obj.type == "MESH"}
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        for name, points in out.items():
            points.append(evaluated_points(found[name]))
    return {name: np.array(points) for name, points in out.items()}


def assert_closed(found, frames=range(1, 15), moves=0.01):
    """Check that points that coincide at rest do so in every frame, and that the skin around them moves, in meters."""
    shown = positions(found, frames)
    for first, second in JOINED:
        apart = np.linalg.norm(rest(found[first])[:, None] - rest(found[second])[None], axis=2)
        pairs = np.argwhere(apart < 1e-5)
        assert len(pairs) >= 16
        gaps = np.linalg.norm(shown[first][:, pairs[:, 0]] - shown[second][:, pairs[:, 1]], axis=2)
        assert gaps.max() < 1e-6 * SIZE + 4e-7, (first, second)
    for name in ("Body", "Top"):
        blocks = found[name].data.shape_keys.key_blocks
        muted = [block.mute for block in blocks]
        blocks.foreach_set("mute", np.ones(len(blocks), bool))
        still = positions({name: found[name]}, frames)[name]
        blocks.foreach_set("mute", muted)
        assert np.linalg.norm(shown[name] - still, axis=2).max() > moves, name


# What belongs to a body ----------------------------------------------------------------------------------------------


def test_add_soft_skin_finds_what_belongs_to_the_body(figure):
    body = figure["Body"]
    assert body.dynamorph.model.hold_head
    assert attachments(body) == [("Top", "", "WITH_BODY"), ("Cap", "", "HELD"), ("Eye", "", "RIGID")]
    assert [piece.reason for piece in body.dynamorph.attachments] == [
        "It is skinned by the same armature",
        "Only bone 'hand' moves it, and it shares points with soft skin",
        "Only bone 'hand' moves it",
    ]
    text = " ".join(drawn(body, "DYNAMORPH_PT_physics"))
    assert "Attachments (3)" in text and "It is skinned by the same" in text and "hold_head" in text


def test_the_character_covers_all_meshes(figure):
    body = figure["Body"]
    character = extract.character(body)
    counts = [len(figure[name].data.vertices) for name in ("Body", "Top", "Cap")]
    assert len(character.vertices) == len(character.weights) == sum(counts)
    assert [each.name for each in character.attachments] == ["Top", "Cap"] and character.own_vertices.stop == counts[0]
    world = np.concatenate([rest(figure[name]) for name in ("Body", "Top", "Cap")])
    assert np.abs(character.vertices - world).max() < 2e-5  # the body's object space is world space
    cap = character.attachments[1].members
    assert (character.rigidity[cap] == 1.0).all() and not character.cage_index.any()
    doubles = character.coincident != np.arange(sum(counts))
    assert doubles.sum() == 32
    assert np.abs(world[doubles] - world[character.coincident[doubles]]).max() < 1e-5


def test_a_mesh_that_cannot_be_used_is_listed_with_the_reason(scene):
    found = make_figure(scene)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Twin", found["Cap"].data))
    keys = found["Eye"]
    keys.shape_key_add(name="Basis")
    keys_of(keys).use_relative = False
    mirror = found["Top"].modifiers.new("Mirror", "MIRROR")
    found["Top"].modifiers.move(found["Top"].modifiers.find(mirror.name), 0)
    activate(found["Body"])
    OPS.add_soft_skin()
    by_name = {piece.object.name: piece for piece in found["Body"].dynamorph.attachments}
    assert by_name["Cap"].attached_by == "RIGID" and "is shared by 2 objects" in by_name["Cap"].reason
    assert by_name["Eye"].attached_by == "RIGID" and "absolute shape keys" in by_name["Eye"].reason
    assert by_name["Top"].attached_by == "RIGID" and "'Mirror' comes before the Armature" in by_name["Top"].reason


def test_a_choice_of_the_artist_has_no_reason(figure):
    piece = figure["Body"].dynamorph.attachments[2]
    piece.attached_by = "WITH_BODY"
    assert piece.reason == ""
    OPS.find_attachments()
    assert attachments(figure["Body"])[2] == ("Eye", "", "WITH_BODY")


def test_a_soft_skin_goes_on_the_body(scene):
    """It is never put on an active helmet; if the armature is active, it goes on its softest mesh."""
    found = make_figure(scene)
    activate(found["Eye"])
    OPS.add_soft_skin()
    assert not found["Eye"].dynamorph.targets and bpy.context.object.dynamorph.targets
    soft = bpy.context.object
    soft.dynamorph.targets.clear()
    soft.dynamorph.attachments.clear()
    activate(found["Figure Rig"])
    OPS.add_soft_skin()
    assert soft.dynamorph.targets and bpy.context.object == found["Figure Rig"]


def test_what_is_parented_to_a_bone_leads_to_the_body(scene):
    found = make_figure(scene)
    sword = make_mesh(scene, "Sword", *ball((0.0, 0.5, 0.0), 0.1))
    activate(sword)
    assert not OPS.add_soft_skin.poll()
    sword.parent, sword.parent_type, sword.parent_bone = found["Figure Rig"], "BONE", "hand"
    OPS.add_soft_skin()
    assert bpy.context.object != sword and bpy.context.object.dynamorph.targets and not sword.dynamorph.targets


# One cage ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", ["BONES", "THICKNESS"])
def test_seams_stay_closed_in_a_bake(figure, hold):
    body = figure["Body"]
    body.dynamorph.model.hold = hold
    before = fingerprint(body)
    bake(body)
    assert_closed(figure, moves=0.002)
    assert figure["Top"].dynamorph.follows == body and figure["Cap"].dynamorph.follows == body
    assert keys_of(figure["Eye"]) is None
    OPS.delete_bake()
    assert fingerprint(body) == before and keys_of(figure["Top"]) is None and keys_of(figure["Cap"]) is None


@pytest.mark.parametrize(("kind", "keys"), [("MODES", 3), ("PC2", 0)])
def test_seams_stay_closed_whatever_the_bake_becomes(figure, tmp_path, kind, keys):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "figure.blend"))
    body = figure["Body"]
    body.dynamorph.output.format, body.dynamorph.output.keys = kind, keys
    bake(body)
    shown = positions(figure, range(1, 15))
    for first, second in JOINED:
        apart = np.linalg.norm(rest(figure[first])[:, None] - rest(figure[second])[None], axis=2)
        one, other = np.argwhere(apart < 1e-5).T
        gaps = np.linalg.norm(shown[first][:, one] - shown[second][:, other], axis=2)
        assert gaps.max() < 1e-6 * SIZE + 4e-7


def test_seams_stay_closed_in_a_part_that_is_baked_again(figure):
    body = figure["Body"]
    bake(body)
    simulation = body.dynamorph.simulation
    simulation.use_scene_range, simulation.keep_outside = False, True
    simulation.frame_start, simulation.frame_end = 6, 10
    body.dynamorph.targets[0].stiffness *= 0.7
    bake(body)
    assert_closed(figure)


def test_seams_stay_closed_where_blender_poses_the_nodes(figure):
    """With Preserve Volume the bones do not determine where the nodes are."""
    for name in ("Body", "Top", "Cap"):
        figure[name].modifiers["Armature"].use_deform_preserve_volume = True
    job = bake(figure["Body"])
    assert job.outcome.character.probed
    assert_closed(figure)


def test_seams_stay_closed_in_an_unreduced_bake(figure):
    model = figure["Body"].dynamorph.model
    model.solver, model.modes = "FULL", 6
    bake(figure["Body"])
    assert_closed(figure)


@pytest.mark.parametrize(
    ("solver", "basis", "apart"), [("REDUCED", "MODES", 2e-5), ("FULL", "MODES", 2e-5), ("REDUCED", "RESPONSES", 2e-3)]
)
def test_live_shows_all_meshes_as_the_bake_does(figure, solver, basis, apart):
    """As a part of how far the body moves. With bone responses the bake has fewer keys than modes."""
    body, plain = figure["Body"], positions(figure, range(1, 15))
    body.dynamorph.model.solver, body.dynamorph.model.basis, body.dynamorph.model.modes = solver, basis, 20
    OPS.build()
    OPS.live()
    live = positions(figure, range(1, 15))
    assert figure["Top"].dynamorph.follows == body
    assert_closed(figure)
    OPS.live()
    assert keys_of(figure["Top"]) is None and keys_of(figure["Cap"]) is None
    bake(body)
    moved = max(np.abs(points - live[name]).max() for name, points in plain.items())
    for name, points in positions(figure, range(1, 15)).items():
        assert np.abs(points - live[name]).max() < apart * moved, name


def test_live_says_when_another_mesh_of_the_body_was_edited(figure):
    body = figure["Body"]
    OPS.build()
    OPS.live()
    bpy.context.scene.frame_set(2)
    figure["Top"].data.vertices.add(1)
    bpy.context.scene.frame_set(3)
    assert "Top" in problem(body)


def test_a_build_notices_what_has_changed_in_any_mesh(figure):
    body = figure["Body"]
    OPS.build()
    assert model_store.stale_reasons(body, extract.character(body)) == []
    figure["Top"].data.vertices[20].co.x += 0.01
    assert model_store.stale_reasons(body, extract.character(body)) == ["mesh changed"]
    figure["Top"].data.vertices[20].co.x -= 0.01
    body.dynamorph.attachments[1].attached_by = "RIGID"
    assert staleness.model_changes(body)


def test_nothing_is_written_unless_all_can_be(figure):
    job = Job(figure["Body"], goal="BAKE")
    batch = Batch([job], "BAKE")
    list(batch.read())
    list(batch.compute())
    figure["Top"].data.vertices.add(1)
    with pytest.raises(errors.SceneError, match="'Top' changed while the job ran"):
        list(batch.write())


@pytest.mark.parametrize("key", ["GLTF", "FBX", "ALEMBIC", "USD"])
def test_an_export_takes_all_meshes_along(figure, tmp_path, key):
    """This includes the rigid ones, and what is parented to a bone."""
    body = figure["Body"]
    if not exports.FORMATS[key].is_available:
        pytest.skip("not in this Blender")
    points, faces = ball((0.0, 0.5, 0.0), 0.1)
    sword = make_mesh(bpy.context.scene, "Sword", points, faces)
    sword.parent, sword.parent_type, sword.parent_bone = figure["Figure Rig"], "BONE", "hand"
    hidden = make_mesh(bpy.context.scene, "Hidden", points, faces)
    hidden.parent = figure["Figure Rig"]
    bpy.context.view_layer.update()
    hidden.hide_set(True)
    bake(body)
    selected = set(bpy.context.selected_objects)
    path = tmp_path / f"figure{exports.FORMATS[key].suffix}"
    export_actions.export(body, key, path, (1, 5))
    assert set(bpy.context.selected_objects) == selected
    assert any("'Hidden' is hidden" in text for text in losses.losses(body, key))
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    reader = {
        "GLTF": bpy.ops.import_scene.gltf, "FBX": bpy.ops.import_scene.fbx,
        "ALEMBIC": bpy.ops.wm.alembic_import, "USD": bpy.ops.wm.usd_import,
    }[key]  # fmt: skip
    reader(filepath=str(path))
    counts = sorted(len(obj.data.polygons) for obj in bpy.data.objects if obj.type == "MESH")
    meshes = {obj.name.split("_")[0].split(".")[0] for obj in bpy.data.objects if obj.type == "MESH"}
    assert {"Body", "Top", "Cap", "Eye", "Sword"} <= meshes and "Hidden" not in meshes, counts


def test_clips_of_actions_have_all_meshes(figure, tmp_path):
    pygltflib = pytest.importorskip("pygltflib")
    OPS.build()
    path = tmp_path / "figure.glb"
    export_actions.export(figure["Body"], "GLTF", path, (1, 5), takes="ACTIONS")
    file = pygltflib.GLTF2().load(str(path))
    meshes = [node.name for node in file.nodes if node.mesh is not None]
    assert sorted(meshes) == ["Body", "Cap", "Eye", "Top"]
    with_morphs = {file.meshes[node.mesh].name for node in file.nodes if node.mesh is not None}
    assert len(with_morphs) == 4
    targets = {
        node.name: len(file.meshes[node.mesh].primitives[0].targets or [])
        for node in file.nodes
        if node.mesh is not None
    }
    assert targets["Body"] == targets["Top"] == targets["Cap"] > 0 == targets["Eye"]


def test_an_export_without_a_bake_is_refused_before_the_file_browser(figure):
    with pytest.raises(errors.ExportError, match="has no bake to export: press Bake first"):
        exports.check_bake(figure["Body"], "GLTF")


# Targets and paint on the other meshes -------------------------------------------------------------------------------


def test_a_sculpt_goes_on_across_a_seam(figure):
    """The nearest skin of the other mesh takes it over, less with growing distance."""
    body = figure["Body"]
    points = mesh_data.rest_points(body)
    body.dynamorph.model.method = "DYNAMIC"
    shape = np.zeros_like(points)
    shape[:, 0] = 0.2 * np.clip(points[:, 2] - 0.5, 0.0, 1.0)
    add_key(body, "lean", shape)
    bpy.context.scene.frame_set(5)
    OPS.add_target(key="lean")
    bpy.context.scene.frame_set(1)
    character = extract.character(body)
    carried = next(target.shape for target in character.targets if target.name == "lean")
    at_seam = np.isclose(character.vertices[:, 2], 1.0, atol=1e-4)
    assert at_seam.sum() == 32 and np.abs(carried[at_seam] - [0.1, 0.0, 0.0]).max() < 1e-5
    assert np.abs(carried[character.vertices[:, 2] > 1.4]).max() == 0.0
    bake(body)
    assert_closed(figure)
    assert OPS.check_targets() == {"FINISHED"}


def test_firmness_of_the_other_meshes_counts(figure):
    body, top = figure["Body"], figure["Top"]
    for obj, weight in ((body, 0.5), (top, 0.25)):
        group = obj.vertex_groups.new(name="Firm")
        group.add(range(len(obj.data.vertices)), weight, "REPLACE")
    body.dynamorph.firmness_group = "Firm"
    character = extract.character(body)
    seam = character.coincident[character.attachments[0].members] < character.own_vertices.stop
    assert (character.firmness[character.own_vertices] == 0.5).all()
    assert character.firmness[character.attachments[0].members][~seam] == pytest.approx(0.25)
    assert (character.rigidity[character.attachments[1].members] == 1.0).all()  # it is held nevertheless


def test_a_setup_keeps_the_attachments_of_other_meshes(figure, tmp_path):
    body, path = figure["Body"], str(tmp_path / "figure.json")
    figure["Top"].vertex_groups.new(name="Belt").add(range(8), 1.0, "REPLACE")
    piece = body.dynamorph.attachments.add()
    piece.object, piece.group, piece.attached_by = figure["Top"], "Belt", "HELD"
    before = attachments(body), [piece.reason for piece in body.dynamorph.attachments]
    assert (extract.character(body).rigidity[extract.character(body).attachments[0].members][:8] == 1.0).all()
    OPS.save_setup(filepath=path)
    body.dynamorph.attachments.clear()
    OPS.load_setup(filepath=path)
    assert (attachments(body), [piece.reason for piece in body.dynamorph.attachments]) == before


# Rigid parts ---------------------------------------------------------------------------------------------------------


def merged(scene, rig, cage_index):
    """A mesh of tubes and balls: (points, faces, bone or weights (V, 3)) each."""
    points, faces, weights = [], [], []
    for vertices, polygons, weight in cage_index:
        first = sum(map(len, points))
        points.append(vertices)
        faces += [[first + corner for corner in face] for face in polygons]
        if isinstance(weight, str):
            weight = np.tile(np.eye(3)[["upper", "lower", "hand"].index(weight)], (len(vertices), 1))
        weights.append(weight)
    obj = make_mesh(scene, "Merged", np.concatenate(points), faces)
    activate(skin(obj, rig, np.concatenate(weights)))
    return obj


def test_loose_parts_on_one_bone_are_rigid(scene):
    found = make_figure(scene)
    points, faces = tube_between(0.0, 2.0, 17)
    horn = ball((0.0, 0.0, 2.5), 0.1)
    ring = tube_between(2.0, 2.1, 2, closed=(False, True))
    obj = merged(
        scene,
        found["Figure Rig"],
        [(points, faces, weights_at(points[:, 2])), (*horn, "hand"), (*ring, "hand")],
    )
    for name in ("Body", "Top", "Cap", "Eye"):
        bpy.data.objects.remove(found[name])
    OPS.add_soft_skin()
    # The points of the ring coincide with those of the tube, so the two are welded.
    assert attachments(obj) == [("", "Dynamorph Attachment Part", "RIGID")]
    character = extract.character(obj, without_targets=True)
    assert (character.cage_index == -1).sum() == len(horn[0]) and obj.dynamorph.attachments[0].reason.startswith(
        "This loose"
    )


def hard_robot(scene):
    rig = make_figure(scene)["Figure Rig"]
    for name in ("Body", "Top", "Cap", "Eye"):
        bpy.data.objects.remove(bpy.data.objects[name])
    parts = [(*tube_between(k, k + 0.9, 5), bone) for k, bone in enumerate(("upper", "lower", "hand"))]
    return merged(scene, rig, parts)


def test_a_wholly_hard_character_is_recognized(scene):
    obj = hard_robot(scene)
    OPS.add_soft_skin()
    text = "'Merged': nothing soft found: paint Firmness"
    assert obj.dynamorph.targets and obj.dynamorph.model.warnings == text
    assert text in " ".join(drawn(obj))
    obj.dynamorph.model.method = "SINGLE"
    refused(OPS.build, text)
    refused(OPS.bake, text)


@pytest.mark.parametrize("way", ["paint", "choose"])
def test_the_artist_can_make_something_hard_soft(scene, way):
    obj = hard_robot(scene)
    OPS.add_soft_skin()
    prepare(obj)
    if way == "paint":
        obj.vertex_groups.new(name="Firm").add(range(len(obj.data.vertices)), 0.0, "REPLACE")
        obj.dynamorph.firmness_group = "Firm"
        obj.dynamorph.attachments.clear()
    else:
        obj.dynamorph.attachments[0].attached_by = "WITH_BODY"
    bake(obj)
    assert obj.dynamorph.bake.exists


def chest():
    """A box and its lid, which share the hinge."""
    return [(*tube_between(0.0, 1.0, 9), "upper"), (*tube_between(1.0, 1.4, 5), "lower")], {"lower": "Lid"}


def box_without_names():
    return [(*tube_between(0.0, 1.0, 9), "upper"), (*tube_between(1.01, 1.4, 5), "lower")], {}


def spring():
    """One skin; each of its rings follows one bone."""
    points, faces = tube_between(0.0, 3.0, 31)
    return [(points * [0.2, 0.2, 1.0], faces, np.eye(3)[points[:, 2].astype(int).clip(0, 2)])], {"upper": "Spring_01"}


def drone():
    rotors = [(*ball((x, y, 1.0), 0.2), "lower") for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    return [(*ball((0.0, 0.0, 1.0), 0.8, 16), "upper"), *rotors], {"lower": "Rotor_FL"}


def skull():
    return [(*ball((0.0, 0.0, 1.0), 0.8, 16), "upper")], {"upper": "skull"}


@pytest.mark.parametrize("made", [chest, box_without_names, spring, drone, skull])
def test_a_hard_thing_that_is_no_robot_is_recognized(scene, made):
    """Its skin follows one bone each, as a soft character's does not; so one bone or two make no jelly of it."""
    rig = make_figure(scene)["Figure Rig"]
    for name in ("Body", "Top", "Cap", "Eye"):
        bpy.data.objects.remove(bpy.data.objects[name])
    skins, names = made()
    obj = merged(scene, rig, skins)
    for before, name in names.items():
        rig.data.bones[before].name = name
    OPS.add_soft_skin()
    text = "'Merged': nothing soft found: paint Firmness"
    assert obj.dynamorph.model.warnings == text and text in " ".join(drawn(obj))
    obj.vertex_groups.new(name="Firm").add(range(len(obj.data.vertices)), 0.0, "REPLACE")
    obj.dynamorph.firmness_group = "Firm"
    obj.dynamorph.attachments.clear()
    assert (extract.character(obj).cage_index >= 0).all()


def test_a_jelly_on_one_bone_is_soft(scene):
    rig = make_figure(scene)["Figure Rig"]
    for name in ("Body", "Top", "Cap", "Eye"):
        bpy.data.objects.remove(bpy.data.objects[name])
    obj = merged(scene, rig, [(*ball((0, 0, 1.0), 0.8, 16), "lower"), (*ball((0, 0.9, 1.0), 0.1), "lower")])
    OPS.add_soft_skin()
    assert [choice for *_, choice in attachments(obj)] == ["RIGID"] and not obj.dynamorph.model.warnings
    character = extract.character(obj, without_targets=True)
    assert (character.cage_index == -1).sum() == len(ball((0, 0, 0), 0.1)[0])


def test_skin_that_shares_points_with_what_a_bone_carries_stays_there(figure):
    """Objects that are parented to a bone get no keys, so the skin must not move away from them."""
    body = figure["Body"]
    points, faces = tube_between(-0.3, 0.0, 3, closed=(True, False))
    boot = make_mesh(bpy.context.scene, "Boot", points, faces)
    rig = figure["Figure Rig"]
    boot.parent, boot.parent_type, boot.parent_bone = rig, "BONE", "upper"
    bone = rig.data.bones["upper"]
    boot.matrix_parent_inverse = (bone.matrix_local @ Matrix.Translation((0.0, bone.length, 0.0))).inverted()
    bpy.context.view_layer.update()
    character = extract.character(body)
    joined = np.isclose(character.vertices[:, 2], 0.0, atol=1e-5)
    assert (character.cage_index[joined] == -1).all() and (character.cage_index[~joined] == 0).all()
    assert (character.rigidity[np.isclose(character.vertices[:, 2], 0.125, atol=1e-4)] == 1.0).all()
    bake(body)
    shown = positions({"Body": body, "Boot": boot}, range(1, 15))
    one, other = np.argwhere(np.linalg.norm(rest(body)[:, None] - points[None], axis=2) < 1e-5).T
    assert np.abs(shown["Body"][:, one] - shown["Boot"][:, other]).max() < 3e-6


# Heads ---------------------------------------------------------------------------------------------------------------


def chain_figure(scene, names=("a", "b", "c"), head=0.45):
    """A trunk of two bones, a neck and a ball on top: one closed skin."""
    rig = make_figure(scene)["Figure Rig"]
    for name in ("Body", "Top", "Cap", "Eye"):
        bpy.data.objects.remove(bpy.data.objects[name])
    points, faces = tube_between(0.0, 3.0, 61)
    z = points[:, 2]
    radius = np.where(z < 1.9, 0.4, 0.15)
    top = (z > 2.05) & (z <= 3.0)
    radius[top] = np.maximum(0.02, np.sqrt(np.maximum(head**2 - (z[top] - 2.5) ** 2, 0.0)))
    points[:, :2] *= (radius / 0.3)[:, None]
    first, second = (np.clip((z - joint) / 0.2 + 0.5, 0.0, 1.0) for joint in (1.0, 2.0))
    weights = np.stack([1 - first, first * (1 - second), second], axis=1)
    obj = skin(make_mesh(scene, "Chain", points, faces), rig, weights)
    for old, new in zip(("upper", "lower", "hand"), names, strict=True):
        rig.data.bones[old].name = new
    activate(obj)
    OPS.add_soft_skin()
    return obj


@pytest.mark.parametrize("names, found", [(("a", "b", "c"), "c"), (("hips", "spine", "Head_05"), "Head_05")])
def test_a_head_is_recognized_by_shape_or_name(scene, names, found):
    obj = chain_figure(scene, names)
    assert obj.dynamorph.model.head == found
    character = extract.character(obj, without_targets=True)
    z = character.vertices[:, 2]
    assert (character.rigidity[z > 2.2] == 1.0).all() and not character.rigidity[z < 1.8].any()
    between = character.rigidity[(z > 1.9) & (z < 2.1)]
    assert (between > 0.0).any() and (between < 1.0).any()
    assert f"Held as the head: {found}" in " ".join(drawn(obj, "DYNAMORPH_PT_physics"))
    obj.dynamorph.model.hold_head = False
    assert not extract.character(obj, without_targets=True).rigidity.any()


def test_a_head_that_follows_a_control_is_recognized_by_its_name(scene):
    """As in Rigify: the bone that deforms hangs on the neck, and copies a mechanism below the control "head"."""
    obj = chain_figure(scene, head=0.15)  # which looks like none
    rig = obj.modifiers["Armature"].object
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    bones = rig.data.edit_bones
    for name, above in (("head", "a"), ("ORG-top", "head")):
        bone = bones.new(name)
        bone.head, bone.tail, bone.parent, bone.use_deform = (0, 0, 2), (0, 0, 3), bones[above], False
    bpy.ops.object.mode_set(mode="OBJECT")
    copied = rig.pose.bones["c"].constraints.new("COPY_TRANSFORMS")
    copied.target, copied.subtarget = rig, "ORG-top"
    activate(obj)
    OPS.find_attachments()
    assert obj.dynamorph.model.head == "head"
    character = extract.character(obj, without_targets=True)
    z = character.vertices[:, 2]
    assert (character.rigidity[z > 2.2] == 1.0).all() and not character.rigidity[z < 1.8].any()


def test_a_head_with_a_japanese_name_is_found(scene):
    assert chain_figure(scene, ("下半身", "首", "頭"), head=0.15).dynamorph.model.head == "頭"


def test_a_plain_tube_has_no_head(scene):
    obj = chain_figure(scene, head=0.15)
    assert obj.dynamorph.model.head == "" and "No head was found" in drawn(obj, "DYNAMORPH_PT_physics")


@pytest.mark.fault("R09")
def test_a_character_without_a_head_that_is_found_says_so(scene, monkeypatch):
    """An arm says nothing: nobody expects it to have one."""
    obj = chain_figure(scene, head=0.15)
    found = lambda: [problem.fix for problem, _ in ui_messages.messages(obj)]  # noqa: E731
    assert found() == []
    monkeypatch.setattr(ui_messages, "CHARACTER", 3)
    assert found() == ["NO_HEAD"]
    OPS.fix(problem="NO_HEAD")
    assert not obj.dynamorph.model.hold_head and found() == []
    obj.dynamorph.model.hold_head = True
    select_bones(obj, "c")
    OPS.hold_bones()
    assert found() == []


def test_soft_paint_frees_a_head(scene):
    obj = chain_figure(scene)
    by_itself = extract.character(obj, without_targets=True).rigidity
    group = obj.vertex_groups.new(name="Firm")
    obj.dynamorph.firmness_group = "Firm"
    for weight, remains in ((0.9, 1.0), (0.25, 0.5), (0.0, 0.0)):
        group.add(range(len(obj.data.vertices)), weight, "REPLACE")
        rigidity = extract.character(obj, without_targets=True).rigidity
        np.testing.assert_array_equal(rigidity, remains * by_itself)


# The arrays ----------------------------------------------------------------------------------------------------------


def test_coincident_points_are_found_across_all_cells(addon):
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (2000, 3))
    doubled = np.concatenate([points, points + rng.uniform(-1, 1, (2000, 3)) * 0.5e-5])
    first = rigid.coincident(doubled, 1e-5)
    assert np.array_equal(first, np.tile(np.arange(2000), 2))
    assert np.array_equal(rigid.coincident(points, 1e-5), np.arange(2000))


def test_rigid_parts_forgive_strays(addon):
    weights = np.zeros((80, 3))
    weights[:40, 0] = 1.0
    weights[0] = [0.5, 0.5, 0.0]  # a stray
    weights[40:] = [0.5, 0.5, 0.0]
    weights[60:] = np.column_stack([np.linspace(0, 1, 20), np.linspace(1, 0, 20), np.zeros(20)])
    labels = np.repeat([0, 1, 2], [40, 20, 20])
    hard, bones = rigid.rigid_parts(labels, weights)
    assert hard.tolist() == [True, True, False] and bones[0] == 0


def test_a_rigid_part_that_touches_by_another_is_joined_too(addon):
    labels, hard = np.array([0, 0, 1, 1, 2, 2, 3]), np.array([False, True, True, True])
    first = np.array([0, 1, 1, 3, 3, 5, 6])
    assert rigid.joined_to_soft(labels, hard, first).tolist() == [False, True, True, False]
