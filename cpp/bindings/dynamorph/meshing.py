# SPDX-License-Identifier: GPL-3.0-or-later
"""Fills a body with tetrahedra, in a child process because TetGen crashes or hangs on some meshes."""

from __future__ import annotations

import atexit
import errno
import functools
import heapq
import io
import itertools
import math
import os
import queue
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from dynamorph._core import (
    Cancelled,
    Error,
    TetMesh,
    closed_surface,
    make_cage_surface,
    points_on_bones,
)

TRY_THIS = "Change the cage resolution a little, or merge vertices that are close together."
# 1 and 2 are Python's own.
EXIT_ERROR, EXIT_MEMORY, EXIT_CALLER, EXIT_MESHER, EXIT_DISK, EXIT_IDLE, EXIT_TIME = 10, 11, 12, 13, 14, 15, 16
# On Windows exit codes from here up are exceptions, and 3 is abort; elsewhere a signal gives a negative code.
WINDOWS_CRASH, WINDOWS_ABORT = 0xC0000000, 3
# TetGen fails, crashes or hangs unpredictably. A slightly coarser or finer cage usually works.
RESOLUTIONS = (1.0, 0.9, 1.12, 0.75)
IDLE = 60.0  # seconds after which a child that got no work ends
KILLED = 9  # SIGKILL, which Windows does not have
# For tests only: makes the child crash, hang or allocate without end. "crash once" crashes at the first resolution
# only.
FAULT_VARIABLE = "DYNAMORPH_MESHER_FAULT"

ProgressFn = Callable[[float], bool]  # called with 0..1, returns False to cancel
Surface = tuple[np.ndarray, np.ndarray]  # vertices (V, 3) and triangles (T, 3)


class _MesherFailed(Error):
    """Another cage may work."""


def mesh_body(
    vertices: np.ndarray,
    triangles: np.ndarray,
    target_nodes: int,
    *,
    cage: Surface | None = None,
    bones: np.ndarray | None = None,
    pin_radius: float = 0.4,
    time_limit: float | None = None,
    memory_limit_gb: float = 4.0,
    progress: ProgressFn | None = None,
) -> tuple[np.ndarray, np.ndarray, TetMesh]:
    """Wraps a closed cage around any triangle soup and fills it with about `target_nodes` nodes.

    vertices (V, 3): meters. triangles (T, 3): vertex indices. cage: vertices (C, 3) and triangles (D, 3) of a closed
    surface to fill instead of a wrap. bones (B, 2, 3): heads and tails of the bones along which to place nodes, meters.
    pin_radius: the part of the way from bone to skin within which the bones pin nodes. time_limit: seconds of computing
    in total, however busy the machine is; None depends on the size of both. progress: called with 0..1 every 50 ms,
    returns False to cancel.
    Returns the cage's vertices (C, 3) and outward triangles (D, 3), and the TetMesh. Raises ValueError on wrong shapes
    or indices. Raises Error, which says what to do, when the mesh cannot be used, or when the mesher crashes, hangs or
    needs too much memory at all resolutions near the requested one. Raises MemoryError when the system kills the
    mesher, OSError when it gives no processes or threads, and Cancelled when progress returns False.
    """
    with Meshing(
        vertices,
        triangles,
        target_nodes,
        cage=cage,
        bones=bones,
        pin_radius=pin_radius,
        time_limit=time_limit,
        memory_limit_gb=memory_limit_gb,
    ) as meshing:
        return meshing.result(progress)


