# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m dynamic_morph_targets`: the command line without Blender, on the bpy wheel."""

import os
import sys
import traceback

try:
    here = os.getcwd()  # noqa: PTH109 - pathlib may be in there too
except FileNotFoundError:  # it was deleted
    here = ""
if __name__ == "__main__" and sys.path[:1] == [here]:
    del sys.path[0]  # a stranger's .blend may have brought a bpy.py into the current folder

from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn


def run() -> int:
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: a file that is opened later would take its place
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 - as long as this runs
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
    if "bpy" in sys.modules:
        from .write.export import child

        child.remove_temporary()  # which it would have done
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # `main` has reported it
            stream.flush()
    os._exit(code)


def run_script(main: Callable[[], int]) -> NoReturn:
    """`leave` with what `main` returns, for scripts; also when it fails."""
    try:
        code = main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
        code = 1
    leave(code)


def script() -> NoReturn:
    """The command `dynamorph` of the wheel."""
    leave(run())


if __name__ == "__main__":
    script()
