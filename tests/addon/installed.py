# SPDX-License-Identifier: GPL-3.0-or-later
"""Links the extension's sources into a user folder of this process, as Blender installs an extension, so that tests can
import them under the name that it has there. To be imported before bpy is.
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="dynamorph_test_")

import bpy

PACKAGE = Path(__file__).parents[2] / "addon" / "dynamic_morph_targets"
MODULE = f"bl_ext.user_default.{PACKAGE.name}"
(Path(bpy.utils.user_resource("EXTENSIONS", path="user_default", create=True)) / PACKAGE.name).symlink_to(PACKAGE)


def leave(code: int):
    """End this process at once: where anything still refers to bpy 4.5 as Python ends, it crashes or waits forever."""
    sys.stdout.flush()
    sys.stderr.flush()
    for folder in (bpy.app.tempdir, os.environ["BLENDER_USER_RESOURCES"]):
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(code)
