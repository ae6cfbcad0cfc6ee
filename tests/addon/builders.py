# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scenes for the extension's tests, and common questions about such a scene.

Programs import it too, so what needs the extension under its installed name imports it when it is called.
"""

import hashlib
import importlib
import threading
from contextlib import contextmanager
from math import pi
from pathlib import Path

import bmesh
import bpy
import numpy as np
import pytest
import scenes
from mathutils.bvhtree import BVHTree
from pins import with_pins

KEPT = ".Dynamorph Sampling"  # what Live has rigs read in, for as long as it reads
EXTENSION = "bl_ext.user_default.dynamic_morph_targets"


def part(name):
    """The extension's module of this name, wherever it is."""
    package = Path(importlib.import_module(EXTENSION).__file__).parent
    (path,) = package.rglob(f"{name}.py")
    return importlib.import_module(".".join([EXTENSION, *path.relative_to(package).with_suffix("").parts]))


def make_rig(scene, name="Rig", bones=2):
    armature = bpy.data.armatures.new(name)
    rig = bpy.data.objects.new(name, armature)
    scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for i, bone_name in enumerate(["upper", "lower", "hand", "finger"][:bones]):
        bone = armature.edit_bones.new(bone_name)
        bone.head, bone.tail, bone.parent = (0, 0, i), (0, 0, i + 1), parent
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        bone.rotation_mode = "XYZ"
    return rig


def make_mesh(scene, name, vertices, faces, edges=()):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices).tolist(), edges, faces)
    obj = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(obj)
    return obj


BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def make_box(name="Box", location=(0.0, 1.0, 1.0), collision=True):
    """A cube of 1 m beside the arm, with Blender's Collision."""
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    made = make_mesh(bpy.context.scene, name, BOX, faces)
    made.location = location
    if collision:
        made.modifiers.new("Collision", "COLLISION")
    bpy.context.view_layer.update()
    return made


def make_ball(name="Ball", radius=0.2):
    """A ball with Blender's Collision."""
    mesh, shape = bpy.data.meshes.new(name), bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=4, radius=radius)
    shape.to_mesh(mesh)
    shape.free()
    ball = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ball)
    ball.modifiers.new("Collision", "COLLISION")
    bpy.context.view_layer.update()
    return ball


def add_key(obj, name, displacement):
    basis = np.empty((len(obj.data.vertices), 3), np.float32)
    obj.data.shape_keys.reference_key.points.foreach_get("co", basis.ravel())
    block = obj.shape_key_add(name=name, from_mix=False)
    block.value = 0.0
    block.points.foreach_set("co", (basis + displacement).astype(np.float32).ravel())
    return block