class Meshing:
    """`mesh_body` in two parts: it begins when this is made, in another process, and `result` waits for it, so that the
    caller can do something else in between. Use it in a `with` statement, whose end ends that process.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        target_nodes: int,
        *,
        cage: Surface | None = None,
        bones: np.ndarray | None = None,
        pin_radius: float = 0.4,
        time_limit: float | None = None,
        memory_limit_gb: float = 4.0,
    ) -> None:
        """Begins. Takes what `mesh_body` does, and raises ValueError and Error like it."""
        bones = np.zeros((0, 2, 3)) if bones is None else np.asarray(bones, np.float64)
        if bones.ndim != 3 or bones.shape[1:] != (2, 3):
            raise ValueError(f"bones: expected shape (any, 2, 3), got {bones.shape}")
        self._arrays = [*_checked(vertices, triangles), *_closed(cage), bones]
        self._settings = [target_nodes, memory_limit_gb, pin_radius]
        self._seconds_left = time_limit or 40.0 + target_nodes / 100 + len(self._arrays[1]) / 20_000
        self._resolutions = list(RESOLUTIONS if cage is None else RESOLUTIONS[:1])  # those to try yet
        self._child = self._begun()

    def result(self, progress: ProgressFn | None = None) -> tuple[np.ndarray, np.ndarray, TetMesh]:
        """Waits for it. Returns and raises what `mesh_body` does."""
        while True:
            try:
                self._child.wait(progress, memory_limit_gb=self._settings[1])
                break
            except _MesherFailed as error:
                if not self._resolutions:
                    raise Error(str(error)) from None
            self._child.end()
            self._child = self._begun()
        vertices, triangles, nodes, tets = self._child.answer()
        return vertices, triangles, TetMesh(nodes, tets)

    def __enter__(self) -> Meshing:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.end()

    def _begun(self) -> _Child:
        """A child that meshes at the next resolution."""
        resolution = self._resolutions.pop(0)
        seconds = self._seconds_left / (2 if self._resolutions else 1)
        self._seconds_left -= seconds
        fault = os.environ.get(FAULT_VARIABLE, "")
        request = io.BytesIO()
        for array in (np.array(fault), np.array([*self._settings, seconds, resolution]), *self._arrays):
            np.save(request, array, allow_pickle=False)
        child = _take()
        try:
            child.give(request.getvalue())
        except BaseException:  # KeyboardInterrupt, say
            child.end()
            raise
        return child


# The child, which may be started before there is work for it ----------------------------------------------------------

_spare: list[_Child] = []  # one; where two threads prepare it at the same time, two


def prepare_mesher() -> None:
    """Starts the process of the next `mesh_body` now, because it takes a tenth of a second. It ends by itself if it
    gets no work.
    """
    with suppress(Error, OSError):  # `mesh_body` will say so
        _spare.append(_take())


@atexit.register
def dismiss_mesher() -> None:
    """Ends what `prepare_mesher` started."""
    while child := _prepared():
        child.end()


def _prepared() -> _Child | None:
    """A child that `prepare_mesher` started, which is the caller's from now on: no other thread gets it."""
    with suppress(IndexError):
        return _spare.pop()
    return None


def _take() -> _Child:
    """A child that waits for work."""
    while child := _prepared():
        if child.waits:
            return child
        child.end()
    return _Child()


class _Child:
    """A process that meshes once. Raises Error when it cannot be started."""

    def __init__(self) -> None:
        # Isolated, with our own paths: the child must not see the artist's Python environment. Inside Blender it runs
        # Blender's bundled Python.
        paths = [str(Path(file).absolute().parent.parent) for file in (__file__, np.__file__)]
        code = f"import sys; sys.path[:0] = {paths!r}; from dynamorph.meshing import _child; _child()"
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # each thread reserves memory, and memory is limited
        self._answer = tempfile.TemporaryFile()  # noqa: SIM115 - it is closed by `end`
        with tempfile.NamedTemporaryFile() as reports:
            self._reports = _opened_again(reports.name)
            try:
                self._process = subprocess.Popen(
                    [sys.executable or "", "-I", "-S", "-X", "utf8", "-c", code],
                    stdin=subprocess.PIPE, stdout=self._answer, stderr=reports, bufsize=0, env=environment,
                    creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # or Windows would flash a console
                )  # fmt: skip
            except OSError as error:
                self._answer.close()
                self._reports.close()
                raise Error(
                    f"The mesher could not be started with '{sys.executable}' ({error}). Let the virus scanner allow "
                    "this program, or install it again."
                ) from error
        self._began = time.monotonic()

    @property
    def waits(self) -> bool:
        """Whether it takes work."""
        return self._process.poll() is None and time.monotonic() - self._began < IDLE / 2

    def give(self, request: bytes) -> None:
        """Has it do the work. It reads the request at once."""
        assert self._process.stdin  # a pipe, which stays open: its end tells the child that this process has ended
        left = memoryview(struct.pack("<Q", len(request)) + request)
        with _without_sigpipe(), suppress(OSError):  # it has ended; its exit code says why
            while left:
                left = left[self._process.stdin.write(left) :]

    def wait(self, progress: ProgressFn | None, memory_limit_gb: float) -> None:
        """Waits until it has done the work. Raises as `mesh_body` does."""
        code = None
        while code is None:
            if progress and not progress(self._reported()[0]):
                raise Cancelled("canceled")
            with suppress(subprocess.TimeoutExpired):
                code = self._process.wait(0.05)
        _raise_failure(code, self._reported()[1], memory_limit_gb)

    def answer(self) -> list[np.ndarray]:
        """The arrays that it wrote."""
        self._answer.seek(0)
        return [np.load(self._answer, allow_pickle=False) for _ in range(4)]

    def end(self) -> None:
        """Ends it, whatever it does."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._reports, self._answer):
            stream.close()  # type: ignore[union-attr]

    def _reported(self) -> tuple[float, str]:
        """The progress, 0..1, and the message in what it has reported by now, a few kilobytes: lines that are numbers,
        and all others.
        """
        self._reports.seek(0)
        *lines, rest = self._reports.read().decode("utf-8", "replace").split("\n")  # the rest may be half a number
        fraction, message = 0.0, []
        for line in lines:
            try:
                fraction = float(line)
            except ValueError:
                message.append(line.rstrip())
        return fraction, "\n".join([*message, rest]).rstrip()


def _opened_again(path: str) -> io.FileIO:
    """A temporary file for reading what the child writes there: if both shared one that is open, they would share its
    position. On Windows it is O_TEMPORARY that lets a file that is deleted when it is closed be opened again.
    """
    return io.FileIO(os.open(path, os.O_RDONLY | getattr(os, "O_TEMPORARY", 0)))


@contextmanager
def _without_sigpipe() -> Iterator[None]:
    """What is written to a process that has ended must not end this one: so it would where Python was started without
    its signal handlers.
    """
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        if signal.SIGPIPE in signal.sigpending():
            signal.sigwait({signal.SIGPIPE})
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _closed(cage: Surface | None) -> Surface:
    """The artist's cage, welded and outward, or an empty one for None. Raises Error when it has holes."""
    if cage is None:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    vertices, triangles, defects = closed_surface(*_checked(*cage))
    if defects["boundary_loops"]:
        raise Error(f"The cage has {defects['boundary_loops']} holes. Close them, or use the automatic cage.")
    return vertices, triangles


