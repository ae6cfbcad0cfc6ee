# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m dynamic_morph_targets`: the command line without Blender, on the bpy wheel."""

import atexit
import os
import shutil
import sys

exit_code = 1  # of what ends otherwise


def run() -> int:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded, whose last digits depend on it
    try:
        import bpy
    except ImportError as error:
        print(f"dynamorph: error: Blender's Python module is missing ({error}): pip install bpy", file=sys.stderr)
        return 2
    from . import cli, register

    if not hasattr(bpy.types.Object, "dynamorph"):  # the installed extension may have registered already
        register()
    return cli.main(sys.argv[1:], opens_file=True)


def _end():
    """End here: in what C++ tears down after this, bpy 4.5 may wait for ever where a process has one core."""
    if bpy := sys.modules.get("bpy"):
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # which it would have done
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(exit_code)


if __name__ == "__main__":
    atexit.register(_end)  # before bpy registers what it does at the end, so after that
    exit_code = run()
