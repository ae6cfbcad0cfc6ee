# SPDX-License-Identifier: GPL-3.0-or-later
"""A motion that goes on in a model of other modes. Never touches bpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .player import Frame, Player, State, changed


def _is_possible(before: Player, after: Player) -> bool:
    """For reduced models of the same cage and bones, with the same steps, without collision; the first sample of nodes
    that Blender poses belongs to the poses of the targets then.
    """
    mine, its = after.model, before.model
    if not (mine.settings.solver == its.settings.solver == "REDUCED" and mine.modes.size and its.modes.size):
        return False
    if after.collision or before.collision or after.probed or before.probed:
        return False
    steps = [(player.settings.step, player.settings.substeps) for player in (before, after)]
    names = [(player.model.bone_names, len(player.character.targets)) for player in (before, after)]
    same = (np.array_equal(getattr(mine, name), getattr(its, name)) for name in ("nodes", "tets", "pinned"))
    return steps[0] == steps[1] and names[0] == names[1] and all(same)


def hand_over(before: Player, state: State, frame: Frame, after: Player) -> Frame | None:
    """Let `after` go on from a state of `before` and its frame: with the nearest displacements, in the metric of the
    volume, that its modes have. Its motion limit remembers nothing. Returns the frame as they have it, or None where
    only a new beginning is possible.
    """
    if before.first is None or not _is_possible(before, after):
        return None
    weighted = np.repeat(after.model.soft_body().volumes.sum(axis=1), 3)[:, None] * after.model.modes
    into = np.linalg.solve(weighted.T @ after.model.modes, weighted.T @ before.model.modes)
    after.number, after.passes = int(frame.number), before.passes
    coordinates = [into @ past for past in state.coordinates]
    after.resume(before.first, changed(state, coordinates=coordinates, limit=np.zeros(0)))
    return replace(frame, coordinates=after.coordinates)
