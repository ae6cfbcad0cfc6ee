# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs an exporter of Blender's in a process of its own, on a copy of the scene.

Blender's Alembic exporter ends the whole process when the disk is full, and that for USD reports success: here the
first costs nobody unsaved work, and the second is noticed. `export_child` is what runs there.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import bpy

from ...core.message import Message
from . import blend_file, child

CHILD = Path(__file__).with_name("child.py")
FAILED = "Failed writing"  # what USD says and goes on
KILLED = -9  # on Linux, by the kernel when memory is short
PROBE = "dynamorph_probe"
# More than simple arithmetic. Blender shows it to the artist as what it did not run.
EXPRESSION = "float('Dynamorph asks whether Python may run'.isprintable())"
ADD_ON = __package__.rsplit(".", 2)[0]


def export(format: str, collection: str, path: Path, frames: tuple[int, int], **options: Any) -> None:
    """Write a collection of the scene to `path`, and read it back at the first and last frame; format: alembic or usd;
    options: of its exporter. Raises RuntimeError with what was said when that failed, OSError when the scene cannot be
    copied, MemoryError.
    """
    with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as folder:
        blend = Path(folder) / (Path(bpy.data.filepath).name or "untitled.blend")  # Alembic notes the name
        _copy(bpy.data.collections[collection], blend)
        trusted, preferences = _runs_python(), bpy.context.preferences.filepaths
        job = {
            "blend": str(blend),
            "scene": bpy.context.scene.name,
            "view_layer": bpy.context.view_layer.name,
            "frames": frames,
            "format": format,
            "options": {"filepath": str(path), "collection": collection, **options},
            "add_on": ADD_ON,
            "runs_texts": trusted and preferences.use_scripts_auto_execute,
            "runs_drivers": trusted,
        }
        request = Path(folder) / "job.json"
        request.write_text(json.dumps(job), encoding="utf-8")
        done = subprocess.run(
            [*_blender(), str(request)],
            env={**os.environ, "TMPDIR": folder, "TEMP": folder, "TMP": folder},  # a crash leaves its own there
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace",
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            check=False,
        )  # fmt: skip
    if done.returncode == KILLED:
        raise MemoryError
    said = done.stderr.rpartition(child.BEGIN)[2].strip()  # not what add-ons say as Blender starts
    if done.returncode or FAILED in said:
        raise RuntimeError(said or f"Blender's exporter crashed with code {done.returncode}")


def leaves_python_out() -> bool:
    """Whether the file has Python that this session does not run, such as drivers."""
    return _has_python() and not _runs_python()


def _runs_python() -> bool:
    """Whether this session runs the Python of its file, which the child must not do otherwise.

    Only evaluating a driver shows it. `autoexec_fail` misses drivers that were never evaluated, such as those of
    objects that only renders show, and the preference does not say whether this file was opened untrusted.
    """
    scene = bpy.context.scene
    if bpy.app.autoexec_fail or scene.library or not _has_python():
        return False
    had_animation = scene.animation_data is not None
    scene[PROBE] = 0.0
    scene.driver_add(f'["{PROBE}"]').driver.expression = EXPRESSION
    try:
        bpy.context.view_layer.update()
        return scene[PROBE] != 0.0
    finally:
        scene.driver_remove(f'["{PROBE}"]')
        del scene[PROBE]
        if not had_animation:
            scene.animation_data_clear()


def _has_python() -> bool:
    """Whether there is any: a text that runs at once, or a driver that is more than arithmetic."""
    drivers = child.drivers()
    return any(text.use_module for text in bpy.data.texts) or any(
        driver.type == "SCRIPTED" and not driver.is_simple_expression for driver in drivers
    )


def _copy(collection: bpy.types.Collection, blend: Path) -> None:
    """Write the scene with what it needs as a .blend, without calling a handler. Raises OSError."""
    for obj in collection.objects:
        obj.update_from_editmode()
    try:
        bpy.data.libraries.write(str(blend), {bpy.context.scene, collection}, path_remap="ABSOLUTE")
        error = blend_file.damage(blend)
    except (OSError, RuntimeError) as fault:
        error = str(fault).strip()
    if error:
        text = (
            "The scene cannot be copied to the temporary folder '{folder}' ({error}): free some space there, or choose "
            "another in Preferences > File Paths"
        )
        raise OSError(Message(text, folder=bpy.app.tempdir, error=error))


def _blender() -> list[str]:
    """The command that runs `CHILD` in the background."""
    if bpy.app.module or not bpy.app.binary_path:  # the bpy wheel
        return [sys.executable, "-P", str(CHILD)]
    return [bpy.app.binary_path, "--background", "--python-exit-code", "1", "--python", str(CHILD), "--"]
