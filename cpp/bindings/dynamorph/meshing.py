# SPDX-License-Identifier: GPL-3.0-or-later
"""From a body's triangles to tetrahedra, in a child process: TetGen crashes or hangs on some meshes."""

from __future__ import annotations

import functools
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynamorph._core import Cancelled, Error, TetMesh, make_cage, points_on_bones, tetrahedralize

TRY_THIS = "Change the cage resolution a little, or clean the mesh (Mesh > Clean Up > Merge by Distance)."
EXIT_ERROR, EXIT_MEMORY, EXIT_CALLER = 2, 3, 4
# For tests only: makes the child crash, hang or allocate without end.
FAULT_VARIABLE = "DYNAMORPH_MESHER_FAULT"


def mesh_body(
    vertices: np.ndarray,
    triangles: np.ndarray,
    target_nodes: int,
    *,
    bones: np.ndarray | None = None,
    held: float = 0.4,
    time_limit: float = 60.0,
    memory_limit_gb: float = 4.0,
    progress: Callable[[float], bool] | None = None,
) -> tuple[np.ndarray, np.ndarray, TetMesh]:
    """Wraps a closed cage around any triangle soup and fills it with about `target_nodes` nodes.

    vertices (V, 3): metres. triangles (T, 3): vertex indices. bones (B, 2, 3): heads and tails of bones along which
    nodes are wanted, metres. held: how far of the way to the skin the bones hold the flesh. time_limit: seconds.
    progress: called with 0..1 every 50 ms, returns False to cancel.
    Returns the cage's vertices (C, 3) and outward triangles (D, 3), and the TetMesh. Raises ValueError on wrong shapes
    or indices; Error, saying what to do, when the mesh cannot be used or the mesher crashes, hangs or takes too much
    memory; Cancelled.
    """
    vertices, triangles = _checked(vertices, triangles)
    bones = np.zeros((0, 2, 3)) if bones is None else np.asarray(bones, np.float64)
    if bones.ndim != 3 or bones.shape[1:] != (2, 3):
        raise ValueError(f"bones: expected shape (any, 2, 3), got {bones.shape}")
    with tempfile.TemporaryFile() as request, tempfile.TemporaryFile() as answer:
        np.save(request, vertices, allow_pickle=False)
        np.save(request, triangles, allow_pickle=False)
        np.save(request, bones, allow_pickle=False)
        request.seek(0)
        _run_child([target_nodes, time_limit, memory_limit_gb, held], request, answer, time_limit, progress)
        answer.seek(0)
        cage_vertices, cage_triangles, nodes, tets = (np.load(answer, allow_pickle=False) for _ in range(4))
    return cage_vertices, cage_triangles, TetMesh(nodes, tets)


def _checked(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    arrays = np.asarray(vertices, np.float64), np.asarray(triangles, np.int32)
    for name, array in zip(("vertices", "triangles"), arrays, strict=True):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name}: expected shape (any, 3), got {array.shape}")
    return arrays


