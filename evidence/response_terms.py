# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the error of bone responses is: the table of docs/decisions/0004.

    python evidence/response_terms.py Cow

Cow: any name of accuracy.SUBJECTS, after one click. The unreduced motion is projected to the coordinates. There the
forces of the reduced model are compared with the exact ones, and the terms that it lacks are added one after the other.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import accuracy_shots as shots
import dynamic_morph_targets
import numpy as np
from accuracy import RESPONSES, SUBJECTS
from contact_sheet import quiet
from dynamic_morph_targets.core.motion import simulate
from motion_error import errors

DETAIL = 120
EVERY = 2  # frames, of the motion whose forces are compared
SMALL, LARGE = 1e-3, 0.05  # steps of differences, in units of the motion: exact for a cubic force but for round-off
WEIGHT = np.ones(1)  # of the only target


def main() -> int:
    subject = SUBJECTS[sys.argv[1]]
    dynamic_morph_targets.register()
    with quiet():
        shot = shots.one_click_shots(subject)[0]
    table = {}
    for material_model in ("STABLE_STVK", "LINEAR"):
        character = shot.character.with_settings(material_model=material_model)
        full, reduced = solve(shot, character)
        mass = np.asarray(full.model.soft_body(character.probed).volumes).sum(axis=1)
        table[f"error, {material_model}"] = errors(reduced.motion, full.motion, mass, {}, full.dynamic)["error"]
        if material_model == "STABLE_STVK":
            table |= compare_forces(full, reduced, mass)
    for name, value in table.items():
        print(f"{name}: {value:.1%}", flush=True)
    return 0


def solve(shot: shots.Shot, character) -> tuple[shots.Solved, shots.Solved]:
    """The shot without reduction, and with responses."""
    unreduced = simulate.build_for(character.with_settings(solver="FULL"), shot.rig, shot.settings)
    settings = shots.row_settings(character.settings, RESPONSES, DETAIL)
    model = simulate.build_for(replace(character, settings=settings), shot.rig, shot.settings, previous=unreduced)
    full, reduced = (shots.solve(each, shot) for each in (unreduced, model))
    return full, reduced


def compare_forces(full: shots.Solved, reduced: shots.Solved, mass: np.ndarray) -> dict[str, float]:
    """RMS over frames of static displacements of what forces lack, as parts of the motion's; norms by mass."""
    basis = np.array([reduced.nodes(unit).ravel() for unit in np.eye(reduced.engine.dofs)]).T
    weighted = np.repeat(mass, 3)[:, None] ** 0.5 * basis
    motion = full.motion.reshape(len(full.frames), -1)
    target = (motion * np.repeat(mass, 3) ** 0.5).T
    found = np.linalg.lstsq(weighted, target, rcond=None)[0].T
    rest = target - target.mean(axis=1, keepdims=True)
    left = rest - weighted @ np.linalg.lstsq(weighted, rest, rcond=None)[0]
    tabulated = reduced.model.summary.tabulated
    stiffness = basis.T @ (full.engine.linearize(WEIGHT, np.zeros(full.engine.dofs))[2] @ basis)
    squares: dict[str, float] = defaultdict(float)
    for coordinates in found[::EVERY]:
        squares["motion"] += float(np.sum((weighted @ coordinates) ** 2))
        for name, force in lacking(full, reduced, basis, stiffness, tabulated, coordinates):
            squares[name] += float(np.sum((weighted @ np.linalg.solve(stiffness, force)) ** 2))
    whole = squares.pop("motion")
    best = float(np.linalg.norm(left) / np.linalg.norm(rest))
    return {"best in these coordinates": best} | {name: (sum_ / whole) ** 0.5 for name, sum_ in squares.items()}


def lacking(full, reduced, basis, stiffness, tabulated: int, q: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """(what is taken into account, the exact force at coordinates q less that) with more and more terms."""

    def force(nodes: np.ndarray) -> np.ndarray:
        return basis.T @ full.engine.linearize(WEIGHT, nodes)[1]

    def quadratic(a, b):
        """The second derivative of the force in directions a and b."""
        h = SMALL
        return (force(h * (a + b)) - force(h * (a - b)) - force(h * (b - a)) + force(-h * (a + b))) / (4 * h * h)

    def cubic(a):
        """The part of the force along a that is cubic in it."""
        h = LARGE
        return (force(2 * h * a) - 2 * force(h * a) + 2 * force(-h * a) - force(-2 * h * a)) / (12 * h**3)

    low, high = np.r_[q[:tabulated], 0 * q[tabulated:]], np.r_[0 * q[:tabulated], q[tabulated:]]
    z, y = basis @ low, basis @ high
    exact = force(z + y)
    yield "no nonlinear force", exact - stiffness @ q
    left = exact - reduced.engine.linearize(WEIGHT, q)[1]
    yield "the reduced model", left
    twice_y = quadratic(y, y) / 2
    left = left - np.r_[twice_y[:tabulated], quadratic(z, y)[tabulated:]]
    yield "and z y y", left
    left = left - np.r_[0 * twice_y[:tabulated], twice_y[tabulated:]]
    yield "and y y y", left
    mixed = (cubic(z + y) - cubic(z - y)) / 2 - cubic(y)  # the part with z twice and y once
    yield "and z z z y", left - np.r_[mixed[:tabulated], cubic(z)[tabulated:]]


if __name__ == "__main__":
    sys.exit(main())
