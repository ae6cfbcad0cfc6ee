# SPDX-License-Identifier: GPL-3.0-or-later
"""What Herbert does: a dive from a springboard, and a run into a wall. NumPy only.

Meters, seconds and degrees; `s` is the distance forward. Of a shot every frame is computed, from keys (time, value).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from herbert_skeleton import KNEES, Motion, Skeleton, curve, ease, solve

FPS = 24
GRAVITY = 9.81

# --- The dive's keys --------------------------------------------------------------------------------------------------

BOARD_HEIGHT = 3.0  # above the water
BOARD_LENGTH = 3.4  # free length; the tip is at s = 0
STEPS = (0.55, 1.03, 1.51)  # when a foot leaves the board
HURDLE, LANDING, TAKE_OFF, ENTRY, DIVE = 2.125, 2.5, 3.0, 4.375, 5.25
TUCKED = (3.6, 3.92)
TURN = 528.0  # of the somersault: a flip and a half less the lean at take-off
HOP_SPEED = 1.75  # forward, from the hurdle to the tip
JUMP_FROM, JUMP_SPEED = -0.06, (1.35, 4.5)  # s of the center of mass; forward and up, m/s

DIVE_KEYS = {
    "pitch": ((0, 0), (0.4, -3), (0.8, 3), (1.6, 5), (2.0, 12), (2.3, 2), (LANDING, 3), (2.72, 16), (TAKE_OFF, 12)),
    "spine": ((0, -2), (0.4, -7), (0.8, -1), (1.7, 2), (2.0, 9), (2.3, -8), (LANDING, 0), (2.72, 20), (TAKE_OFF, -4),
              (3.25, 2), (3.6, 78), (3.92, 78), (4.2, -4)),
    "head": ((0, 0), (0.4, -8), (0.8, 4), (1.6, 14), (2.0, 10), (2.3, 4), (2.72, -14), (TAKE_OFF, -4), (3.2, 5),
             (3.6, 42), (3.92, 38), (4.2, -8)),
    "toes": ((2.1, 35), (2.42, 20), (TAKE_OFF, 62), (3.3, 60), (3.6, 35), (3.95, 35), (4.2, 65)),
    "knees": ((3.3, KNEES), (3.6, 0.75), (3.92, 0.75), (4.16, KNEES)),
    "grip": ((3.36, 0), (3.58, 1), (3.92, 1), (4.06, 0)),
    "curl": ((0, 18), (3.3, 12), (3.55, 30), (3.95, 30), (4.1, 4)),
}  # fmt: skip
# Arms as (raised forward, raised outward, elbow).
STROLL = ((0.95, (24, 12, 22)), (1.43, (-22, 12, 10)))  # the right arm; the left one swings the other way
DIVE_ARMS = (
    (1.8, (-30, 16, 8)), (2.0, (-48, 20, 10)), (2.3, (150, 24, 12)), (LANDING, (140, 40, 14)), (2.68, (-40, 26, 8)),
    (TAKE_OFF, (165, 10, 6)), (3.2, (172, 8, 4)), (3.5, (75, 12, 60)), (3.95, (75, 12, 60)), (4.18, (178, 1, 0)),
)  # fmt: skip
# Contacts of the ball of a foot: (down, up, s).
DIVE_CONTACTS = (
    ((0, STEPS[0], -2.55), (0.98, STEPS[2], -2.06), (1.92, HURDLE, -1.06), (LANDING, 99, -0.05)),
    ((0, STEPS[1], -2.55), (1.46, 2.0, -1.54), (LANDING, 99, -0.05)),
)
IN_THE_AIR = ((2.4, 0), (LANDING, 1), (TAKE_OFF, 1), (3.13, 0))
GROUNDED = (((HURDLE, 1), (2.225, 0), *IN_THE_AIR), ((1.98, 1), (2.1, 0), *IN_THE_AIR))
# Ankles from the hips, in shares of the leg for the straight leg.
PUSHED, KNEE_UP, TRAILING = (0, 0.05, -0.82), (0, -0.23, -0.74), (0, 0.14, -0.92)
READY, STRAIGHT, TUCK = (0, -0.06, -0.93), (0, 0.03, -1.0), (0.12, -0.17, -0.23)


# --- The wall's keys --------------------------------------------------------------------------------------------------

WALL = 6.3  # s of the wall, from where the run starts
RUN, IMPACT, WALL_SHOT = 0.42, 2.0, 3.75
SPEED = 4.2  # m/s, stopped within a frame
STRIDE = 0.23  # seconds a step
STOP = WALL - 0.5  # s of the center of mass when the hands are on the wall
REBOUND = 0.62  # meters

WALL_KEYS = {
    "pitch": ((0, 0), (0.28, -6), (0.52, 18), (1.2, 10), (1.85, 4), (IMPACT, -2), (2.12, 3), (2.4, -15), (2.8, 5),
              (3.2, -3), (WALL_SHOT, 0)),
    "spine": ((0, 0), (0.28, -6), (0.52, 8), (1.2, 3), (1.88, -3), (IMPACT, -5), (2.12, 2), (2.4, -10), (2.8, 6),
              (WALL_SHOT, 0)),
    "head": ((0, 0), (0.28, -6), (0.52, -10), (1.85, -4), (IMPACT, -16), (2.1, 6), (2.3, -26), (2.8, 12), (3.2, -8),
             (WALL_SHOT, 2)),
    "grip": ((1.9, 0), (IMPACT, 1), (2.12, 1), (2.25, 0)),
    "curl": ((0, 18), (RUN, 55), (1.8, 55), (1.96, -4), (2.3, 10), (WALL_SHOT, 20)),
}  # fmt: skip
WALL_ARMS = ((2.12, (78, 22, 70)), (2.45, (48, 62, 30)), (2.95, (10, 42, 18)), (WALL_SHOT, (2, 16, 16)))
CROUCH = ((0, 0), (0.28, -0.07), (0.52, -0.035), (IMPACT, -0.03), (2.15, -0.06), (2.5, -0.02), (2.9, -0.05),
          (WALL_SHOT, 0))  # fmt: skip
# After the last running step the left foot stands until 2.40; both stagger back.
STAGGER = (
    ((2.64, 2.98, STOP - 0.42), (3.2, 99, STOP - 0.56)),
    ((2.06, 2.24, STOP - 0.10), (2.48, 2.72, STOP - 0.50), (2.95, 99, STOP - 0.56)),
)


# --- Parts ------------------------------------------------------------------------------------------------------------


def walk(times, contacts: Sequence[tuple[float, float, float]], lift: float, heel: float) -> tuple[np.ndarray, ...]:
    """One foot's ball: s (F,), height (F,) and heel pitch (F,), from contacts (down, up, s) and swings between."""
    s, height, pitch = np.full(len(times), contacts[0][2]), np.zeros(len(times)), np.zeros(len(times))
    for (_, up, start), (down, _, end) in pairwise(contacts):
        u = np.clip((times - up) / (down - up), 0, 1)
        s += (end - start) * ease(u)
        height += lift * np.sin(np.pi * u) ** 1.5
        raised = ease((times - up + 0.12) / 0.14)  # the heel leaves before the ball does
        pitch += heel * raised * (1 - ease(u * 1.25))
    return s, height, pitch


