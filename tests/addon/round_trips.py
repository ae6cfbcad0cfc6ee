# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake in every form that it can take is read back by another program, and compared with the engine's surface.

Readers are for the tests; `measure` is for a page. As a script it measures a sample scene and prints JSON:

    python tests/addon/round_trips.py [shot.blend [OBJECT]]
"""

from __future__ import annotations

import importlib
import json
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]


class ReaderMissing(RuntimeError):
    """The reader of a format is not installed. The message says what is missing."""


# Readers: (path, mesh's name, frames) -> surface at each frame (F, V, 3), Blender's axes and units ------------------


def shown(name: str, frames) -> np.ndarray:
    """World positions as Blender shows them."""
    surfaces = []
    for frame in frames:
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1.0)
        mesh = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get())
        points = np.empty((len(mesh.data.vertices), 3), np.float32)
        mesh.data.attributes["position"].data.foreach_get("vector", points.ravel())
        world = np.array(mesh.matrix_world)
        surfaces.append(points @ world[:3, :3].T + world[:3, 3])
    return np.array(surfaces)


def imported(load: Callable, path: Path, **options):
    """Open a file in an empty scene of the same frame rate, in which Blender's Alembic importer counts, with sliders
    that are wide enough: its importers leave them at 0 to 1."""
    rate = bpy.context.scene.render.fps, bpy.context.scene.render.fps_base
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = rate
    load(filepath=str(path), **options)
    for keys in bpy.data.shape_keys:
        for block in keys.key_blocks:
            block.slider_min, block.slider_max = -10.0, 10.0


def by_import(load: str, from_0=False, **options) -> Callable:
    """One of Blender's own readers; load: an operator of bpy.ops; from_0: whether it has the first frame at frame 0."""
    group, name = load.split(".")

    def read(path: Path, mesh: str, frames) -> np.ndarray:
        imported(getattr(getattr(bpy.ops, group), name), path, **options)
        (found,) = (obj.name for obj in bpy.data.objects if obj.type == "MESH" and obj.name.startswith(mesh))
        return shown(found, [frame - frames[0] for frame in frames] if from_0 else frames)

    return read


def point_cache(path: Path, _mesh: str, frames) -> np.ndarray:
    """PC2 with one surface per frame, local space."""
    data = path.read_bytes()
    assert data[:12] == b"POINTCACHE2\0"
    version, vertices, first, step, count = struct.unpack_from("<iiffi", data, 12)
    assert version == 1
    surfaces = np.frombuffer(data, "<f4", offset=32).reshape(count, vertices, 3)
    return surfaces[np.searchsorted(first + step * np.arange(count), frames)]


USD = """
import sys, numpy as np
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[1])
meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
(mesh,) = [mesh for mesh in meshes if mesh.GetPrim().GetParent().GetName() == sys.argv[3]]
out = []
for frame in map(float, sys.argv[4:]):
    world = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(frame))
    out.append(np.array(mesh.GetPointsAttr().Get(frame)) @ world[:3, :3] + world[3, :3])
np.save(sys.argv[2], out)
"""


