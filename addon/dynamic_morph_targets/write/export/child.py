# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports a copy of a scene and reads the file back, in a process of its own: both may crash. See write/export/process.

A script for Blender in the background, or for Python with the bpy wheel; the last argument is the job, a JSON file.
The extension is not part of it, as it would show Live again.
"""

import json
import sys
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path

import bpy
import numpy as np

BEGIN = "dynamorph: the export begins"
UNREADABLE = "the written data cannot be read back"  # as in `io/outputs`


def run(job: dict) -> None:
    import addon_utils  # it is found when bpy is there

    addon_utils.disable(job["add_on"])
    show(job)
    print(BEGIN, file=sys.stderr, flush=True)
    getattr(bpy.ops.wm, f"{job['format']}_export")(**job["options"])
    read_back(job["format"], job["options"]["filepath"], job["frames"])


def show(job: dict) -> None:
    """Open the copy as the artist sees it. Texts of the file run only if the artist lets those of all files run."""
    bpy.ops.wm.open_mainfile(filepath=job["blend"], load_ui=False, use_scripts=job["runs_texts"])
    if job["runs_drivers"] and not job["runs_texts"]:
        bpy.context.preferences.filepaths.use_scripts_auto_execute = True  # in this process
        for driver in drivers():
            driver.expression = driver.expression  # those that were not allowed until now run again
    window, scene = bpy.context.window, bpy.data.scenes[job["scene"]]
    window.scene, window.view_layer = scene, scene.view_layers[job["view_layer"]]


def drivers() -> Iterator[bpy.types.Driver]:
    """Those of the whole file."""
    for block in bpy.data.user_map():
        animation = getattr(block, "animation_data", None)
        for curve in animation.drivers if animation else ():
            yield curve.driver


def read_back(format: str, path: str, frames: Sequence[int]) -> None:
    """Raises RuntimeError when the file cannot be opened, shows no mesh, or one without a place."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    try:
        getattr(bpy.ops.wm, f"{format}_import")(filepath=path)
    except RuntimeError as error:
        raise RuntimeError(UNREADABLE) from error
    meshes = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        points = [positions(mesh.evaluated_get(graph).data) for mesh in meshes]
        if not any(map(len, points)):
            raise RuntimeError(UNREADABLE)
        if not all(np.isfinite(each).all() for each in points):
            raise RuntimeError("a mesh has positions that are not numbers")


def positions(mesh: bpy.types.Mesh) -> np.ndarray:
    found = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", found.ravel())
    return found


def main() -> int:
    try:
        run(json.loads(Path(sys.argv[-1]).read_text(encoding="utf-8")))
    except Exception:
        traceback.print_exc()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
