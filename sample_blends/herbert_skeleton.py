# SPDX-License-Identifier: GPL-3.0-or-later
"""Herbert's kinematics: what an animator gives, and the turns of the bones that follow. NumPy only.

Armature space, meters: Z is up, he faces -Y, his left is +X. A *turn* is a bone's rotation relative to its parent and
to rest, about the armature's axes. The center of mass is led along a path and the legs reach for the ground below it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

SIDES = ("l", "r")
KNEES = 0.22  # how far apart the knees point
SPINE = ("spine_01", "spine_02", "spine_03")
# The body's mass as a share for each bone; the rest is massless.
MASSES = {"pelvis": 0.14, "spine_01": 0.13, "spine_02": 0.12, "spine_03": 0.13, "head": 0.12} | {
    f"{bone}_{side}": share
    for bone, share in (("thigh", 0.085), ("calf", 0.04), ("foot", 0.018), ("upperarm", 0.02), ("lowerarm", 0.013),
                        ("hand", 0.008))
    for side in SIDES
}  # fmt: skip
THICKNESS = 0.11  # meters, radius of gyration of a part by itself
SHARES = np.array(list(MASSES.values())) / sum(MASSES.values())


# --- Curves -----------------------------------------------------------------------------------------------------------


def ease(t):
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def curve(times: np.ndarray, *keys: tuple) -> np.ndarray:
    """Keys (time, value) joined smoothly and without overshoot, constant outside: (F,) or (F, C)."""
    at = np.array([key[0] for key in keys], float)
    values = np.array([key[1] for key in keys], float)
    shape = values.shape[1:]
    values = values.reshape(len(at), -1)
    steps = np.diff(at)[:, None]
    slopes = np.diff(values, axis=0) / steps
    tangents = np.zeros_like(values)
    same_way = slopes[1:] * slopes[:-1] > 0  # extremes are flat
    mean = 2 * slopes[1:] * slopes[:-1] / np.where(same_way, slopes[1:] + slopes[:-1], 1)
    tangents[1:-1] = np.where(same_way, mean, 0)
    t = np.clip(times, at[0], at[-1])
    k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2)
    h = steps[k]
    u = (t[:, None] - at[k][:, None]) / h
    out = values[k] * (1 + 2 * u) * (1 - u) ** 2 + values[k + 1] * u * u * (3 - 2 * u)
    out += h * (tangents[k] * u * (1 - u) ** 2 - tangents[k + 1] * u * u * (1 - u))
    return out.reshape(len(times), *shape)


def about(axis: int | np.ndarray, degrees) -> np.ndarray:
    """Rotations (..., 3, 3) about a coordinate axis, or about a unit vector."""
    axis = np.eye(3)[axis] if isinstance(axis, int) else axis
    angle = np.radians(np.asarray(degrees, float))[..., None, None]
    cross = np.cross(np.eye(3), axis)  # rows e_i x axis: the matrix of axis x
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def swing(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotations (..., 3, 3) that carry directions to directions."""
    half = unit(unit(start) + unit(end))
    flip = 2 * half[..., :, None] * half[..., None, :] - np.eye(3)
    mirror = 2 * unit(start)[..., :, None] * unit(start)[..., None, :] - np.eye(3)
    return flip @ mirror


