# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m dynamic_morph_targets`: the command line without Blender, on the bpy wheel."""

import os
import sys

if __name__ == "__main__" and sys.path[:1] == [os.getcwd()]:  # noqa: PTH109 - pathlib may be in there too
    del sys.path[0]  # a stranger's .blend may have brought a bpy.py into the current folder

import shutil
from typing import NoReturn


def run() -> int:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded, whose last digits depend on it
    try:
        import bpy
    except ImportError as error:
        print(f"dynamorph: error: Blender's Python module is missing ({error}): pip install bpy", file=sys.stderr)
        return 2
    from . import register
    from .cli import main
    from .core import blas

    blas.use_one_thread()  # NumPy may have been loaded before
    if not hasattr(bpy.types.Object, "dynamorph"):  # the installed extension may have registered already
        register()
    return main.main(sys.argv[1:], opens_file=True)


def leave(code: int) -> NoReturn:
    """End this process, for scripts too: as it tears itself down, bpy 4.5 may wait for ever for a thread of its own."""
    if bpy := sys.modules.get("bpy"):
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # which it would have done
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def script() -> NoReturn:
    """The command `dynamorph` of the wheel."""
    leave(run())


if __name__ == "__main__":
    script()