def make_arm(scene, name="Arm", rings=17, around=16):
    rig = make_rig(scene, f"{name} Rig")
    vertices, faces = scenes.tube(rings, around)
    obj = make_mesh(scene, name, vertices, faces)
    obj.shape_key_add(name="Basis", from_mix=False)
    add_key(obj, "flexed", scenes.bulge(vertices))
    add_key(obj, "smile", scenes.bulge(vertices, center=1.6, amount=-0.05))
    for bone, weights in zip(["upper", "lower"], scenes.two_bone_weights(vertices).T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for index in np.flatnonzero(weights):
            group.add([int(index)], float(weights[index]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    for frame, angle in ((1, 0.0), (20, pi / 2)):
        rig.pose.bones["lower"].rotation_euler.x = angle
        rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, 20
    scene.frame_set(1)
    activate(obj)
    return obj


def make_soft(obj, keys=("flexed",)):
    scene = bpy.context.scene
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    with_pins(obj)
    scene.frame_set(20)
    for key in keys:
        bpy.ops.dynamorph.add_target(key=key)
    scene.frame_set(1)
    return obj


def activate(obj):
    bpy.context.view_layer.objects.active = obj


def rig_of(obj):
    return obj.modifiers["Armature"].object


def select_bones(obj, *names):
    """Select these pose bones alone of the rig of `obj`."""
    for bone in rig_of(obj).pose.bones:
        (bone if hasattr(bone, "select") else bone.bone).select = bone.name in names


def skinning_of(obj):
    from bl_ext.user_default.dynamic_morph_targets.scene.skinning import Skinning

    return Skinning.of(obj)


def warnings_of(obj):
    """What a build would warn about before it begins."""
    from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
    from bl_ext.user_default.dynamic_morph_targets.scene.read import source

    return extract.warnings(source.Source.of(skinning_of(obj)))


def hand_made_bake(obj, frames=range(1, 21), modes=3, seed=1):
    """A Bake as an engine could make it for the targets of `obj`."""
    rng = np.random.default_rng(seed)
    names = ("Neutral", *(target.name for target in obj.dynamorph.targets[1:]))
    vertices = len(obj.data.vertices)
    weights = rng.uniform(size=(len(frames), len(names)))
    residual_shapes = rng.normal(0, 0.02, (len(names), vertices, 3))
    residual_shapes[0] = 0.0
    from bl_ext.user_default.dynamic_morph_targets.core.motion import baked

    return baked.Bake(
        frames=np.array(frames),
        coordinates=rng.normal(0, 3.0, (len(frames), modes)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        modes=rng.normal(0, 0.01, (modes, vertices, 3)),
        residual_shapes=residual_shapes,
        target_names=names,
        static=rng.normal(0, 3.0, (len(frames), modes)),
    )


def evaluated_points(obj) -> np.ndarray:
    """World positions (V, 3) of the mesh as Blender shows it now."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty((len(evaluated.data.vertices), 3), np.float32)
    evaluated.data.attributes["position"].data.foreach_get("vector", points.ravel())
    world = np.array(evaluated.matrix_world)
    return points @ world[:3, :3].T + world[:3, 3]


def shown(meshes) -> list[np.ndarray]:
    """World positions (F, V, 3) of each mesh over the scene's frames."""
    scene = bpy.context.scene
    frames = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        frames.append([evaluated_points(mesh) for mesh in meshes])
    scene.frame_set(scene.frame_start)
    return [np.array(points) for points in zip(*frames, strict=True)]


def depths(points: np.ndarray, surface: np.ndarray, triangles: list) -> np.ndarray:
    """How deep points (P, 3) are behind the nearest triangle of a surface (V, 3): (P,), negative in front of it."""
    tree = BVHTree.FromPolygons(surface.tolist(), triangles, all_triangles=True)
    nearest = [tree.find_nearest(point)[:2] for point in points.tolist()]
    places, normals = (np.array([tuple(each[k]) for each in nearest]) for k in (0, 1))
    return np.einsum("pc,pc->p", places - points, normals)


def keys_of(obj):
    return obj.data.shape_keys


def skinned(character, samples, displacement=0.0):
    """World positions (S, V, 3) by linear blend skinning of the extracted arrays."""
    matrices = samples.skin_matrices(character.skeleton, character.to_bind)
    blended = np.einsum("vb,sbij->svij", character.weights, matrices)
    bind = (character.vertices + displacement) @ character.to_bind.T
    return np.einsum("svij,vj->svi", blended[..., :3], bind) + blended[..., 3]


def assert_shows(obj, bake, extra=0.0):
    """Blender's mesh at every frame is vertices + Bake.displacement, skinned. bake: of the whole body."""
    from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
    from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion

    character = extract.character(obj)
    samples = rig_motion.sample_rig(obj, int(bake.frames[0]), int(bake.frames[-1]), 1)
    size = np.ptp(character.vertices @ character.to_bind.T, axis=0).max()
    for i, frame in enumerate(bake.frames):
        bpy.context.scene.frame_set(int(frame))
        ours = skinned(character, samples[i : i + 1], bake.displacement(i) + extra)[0, character.own_vertices]
        round_off = 2e-7 * np.abs(ours).max()  # far from the origin Blender has no more digits
        assert np.abs(evaluated_points(obj) - ours).max() < 1e-5 * size + round_off


@contextmanager
def soon():
    """Call, at the end, what was left to timers in the meantime: without a window no timer runs."""
    from bl_ext.user_default.dynamic_morph_targets.scene import events

    asked = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(events, "soon", lambda look, _seconds: asked.setdefault(look))
        yield
        for _ in range(2):  # these may leave something to timers, too
            due = [*asked]
            asked.clear()
            for look in due:
                look()


def refused(operator, words, **arguments):
    """The operator must report an error with these words, which Python sees as RuntimeError."""
    with pytest.raises(RuntimeError, match=words):
        operator(**arguments)


class StandIn:
    """Replaces the modules build and simulate, to test what surrounds them."""

    def __init__(self):
        self.built = 0
        self.bytes = 800  # size of a model
        self.fail = None  # an exception that bake raises
        self.waits = {}  # by character: an Event for which its bake waits at each frame unless it is canceled
        self.hears = None  # an Event that it waits for before it looks whether it is
        self.looks = 0  # how often it has looked, of 10 times for each bake
        self.playing = threading.Event()  # bake has begun

    class Model:
        tets, thickness, modes, only_cage = (), np.zeros(0), (), False

        def __init__(self, arrays, dependencies, summary):
            self.arrays, self.dependencies, self.summary, self.made = arrays, dependencies, summary, {}

        @classmethod
        def from_arrays(cls, arrays, meta):
            from bl_ext.user_default.dynamic_morph_targets.core.model.summary import Summary

            return cls(arrays, meta["dependencies"], Summary.from_stored(meta["summary"]))

        def to_arrays(self):
            return self.arrays, {"dependencies": self.dependencies, "summary": self.summary.stored}

        @property
        def settings(self):
            from bl_ext.user_default.dynamic_morph_targets.core.settings import ModelSettings

            return ModelSettings()

        def with_settings(self, _settings):
            return self

    def dependencies(self, character):
        shapes = {f"shape of '{t.name}'": hashlib.sha256(t.shape.tobytes()).hexdigest() for t in character.targets}
        return {"mesh": hashlib.sha256(character.vertices.tobytes()).hexdigest(), **shapes}

    def stale_reasons(self, model, character):
        now = self.dependencies(character)
        return [f"{name} changed" for name in now if model.dependencies.get(name) != now[name]]

    def build_for(self, character, rig, settings, progress=None, previous=None, draft=None):
        from bl_ext.user_default.dynamic_morph_targets.core.model.summary import Summary

        self.built += 1
        for i in range(5):
            assert progress(i / 5, "Modes")
        counts = {"nodes": 10, "tets": 20, "pinned": 4, "dofs": 30, "modes": 3, "tabulated": 3}
        made = Summary(**counts, held=0.4, targets=len(character.targets), seconds={"modes": 0.5})
        return self.Model({"a": np.zeros(self.bytes // 8)}, self.dependencies(character), made)

    def Shot(self, model, character, settings, progress):  # stands in for a class
        return StandInShot(self, character, settings, progress)


class StandInShot:
    """Stands in for `simulate.Shot`."""

    def __init__(self, engine, character, settings, progress):
        self.engine, self.character, self.settings, self.progress = engine, character, settings, progress
        self.done = 0

    @property
    def is_complete(self):
        return self.done == len(self.settings.frames)

    @property
    def held(self):
        from bl_ext.user_default.dynamic_morph_targets.core.motion.limits import Held

        return Held()

    touched = poses = None

    def play(self, rig):
        engine, settings = self.engine, self.settings
        if engine.fail:
            raise engine.fail
        assert len(rig) % settings.substeps == (self.done == 0) % settings.substeps
        self.done += -(-len(rig) // settings.substeps)
        engine.playing.set()
        if engine.hears:
            engine.hears.wait(60.0)
        for i in range(10):
            engine.looks += 1
            self.tell(i)
            while self.character.name in engine.waits and not engine.waits[self.character.name].wait(0.01):
                self.tell(i)

    def tell(self, frame):
        if not self.progress(frame / 10, f"Frame {frame}"):
            raise RuntimeError("canceled")

    def bake(self, exact=False):
        character, settings = self.character, self.settings
        rng = np.random.default_rng(1)
        vertices, targets = len(character.vertices), character.targets
        from bl_ext.user_default.dynamic_morph_targets.core.motion import baked

        bake = baked.Bake(
            settings.frames, rng.normal(size=(len(settings.frames), 3)),
            np.full((len(settings.frames), len(targets)), 1 / len(targets)), rng.normal(0, 0.001, (3, vertices, 3)),
            np.zeros((len(targets), vertices, 3)), tuple(t.name for t in targets), np.zeros((len(settings.frames), 3)),
        )  # fmt: skip
        report = {
            "steps": 100, "steps_per_second": 1000.0, "residual": 1e-7, "energy": 2.0, "smallest_det": 0.9,
            "inverted": 0, "warnings": [],
        }  # fmt: skip
        return bake, report | ({"gap": 3e-5} if settings.loop else {})


def fingerprint(obj):
    """Everything that a bake may change and Delete Bake must restore, as comparable data."""
    bpy.context.view_layer.update()  # animated values are those of the frame
    keys = obj.data.shape_keys
    animation = keys.animation_data
    return {
        "keys": [
            (k.name, k.value, k.mute, k.slider_min, k.slider_max, k.relative_key.name, k.vertex_group)
            for k in keys.key_blocks
        ],
        "points": [[tuple(p.co) for p in k.points] for k in keys.key_blocks],
        "active": obj.active_shape_key_index,
        "animation": animation
        and (
            animation.action and animation.action.name,
            animation.action_slot and animation.action_slot.identifier,
            [(d.data_path, d.driver.expression) for d in animation.drivers],
            [(t.name, t.mute, [(s.name, s.frame_start, s.frame_end) for s in t.strips]) for t in animation.nla_tracks],
        ),
        "actions": sorted(action.name for action in bpy.data.actions),
        "objects": sorted(o.name for o in bpy.data.objects if not o.name.startswith(KEPT)),
        "scenes": sorted(s.name for s in bpy.data.scenes if not s.name.startswith(KEPT)),
    }
