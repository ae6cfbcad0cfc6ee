# SPDX-License-Identifier: GPL-3.0-or-later
"""A baked character in other formats: written, read back by others and by Blender, and compared at each frame."""

import subprocess
import sys

import bpy
import numpy as np
import pytest
from builders import evaluated_points, fingerprint, hand_made_bake, keys_of, make_arm, make_soft, part, rig_of

FRAMES = 1, 20


@pytest.fixture
def baked(soft_arm):
    """The arm with a bake of every frame, and the posed surface (F, V, 3) in world space."""
    bake = hand_made_bake(soft_arm)
    part("sinks").write_keys(soft_arm, bake)
    return soft_arm, bake


def posed(obj):
    """World positions (F, V, 3) as Blender shows them."""
    surfaces = []
    for frame in range(FRAMES[0], FRAMES[1] + 1):
        bpy.context.scene.frame_set(frame)
        surfaces.append(evaluated_points(obj))
    bpy.context.scene.frame_set(FRAMES[0])
    return np.array(surfaces)


def imported(load, path, name, **options):
    """The mesh of a file in an empty scene, its sliders wide enough: Blender's importers leave them at 0 to 1."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    load(filepath=str(path), **options)
    meshes = [obj for obj in bpy.data.objects if obj.type == "MESH" and obj.name.startswith(name)]
    (mesh,) = meshes
    for block in mesh.data.shape_keys.key_blocks if mesh.data.shape_keys else ():
        block.slider_min, block.slider_max = -10.0, 10.0
    return mesh


def assert_same(shown, exact, tolerance=1e-5):
    """The surfaces are one, whatever vertices were split at seams. Which is which, the frames tell together."""
    if shown.shape != exact.shape:
        apart = np.linalg.norm(shown[0][:, None] - exact[0][None], axis=2)
        assert apart.min(axis=1).max() < tolerance
        same = apart < 2 * tolerance
        distance = np.linalg.norm(shown[:, :, None] - exact[:, None], axis=3).max(axis=0)
        assert np.where(same, distance, np.inf).min(axis=1).max() < tolerance
        assert same.any(axis=0).all()
    else:
        assert np.abs(shown - exact).max() < tolerance


READERS = {
    "GLTF": lambda path, name="Arm": imported(bpy.ops.import_scene.gltf, path, name),
    "FBX": lambda path, name="Arm": imported(bpy.ops.import_scene.fbx, path, name, anim_offset=0.0),
    "ALEMBIC": lambda path, name="Arm": imported(bpy.ops.wm.alembic_import, path, name),
    "USD": lambda path, name="Arm": imported(bpy.ops.wm.usd_import, path, name),
}


@pytest.mark.parametrize("key", READERS)
def test_blender_reads_back_what_it_shows(baked, tmp_path, key):
    obj, _ = baked
    exact, before = posed(obj), fingerprint(obj)
    exports = part("exports")
    path = tmp_path / f"Arm{exports.FORMATS[key].suffix}"
    exports.export(obj, key, path, FRAMES)
    assert fingerprint(obj) == before
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert_same(posed(READERS[key](path)), exact)


def test_gltf_holds_the_bake_s_shapes_and_values(baked, tmp_path):
    """Read by another reader, before skinning: rest + weights . morph targets."""
    gltf = pytest.importorskip("pygltflib")
    obj, bake = baked
    vertices = key_positions(obj)
    exports, path = part("exports"), tmp_path / "Arm.glb"
    exports.export(obj, "GLTF", path, FRAMES)
    file = gltf.GLTF2().load(str(path))
    data = file.binary_blob()

    def read(view, offset, kind, count, width):
        view = file.bufferViews[view]
        return np.frombuffer(data, kind, count * width, (view.byteOffset or 0) + (offset or 0)).reshape(-1, width)

    def array(index):
        accessor = file.accessors[index]
        width, sparse = {"SCALAR": 1, "VEC3": 3}[accessor.type], accessor.sparse
        if accessor.bufferView is not None:
            return read(accessor.bufferView, accessor.byteOffset, np.float32, accessor.count, width)
        values = np.zeros((accessor.count, width), np.float32)
        if sparse:
            kind = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32}[sparse.indices.componentType]
            rows = read(sparse.indices.bufferView, sparse.indices.byteOffset, kind, sparse.count, 1)[:, 0]
            values[rows] = read(sparse.values.bufferView, sparse.values.byteOffset, np.float32, sparse.count, width)
        return values

    (animation,) = file.animations
    (primitive,) = file.meshes[0].primitives
    rest = array(primitive.attributes.POSITION)
    morphs = np.array([array(target["POSITION"]) for target in primitive.targets])
    (channel,) = [channel for channel in animation.channels if channel.target.path == "weights"]
    sampler = animation.samplers[channel.sampler]
    values = array(sampler.output).reshape(-1, len(morphs))
    times = array(sampler.input)[:, 0]
    fps = bpy.context.scene.render.fps
    assert times * fps - FRAMES[0] == pytest.approx(np.arange(20), abs=1e-3)
    surface = rest + np.tensordot(values, morphs, 1)
    surface = surface[..., [0, 2, 1]] * [1, -1, 1]  # glTF's y is up
    exact = np.array([vertices + bake.displacement(k) for k in range(len(bake.frames))])
    assert_same(surface, exact)


def key_positions(obj):
    return part("properties").key_points(keys_of(obj).reference_key).astype(float)


USD = """
import sys, numpy as np
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[1])
(mesh,) = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
out = []
for frame in range(1, 21):
    world = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(frame))
    out.append(np.array(mesh.GetPointsAttr().Get(frame)) @ world[:3, :3] + world[3, :3])