def tet_quality(mesh: TetMesh) -> dict[str, float]:
    """Measures how well shaped the tetrahedra are.

    min_dihedral, max_dihedral: degrees. under_5: the fraction of dihedral angles below 5 degrees. mean_aspect,
    max_aspect: the longest edge over the radius of the inscribed sphere, scaled to 1 for a regular tetrahedron.
    """
    corners = mesh.nodes[mesh.tets]
    areas = []  # area vectors of the faces, each opposite its corner
    for a, b, c in ((1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)):
        areas.append(np.cross(corners[:, b] - corners[:, a], corners[:, c] - corners[:, a]) / 2)
    pairs = list(itertools.combinations(range(4), 2))
    angles = np.stack([_angle(-areas[i], areas[j]) for i, j in pairs])
    longest = np.max([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in pairs], axis=0)
    radius = 3 * mesh.volumes / sum(np.linalg.norm(area, axis=1) for area in areas)
    aspect = longest / (2 * math.sqrt(6) * radius)
    return {
        "min_dihedral": float(angles.min()),
        "max_dihedral": float(angles.max()),
        "under_5": float((angles < 5).mean()),
        "mean_aspect": float(aspect.mean()),
        "max_aspect": float(aspect.max()),
    }


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles (m,) between vectors (m, 3), degrees."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), np.einsum("mi,mi->m", first, second)))


def _checked(vertices: np.ndarray, triangles: np.ndarray) -> Surface:
    arrays: Surface = np.asarray(vertices, np.float64), np.asarray(triangles, np.int32)
    for name, array in zip(("vertices", "triangles"), arrays, strict=True):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name}: expected shape (any, 3), got {array.shape}")
    return arrays


def _raise_failure(code: int, message: str, memory_limit_gb: float) -> None:
    if code == 0:
        return
    if code == EXIT_ERROR:
        raise Error(message)
    if code == EXIT_MESHER:
        raise _MesherFailed(message)
    if code == EXIT_IDLE:
        raise _MesherFailed(f"The mesher got no work in {IDLE:g} seconds. Try it again.")
    if code == EXIT_TIME:
        raise _MesherFailed(f"Meshing took too long and was stopped. {TRY_THIS}")
    if code == EXIT_CALLER:
        raise ValueError(message)
    if code == EXIT_MEMORY:
        raise Error(
            f"Meshing needed more than {memory_limit_gb:g} GB of memory, or than this process may take. Lower the cage "
            "resolution."
        )
    if code == EXIT_DISK:
        number = getattr(errno, message, errno.ENOSPC)  # a full one may have no room for the message either
        raise OSError(number, os.strerror(number), tempfile.gettempdir())
    if code == -KILLED:
        raise MemoryError("The mesher was killed by the system, as happens when memory is short.")
    if code < 0 or code == WINDOWS_ABORT or code >= WINDOWS_CRASH:
        name = signal.Signals(-code).name if code < 0 else f"{code:#x}"
        raise _MesherFailed(f"The mesher crashed on this mesh ({name}). {TRY_THIS}")
    last_line = message.rpartition("\n")[2]
    if "start new thread" in last_line:  # the system has no more
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), "the mesher")
    raise Error(f"The mesher failed on this mesh (exit code {code}: {last_line}). {TRY_THIS}")


