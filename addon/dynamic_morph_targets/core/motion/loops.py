# SPDX-License-Identifier: GPL-3.0-or-later
"""A cycle whose last frame continues with its first: finds the start from which it ends as it began. Never touches
bpy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .keyed import KeyedSettings
from .player import NO_STEPS, Frame, Player, changed, first_frame
from .rig_samples import RigSamples

CLOSED = 1e-6  # body sizes; a loop whose gap is smaller is closed
SAME_POSE = 1e-3  # body sizes; poses whose skins differ less after a rigid motion are the same
PASSES = 400  # passes of a loop, at most
ACCELERATED = 40  # passes with Anderson's method
REMEMBERED = 12  # passes that are combined into the next start
PLAIN, KRYLOV = 5, 20  # passes of Newton's method: to approach the solution, and at most to find a step


def cycle(player: Player, rig: RigSamples) -> tuple[list[Frame], float]:
    """The frames of a loop, and its largest gap in meters where it begins again and a frame later.

    Passes over its range are repeated until one ends as it began: in position and, by the frame after, in velocity.
    """
    loop = Loop(player, rig)
    if not repeat_accelerated(loop) and pose_gap(player, rig) <= SAME_POSE * player.size:  # otherwise it cannot close
        solve_by_newton(loop)
    return loop.frames, loop.gap


class Loop:
    """One pass over the range of a loop, as a map from its start to its end: coordinates (4, dofs) then and at the last
    three steps before. The result of the pass that closed best is kept: frames and gap, as for `cycle`.
    """

    def __init__(self, player: Player, rig: RigSamples):
        self._player, self._rig = player, rig
        self._first = player.begin(rig)
        self._start = player.state
        self.began: np.ndarray = np.array(self._start.coordinates)
        self.off = np.zeros(0)  # how the last pass failed to close
        self.frames: list[Frame] = []
        self.gap = np.inf

    @property
    def is_closed(self) -> bool:
        return self.gap <= CLOSED * self._player.size or self._player.engine is None

    @property
    def passes(self) -> int:
        return self._player.passes

    def __call__(self, began: np.ndarray) -> np.ndarray:
        player, rig, settings = self._player, self._rig, self._player.settings
        numbers = settings.simulated[1:]
        player.state, player.number = changed(self._start, coordinates=list(began)), settings.frame_start
        first = self._first
        if player.passes:
            dents = first.coordinates[began.shape[1] :]  # they have no past
            first = replace(first, coordinates=np.append(began[0], dents))
        frames = [first, *player.play(rig[1:], numbers)]
        ended = np.array(player.state.coordinates)
        self._first = begin_again(player, rig, frames[-1])
        self._start = player.state
        next_frame = rig[1 : 1 + settings.substeps], numbers[:1]  # a range of one frame has none
        again = [frames[-1], *player.play(*next_frame)]
        pairs = list(zip(frames[:: settings.samples], again[:: settings.samples], strict=False))
        gap = max(player.gap(*pair) for pair in pairs)
        self.off = np.concatenate([after.coordinates - before.coordinates for before, after in pairs])
        if gap < self.gap or not self.frames:
            self.frames, self.gap = frames, gap
        return ended


def repeat_accelerated(loop: Loop) -> bool:
    """Call `loop` until it ends as it began; False when that takes too many passes, or leads to values that
    are not finite.

    Anderson's acceleration of repeated passes: the next one begins where the last ones, combined by weights that sum
    to one, would have ended as they began, in the least squares sense.

    For a linear law that is exact once there are as many passes as directions of error (Walker and Ni 2011, Anderson
    acceleration for fixed-point iterations).
    """
    began = loop.began
    passes: list[tuple[np.ndarray, np.ndarray]] = []
    while loop.passes < ACCELERATED:
        ended = loop(began)
        if loop.is_closed:
            return True
        if not np.isfinite(loop.off).all():
            return False
        best = min((np.linalg.norm(off) for _, off in passes), default=np.inf)
        if not np.linalg.norm(loop.off) < 10.0 * best:  # far from linear, so earlier passes do not help
            passes.clear()
        passes = [*passes[1 - REMEMBERED :], (ended, loop.off)]
        ends, offs = (np.array(part) for part in zip(*passes, strict=True))
        weights, *_ = np.linalg.lstsq((offs[:-1] - loop.off).T, -loop.off, rcond=1e-9)
        began = ended + np.tensordot(weights, ends[:-1] - ended, 1)
    return False


def solve_by_newton(loop: Loop) -> None:
    """Call `loop` until it ends as it began, or until that is given up.

    Newton's method for the fixed point of a pass. Its tangent is only ever multiplied, by a pass with a slightly
    different start (Knoll and Keyes 2004, Jacobian-free Newton-Krylov methods).

    Tissue so soft that one pass does not predict the next closes by it. Plain passes precede it, and replace steps that
    do not help.
    """
    began, ended = loop.began, loop.began
    plain = PLAIN
    while loop.passes < PASSES - PLAIN - KRYLOV - 2:
        for _ in range(plain):
            began, ended = ended, loop(ended)
            if not np.isfinite(loop.off).all():
                return
        off = np.linalg.norm(ended - began)
        if loop.is_closed or not 0.0 < off < np.inf:
            return
        step, plain = _newton_step(loop, began, ended), PLAIN
        for fraction in (1.0, 0.5):
            trial = began + fraction * step
            after = loop(trial)
            if np.linalg.norm(after - trial) < (1.0 - 0.3 * fraction) * off:
                began, ended, plain = trial, after, 0
                break
        if loop.is_closed:
            return


def _newton_step(loop: Loop, began: np.ndarray, ended: np.ndarray) -> np.ndarray:
    """What to add to `began`, by GMRES (Saad and Schultz 1986): the least squares solution, to a tenth, in the space
    that passes from nearby span.
    """
    residual = (ended - began).ravel()
    size = np.linalg.norm(residual)
    nearby = 1e-4 * max(np.linalg.norm(began), size)
    basis, hessenberg = [residual / size], np.zeros((KRYLOV + 1, KRYLOV))
    for j in range(KRYLOV):
        changed = (loop(began + nearby * basis[j].reshape(began.shape)) - ended).ravel() / nearby
        image = basis[j] - changed
        for i, vector in enumerate(basis):
            hessenberg[i, j] = vector @ image
            image = image - hessenberg[i, j] * vector
        hessenberg[j + 1, j] = np.linalg.norm(image)
        goal = size * np.eye(j + 2)[0]
        weights, *_ = np.linalg.lstsq(hessenberg[: j + 2, : j + 1], goal, rcond=None)
        if np.linalg.norm(hessenberg[: j + 2, : j + 1] @ weights - goal) < 0.1 * size:
            break
        basis.append(image / max(hessenberg[j + 1, j], 1e-300))
    return (weights @ np.array(basis[: len(weights)])).reshape(began.shape)


def loop_warnings(player: Player, rig: RigSamples, gap: float) -> list[str]:
    first, last = player.settings.frame_start, player.settings.frame_end
    off = pose_gap(player, rig)
    if off > SAME_POSE * player.size:
        return [
            f"The rig at frame {last} is {1000 * off:.3g} mm off its pose at frame {first}: end the loop where that "
            "pose comes back, or turn Loop off"
        ]
    keyed = rig.track(KeyedSettings)
    if keyed and not np.allclose(keyed.values[0], keyed.values[-1], rtol=1e-3):
        return [f"Settings that are keyed have other values at frame {last} than at frame {first}: key them alike"]
    if gap > CLOSED * player.size:
        return [f"The loop is not closed after {player.passes} passes: raise the targets' damping, or make it longer"]
    return []


def begin_again(player: Player, rig: RigSamples, frame: Frame) -> Frame:
    """Lets it go back from `frame`, the last of a cycle, to the first, with the soft skin in its present motion. The
    distance that the rig has traveled is removed from its past.
    """
    first, last = _ends(player, rig)
    turn, shift = _rigid_fit(last, first)
    state = player.state
    moved = [turn @ past.reshape(-1, 3, 4) for past in state.bones]
    for past in moved:
        past[:, :, 3] += shift
    bones = [past.reshape(-1, 12) for past in moved]
    player.state = changed(state, bones=bones, contact=np.zeros(0))  # what is touched in the first frame is found again
    player.number, player.passes = player.settings.frame_start, player.passes + 1
    return first_frame(player, rig, frame.coordinates, player.posing.posed(rig[:1])[1][0], NO_STEPS)


def pose_gap(player: Player, rig: RigSamples) -> float:
    """The largest distance, in meters, of the skin of the last pose from that of the first, after a rigid motion."""
    first, last = _ends(player, rig)
    turn, shift = _rigid_fit(last, first)
    return float(np.linalg.norm(last @ turn.T + shift - first, axis=1).max(initial=0.0))


def _ends(player: Player, rig: RigSamples) -> np.ndarray:
    """The skin at rest, posed by the first sample and by the last: (2, V, 3), world space."""
    return player.posing.skinned(rig[:: max(1, len(rig) - 1)])[[0, -1]]


def _rigid_fit(points: np.ndarray, onto: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation (3, 3) and translation (3,) that bring points (V, 3) nearest to others."""
    if not len(points):
        return np.eye(3), np.zeros(3)
    center, goal = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - goal).T @ (points - center))
    turn = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return turn, goal - turn @ center
