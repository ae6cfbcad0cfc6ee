# SPDX-License-Identifier: GPL-3.0-or-later
"""What a build or bake takes of memory, estimated before it begins, and how much there is. Never touches bpy.

The figures are fitted to the peaks that were measured with 500 to 20,000 nodes, 20 to 400 modes, 100 and 1,000 frames
and 2 to 1,000 bones. They are nearer than a factor of 2, and rather too small than too large: what would fit must
not be refused, and what does not fit after all ends with `errors.NO_MEMORY`.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from math import comb, inf
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .errors import MemoryShortError, SceneError
from .message import Message
from .settings import ModelSettings, SimulationSettings

GIGABYTE = 2**30
LIGHTEST = 0.01  # as kNegligible of pose/skinning.cpp
COUNTED = 2000  # bones up to which pairs of them are counted; of more there may be as many as all nodes together have
# What to lower, by the part of the work that takes the memory.
REMEDIES = {
    "nodes": Message("lower Cage Nodes"),
    "modes": Message("lower Detail (Modes)"),
    "frames": Message("bake fewer frames"),
    "rig": Message("lower Substeps Per Frame, or bake fewer frames"),
    "skin": Message("use a mesh with fewer vertices"),
}


class Size(NamedTuple):
    """Of a character: vertices, targets, bones, and nodes of its cage."""

    vertices: int
    targets: int
    bones: int
    nodes: int


def build_bytes(size: Size, settings: ModelSettings, cores: int) -> dict[str, float]:
    """What a build takes at most at one time, by the keys of REMEDIES. cores: on which it works."""
    if settings.method == "STATIC":
        return {"skin": 100.0 * size.vertices * size.targets}
    reduced = settings.solver == "REDUCED"
    finer = (size.nodes / 2000) ** 0.27  # of the factors of sparse matrices grow more than the nodes
    per_target = 60.0 * (settings.modes + 100) if reduced else 2000.0
    found = {
        "nodes": size.nodes * finer * ((18e3 if reduced else 6e3) + per_target * size.targets),
        "skin": size.vertices * (500.0 + 60.0 * size.targets),
    }
    if reduced:
        tables, sums, stored = _tables(size, settings)
        found["modes"] = max(tables + min(size.targets, cores) * sums, 5.0 * stored)
    return found


def bake_bytes(size: Size, settings: ModelSettings, simulation: SimulationSettings, chunk: int) -> dict[str, float]:
    """What a bake takes at most at one time, by the keys of REMEDIES; chunk: frames that are read at once."""
    frames = len(simulation.times)
    samples = min(chunk, len(simulation.simulated)) * simulation.substeps
    kept = size.targets  # shapes of the bake
    found = {"rig": 380.0 * samples * size.bones}
    if settings.method != "STATIC":
        kept += settings.modes
        free = 3 * size.nodes
        if settings.solver == "FULL":
            found["nodes"] = 16e3 * size.nodes * (size.nodes / 2000) ** 0.27
            found["frames"] = 72.0 * frames * free
        else:
            pairs = comb(settings.tabulated + 1, 2)
            folded = 0.0 if settings.material_model == "LINEAR" else pairs**2 / 2
            found["modes"] = (12.0 + 4.0 * size.targets) * folded + 24.0 * free * settings.modes
            found["frames"] = 24.0 * frames * settings.modes
    found["skin"] = 120.0 * size.vertices * kept
    return found


def inertia_bytes(node_weights: np.ndarray, modes: int, sets: int) -> float:
    """What the inertia of a stored model takes at most: a tensor for each pair of bones that move one node together.

    node_weights: (n, B + 1). The engine leaves out weights below LIGHTEST of a node's sum.
    """
    moves = node_weights >= LIGHTEST * node_weights.sum(axis=1, keepdims=True)
    columns = node_weights.shape[1]
    if columns <= COUNTED:
        together = moves.T.astype(np.float32) @ moves.astype(np.float32)
        pairs = int(np.count_nonzero(np.triu(together)))
    else:
        counts = moves.sum(axis=1)
        pairs = min(int((counts * (counts + 1) // 2).sum()), comb(columns + 1, 2))
    return 8.0 * (sets + 1) * pairs * (18 * modes + 9 * comb(modes, 2))


def _tables(size: Size, settings: ModelSettings) -> tuple[float, float, float]:
    """Bytes of all targets' energy tables, of the sums that one target's are made of, and of the stored model."""
    r, h = settings.tabulated, settings.modes - settings.tabulated
    pairs, linear = comb(r + 1, 2), settings.material_model == "LINEAR"
    distinct = pairs if linear else pairs + comb(r + 2, 3) + comb(r + 3, 4)
    coupling = h * (1 if linear else pairs)
    tables = 2.0 * size.targets * (8 * distinct + 4 * coupling)
    sums = 4.0 * r**2 if linear else 4.0 * (r + pairs) ** 2 * (2 if settings.material_model == "STVK" else 1)
    modes = 24.0 * size.nodes * settings.modes
    shapes = 24.0 * size.targets * (size.nodes + size.vertices)
    return tables, sums, tables + modes + shapes + 400.0 * size.nodes


# How much there is ---------------------------------------------------------------------------------------------------


class Room(NamedTuple):
    """Bytes: what this process could ever take beside what it has, and what is free now; inf where nothing says."""

    limit: float
    free: float


def room() -> Room:
    """The least of what the machine has, of the limit of the process (ulimit -v), and of that of its container."""
    rooms = [Room(inf, inf), *filter(None, (_of_machine(), _of_process(), of_container()))]
    return Room(min(each.limit for each in rooms), min(each.free for each in rooms))


def check(name: str, needs: Mapping[str, float], there: Room | None = None) -> None:
    """Raises SceneError when what is needed, by the keys of REMEDIES, is more than there could ever be, and
    MemoryShortError when it is more than what is free now. Both say what to lower.
    """
    there = there or room()
    needed = sum(needs.values())
    if needed <= there.free:
        return
    largest = max(needs, key=lambda part: needs[part])
    values = {"name": name, "needed": _gigabytes(needed), "remedy": REMEDIES[largest]}
    if needed > there.limit:
        raise SceneError(
            "'{name}' needs about {needed} GB of memory, and there are {most} GB at most: {remedy}",
            **values,
            most=_gigabytes(there.limit),
        )
    raise MemoryShortError(
        "'{name}' needs about {needed} GB of memory, and {free} GB are free: close other programs, or {remedy}",
        **values,
        free=_gigabytes(there.free),
    )


def _gigabytes(size: float) -> str:
    """For a sentence. Less than nothing is left where a limit was set below what the process has."""
    number = max(size / GIGABYTE, 0.0)
    return f"{number:.2g}" if number < 9.5 else f"{number:,.0f}"


def _of_machine() -> Room | None:
    if sys.platform == "win32":
        status = (ctypes.c_uint64 * 8)(64)  # MEMORYSTATUSEX: its size and the load share the first
        if not ctypes.windll.kernel32.GlobalMemoryStatusEx(status):
            return None
        _, _, _, page_total, page_free, *_ = status
        return Room(float(page_total), float(page_free))
    with suppress(OSError, ValueError, KeyError):
        fields = (line.split() for line in Path("/proc/meminfo").read_text().splitlines())
        sizes = {name: 1024.0 * float(number) for name, number, *_ in fields}
        return Room(sizes["MemTotal:"] + sizes["SwapTotal:"], sizes["MemAvailable:"] + sizes["SwapFree:"])
    with suppress(OSError, ValueError):  # of others only the size is known
        size = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        return Room(size, size)
    return None


def _of_process() -> Room | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    taken = 0.0
    with suppress(OSError, ValueError):
        taken = float(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    return Room(limit - taken, limit - taken)


def of_container(groups: Path = Path("/proc/self/cgroup"), tree: Path = Path("/sys/fs/cgroup")) -> Room | None:
    """The room in the control group of the process and in those around it; both versions of Linux's groups."""
    found = None
    with suppress(OSError, ValueError):
        for line in groups.read_text().splitlines():
            number, controllers, path = line.split(":", 2)
            if number != "0" and "memory" not in controllers.split(","):
                continue
            base, limit, usage = tree, "memory.max", "memory.current"
            if number != "0":
                base, limit, usage = tree / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
            folder = base / path.strip("/")
            for each in (folder, *folder.parents):
                found = _smaller(found, _of_group(each, limit, usage))
                if each == base:
                    break
    return found


def _of_group(folder: Path, limit_file: str, usage_file: str) -> Room | None:
    try:
        limit = float((folder / limit_file).read_text().replace("max", "inf"))
        taken = float((folder / usage_file).read_text())
    except (OSError, ValueError):
        return None
    if limit > 2**60:  # none
        return None
    with suppress(OSError, ValueError):  # files that were read go when somebody needs the memory
        lines = (line.split() for line in (folder / "memory.stat").read_text().splitlines())
        taken -= max(float(size) for name, size in lines if name.endswith("inactive_file"))
    return Room(limit, limit - taken)


def _smaller(first: Room | None, second: Room | None) -> Room | None:
    if first is None or second is None:
        return first or second
    return Room(min(first.limit, second.limit), min(first.free, second.free))
