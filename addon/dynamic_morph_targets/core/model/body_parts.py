# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a body is soft by nature: its chest, belly, glutes, thighs, upper arms and cheeks.

Only upper arms and thighs are found by the names of bones, in whatever rig. The trunk is what hangs on neither of them
nor on a head, and a height in it counts from the hips, 0, to the shoulders, 1. NumPy only, never bpy.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..character import Skeleton
from ..geometry import diagonal, smooth_step, vertex_areas
from . import rigid

CHEST, BELLY, GLUTES, THIGHS, UPPER_ARMS, CHEEKS = "Chest", "Belly", "Glutes", "Thighs", "Upper Arms", "Cheeks"
PARTS = (CHEST, BELLY, GLUTES, THIGHS, UPPER_ARMS, CHEEKS)
LEAST = 0.0005  # of the skin's area; a part that has less is not there
STICK = 0.01  # of the body's size: radius of a limb that is bone alone
FAMILIES = {"def", "org", "bip", "j", "cc", "c", "base", "valve", "skeleton"}  # words of rigs, not of bodies
SIDES = {"l": 1, "left": 1, "左": 1, "r": -1, "right": -1, "右": -1}
# What means nothing else, and what may also mean the part below it, so that only the topmost such bone counts.
UPPER_ARM = re.compile(r"upper ?arm|up ?arm|shldr|腕"), re.compile(r"arm( |$)")
PIECE = re.compile(r"twist|stretch|bend|roll")  # of a limb that has several bones
THIGH = re.compile(r"thigh|upper ?leg|up ?leg|足(?!首|先)"), re.compile(r"leg( |$)")
# Where each part begins and has all its weight, has less, and ends: along the limb from its first joint, 0, to its
# second, 1, or as heights in the trunk.
ALONG_LIMB = (0.05, 0.25, 0.8, 0.98)
HEIGHTS = {CHEST: (0.5, 0.62, 0.92, 1.05), BELLY: (-0.05, 0.1, 0.45, 0.58), GLUTES: (-0.32, -0.2, 0.1, 0.24)}
TO_END = (0.45, 0.95)  # of an upper arm's or a thigh's length from its second joint: where hand or foot begins
FACING = (-0.1, 0.35)  # of half of the trunk's depth from its middle, forward, or back for the glutes
CHEEK, CHEEK_SIZE = (0.6, 0.5, -0.36), (0.6, 0.6, 0.5)  # its middle and radii in the head's box: left, front, up


@dataclass(frozen=True)
class Limb:
    """side: 1 left, -1 right; bones (B,) bool: it, and what hangs on it; lower (B,): what hangs on its second joint;
    joints (2, 3): where it begins and bends.
    """

    side: int
    bones: np.ndarray
    lower: np.ndarray
    joints: np.ndarray


@dataclass(frozen=True)
class RiggedSkin:
    """bone_heads (B, 3) and points (V, 3): bind space; triangles (T, 3); weights (V, B + 1)."""

    skeleton: Skeleton
    bone_heads: np.ndarray
    points: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray

    @cached_property
    def areas(self) -> np.ndarray:
        return vertex_areas(self.points, self.triangles)

    @cached_property
    def described(self) -> list[tuple[str, int]]:
        """`_described` of each bone's name."""
        return [_described(name) for name in self.skeleton.names]

    @cached_property
    def carried(self) -> np.ndarray:
        """The area (B,) of the skin on each bone and on those below it."""
        return self.skeleton.below @ (self.weights.T @ self.areas)[:-1]

    def on(self, bones: np.ndarray) -> np.ndarray:
        """The share (V,) of the skin that bones (B,) bool carry."""
        return self.weights @ np.append(bones, 0.0)  # of all columns, which needs no copy

    @cached_property
    def arms(self) -> list[Limb]:
        """The left upper arm and the right one, or none."""
        return self._limbs(UPPER_ARM)

    @cached_property
    def legs(self) -> list[Limb]:
        """The same of the thighs."""
        return self._limbs(THIGH)

    def _limbs(self, kinds: Sequence[re.Pattern[str]]) -> list[Limb]:
        below, described, carried = self.skeleton.below, self.described, self.carried
        for kind in kinds:
            named = np.array([bool(side and kind.match(words)) for words, side in described], bool)
            topmost = named & ~(below[named].sum(axis=0) > named)
            if kind is not kinds[0]:
                named &= topmost | [bool(PIECE.search(words)) for words, _ in described]
            best = []
            for side in (1, -1):
                bones = [bone for bone in np.flatnonzero(topmost) if described[bone][1] == side]
                limbs = [limb for bone in bones if (limb := self._limb(bone, side, named, carried))]
                best += [max(limbs, key=lambda limb: carried[limb.bones].max())] if limbs else []
            if len(best) == 2:
                return best
        return []

    def _limb(self, bone: int, side: int, named: np.ndarray, carried: np.ndarray) -> Limb | None:
        """A limb that begins with this bone. It bends where what carries most of those that are named otherwise
        begins.
        """
        below, heads = self.skeleton.below, self.bone_heads
        others = [other for other in np.flatnonzero(below[bone] & ~named) if named[self.skeleton.parents[other]]]
        others = [other for other in others if (heads[other] != heads[bone]).any()]
        if not others:
            return None
        bends = max(others, key=lambda other: (carried[other], below[other].sum()))
        return Limb(side, below[bone], below[bends], heads[[bone, bends]])