def foot(side: int, s, height) -> np.ndarray:
    """Places (F, 3) of a foot: side 0 is the left."""
    return np.stack([np.full_like(s, -0.08 if side else 0.08), -s, height], 1)


def sway(times, size, start, begin, end):
    """A sine at the pace of the walk, that lasts from `begin` to `end`."""
    pace = 2 * (STEPS[1] - STEPS[0])
    wave = size * np.sin(2 * np.pi * (times - start) / pace)
    return wave * ease((times - begin) / 0.3) * ease((end + 0.2 - times) / 0.3)


def flight(times, start: float, place, speed) -> np.ndarray:
    """Ballistic path (F, 2) of (s, z)."""
    t = np.asarray(times - start)[..., None]
    return place + np.multiply(speed, t) - [0, GRAVITY / 2] * t * t


def passage(times, start: float, end: float, places, speeds) -> np.ndarray:
    """A cubic path (F, 2) between two places with given speeds there."""
    h = end - start
    u = np.clip((times - start) / h, 0, 1)[:, None]
    (a, b), (va, vb) = np.array(places), np.array(speeds)
    path = a * (1 + 2 * u) * (1 - u) ** 2 + b * u * u * (3 - 2 * u)
    return path + h * (va * u * (1 - u) ** 2 - vb * u * u * (1 - u))


# --- The dive ---------------------------------------------------------------------------------------------------------


def board_bend(s, tip):
    """Height of the board at s when its tip is `tip` above level: a cantilever loaded at the tip."""
    u = np.clip(1 + np.asarray(s) / BOARD_LENGTH, 0, None)
    return tip * u * u * (3 - u) / 2


def board_tip(times) -> np.ndarray:
    """Height (F,) of the board's tip over time: it nods with the steps, takes the landing, throws, and rings."""
    nods = zip(STEPS, (0.01, 0.02, 0.03), strict=True)
    nod = sum(depth * np.exp(-(((times - t - 0.2) / 0.12) ** 2)) for t, depth in nods)
    u = np.clip((times - LANDING) / (TAKE_OFF - LANDING), 0, 1)
    dip = 0.34 * np.sin(np.pi * u**0.85) ** 2
    after = np.clip(times - TAKE_OFF, 0, None)
    ring = 0.13 * np.exp(-2.6 * after) * np.sin(2 * np.pi * 3.6 * after)
    return ring - nod - dip