def _child() -> None:
    """The child's main function: reads arrays from standard input, and writes arrays to standard output and what it
    reports to standard error.
    """
    work: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=[work], daemon=True).start()
    try:
        code = _worked(io.BytesIO(work.get(timeout=IDLE)))
    except queue.Empty:
        os._exit(EXIT_IDLE)  # Python's own end would want standard input, from which the other thread still reads
    except MemoryError:
        code = EXIT_MEMORY
    except OSError as error:
        with suppress(OSError):  # what it reports may be on the same disk
            _say(errno.errorcode.get(error.errno or 0, "EIO"))
        os._exit(EXIT_DISK)  # Python would try to write the report again, and end with another code
    sys.exit(code)


def _listen(work: queue.SimpleQueue[bytes]) -> None:
    """Reads the request, then waits for the end of standard input, which tells that the parent has ended, however that
    was, and ends this process with it. Also while it meshes, because compiled code lets other threads run.
    """
    try:
        (size,) = struct.unpack("<Q", sys.stdin.buffer.read(8))
        work.put(sys.stdin.buffer.read(size))
        os.read(0, 1)  # nothing comes
    finally:
        os._exit(1)


def _worked(request: io.BytesIO) -> int:
    """Meshes what the request says. Returns the exit code."""
    load = functools.partial(np.load, request, allow_pickle=False)
    fault, (nodes, memory_limit_gb, pin_radius, time_limit, resolution) = load(), load().tolist()
    body, cage, bones = (load(), load()), (load(), load()), load()
    target_nodes = int(nodes)
    limit_resources(time_limit, memory_limit_gb)
    threading.Thread(target=_end_after, args=[time_limit], daemon=True).start()
    try:
        _fault(str(fault), resolution)
        if len(cage[1]):
            cage = _refined(cage, max(int(_surface_share(target_nodes) * target_nodes), 4))
            arrays = _filled(cage, body, bones, pin_radius, target_nodes)
        else:
            arrays = _wrapped(body, bones, pin_radius, target_nodes, resolution)
    except (Error, ValueError) as error:
        _say(error)
        codes: dict[type[Exception], int] = {_MesherFailed: EXIT_MESHER, Error: EXIT_ERROR}
        return codes.get(type(error), EXIT_CALLER)
    _answer(arrays)
    return 0


def _say(what: object) -> None:
    print(what, file=sys.stderr, flush=True)


def _end_after(seconds: float) -> None:
    """Ends this process when it has computed for so long: not what it waits for while others compute."""
    end = time.process_time() + seconds
    while (left := end - time.process_time()) > 0:
        time.sleep(left)
    os._exit(EXIT_TIME)


def _answer(arrays: Iterable[np.ndarray]) -> None:
    """Raises OSError on a full disk, which `np.save` to a file would not notice."""
    content = io.BytesIO()
    for array in arrays:
        np.save(content, array, allow_pickle=False)
    with open(1, "wb", closefd=False) as answer:
        answer.write(content.getbuffer())


def limit_resources(time_limit: float, memory_limit_gb: float) -> None:
    """Memory and time, and no dump or dialog after a crash. macOS does not limit the memory."""
    memory = int(memory_limit_gb * 2**30)
    cpu = math.ceil(time_limit) + 10  # where Python has no turn to end it
    if sys.platform == "win32":
        _limit_on_windows(memory, cpu)
        return
    import resource

    for kind, limit in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CORE, 0), (resource.RLIMIT_CPU, cpu)):
        with suppress(ValueError, OSError):  # the system has no limit of this kind
            given, _ = resource.getrlimit(kind)  # only a privileged process may raise it
            least = limit if given == resource.RLIM_INFINITY else min(limit, given)
            resource.setrlimit(kind, (least, least))