np.save(sys.argv[2], out)
"""


def test_usd_is_what_pixar_s_library_reads(baked, tmp_path):
    obj, _ = baked
    exact = posed(obj)
    part("exports").export(obj, "USD", tmp_path / "arm.usdc", FRAMES)
    command = [
        sys.executable,
        "-c",
        USD,
        tmp_path / "arm.usdc",
        tmp_path / "points.npy",
    ]  # its symbols clash with bpy's
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if "No module named 'pxr'" in run.stderr:
        pytest.skip("usd-core is not installed")
    assert run.returncode == 0, run.stderr
    assert_same(np.load(tmp_path / "points.npy"), exact)


def test_a_raw_clip_is_the_bake(baked, tmp_path):
    obj, bake = baked
    part("exports").export(obj, "RAW", tmp_path / "arm.npz", FRAMES)
    with np.load(tmp_path / "arm.npz", allow_pickle=False) as clip:
        surface = clip["vertices"] + np.tensordot(clip["coordinates"], clip["modes"], 1)
        assert clip["frames"] == pytest.approx(bake.frames)
        assert clip["fps"] == bpy.context.scene.render.fps
    exact = [key_positions(obj) + bake.displacement(k) for k in range(len(bake.frames))]
    assert surface == pytest.approx(np.array(exact), abs=1e-5)


def test_drivers_actions_and_influence_are_exported_as_shown(scene, baked, tmp_path):
    """Everything that moves a key counts, not only the bake: sampled, and left as it was."""
    obj, _ = baked
    smile = keys_of(obj).key_blocks["smile"]
    driver = smile.driver_add("value").driver
    driver.expression = "0.05 * frame"
    part("sinks").influence_strip(obj).influence = 0.5
    exact, before = posed(obj), fingerprint(obj)
    exports = part("exports")
    assert any("Drivers are left out" in text and "smile" in text for text in exports.losses(obj, "GLTF"))
    exports.export(obj, "GLTF", tmp_path / "Arm.glb", FRAMES)
    assert fingerprint(obj) == before
    assert_same(posed(READERS["GLTF"](tmp_path / "Arm.glb")), exact)


@pytest.mark.parametrize("key", READERS)
def test_what_moves_with_the_flesh_is_exported_too(scene, baked, tmp_path, key):
    obj, _ = baked
    sleeve = make_arm(scene, "Sleeve")
    bpy.data.objects.remove(rig_of(sleeve))
    sleeve.modifiers["Armature"].object = rig_of(obj)
    part("sinks").write_keys(sleeve, hand_made_bake(obj, seed=2), obj)
    exact, before = posed(sleeve), fingerprint(sleeve)
    path = tmp_path / f"arm{part('exports').FORMATS[key].suffix}"
    part("exports").export(obj, key, path, FRAMES)
    assert fingerprint(sleeve) == before
    assert_same(posed(READERS[key](path, "Sleeve")), exact)


def more_bones(obj):
    for group in (obj.vertex_groups.new(name=f"b{i}") for i in range(5)):
        group.add([0], 0.1, "REPLACE")
        bpy.context.view_layer.objects.active = rig_of(obj)
        bpy.ops.object.mode_set(mode="EDIT")
        bone = rig_of(obj).data.edit_bones.new(group.name)
        bone.head, bone.tail = (0, 0, 0), (0, 1, 0)
        bpy.ops.object.mode_set(mode="OBJECT")


LOSSES = {
    "Modifier 'Subdivision' is left out": lambda obj: obj.modifiers.new("Subdivision", "SUBSURF"),
    "Preserve Volume": lambda obj: setattr(obj.modifiers["Armature"], "use_deform_preserve_volume", True),
    "Bendy bones": lambda obj: setattr(rig_of(obj).data.bones["lower"], "bbone_segments", 4),
    "1 vertices follow more than 4 bones": more_bones,
}


@pytest.mark.parametrize("words", LOSSES)
def test_export_check_says_what_is_dropped(baked, words):
    obj, _ = baked
    exports = part("exports")
    assert list(exports.losses(obj, "GLTF")) == []
    LOSSES[words](obj)
    assert any(words in text for text in exports.losses(obj, "GLTF"))
    assert list(exports.losses(obj, "ALEMBIC")) == []


def test_export_check_counts_the_morphs_that_move(scene):
    obj = make_soft(make_arm(scene))
    part("sinks").write_keys(obj, hand_made_bake(obj, modes=9))
    assert any(text.startswith("10 keys move") for text in part("exports").losses(obj, "FBX"))


def test_the_button_writes_what_the_format_is_called(baked, tmp_path):
    obj, _ = baked
    bpy.context.view_layer.objects.active = obj
    bpy.ops.dynamorph.export(format="RAW", filepath=str(tmp_path / "arm"))
    assert [file.name for file in tmp_path.iterdir()] == ["arm.npz"]
    assert bpy.ops.dynamorph.export_check(format="FBX") == {"FINISHED"}
    part("sinks").free(obj)
    assert not bpy.ops.dynamorph.export.poll()


def test_refused(baked, tmp_path):
    obj, _ = baked
    exports = part("exports")
    error = exports.ExportError
    with pytest.raises(error, match="no folder '.*nowhere'"):
        exports.export(obj, "RAW", tmp_path / "nowhere" / "arm.npz", FRAMES)
    obj.hide_set(True)
    with pytest.raises(error, match="'Arm' is hidden"):
        exports.export(obj, "USD", tmp_path / "arm.usdc", FRAMES)
    obj.hide_set(False)
    part("sinks").free(obj)
    with pytest.raises(error, match="no bake to export: press Bake"):
        exports.export(obj, "GLTF", tmp_path / "arm.glb", FRAMES)
    assert list(tmp_path.iterdir()) == []