def jump(times, standing: float) -> np.ndarray:
    """The flight to the water, (F, 2), above the board's height."""
    return flight(times, TAKE_OFF, (JUMP_FROM, standing + 0.06), JUMP_SPEED)


def dive_center(times, standing: float) -> np.ndarray:
    """Path (F, 2) of the center of mass, (s, z) above the board's height; `standing` is its height when he stands."""
    crouch = 1.75
    rise = GRAVITY * (LANDING - HURDLE) / 2
    hop = flight(times, HURDLE, (-1.02, standing), (HOP_SPEED, rise))
    landed = (-1.02 + HOP_SPEED * (LANDING - HURDLE), standing)
    walking = np.stack([
        curve(times, (0, -2.62), (0.5, -2.60), (0.9, -2.36), (1.8, -1.42), (2.0, -1.2)),
        standing - 0.02 * ease((times - 0.5) / 0.3)
        + 0.012 * np.cos(2 * np.pi * (times - STEPS[0]) / (STEPS[1] - STEPS[0])) * ease((times - 0.3) / 0.3),
    ], 1)  # fmt: skip
    start = walking[np.argmin(abs(times - crouch))]
    entry_speed = np.array(JUMP_SPEED) - [0, GRAVITY * (ENTRY - TAKE_OFF)]
    sinking = entry_speed * 0.28 * (1 - np.exp(-(times - ENTRY) / 0.28))[:, None]
    stages = (
        (0, walking),
        (crouch, passage(times, crouch, HURDLE, (start, (-1.02, standing)), ((1.05, -0.5), (HOP_SPEED, rise)))),
        (HURDLE, hop),
        (LANDING, passage(times, LANDING, TAKE_OFF, (landed, (JUMP_FROM, standing + 0.06)),
                          ((HOP_SPEED, -rise), JUMP_SPEED))),
        (TAKE_OFF, jump(times, standing)),
        (ENTRY, jump(np.array(ENTRY), standing) + sinking),
    )  # fmt: skip
    path = np.empty((len(times), 2))
    for begin, stage in stages:
        path[times >= begin - 1e-6] = stage[times >= begin - 1e-6]
    return path


def dive_feet(times) -> tuple[np.ndarray, np.ndarray]:
    """Balls of the feet (2, F, 3) on the moving board, and heel pitches (2, F)."""
    feet, pitches = [], []
    for side, contacts in enumerate(DIVE_CONTACTS):
        s, height, pitch = walk(times, contacts, 0.10, 38)
        feet.append(foot(side, s, BOARD_HEIGHT + height + board_bend(s, board_tip(times))))
        pitches.append(pitch + curve(times, (2.8, 0), (TAKE_OFF, 62), (3.1, 62)))
    return np.array(feet), np.array(pitches)


def dive_ankles(times, leg: float) -> np.ndarray:
    """Ankles from the hips (2, F, 3) while they are in the air; the right knee is driven up in the hurdle."""
    ankles = []
    for hurdle, out in ((TRAILING, 1), (KNEE_UP, -1)):
        keys = (2.05, PUSHED), (2.3, hurdle), (2.44, READY), (3.2, STRAIGHT), *((t, TUCK) for t in TUCKED), \
            (4.16, STRAIGHT)  # fmt: skip
        ankles.append(leg * curve(times, *keys) * [out, 1, 1])
    return np.array(ankles)


def dive_arms(times) -> np.ndarray:
    rest = (0, 14, 18)
    start = (0.0, rest), (0.35, (-12, 20, 10)), (0.55, rest)
    other = [(t, (-forward, out, elbow)) for t, (forward, out, elbow) in STROLL]
    return np.array([curve(times, *start, *stroll, *DIVE_ARMS) for stroll in (other, STROLL)])


def somersault(skeleton: Skeleton, motion: Motion) -> np.ndarray:
    """Degrees (F,) turned in flight: angular momentum is kept, so he spins fast while he is small."""
    inertia = skeleton.inertia(*skeleton.pose(*solve(skeleton, motion)))
    flying = (motion.times >= TAKE_OFF) & (motion.times <= ENTRY)
    rate = np.where(flying, 1 / inertia, 0)
    turned = np.concatenate([[0], np.cumsum((rate[1:] + rate[:-1]) / 2)])
    return TURN * turned / turned[-1]