def _run_child(arguments: list, request, answer, time_limit: float, progress: Callable[[float], bool] | None) -> None:
    """Runs `_child` on open files; its standard error carries progress (numbers) and, at the end, a message."""
    # Isolated, with our own paths: nothing of the artist's Python environment, and inside Blender its bundled Python.
    paths = [str(Path(module.__file__).absolute().parent.parent) for module in (sys.modules["dynamorph"], np)]
    code = f"import sys; sys.path[:0] = {paths!r}; from dynamorph.meshing import _child; _child()"
    command = [sys.executable, "-I", "-S", "-c", code, *map(str, arguments)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # each thread reserves memory, which is limited
    try:
        child = subprocess.Popen(
            command, stdin=request, stdout=answer, stderr=subprocess.PIPE, text=True, env=environment
        )
    except OSError as error:
        raise Error(f"The mesher could not be started ({error}). Re-install the add-on.") from error
    fraction, message = [0.0], []
    reader = threading.Thread(target=_read_reports, args=(child.stderr, fraction, message), daemon=True)
    reader.start()
    deadline = time.monotonic() + time_limit
    try:
        while child.poll() is None:
            if progress and not progress(fraction[0]):
                raise Cancelled("cancelled")
            if time.monotonic() > deadline:
                raise Error(f"Meshing took longer than {time_limit:g} s and was stopped. {TRY_THIS}")
            time.sleep(0.05)
    finally:  # also on KeyboardInterrupt, or an exception of progress's own
        child.kill()
        child.wait()
        reader.join()
        child.stderr.close()
    _raise_failure(child.returncode, "\n".join(message), memory_limit_gb=arguments[2])


def _read_reports(stream, fraction: list[float], message: list[str]) -> None:
    for line in stream:
        try:
            fraction[0] = float(line)
        except ValueError:
            message.append(line.rstrip())


def _raise_failure(code: int, message: str, memory_limit_gb: float) -> None:
    if code == 0:
        return
    if code == EXIT_ERROR:
        raise Error(message)
    if code == EXIT_CALLER:
        raise ValueError(message)
    if code == EXIT_MEMORY:
        raise Error(f"Meshing needed more than {memory_limit_gb:g} GB of memory. Lower the cage resolution.")
    if code < 0:
        raise Error(f"The mesher crashed on this mesh ({signal.Signals(-code).name}). {TRY_THIS}")
    last_line = message.rpartition("\n")[2]
    raise Error(f"The mesher failed on this mesh (exit code {code}: {last_line}). {TRY_THIS}")


def _child() -> None:
    """The child's main: arrays from standard input to standard output."""
    target_nodes = int(sys.argv[1])
    time_limit, memory_limit_gb, held = map(float, sys.argv[2:5])
    _limit_resources(time_limit, memory_limit_gb)
    try:
        _fault(os.environ.get(FAULT_VARIABLE))
        vertices, triangles, bones = (np.load(sys.stdin.buffer, allow_pickle=False) for _ in range(3))
        for array in _mesh(vertices, triangles, bones, held, target_nodes):
            np.save(sys.stdout.buffer, array, allow_pickle=False)
    except (Error, ValueError) as error:
        print(error, file=sys.stderr)
        sys.exit(EXIT_ERROR if isinstance(error, Error) else EXIT_CALLER)
    except MemoryError:
        sys.exit(EXIT_MEMORY)


def _limit_resources(time_limit: float, memory_limit_gb: float) -> None:
    try:
        import resource
    except ImportError:  # Windows: the parent's time limit alone
        return
    memory = int(memory_limit_gb * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    cpu = math.ceil(time_limit) + 10  # outlives the parent's limit: only for a child whose parent was killed
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu))


def _mesh(vertices, triangles, bones, held: float, target_nodes: int) -> tuple[np.ndarray, ...]:
    """A cage that leaves room for nodes inside; again with fewer vertices while good tets need too many nodes."""
    # Fitted to many characters: the surface's share of the nodes falls as the mesh gets finer.
    share = np.clip(0.62 - 0.12 * math.log(target_nodes / 2000, 4), 0.4, 0.7)
    cage_vertices = share * target_nodes
    for attempt in range(3):
        progress = functools.partial(_report, attempt)
        cage = make_cage(vertices, triangles, max(int(cage_vertices), 4), progress)
        mesh = tetrahedralize(*cage, target_nodes, points_on_bones(*cage, bones[:, 0], bones[:, 1], held))
        if len(mesh.nodes) <= 1.1 * target_nodes:
            break
        cage_vertices *= target_nodes / len(mesh.nodes)
    return *cage, mesh.nodes, mesh.tets


def _report(attempt: int, done: float) -> bool:
    print(1 - 0.1**attempt * (1 - 0.9 * done), file=sys.stderr, flush=True)
    return True


def _fault(kind: str | None) -> None:
    if kind == "crash":
        signal.raise_signal(signal.SIGSEGV)
    elif kind == "hang":
        time.sleep(3600)
    elif kind == "memory":
        bytearray(2**40)
