# SPDX-License-Identifier: GPL-3.0-or-later
"""What a build or bake needs of memory is estimated before it begins, and compared with what there is."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from dynamic_morph_targets.core import errors, memory
from dynamic_morph_targets.core.memory import Room, Size
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.settings import ModelSettings, SimulationSettings
from dynamic_morph_targets.io import model_file
from test_defects import BODIES, shot, soft

GIGABYTE = 2.0**30
SIZE = Size(vertices=10_000, targets=4, bones=60, nodes=2000)
SHOT = SimulationSettings(1, 100)

resource = pytest.importorskip("resource", reason="a system without limits of processes")


# The estimate --------------------------------------------------------------------------------------------------------


def taken(work) -> float:
    """Bytes by which the memory of this process grows at most during the work."""

    def now(field: str) -> float:
        (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field))
        return 1024.0 * float(line.split()[1])

    Path("/proc/self/clear_refs").write_text("5")  # the peak begins again
    before = now("VmRSS")
    work()
    return now("VmHWM") - before


def measured(what: str) -> None:
    """Print what was estimated, and what it took."""
    character = soft(BODIES["arm"](), 1000).with_settings(modes=60 if what == "build" else 8)
    size = Size(len(character.vertices), 1, 2, 1000)
    if what == "build":
        estimate = memory.build_bytes(size, character.settings, 1)
        took = taken(lambda: model_file.pack(*build(character).to_arrays()))
    else:
        character = character.with_settings(solver="FULL")
        model = build(character)
        rig, settings = shot(character, 2.0)
        settings = replace(settings, frame_end=300)
        pose = np.resize(rig.pose, (1 + 299 * settings.substeps, *rig.pose.shape[1:]))
        worlds = np.resize(rig.rig_world, (len(pose), 4, 4))
        rig = replace(rig, pose=pose, rig_world=worlds, object_world=worlds)
        estimate = memory.bake_bytes(size, character.settings, settings, 300)
        took = taken(lambda: simulate.bake(model, character, rig, settings))
    print(sum(estimate.values()), took)


@pytest.mark.skipif(not os.access("/proc/self/clear_refs", os.W_OK), reason="no peak of memory to be read")
@pytest.mark.parametrize("what", ["build", "bake"])
def test_it_is_within_a_factor_of_two(what):
    estimate, took = map(float, run(f"import test_memory; test_memory.measured({what!r})").split())
    assert took > 20e6  # or the noise would decide
    assert took / 2 < estimate < 2 * took


def run(code: str, expected: int = 0) -> str:
    """What a fresh Python prints that can import the modules of this folder."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == expected, done.stderr
    return done.stdout.strip()


def total(needs: dict[str, float]) -> float:
    return sum(needs.values())


def test_it_grows_with_everything_that_takes_memory():
    settings = ModelSettings(basis="MODES", modes=20)
    built = total(memory.build_bytes(SIZE, settings, 4))
    for more in (
        memory.build_bytes(SIZE._replace(nodes=4000), settings, 4),
        memory.build_bytes(SIZE._replace(vertices=10**6), settings, 4),
        memory.build_bytes(SIZE._replace(targets=8), settings, 4),
        memory.build_bytes(SIZE, replace(settings, modes=60), 4),
    ):
        assert total(more) > 1.1 * built
    bake = total(memory.bake_bytes(SIZE, settings, SHOT, 1000))
    for more in (
        memory.bake_bytes(SIZE._replace(vertices=10**6), settings, SHOT, 1000),
        memory.bake_bytes(SIZE._replace(bones=600), settings, SHOT, 1000),
        memory.bake_bytes(SIZE, replace(settings, modes=80), SHOT, 1000),
        memory.bake_bytes(SIZE, replace(settings, solver="FULL"), SHOT, 1000),
        memory.bake_bytes(SIZE, settings, replace(SHOT, substeps=50), 1000),
    ):
        assert total(more) > 1.1 * bake


@pytest.mark.parametrize("modes", [1, 7, 20, 400])
@pytest.mark.parametrize("basis", ["MODES", "RESPONSES"])
@pytest.mark.parametrize("material_model", ["LINEAR", "STVK", "STABLE_STVK"])
@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_it_is_a_number_for_all_settings(modes, basis, material_model, solver):
    settings = ModelSettings(modes=modes, basis=basis, material_model=material_model, solver=solver)
    for method in ("DYNAMIC", "STATIC"):
        chosen = replace(settings, method=method)
        needs = memory.build_bytes(SIZE, chosen, 1) | memory.bake_bytes(SIZE, chosen, SHOT, 100)
        assert needs.keys() <= memory.REMEDIES.keys() and all(0 < need < inf for need in needs.values())