def find(skin: RiggedSkin, of_head: np.ndarray) -> dict[str, np.ndarray]:
    """The parts of PARTS that a body has, and how much each vertex belongs to each (V,), 0 to 1. of_head (V,): see
    `rigid.head_rigidity`.
    """
    found, arms, legs = {}, skin.arms, skin.legs
    for name, limbs in ((UPPER_ARMS, arms), (THIGHS, legs)):
        if limbs and _radius(limbs, skin) > STICK * diagonal(skin.points):
            found[name] = sum(_between_joints(limb, skin.points) * skin.on(limb.bones) for limb in limbs)
    if arms and legs:
        of_legs = skin.on(np.any([limb.bones for limb in legs], axis=0))
        of_arms = skin.on(np.any([limb.bones for limb in arms], axis=0))
        trunk = (1.0 - of_arms - of_legs - of_head - skin.weights[:, -1]).clip(0.0)
        found |= _of_trunk(_upright(arms, legs, skin.points), trunk, trunk + of_legs, of_head)
    whole = skin.areas.sum()
    return {name: found[name] for name in PARTS if name in found and found[name] @ skin.areas > LEAST * whole}


def limb_ends(skin: RiggedSkin) -> np.ndarray:
    """How much (V,) of a skin belongs to hands and feet: less along forearms and shins."""
    out = np.zeros(len(skin.points))
    for limb in (*skin.arms, *skin.legs):
        length = np.linalg.norm(limb.joints[1] - limb.joints[0])
        away = np.linalg.norm(skin.points - limb.joints[1], axis=1) / length
        out += smooth_step(away, *TO_END) * skin.on(limb.lower)
    return out


def _described(name: str) -> tuple[str, int]:
    """The words of a bone's name without those of its family of rigs, and its side: 1 left, -1 right, 0 neither."""
    words: list[str] = []
    side = 0
    for word in rigid.WORD.findall(re.sub("[左右]", r" \g<0> ", name.rpartition(":")[2])):
        word = word.lower()
        if not side and word in SIDES:
            side = SIDES[word]
        elif words or not (word in FAMILIES or word.isdigit()):
            words.append(word)
    return " ".join(words), side


def _along(limb: Limb, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far (V,) along a limb points are, 0 to 1 between its joints, and their distances (V,) from its line."""
    axis = limb.joints[1] - limb.joints[0]
    off = points - limb.joints[0]
    along = off @ axis / (axis @ axis)
    return along, np.linalg.norm(off - along[:, None] * axis, axis=1)


def _within(x: np.ndarray, ends: Sequence[float]) -> np.ndarray:
    begins, full, less, over = ends
    return smooth_step(x, begins, full) * (1.0 - smooth_step(x, less, over))


def _between_joints(limb: Limb, points: np.ndarray) -> np.ndarray:
    return _within(_along(limb, points)[0], ALONG_LIMB)


def _radius(limbs: list[Limb], skin: RiggedSkin) -> float:
    """The mean distance of the skin of limbs from their lines, meters; 0 without skin."""
    shares = [skin.areas * _between_joints(limb, skin.points) * skin.on(limb.bones) for limb in limbs]
    away = [_along(limb, skin.points)[1] for limb in limbs]
    return float(np.vdot(shares, away) / max(np.sum(shares), 1e-300))


def _upright(arms: list[Limb], legs: list[Limb], points: np.ndarray) -> np.ndarray:
    """Points (V, 3) as the body has them: to its left, forward, and up from the hips, 0, to the shoulders, 1."""
    hips, shoulders = (np.mean([limb.joints[0] for limb in limbs], axis=0) for limbs in (legs, arms))
    up = shoulders - hips
    height = np.linalg.norm(up)
    up = up / max(height, 1e-300)
    left = np.sum([limb.side * limb.joints[0] for limb in (*arms, *legs)], axis=0)
    left = left - left @ up * up
    left = left / max(np.linalg.norm(left), 1e-300)
    return (points - hips) @ np.column_stack([left, np.cross(left, up), up]) / max(height, 1e-300)


def _of_trunk(
    points: np.ndarray, trunk: np.ndarray, with_legs: np.ndarray, of_head: np.ndarray
) -> dict[str, np.ndarray]:
    """The parts of trunk and head. points (V, 3): `_upright`; the others (V,): the skin's shares."""
    found, height = {}, points[:, 2]
    inner = (trunk > 0.5) & (height > 0.0) & (height < 1.0)
    if inner.any():
        back, front = np.quantile(points[inner, 1], [0.02, 0.98])
        forward = (2.0 * points[:, 1] - back - front) / max(front - back, 1e-300)
        for name, sign, skin in ((CHEST, 1, trunk), (BELLY, 1, trunk), (GLUTES, -1, with_legs)):
            found[name] = skin * _within(height, HEIGHTS[name]) * smooth_step(sign * forward, *FACING)
    inner = of_head >= 1.0
    if inner.any():
        low, high = np.quantile(points[inner], [0.01, 0.99], axis=0)
        place = (2.0 * points - low - high) / np.maximum(high - low, 1e-300)
        place[:, 0] = np.abs(place[:, 0])
        away = np.linalg.norm((place - CHEEK) / CHEEK_SIZE, axis=1)
        found[CHEEKS] = of_head * (1.0 - smooth_step(away, 0.6, 1.2))
    return found
