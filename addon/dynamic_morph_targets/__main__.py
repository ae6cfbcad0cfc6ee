# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m dynamic_morph_targets`: the command line without Blender, on the bpy wheel."""

import os
import sys
import threading

try:
    here = os.getcwd()  # noqa: PTH109 - pathlib may be in there too
except FileNotFoundError:  # it was deleted
    here = ""
if __name__ == "__main__" and sys.path[:1] == [here]:
    del sys.path[0]  # a stranger's .blend may have brought a bpy.py into the current folder


CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
THREADS = 5 + CORES  # about as many as Blender starts


def can_start(count: int) -> bool:
    """Whether the system gives so many threads. Without them, Blender ends its process with no word that helps."""
    ends, started = threading.Event(), []
    try:
        for _ in range(count):
            thread = threading.Thread(target=ends.wait)
            thread.start()
            started.append(thread)
    except RuntimeError:
        return False
    finally:
        ends.set()
        for thread in started:
            thread.join()
    return True


def run() -> int:
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: a file that is opened later would take its place
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 - as long as this runs
    if not can_start(THREADS):
        print("dynamorph: error: the system gives no more threads or processes (ulimit -u): try again", file=sys.stderr)
        return 75
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded, whose last digits depend on it
    try:
        import bpy
    except ImportError as error:
        remedy = "pip install 'bpy==4.5.*' (Python 3.11) or 'bpy==5.2.*' (Python 3.13)"
        print(f"dynamorph: error: Blender's Python module is missing ({error}): {remedy}", file=sys.stderr)
        return 2
    from . import register
    from .cli import main
    from .core import blas

    blas.use_one_thread()  # NumPy may have been loaded before
    if not hasattr(bpy.types.Object, "dynamorph"):  # the installed extension may have registered already
        register()
    return main.main(sys.argv[1:], opens_file=True)


def script() -> int:
    """The command `dynamorph` of the wheel: its exit code."""
    code = run()
    for name in ("stdout", "stderr"):
        try:
            getattr(sys, name).flush()
        except OSError:  # `main` has reported it, and Python would once more
            setattr(sys, name, None)
    return code


if __name__ == "__main__":
    sys.exit(script())