def test_what_can_be_built_is_not_refused_on_a_small_machine():
    """The defaults, and the largest settings that the interface suggests, fit into 8 GB."""
    defaults = total(memory.build_bytes(SIZE, ModelSettings(), 4))
    assert defaults < 0.5 * GIGABYTE
    assert total(memory.build_bytes(SIZE._replace(nodes=20_000), ModelSettings(), 4)) < 8 * GIGABYTE
    many = ModelSettings(modes=240)
    assert total(memory.build_bytes(SIZE, many, 4)) < 8 * GIGABYTE


# What there is -------------------------------------------------------------------------------------------------------


def test_the_limit_of_the_process_counts():
    code = "import resource; from dynamic_morph_targets.core import memory; "
    code += "resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31)); print(*memory.room())"
    most, free = map(float, run(code).split())
    assert 0 < free == most < 2**31
    whole = memory.room()
    assert free < whole.limit and 0 < whole.free <= whole.limit


@pytest.fixture
def groups(tmp_path, monkeypatch):
    """Stands in for the control groups of the system; returns a function that sets their files."""

    def made(line: str, files: dict[str, str]) -> Room | None:
        (tmp_path / "cgroup").write_text(f"3:cpu,cpuacct:/elsewhere\n{line}\n")
        for name, text in files.items():
            path = tmp_path / "tree" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return memory.of_container(tmp_path / "cgroup", tmp_path / "tree")

    return made


def test_the_limit_of_a_container_counts(groups):
    files = {
        "a/b/memory.max": "max\n",
        "a/b/memory.current": "5\n",
        "a/memory.max": f"{4 * GIGABYTE:.0f}\n",
        "a/memory.current": f"{3 * GIGABYTE:.0f}\n",
        "a/memory.stat": f"anon 7\ninactive_file {GIGABYTE:.0f}\n",
    }
    assert groups("0::/a/b", files) == (4 * GIGABYTE, 2 * GIGABYTE)


def test_the_limit_of_an_older_container_counts(groups):
    files = {
        "memory/c/memory.limit_in_bytes": f"{GIGABYTE:.0f}",
        "memory/c/memory.usage_in_bytes": f"{GIGABYTE / 4:.0f}",
        "memory/memory.limit_in_bytes": "9223372036854771712",
        "memory/memory.usage_in_bytes": "99",
    }
    assert groups("4:memory:/c", files) == (GIGABYTE, 0.75 * GIGABYTE)


@pytest.mark.parametrize("line", ["", "nonsense", "0::/", "4:memory:/none", "x:memory:/"])
def test_no_container_is_no_limit(groups, line):
    assert groups(line, {"memory.max": "nonsense"}) is None


# The refusal ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", memory.REMEDIES)
def test_too_much_is_refused_with_what_to_lower(part):
    needs = {"nodes": GIGABYTE, "modes": GIGABYTE} | {part: 3 * GIGABYTE}
    memory.check("Arm", needs, Room(9 * GIGABYTE, total(needs)))
    with pytest.raises(errors.SceneError, match="^'Arm' needs about [45] GB .* 2 GB at most: ") as never:
        memory.check("Arm", needs, Room(2 * GIGABYTE, 2 * GIGABYTE))
    assert str(memory.REMEDIES[part]) in errors.sentence(never.value)
    with pytest.raises(errors.MemoryShortError, match="2 GB are free: close other programs, or") as short:
        memory.check("Arm", needs, Room(9 * GIGABYTE, 2 * GIGABYTE))
    assert isinstance(short.value, MemoryError) and str(memory.REMEDIES[part]) in errors.sentence(short.value)


def test_sizes_are_told_in_words_of_people():
    for needed, free, words in (
        (835, 16.4, "835 GB .* 16 GB at"),
        (2000, 0.5, "2,000 GB .* 0.5 GB"),
        (4, -1, "4 GB .* 0 GB"),
    ):
        with pytest.raises(errors.SceneError, match=f"needs about {words}"):
            memory.check("Arm", {"nodes": needed * GIGABYTE}, Room(free * GIGABYTE, free * GIGABYTE))


@pytest.mark.parametrize("limit_gb", [1.5, 3.0])
def test_meshing_keeps_to_a_lower_limit_of_the_process(limit_gb):
    """Only a privileged process may raise it again."""
    code = f"""
import resource
limit = int({limit_gb} * 2**30)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
import test_refusals, dynamorph
print(len(dynamorph.mesh_body(*test_refusals.box(), 200)[2].nodes))
"""
    assert int(run(code)) > 50
