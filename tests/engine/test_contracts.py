# SPDX-License-Identifier: GPL-3.0-or-later
"""Every callable of the binding refuses bad input with an error that says so, or gives numbers: it never crashes or
hangs, and no NaN comes out. The calls are made from the types in the stubs (contracts.py), in a process of their own.
"""

from __future__ import annotations

import gc
import json
import os
import queue
import subprocess
import sys
import threading
from pathlib import Path

import contracts
import dynamorph
import numpy as np
import pytest

LONGEST = 120.0  # seconds for one call, on a busy machine
# TetGen crashes and hangs on some input, which is why `mesh_body` runs it in a process of its own: see its docstring.
MAY_DIE = {"tetrahedralize": 2.0}  # and after how many seconds it counts as such


@pytest.fixture(scope="module")
def outcomes() -> dict[tuple[str, str, str], str]:
    """The outcome of each call."""
    cases, found, first = contracts.cases(), {}, 0
    while first < len(cases):
        last = worked(first, found)
        if last not in found:  # it died at this one, or it had to be ended
            found[last] = "it crashed or hung"
        first = last + 1
    return {cases[number]: outcome for number, outcome in found.items()}


def worked(first: int, found: dict[int, str]) -> int:
    """Make the calls from `first` on in another process, until one ends it; returns the last."""
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    command = [sys.executable, contracts.__file__, str(first)]
    environment = os.environ | {"PYTHONPATH": path}
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as child:
        reader = threading.Thread(target=lambda: [*map(lines.put, child.stdout), lines.put("")], daemon=True)
        reader.start()
        last = first
        try:
            while line := lines.get(timeout=MAY_DIE.get(contracts.cases()[last][0], LONGEST)):
                last, outcome = json.loads(line)
                if outcome:
                    found[last] = outcome
        except queue.Empty:
            child.kill()
        reader.join()
    return last


def test_the_good_calls_are_good():
    for name, (_, arguments) in contracts.calls().items():
        if name != "unpack_model":  # a good one needs a whole model
            assert not contracts.has_nan(contracts.call(name, arguments)), name


def test_each_callable_of_the_stubs_has_one():
    assert contracts.declared().keys() == contracts.calls().keys()
    for name, types in contracts.declared().items():
        assert types.keys() == contracts.calls()[name][1].keys(), name
    assert len(contracts.cases()) > 2500


@pytest.mark.parametrize("name", contracts.declared())
def test_bad_input_is_refused_or_harmless(name, outcomes):
    wrong = {
        f"{parameter}: {how}": outcome
        for (callee, parameter, how), outcome in outcomes.items()
        if callee == name and outcome not in ("refused", "taken")
    }
    if name in MAY_DIE:
        wrong = {case: outcome for case, outcome in wrong.items() if outcome != "it crashed or hung"}
    assert not wrong


def test_what_is_not_a_number_is_refused_everywhere(outcomes):
    taken = [case for case, outcome in outcomes.items() if outcome == "taken" and "nan" in case[2]]
    # A collider may be lost in a frame: nothing touches it there, and the report says so.
    assert {case[:2] for case in taken} == {("ColliderMotion", "motion")}


# Results that outlive what made them --------------------------------------------------------------------------------


def properties() -> list[tuple[str, str]]:
    """(class, property) of all that can be constructed."""
    found = []
    for name in contracts.declared():
        made = getattr(dynamorph, name, None)
        if isinstance(made, type):
            found += [(name, member) for member, value in vars(made).items() if isinstance(value, property)]
    return found


@pytest.mark.parametrize(("name", "member"), properties())
def test_a_result_outlives_what_it_came_from(name, member):
    made = getattr(dynamorph, name)(**contracts.calls()[name][1])
    if name == "Simulation":
        contracts.run_on(made)
    result = getattr(made, member)
    before = numbers(result)
    del made
    gc.collect()
    junk = [np.full(size, 7.0) for size in (3, 30, 300, 3000) for _ in range(50)]  # in memory that was freed
    assert numbers(result) == before
    del junk


def numbers(result: object) -> bytes:
    """All numbers in a result."""
    if isinstance(result, (list, tuple)):
        return b"".join(map(numbers, result))
    if type(result).__module__.startswith("dynamorph") and not hasattr(type(result), "__members__"):
        members = [name for name, value in vars(type(result)).items() if isinstance(value, property)]
        return b"".join(numbers(getattr(result, name)) for name in members)
    return np.asarray(result).tobytes() if isinstance(result, (np.ndarray, float, int)) else repr(result).encode()


# Calls from within a call, and from other threads ---------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["full", "reduced"])
@pytest.mark.parametrize("change", ["advance", "start", "state", "balance_targets", "solve_static"])
def test_a_simulation_is_not_changed_by_its_own_callback(kind, change):
    s = contracts.scene()
    steps, refusals = (
        {
            "advance": lambda simulation: simulation.advance(s.next[None], s.weights[None]),
            "start": lambda simulation: simulation.start(s.bones, s.next, s.weights),
            "state": lambda simulation: setattr(simulation, "state", simulation.state),
            "balance_targets": lambda simulation: simulation.balance_targets(np.repeat(s.bones[None], 2, 0)),
            "solve_static": lambda simulation: simulation.solve_static(s.bones, s.weights),
        },
        [],
    )

    def meddling() -> bool:
        assert np.isfinite(simulation.coordinates).all()  # to read it is allowed
        try:
            steps[change](simulation)
        except ValueError as error:
            refusals.append(str(error))
        return True

    model = getattr(s, kind)
    simulation, alone = dynamorph.Simulation(model, 0.01, keep_going=meddling), dynamorph.Simulation(model, 0.01)
    for each in (simulation, alone):
        each.start(s.bones, s.next, s.weights)
        each.advance(s.next[None], s.weights[None])
    assert refusals and set(refusals) == {"keep_going: must not change the simulation that calls it"}
    assert np.array_equal(simulation.coordinates, alone.coordinates)
    simulation.advance(s.next[None], s.weights[None])  # it goes on


def test_threads_that_share_one_do_not_race():
    """They take turns: what is read meanwhile is the state after a whole call, and all calls are made."""
    shared, alone = contracts.started(), contracts.started()
    s = contracts.scene()
    step = s.next[None], s.weights[None]
    states = [alone.coordinates]
    for _ in range(20):
        alone.advance(*step)
        states.append(alone.coordinates)
    threads = [threading.Thread(target=lambda: [shared.advance(*step) for _ in range(5)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        seen = shared.coordinates
        assert any(np.array_equal(seen, state) for state in states)
    assert np.array_equal(shared.coordinates, states[-1])