def apply(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("...ij,...j->...i", rotations, vectors)


def frames_of(direction: np.ndarray, pole: np.ndarray) -> np.ndarray:
    """Orthonormal frames (..., 3, 3): first axis along a limb, second toward the side its joint points to."""
    direction = unit(direction)
    pole = unit(pole - (pole * direction).sum(-1, keepdims=True) * direction)
    return np.stack([direction, pole, np.cross(direction, pole)], axis=-1)


def bend(root: np.ndarray, target: np.ndarray, pole: np.ndarray, first: float, second: float) -> np.ndarray:
    """Where the joint of a two-part limb is: (..., 3). A target out of reach is approached along the straight limb."""
    reach = target - root
    distance = np.clip(np.linalg.norm(reach, axis=-1, keepdims=True), abs(first - second) + 1e-3, first + second - 1e-3)
    axes = frames_of(reach, pole)
    along = (distance**2 + first**2 - second**2) / (2 * distance)
    return root + along * axes[..., 0] + np.sqrt(np.maximum(first**2 - along**2, 0)) * axes[..., 1]


# --- The skeleton -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Skeleton:
    """Bones at rest, parents before children: name -> head and tail (3,), and the parent's name or ''."""

    heads: dict[str, np.ndarray]
    tails: dict[str, np.ndarray]
    parents: dict[str, str]

    def pose(self, turns: dict[str, np.ndarray], pelvis: np.ndarray) -> tuple[dict, dict]:
        """(rotations (F, 3, 3), heads (F, 3)) of every bone from its turns and the pelvis's place (F, 3)."""
        rotations, heads = {}, {}
        for bone, parent in self.parents.items():
            if not parent:
                rotations[bone], heads[bone] = turns[bone], pelvis
                continue
            heads[bone] = heads[parent] + rotations[parent] @ (self.heads[bone] - self.heads[parent])
            rotations[bone] = rotations[parent] @ turns[bone] if bone in turns else rotations[parent]
        return rotations, heads

    def mass_points(self, rotations: dict, heads: dict) -> np.ndarray:
        """The middles of the bones that have mass: (M, F, 3)."""
        return np.array([heads[b] + rotations[b] @ ((self.tails[b] - self.heads[b]) / 2) for b in MASSES])

    def center_of_mass(self, rotations: dict, heads: dict) -> np.ndarray:
        return np.tensordot(SHARES, self.mass_points(rotations, heads), 1)

    def inertia(self, rotations: dict, heads: dict) -> np.ndarray:
        """Moment of inertia (F,) about the left-right axis through the center of mass, for a body of unit mass."""
        points = self.mass_points(rotations, heads)
        apart = (points - np.tensordot(SHARES, points, 1))[..., 1:]
        return SHARES @ ((apart**2).sum(-1) + THICKNESS**2)

    def length(self, bone: str, child: str) -> float:
        return float(np.linalg.norm(self.heads[child] - self.heads[bone]))

    def leg(self) -> float:
        return self.length("thigh_l", "calf_l") + self.length("calf_l", "foot_l")

    def standing(self) -> float:
        """Height of the center of mass above the soles when he stands, never quite straight."""
        still = {bone: np.eye(3)[None] for bone in self.parents}
        return float(self.center_of_mass(*self.pose(still, self.heads["pelvis"][None]))[0, 2]) - 0.015


@dataclass
class Motion:
    """What the animator gives, over F frames. Degrees; a leading 2 is left and right.

    center (F, 3) of mass; (F,): pitch, roll and yaw of the pelvis; spine, bent forward in all; twist of the chest; nods
    of the head. arms (2, F, 3): raised forward, raised outward, elbow; curl (F,) of the fingers.
    feet (2, F, 3): ball of the foot on the ground, and foot_pitch (2, F): heel up. grounded (2, F): 1 where the foot
    keeps to the ground, 0 where it hangs from the hip by the vector ankles (2, F, 3), pointed by toes (F,).
    knees (F,): how far apart they point. grip (F,): how much the hands go to hands (2, F, 3), or to the shins.
    """

    times: np.ndarray
    center: np.ndarray
    feet: np.ndarray
    foot_pitch: np.ndarray
    pitch: np.ndarray = 0.0
    roll: np.ndarray = 0.0
    yaw: np.ndarray = 0.0
    spine: np.ndarray = 0.0
    twist: np.ndarray = 0.0
    head: np.ndarray = 0.0
    arms: np.ndarray = field(default_factory=lambda: np.zeros((2, 1, 3)))
    grounded: np.ndarray = 1.0
    ankles: np.ndarray = 0.0
    toes: np.ndarray = 0.0
    knees: np.ndarray = KNEES
    hands: np.ndarray | None = None
    grip: np.ndarray = 0.0
    curl: np.ndarray = 25.0

    def __post_init__(self):
        count = len(self.times)
        for name in ("pitch", "roll", "yaw", "spine", "twist", "head", "toes", "knees", "grip", "curl"):
            setattr(self, name, np.broadcast_to(np.asarray(getattr(self, name), float), count))
        self.grounded = np.broadcast_to(np.asarray(self.grounded, float), (2, count))
        self.ankles = np.broadcast_to(np.asarray(self.ankles, float), (2, count, 3))
        self.arms = np.broadcast_to(self.arms, (2, count, 3))


def solve(skeleton: Skeleton, motion: Motion) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Turns (F, 3, 3) of the bones that move, and the pelvis's place (F, 3), so that the center of mass is led."""
    turns = {"pelvis": about(0, motion.pitch) @ about(1, motion.roll) @ about(2, motion.yaw)}
    turns |= {bone: about(0, motion.spine / 3) @ about(2, motion.twist / 3) for bone in SPINE}
    turns |= {"neck_01": about(0, motion.head / 2), "head": about(0, motion.head / 2) @ about(2, -motion.twist / 2)}
    for side, arm in zip(SIDES, motion.arms, strict=True):
        turns |= arm_turns(skeleton, side, *arm.T) | finger_turns(skeleton, side, motion.curl)
    pelvis = motion.center.copy()
    for _ in range(8):
        for k, side in enumerate(SIDES):
            turns |= leg_turns(skeleton, side, k, motion, *skeleton.pose(turns, pelvis))
            turns |= reach_turns(skeleton, side, k, motion, *skeleton.pose(turns, pelvis))
        pelvis = pelvis + motion.center - skeleton.center_of_mass(*skeleton.pose(turns, pelvis))
    return turns, pelvis


def arm_turns(skeleton: Skeleton, side: str, forward, outward, elbow) -> dict[str, np.ndarray]:
    """The arm hangs at 0; the elbow bends forward."""
    upper, lower, hand = (f"{bone}_{side}" for bone in ("upperarm", "lowerarm", "hand"))
    hang = swing(skeleton.heads[hand] - skeleton.heads[upper], np.array([0, 0, -1.0]))
    out = about(1, -outward if side == "l" else outward)
    return {upper: about(0, -forward) @ out @ hang, lower: hang.T @ about(0, -elbow) @ hang}


def finger_turns(skeleton: Skeleton, side: str, curl) -> dict[str, np.ndarray]:
    wrist, index, pinky = (skeleton.heads[f"{bone}_{side}"] for bone in ("hand", "index_01", "pinky_01"))
    palm = unit(np.cross(index - wrist, pinky - wrist)) * (-1 if side == "l" else 1)
    axis = unit(np.cross((index + pinky) / 2 - wrist, palm))
    fingers = [bone for bone in skeleton.parents if bone.split("_")[0] in ("index", "middle", "ring", "pinky")]
    return {bone: about(axis, curl) for bone in fingers if bone.endswith(side)}


def leg_turns(skeleton: Skeleton, side: str, k: int, motion: Motion, rotations: dict, heads: dict) -> dict:
    """Thigh, calf, foot and toes such that the foot is where the motion wants it; the knee points ahead."""
    thigh, calf, foot, ball = (f"{bone}_{side}" for bone in ("thigh", "calf", "foot", "ball"))
    rest = skeleton.heads
    pelvis, hip = rotations["pelvis"], heads[thigh]
    flat = about(0, motion.foot_pitch[k])
    standing = motion.feet[k] + flat @ (rest[foot] - rest[ball] * [1, 1, 0])
    grounded = motion.grounded[k][:, None]
    ankle = grounded * standing + (1 - grounded) * (hip + apply(pelvis, motion.ankles[k]))
    angle = motion.grounded[k] * motion.foot_pitch[k] + (1 - motion.grounded[k]) * (motion.pitch + motion.toes)
    out = np.array([1.0 if side == "l" else -1.0, 0, 0])
    ahead = apply(pelvis, motion.knees[:, None] * out + [0, -1.0, 0])
    knee = bend(hip, ankle, ahead, skeleton.length(thigh, calf), skeleton.length(calf, foot))
    limbs = rest[calf] - rest[thigh], rest[foot] - rest[calf]
    rest_axes = [frames_of(limb, KNEES * out + [0, -1.0, 0]) for limb in limbs]
    pole = knee - (hip + ankle) / 2 + 1e-3 * ahead
    upper = frames_of(knee - hip, pole) @ rest_axes[0].T
    lower = frames_of(ankle - knee, pole) @ rest_axes[1].T
    level = about(0, angle)
    return {
        thigh: pelvis.swapaxes(1, 2) @ upper,
        calf: upper.swapaxes(1, 2) @ lower,
        foot: lower.swapaxes(1, 2) @ level,
        ball: about(0, -motion.grounded[k] * np.maximum(motion.foot_pitch[k], 0)),
    }


def reach_turns(skeleton: Skeleton, side: str, k: int, motion: Motion, rotations: dict, heads: dict) -> dict:
    """Bends the arm so that the hand goes to the motion's place, or to the shin, by the weight of the grip."""
    upper, lower, hand, clavicle = (f"{bone}_{side}" for bone in ("upperarm", "lowerarm", "hand", "clavicle"))
    if not motion.grip.any():
        return {}
    parent = rotations[clavicle].swapaxes(1, 2)
    free = arm_turns(skeleton, side, *motion.arms[k].T)
    posed = rotations[clavicle] @ free[upper]
    rest = skeleton.heads
    elbow = heads[upper] + posed @ (rest[lower] - rest[upper])
    wrist = elbow + posed @ free[lower] @ (rest[hand] - rest[lower])
    place = motion.hands[k] if motion.hands is not None else shin(skeleton, side, rotations, heads)
    grip = motion.grip[:, None]
    target = wrist + grip * (place - wrist)
    pole = elbow - (heads[upper] + wrist) / 2 + 1e-3 * apply(rotations[clavicle], np.array([0, 1.0, 0]))
    new = bend(heads[upper], target, pole, skeleton.length(upper, lower), skeleton.length(lower, hand))
    above = swing(elbow - heads[upper], new - heads[upper]) @ posed
    straight = above @ free[lower]
    below = swing(straight @ (rest[hand] - rest[lower]), target - new) @ straight
    return {upper: parent @ above, lower: above.swapaxes(1, 2) @ below}


def shin(skeleton: Skeleton, side: str, rotations: dict, heads: dict) -> np.ndarray:
    """Where a hand holds the tucked leg: before and outside the middle of the shin."""
    calf = f"calf_{side}"
    along = skeleton.heads[f"foot_{side}"] - skeleton.heads[calf]
    out = np.array([0.09 if side == "l" else -0.09, -0.06, 0])
    return heads[calf] + rotations[calf] @ (0.62 * along + out)