def _limit_on_windows(memory: int, cpu: int) -> None:
    """memory: bytes; cpu: seconds. A job object with this process alone has these limits, and ends with it."""
    import ctypes

    extended_limits, this_process = 9, ctypes.c_void_p(-1)
    limits = 0x2 | 0x100 | 0x400  # of the time, of the memory; an exception ends the process
    # JOBOBJECT_EXTENDED_LIMIT_INFORMATION: the time in units of 100 ns at 0, flags at 16, the memory at 112.
    values = struct.pack("<q8xI92xQ24x", cpu * 10**7, limits, memory)
    kernel = ctypes.CDLL("kernel32")
    kernel.CreateJobObjectW.restype = ctypes.c_void_p
    job = ctypes.c_void_p(kernel.CreateJobObjectW(None, None))
    kernel.SetInformationJobObject(job, extended_limits, values, len(values))
    kernel.AssignProcessToJobObject(job, this_process)


def _wrapped(
    body: Surface,
    bones: np.ndarray,
    pin_radius: float,
    target_nodes: int,
    resolution: float,
) -> tuple[np.ndarray, ...]:
    """Wraps cages until good tets need about `target_nodes` nodes: neither too many, nor too few for lack of room."""
    cage_vertices = _surface_share(target_nodes) * target_nodes * resolution
    best: tuple[np.ndarray, ...] = ()
    best_error = math.inf
    for attempt in range(3):
        progress = functools.partial(_report, attempt)
        cage = make_cage_surface(*body, max(int(cage_vertices), 4), progress=progress)
        arrays = _filled(cage, body, bones, pin_radius, target_nodes)
        nodes = len(arrays[2])
        error = abs(math.log(nodes / target_nodes))
        if error < best_error:
            best, best_error = arrays, error
        if best_error < 0.1:
            break
        cage_vertices *= target_nodes / nodes
    return best


def _surface_share(nodes: int) -> float:
    """The fraction of the nodes on the cage. Fitted to many characters: it falls as the mesh gets finer."""
    return float(np.clip(0.62 - 0.12 * math.log(nodes / 2000, 4), 0.4, 0.7))


def _refined(cage: Surface, target_vertices: int) -> Surface:
    """The same surface with at least `target_vertices` vertices: its longest edge is halved repeatedly.

    Unlike `refine` in C++, which halves triangle after triangle down to a length, it takes the edges of the whole
    surface in order and stops at a number.
    """
    vertices, triangles = cage
    points = [tuple(point) for point in vertices.tolist()]
    opposite: dict[tuple[int, int], int] = {}  # the corner opposite a directed edge
    for a, b, c in triangles.tolist():
        opposite |= {(a, b): c, (b, c): a, (c, a): b}
    if len(opposite) < triangles.size:  # some edge has more than two triangles
        return vertices, triangles

    def length(a: int, b: int) -> float:
        return math.dist(points[a], points[b])

    heap = [(-length(a, b), a, b) for a, b in opposite if a < b]
    heapq.heapify(heap)
    while len(points) < target_vertices:
        _, a, b = heapq.heappop(heap)
        c, d, middle = opposite.pop((a, b)), opposite.pop((b, a)), len(points)
        points.append(tuple((p + q) / 2 for p, q in zip(points[a], points[b], strict=True)))
        for p, q, r in ((a, middle, c), (middle, b, c), (b, middle, d), (middle, a, d)):
            opposite |= {(p, q): r, (q, r): p, (r, p): q}
        for end in (a, b, c, d):
            heapq.heappush(heap, (-length(end, middle), end, middle))
    return np.array(points), np.array([(a, b, c) for (a, b), c in opposite.items() if a < min(b, c)], np.int32)


def _filled(
    cage: Surface, body: Surface, bones: np.ndarray, pin_radius: float, target_nodes: int
) -> tuple[np.ndarray, ...]:
    """The cage, and the nodes and tets that fill it. Raises _MesherFailed."""
    from dynamorph._mesher import tetrahedralize  # in the child alone

    try:
        inner = points_on_bones(*cage, *body, bones[:, 0], bones[:, 1], pin_radius)
        return *cage, *tetrahedralize(*cage, target_nodes, inner)
    except Error as error:
        raise _MesherFailed(str(error)) from error


def _report(attempt: int, done: float) -> bool:
    _say(1 - 0.1**attempt * (1 - 0.9 * done))
    return True


def _fault(kind: str, resolution: float) -> None:
    kind, _, once = kind.partition(" ")
    if once and resolution != RESOLUTIONS[0]:
        return
    if kind == "crash":
        signal.raise_signal(signal.SIGSEGV)
    elif kind == "hang":
        while True:
            pass
    elif kind == "memory":
        bytearray(2**40)