def dive(skeleton: Skeleton) -> Motion:
    times = np.arange(round(DIVE * FPS) + 1) / FPS
    path = dive_center(times, skeleton.standing())
    feet, pitches = dive_feet(times)
    yaw = sway(times, 7.0, STEPS[0] - 0.24, 0.5, 1.8)
    motion = Motion(
        times,
        center=np.stack([np.zeros_like(times), -path[:, 0], BOARD_HEIGHT + path[:, 1]], 1),
        feet=feet,
        foot_pitch=pitches,
        roll=sway(times, 3.0, STEPS[0], 0.5, 1.8),
        yaw=yaw,
        twist=-2 * yaw,
        arms=dive_arms(times),
        grounded=np.array([curve(times, *keys) for keys in GROUNDED]),
        ankles=dive_ankles(times, skeleton.leg()),
        **{channel: curve(times, *keys) for channel, keys in DIVE_KEYS.items()},
    )
    motion.pitch = motion.pitch + somersault(skeleton, motion)
    return motion


# --- The wall ---------------------------------------------------------------------------------------------------------


def run_path(times) -> np.ndarray:
    """s (F,): from a stand to full speed in 0.4 s, dead at the wall, then back."""
    go = np.clip(times - RUN, 0, None)
    run = SPEED * np.where(go < 0.4, go * go / 0.8, go - 0.2)
    back = np.clip(times - IMPACT - 2.5 / FPS, 0, None)
    rebound = -REBOUND * (1 - np.exp(-back / 0.32))
    at_impact = SPEED * (IMPACT - RUN - 0.2)
    return STOP - at_impact + np.where(times < IMPACT - 1e-6, run, at_impact + rebound)


def run_feet(times, s, downs) -> tuple[np.ndarray, np.ndarray]:
    """Balls of the feet (2, F, 3) and heel pitches (2, F): running steps at `downs`, left first, then the stagger."""
    feet, pitches = [], []
    for side, stagger in enumerate(STAGGER):
        own = downs[side::2]
        contacts = [(t, t + 0.15, float(np.interp(t + 0.07, times, s)) + 0.09) for t in own]
        contacts.insert(0, (0, own[0] - 0.16, 0.06))
        if side == 0:
            contacts[-1] = (own[-1], 2.40, STOP + 0.12)
        along, height, pitch = walk(times, [*contacts, *stagger], 0.2, 55)
        height[times > IMPACT] *= 0.45
        feet.append(foot(side, along, height))
        pitches.append(pitch)
    return np.array(feet), np.array(pitches)


def run_arms(times, swing, going, flail) -> np.ndarray:
    """Pumping in the run, up before the wall, rowing for balance after it."""
    hit = ease((times - IMPACT + 0.17) / 0.15)[:, None]
    tracks = []
    for sign in (-1, 1):
        pumping = np.stack([sign * 52 * swing + 8 * going, 12 + 4 * going, 18 + 72 * going], 1)
        rowing = curve(times, *WALL_ARMS) + np.stack([30 * sign * flail, 18 * flail, 0 * flail], 1)
        tracks.append(pumping * (1 - hit) + rowing * hit)
    return np.array(tracks)


def wall(skeleton: Skeleton) -> Motion:
    times = np.arange(round(WALL_SHOT * FPS) + 1) / FPS
    s = run_path(times)
    downs = IMPACT - 0.06 - STRIDE * np.arange(7)[::-1]
    phase = np.pi * (times - downs[0]) / STRIDE
    going = ease((times - RUN) / 0.25) * (times <= IMPACT)
    dizzy = np.clip(times - IMPACT - 0.25, 0, None)
    flail = np.exp(-0.8 * dizzy) * np.sin(2 * np.pi * 1.5 * dizzy)
    height = skeleton.standing() - 0.02 + 0.014 * np.sin(2 * (phase - 0.1 * np.pi)) * going + curve(times, *CROUCH)
    feet, pitches = run_feet(times, s, downs)
    palms = np.array([(0.30, 0.13 - WALL, 1.27), (-0.30, 0.13 - WALL, 1.27)])
    return Motion(
        times,
        center=np.stack([np.zeros_like(s), -s, height], 1),
        feet=feet,
        foot_pitch=pitches,
        yaw=9 * np.sin(phase) * going,
        twist=-20 * np.sin(phase) * going + 8 * flail,
        roll=4 * np.sin(phase + 0.4) * going + 7 * flail,
        arms=run_arms(times, np.sin(phase - 0.3) * going, going, flail),
        hands=np.repeat(palms[:, None], len(times), axis=1),
        **{channel: curve(times, *keys) for channel, keys in WALL_KEYS.items()},
    )


SHOTS: dict[str, Callable[[Skeleton], Motion]] = {"Dive": dive, "Wall": wall}
