# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a stroke of paint takes until Live shows it, against a build: python evidence/stroke.py ASSET

ASSET is a .glb or a .blend. Its largest mesh is subdivided until it has VERTICES. Prints seconds: of the wall clock,
and of the processor; of strokes, the medians.
"""

from __future__ import annotations

import sys
import time

import project  # noqa: F401
import fresh_blender  # noqa: F401

import bpy
import dynamic_morph_targets
import numpy as np
from dynamic_morph_targets.core.material import fit
from dynamic_morph_targets.core.model import build
from dynamic_morph_targets.run.playing import session
from dynamic_morph_targets.scene.character import extract
from dynamic_morph_targets.scene.store import model_store

VERTICES = 10_000
COMPARED = 6  # of the slowest modes
STROKES = 5  # of the same weight


def main() -> None:
    dynamic_morph_targets.register()
    obj = character(sys.argv[1])
    bpy.ops.dynamorph.add_soft_skin()
    bpy.ops.dynamorph.build()
    model = model_store.load_model(obj)
    print(f"{obj.name}: {len(obj.data.vertices)} vertices, {len(model.nodes)} nodes, {model.modes.shape[1]} modes")
    height = np.array([(obj.matrix_world @ vertex.co).z for vertex in obj.data.vertices])
    group = obj.vertex_groups.new(name="Firmness")
    obj.dynamorph.firmness_group = group.name
    for weight in (0.0, 0.25, 0.9):
        group.add(np.flatnonzero(height < np.median(height)).tolist(), weight, "REPLACE")
        painted = extract.character(obj)
        model_store.live_model(obj)  # the first stroke measures the depths of the body
        quick, _ = timed("stroke, its model", lambda: model_store.live_model(obj), STROKES)
        timed("stroke, all of Live", lambda: session.Session(obj, bpy.context.scene), STROKES)
        built = timed("build", lambda character=painted: build.build(character, previous=model))
        errors = [frequencies(each, built, painted) for each in (quick, built)]
        print(f"lower half painted {weight:g}: the slowest modes are too fast by up to "
              f"{errors[0]:.1%} after the stroke, {errors[1]:.1%} after the build")  # fmt: skip


def character(path: str) -> bpy.types.Object:
    """The largest mesh of a file, selected, with VERTICES."""
    if path.endswith(".blend"):
        bpy.ops.wm.open_mainfile(filepath=path)
    else:
        bpy.ops.wm.read_homefile(use_empty=True)
        bpy.ops.import_scene.gltf(filepath=path)
    obj = max((each for each in bpy.data.objects if each.type == "MESH"), key=lambda each: len(each.data.vertices))
    for other in bpy.context.selected_objects:
        other.select_set(False)
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    while len(obj.data.vertices) < VERTICES:
        bpy.ops.mesh.subdivide()
        obj.update_from_editmode()
    bpy.ops.object.mode_set(mode="OBJECT")
    return obj


def timed(label: str, work, times=1):
    seconds = []
    for _ in range(times):
        wall, processor = time.perf_counter(), time.process_time()
        result = work()
        seconds.append((time.perf_counter() - wall, time.process_time() - processor))
    wall, processor = np.median(seconds, axis=0)
    print(f"{label:20s} {wall:6.2f} s  {processor:6.2f} s")
    return result


def frequencies(model, built, painted) -> float:
    """By how much the slowest modes of a reduced `model` are faster than those of the unreduced one."""
    full = fit.full_engine(built, painted)
    omega, _ = full.linear_modes(0, COMPARED)
    at_rest = np.eye(len(painted.targets))[0]
    stiffness = full.linearize(at_rest, np.zeros(full.dofs))[2]
    mass = np.repeat(full.body.volumes.sum(axis=1), 3)[:, None] * painted.targets[0].material.density
    modes = model.modes
    squared = np.linalg.eigvals(np.linalg.solve(modes.T @ (mass * modes), modes.T @ (stiffness @ modes)))
    return float((np.sqrt(np.sort(squared.real)[:COMPARED]) / omega - 1.0).max())


if __name__ == "__main__":
    main()