def by_usd_core(path: Path, mesh: str, frames) -> np.ndarray:
    """Read by Pixar's library in a separate process: its symbols clash with bpy's."""
    with tempfile.TemporaryDirectory() as folder:
        points = Path(folder) / "points.npy"
        command = [sys.executable, "-c", USD, path, points, mesh.replace(" ", "_"), *map(str, frames)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if "No module named 'pxr'" in run.stderr:
            raise ReaderMissing("usd-core is not installed")
        assert run.returncode == 0, run.stderr
        return np.load(points)


def by_pygltflib(path: Path, mesh: str, frames, animation: str | None = None) -> np.ndarray:
    """The mesh as a viewer has it: morph targets, then bones. animation: by name; None: there is one.

    The animation has a key at each of these frames; vertices are split at seams.
    """
    return Gltf(path).surfaces(mesh, len(frames), animation)


KINDS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Gltf:
    """A binary glTF file, evaluated without Blender."""

    def __init__(self, path: Path):
        try:
            import pygltflib
        except ImportError as error:
            raise ReaderMissing("pygltflib is not installed") from error
        self.file = pygltflib.GLTF2().load(str(path))
        self._data = self.file.binary_blob()

    def array(self, index: int) -> np.ndarray:
        """An accessor's values (count, width)."""
        accessor = self.file.accessors[index]
        width, kind = WIDTHS[accessor.type], KINDS[accessor.componentType]
        if accessor.bufferView is None:
            values = np.zeros((accessor.count, width), kind)
        else:
            values = self._read(accessor, kind, accessor.count, width)
        if accessor.sparse:
            count, values = accessor.sparse.count, values.copy()
            rows = self._read(accessor.sparse.indices, KINDS[accessor.sparse.indices.componentType], count, 1)[:, 0]
            values[rows] = self._read(accessor.sparse.values, kind, count, width)
        return values

    def _read(self, at, kind, count: int, width: int) -> np.ndarray:
        view = self.file.bufferViews[at.bufferView]
        begin = (view.byteOffset or 0) + (at.byteOffset or 0)
        return np.frombuffer(self._data, kind, count * width, begin).reshape(count, width)

    @property
    def clips(self) -> list[str]:
        return [each.name for each in self.file.animations]

    def morph_names(self, mesh: str) -> list[str]:
        (node,) = (node for node in self.file.nodes if node.name == mesh and node.mesh is not None)
        return self.file.meshes[node.mesh].extras["targetNames"]

    def animation(self, name: str | None):
        found = [each for each in self.file.animations if name in (None, each.name)]
        assert len(found) == 1, [each.name for each in self.file.animations]
        return found[0]

    def times(self, animation: str | None) -> np.ndarray:
        """The times (F,) in seconds of its keys, which all channels share."""
        every = [self.array(sampler.input)[:, 0] for sampler in self.animation(animation).samplers]
        assert all(np.array_equal(every[0], times) for times in every)
        return every[0]

    def surfaces(self, mesh: str, frames: int, animation: str | None = None) -> np.ndarray:
        (index,) = (k for k, node in enumerate(self.file.nodes) if node.name == mesh and node.mesh is not None)
        node = self.file.nodes[index]
        values = self._channels(animation)
        points = self._morphed(self.file.meshes[node.mesh], values.get((index, "weights")))
        assert len(points) in (1, frames)
        joints = self._joints(self.file.skins[node.skin], values, frames)
        corners, weights = (
            np.concatenate([self.array(getattr(primitive.attributes, name)) for primitive in self._primitives(node)])
            for name in ("JOINTS_0", "WEIGHTS_0")
        )
        skinned = np.einsum("vk,fvkij->fvij", weights, joints[:, corners])
        world = np.einsum("fvij,fvj->fvi", skinned[..., :3, :3], np.broadcast_to(points, (frames, *points.shape[1:])))
        return (world + skinned[..., :3, 3])[..., [0, 2, 1]] * [1, -1, 1]  # glTF's y is up

    def morphed(self, mesh: str, animation: str | None = None) -> np.ndarray:
        """Before skinning, Blender's axes."""
        (index,) = (k for k, node in enumerate(self.file.nodes) if node.name == mesh and node.mesh is not None)
        values = self._channels(animation)[index, "weights"]
        points = self._morphed(self.file.meshes[self.file.nodes[index].mesh], values)
        return points[..., [0, 2, 1]] * [1, -1, 1]

    def _primitives(self, node):
        return self.file.meshes[node.mesh].primitives

    def _morphed(self, mesh, values) -> np.ndarray:
        """(F, V, 3), or (1, V, 3) without values."""
        parts = []
        for primitive in mesh.primitives:
            rest = self.array(primitive.attributes.POSITION)[None]
            if values is not None:
                morphs = np.array([self.array(target["POSITION"]) for target in primitive.targets])
                rest = rest + np.tensordot(values.reshape(-1, len(morphs)), morphs, 1)
            parts.append(rest)
        return np.concatenate(parts, axis=1)

    def _channels(self, animation: str | None) -> dict:
        """The values at all keys, by node and path."""
        chosen = self.animation(animation)
        return {
            (channel.target.node, channel.target.path): self.array(chosen.samplers[channel.sampler].output)
            for channel in chosen.channels
        }

    def _joints(self, skin, values, frames: int) -> np.ndarray:
        """(F, B, 4, 4) from the mesh at rest to the world."""
        inverse = self.array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        parents = {child: k for k, node in enumerate(self.file.nodes) for child in node.children or ()}
        worlds: dict[int, np.ndarray] = {}

        def world(index: int) -> np.ndarray:
            if index not in worlds:
                own = self._local(index, values, frames)
                worlds[index] = world(parents[index]) @ own if index in parents else own
            return worlds[index]

        return np.stack([world(joint) for joint in skin.joints], axis=1) @ inverse

    def _local(self, index: int, values, frames: int) -> np.ndarray:
        node, out = self.file.nodes[index], np.tile(np.eye(4), (frames, 1, 1))
        if node.matrix is not None:
            out[:] = np.array(node.matrix).reshape(4, 4).T
            return out
        still = {"translation": node.translation, "rotation": node.rotation, "scale": node.scale}
        default = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
        place, turn, scale = (
            np.broadcast_to(values.get((index, path), np.array([still[path] or default[path]])), (frames, len(none)))
            for path, none in default.items()
        )
        out[:, :3, :3] = rotations(turn) * scale[:, None]
        out[:, :3, 3] = place
        return out


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """Matrices (F, 3, 3) of quaternions (F, 4), x y z w, whose length is about one."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(float).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.array(rows).transpose(2, 0, 1)


# Comparison --------------------------------------------------------------------------------------------------------


def farthest(seen: np.ndarray, exact: np.ndarray, same_order=True) -> float:
    """The largest distance of a vertex between two moving surfaces (F, V, 3).

    same_order: False if vertices were split at seams or put in another order. All frames together tell which vertex is
    which.
    """
    assert len(seen) == len(exact)
    if same_order:
        assert seen.shape == exact.shape
        return float(np.linalg.norm(seen - exact, axis=2).max())
    first, second = (surface.transpose(1, 0, 2).reshape(surface.shape[1], -1) for surface in (seen, exact))
    squares = (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1) - 2 * first @ second.T
    forth, back = squares.argmin(axis=1), squares.argmin(axis=0)
    apart = (seen - exact[:, forth], seen[:, back] - exact)  # no vertex is left out on either side
    return max(float(np.linalg.norm(each, axis=2).max()) for each in apart)


# Forms -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Form:
    """What a bake becomes. format, keys: of its output; key: of exports.FORMATS, or none; read: None if Blender shows
    it; reader: the name of what reads it. local: before skinning.
    """

    name: str
    reader: str
    format: str = "MODES"
    key: str = ""
    read: Callable | None = None
    keys: int = 0
    local: bool = False
    same_order: bool = True


FBX, ALEMBIC = by_import("import_scene.fbx", anim_offset=0.0), by_import("wm.alembic_import")
FORMS = (
    Form("Shape Keys", "Blender"),
    Form("Shape Keys, 8", "Blender", keys=8),
    Form("Point Cache (PC2)", "Blender", format="PC2"),
    Form("PC2, the file", "NumPy", format="PC2", read=point_cache, local=True),
    Form("glTF", "pygltflib", key="GLTF", read=by_pygltflib, same_order=False),
    Form("glTF, 8 keys", "pygltflib", key="GLTF", read=by_pygltflib, keys=8, same_order=False),
    Form("FBX", "Blender, imported", key="FBX", read=FBX),
    Form("Alembic", "Blender, imported", key="ALEMBIC", read=ALEMBIC),
    Form("USD", "usd-core", key="USD", read=by_usd_core),
)


def module_of(obj, name: str):
    """A module of the add-on, such as run.job, under the name by which it was loaded."""
    package = type(obj.dynamorph).__module__.removesuffix(".scene.properties.object_properties")
    return importlib.import_module(f"{package}.{name}")


@dataclass(frozen=True)
class Exact:
    """The engine's surface of a bake (F, V, 3), before skinning in local space and in the world. size: diagonal of the
    box around the body at rest. All in meters, which Blender's units and the mesh's are too.
    """

    local: np.ndarray
    world: np.ndarray
    size: float


def exact(job) -> Exact:
    """What the engine computed at whole frames of a shot that was read at once, skinned by NumPy from the engine's own
    arrays.
    """
    from builders import skinned

    character, bake, settings = job.outcome.character, job.outcome.bake, job.input.settings
    whole = np.flatnonzero(bake.frames % 1 == 0)
    moved = np.array([bake.displacement(k) for k in whole])
    samples = job.computation.rig[(settings.frame_start - settings.first) * settings.substeps :: settings.substeps]
    world = np.array([skinned(character, samples[k : k + 1], moved[k])[0] for k in range(len(whole))])
    size = float(np.linalg.norm(np.ptp(character.vertices @ character.to_bind.T, axis=0)))
    return Exact(character.vertices + moved, world, size)


def measure(obj, folder: Path, forms=FORMS, frames: tuple[int, int] | None = None) -> list[dict]:
    """Bake `obj`, a soft skin on plain bones in a scene in meters, in each form, and read it back; the scene is lost.

    Returns for each form: form, reader; error, the largest distance from the engine's surface over all frames and
    vertices, in sizes of the body; bytes of keys or of the file; seconds to write it, without the simulation.
    """
    jobs, batch = module_of(obj, "run.bake.job"), module_of(obj, "run.bake.batch")
    exports, actions = module_of(obj, "write.export.exports"), module_of(obj, "run.bake.export_actions")
    name, found, unread = obj.name, [], []
    for k, form in enumerate(forms):
        obj.dynamorph.output.format, obj.dynamorph.output.keys = form.format, form.keys
        job = jobs.Job(obj, "BAKE", frames, folder=folder)
        batch.run(job)
        ours = exact(job)
        row = {"form": form.name, "reader": form.reader, "error": None, "bytes": job.outcome.size}
        row["seconds"] = job.progress.seconds["make keys"] + job.progress.seconds["write keys"]
        numbers = range(job.input.settings.frame_start, job.input.settings.frame_end + 1)
        path = job.outcome.written[0][1]
        if form.key:
            path = folder / f"{k}{exports.FORMATS[form.key].suffix}"
            began = time.perf_counter()
            actions.export(obj, form.key, path, (job.input.settings.frame_start, job.input.settings.frame_end))
            row["seconds"] = time.perf_counter() - began
        if path:
            row["bytes"] = path.stat().st_size
        if form.read:
            unread.append((form, row, path, numbers, ours))
        else:
            row["error"] = farthest(shown(name, numbers), ours.world) / ours.size
        found.append(row)
    for form, row, path, numbers, ours in unread:  # some readers empty the scene
        try:
            seen = form.read(path, name, numbers)
        except ReaderMissing as missing:
            row["reader"] = f"{form.reader}: {missing}"
            continue
        row["error"] = farthest(seen, ours.local if form.local else ours.world, form.same_order) / ours.size
    return found


def main():
    import dynamic_morph_targets

    dynamic_morph_targets.register()
    shot = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "sample_blends" / "bulging_cylinder.blend"
    bpy.ops.wm.open_mainfile(filepath=str(shot.resolve()))
    skins = [obj for obj in bpy.context.scene.objects if obj.type == "MESH" and obj.dynamorph.targets]
    obj = bpy.data.objects[sys.argv[2]] if len(sys.argv) > 2 else skins[0]
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(obj, Path(folder))
    print(json.dumps({"blender": bpy.app.version_string, "file": shot.name, "forms": rows}, indent=1), flush=True)


if __name__ == "__main__":
    sys.path[:0] = [str(ROOT / "addon"), str(ROOT / "tests")]
    main()
