# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses and sculpted shapes of the shoulder: bulging muscles, and soft tissue that makes room where it would be cut."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from shoulder_mesh import BONES, CHEST, FOREARM, UPPERARM, Bust, along_arm, hinge, neighbor_average, rotation
from stage import bump, smoothstep

UP = np.array([0, 0, 1.0])
FORWARD = np.array([0, -1.0, 0])  # turning about it raises the left arm sideways

HALF, FOLDED = 60.0, 110.0  # degrees of fold beyond the rest pose, whose elbow is bent by 22
ELBOW_GAP, ARMPIT_GAP = 0.0015, 0.0025  # meters from the skin to the plane between its two sides
CREASE = 0.012  # meters from the middle of the crook within which that gap narrows
SEAM = 0.2  # skin whose weight is nearer to even than this is the armpit's own fold, on neither side
ROUNDS, SPREAD = 60, 20  # of pushing, and of averaging over neighbors after each


@dataclass(frozen=True)
class Pose:
    """Degrees: how far the clavicle and the upper arm are raised sideways, the upper arm turned outward about
    itself, and the elbow folded."""

    clavicle: float = 0.0
    raised: float = 0.0
    turned: float = 0.0
    fold: float = 0.0

    def part_of_the_way(self, progress: float) -> Pose:
        return Pose(*(progress * angle for angle in astuple(self)))

    def turns(self, joints) -> list[np.ndarray]:
        """Rotations (3, 3) of BONES, each relative to its parent, in the axes of the rest pose."""
        twist = rotation(direction(joints["upperarm"], joints["forearm"]), -np.radians(self.turned))
        return [
            np.eye(3),
            rotation(FORWARD, np.radians(self.clavicle)),
            rotation(FORWARD, np.radians(self.raised)) @ twist,
            rotation(hinge(joints), np.radians(self.fold)),
        ]

    def transforms(self, joints) -> np.ndarray:
        """(4, 3, 4): how each of BONES moves space."""
        linear, offset, out = np.eye(3), np.zeros(3), []
        for turn, bone in zip(self.turns(joints), BONES, strict=True):
            head = joints[bone]
            offset = linear @ (head - turn @ head) + offset
            linear = linear @ turn
            out.append(np.column_stack([linear, offset]))
        return np.array(out)


REST = Pose()
RAISED = Pose(clavicle=14, raised=38, turned=60)
LOWERED = Pose(clavicle=-4, raised=-30, turned=25)


def skin(transforms: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(V, 3, 4): how each vertex moves."""
    return np.einsum("vb,bij->vij", weights, transforms)


def moved(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.einsum("...ij,...j->...i", transforms[..., :3], points) + transforms[..., 3]


# --- Where is what ----------------------------------------------------------------------------------------------------


def softness(bust: Bust) -> np.ndarray:
    """(V,): 0 at the cuts and on the hand, 1 in between."""
    return smoothstep((bust.to_cut - 0.035) / 0.08) * smoothstep(1 - 1.25 * bust.hand)


def elbow_region(bust: Bust) -> np.ndarray:
    """(V,): 1 around the elbow, biceps and thick half of the forearm included, 0 at the shoulder and the wrist."""
    along = along_arm(bust.vertices, bust.joints)
    arm = bust.weights[:, UPPERARM:].sum(axis=1)
    return smoothstep((along + 0.23) / 0.10) * smoothstep((0.23 - along) / 0.09) * smoothstep(2 * arm - 1)


# --- Shapes -----------------------------------------------------------------------------------------------------------


def grown(bust: Bust, **amounts: float) -> np.ndarray:
    """MakeHuman's muscles, each grown by an amount, (V, 3); nothing moves at the cuts and the hand."""
    shape = sum(amount * bust.muscles[name] for name, amount in amounts.items())
    return shape * softness(bust)[:, None]


def lumps(bust: Bust, *parts: tuple[float, float, float, float, float]) -> np.ndarray:
    """Lumps on the arm, (V, 3): (inward, sideways, meters along the arm, width along, height).

    (1, 0) is the inside of the fold, (-1, 0) the elbow's tip, (0, +-1) its two sides.
    """
    joints, along = bust.joints, along_arm(bust.vertices, bust.joints)
    side = hinge(joints)
    axis = limb_axis(bust)
    from_elbow = bust.vertices - joints["forearm"]
    outward = from_elbow - np.einsum("vi,vi->v", from_elbow, axis)[:, None] * axis
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    inside, sideways = np.einsum("vi,vi->v", np.cross(side, axis), outward), outward @ side
    height = sum(
        h * bump(along, center, width) * np.exp((inside * i + sideways * s - 1) / 0.5)
        for i, s, center, width, h in parts
    )
    return outward * (height * elbow_region(bust))[:, None]


def limb_axis(bust: Bust) -> np.ndarray:
    """(V, 3): along the upper arm or the forearm, whichever is nearer; fades to nothing on the torso."""
    shoulder, elbow, hand = (bust.joints[name] for name in ("upperarm", "forearm", "hand_l"))
    above = along_arm(bust.vertices, bust.joints)[:, None] < 0
    arm = bust.weights[:, UPPERARM:].sum(axis=1, keepdims=True)
    return arm * np.where(above, direction(shoulder, elbow), direction(elbow, hand))


def direction(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    return (end - start) / np.linalg.norm(end - start)


# --- Room where skin meets skin ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parting:
    """How the skin is kept apart in one pose: gradient . displacement + distance >= needed, for each vertex.

    gradient (V, 3) and distance (V,) from a plane, positive on the vertex's own side; way (V, 3): where the skin gives
    way; needed (V,), -inf where it does not matter; target_weights (J,): the weights of the shapes in this pose.
    """

    gradient: np.ndarray
    way: np.ndarray
    distance: np.ndarray
    needed: np.ndarray
    target_weights: np.ndarray


def part(bust: Bust, pose: Pose, point, normal, side: np.ndarray, needed: np.ndarray, target_weights) -> Parting:
    """Keep the vertices of positive `side` in front of the plane, the others behind it.

    Skin gives way into the limb: along it, it would pile up.
    """
    maps = skin(pose.transforms(bust.joints), bust.weights)
    sign = np.sign(side)
    gradient = np.einsum("v,i,vij->vj", sign, normal, maps[..., :3])
    axis = limb_axis(bust)
    way = gradient - 0.8 * np.einsum("vi,vi->v", gradient, axis)[:, None] * axis
    return Parting(gradient, way, sign * ((moved(maps, bust.vertices) - point) @ normal), needed, target_weights)


def elbow_partings(bust: Bust, angles: tuple[float, ...]) -> list[Parting]:
    """Upper arm and forearm, on their sides of the plane that halves the fold, all along the fold.

    Between targets at `angles` their shapes blend linearly, what must be cleared does not: so it must be looked at
    everywhere, not only at the targets.
    """
    joints, along = bust.joints, along_arm(bust.vertices, bust.joints)
    needed = np.where(elbow_region(bust) > 0, ELBOW_GAP * np.minimum(abs(along) / CREASE, 1.0), -np.inf)
    out = []
    for angle in np.arange(10.0, angles[-1] + 1, 4.0):
        pose = Pose(fold=angle)
        hand = moved(pose.transforms(joints)[FOREARM], joints["hand_l"])
        normal = direction(joints["upperarm"], joints["forearm"]) + direction(joints["forearm"], hand)
        normal /= np.linalg.norm(normal)
        target_weights = [np.interp(angle, (0.0, *angles), hat) for hat in np.eye(len(angles) + 1)[1:]]
        out.append(part(bust, pose, joints["forearm"], normal, along, needed, np.array(target_weights)))
    return out


def armpit_partings(bust: Bust, lowered: Pose) -> list[Parting]:
    """Arm and flank, on their sides of a plane down from the armpit, as the arm comes down to `lowered`."""
    arm = bust.weights[:, UPPERARM:].sum(axis=1) - 0.5
    seam = np.flatnonzero(abs(arm) < 0.1)
    armpit = bust.vertices[seam[np.argsort(bust.vertices[seam, 2])[:8]]].mean(axis=0)
    out = []
    for progress in np.linspace(0.3, 1.0, 8):
        pose = lowered.part_of_the_way(progress)
        transforms = pose.transforms(bust.joints)
        apex = moved(0.5 * transforms[CHEST] + 0.5 * transforms[UPPERARM], armpit)
        hanging = transforms[UPPERARM][:, :3] @ direction(bust.joints["upperarm"], bust.joints["forearm"])
        down = hanging - UP
        normal = np.array([-down[2], 0.0, down[0]]) / np.hypot(down[0], down[2])
        posed = moved(skin(transforms, bust.weights), bust.vertices)
        below = smoothstep((apex[2] - posed[:, 2]) / 0.02)
        needed = np.where((below > 0) & (abs(arm) > SEAM), ARMPIT_GAP * below, -np.inf)
        out.append(part(bust, pose, apex, normal, arm, needed, np.array([progress])))
    return out


def make_room(bust: Bust, shapes: list[np.ndarray], partings: list[Parting], free: np.ndarray) -> list[np.ndarray]:
    """Change shapes (V, 3) where `free` (V,) is not 0 until every parting holds.

    What is pushed takes its neighbors along, a little further round after round: so the skin that makes room has
    round edges.
    """
    shapes = np.array(shapes)
    average = neighbor_average(bust.faces, len(free))
    for _ in range(ROUNDS):
        pushed = shapes.copy()
        for parting in partings:
            push_apart(parting, pushed, 1.3)
        push = pushed - shapes
        for _ in range(SPREAD):
            push = free[:, None] * np.array([average @ p for p in push])
        shapes += 0.4 * push
    for parting in partings * 5:  # what is left
        push_apart(parting, shapes, 1.0)
    return list(shapes)


def push_apart(parting: Parting, shapes: np.ndarray, loose: float) -> None:
    """Moves each vertex of the shapes (J, V, 3) the shortest way to `loose` times the distance it needs."""
    gradient, way, target_weights = parting.gradient, parting.way, parting.target_weights
    now = parting.distance + np.einsum("vi,vi->v", gradient, np.tensordot(target_weights, shapes, 1))
    step = np.maximum(loose * parting.needed - now, 0) / np.einsum("vi,vi->v", gradient, way)
    shapes += np.einsum("j,v,vi->jvi", target_weights / (target_weights @ target_weights), step, way)


# --- Targets ----------------------------------------------------------------------------------------------------------


def shoulder_shapes(bust: Bust) -> dict[str, np.ndarray]:
    """Arm raised: the deltoid gathers. Arm lowered: chest and flank bulge, and make room for the arm."""
    lowered = grown(bust, pectoral=0.6, dorsi=0.35)
    (lowered,) = make_room(bust, [lowered], armpit_partings(bust, LOWERED), softness(bust))
    return {"Arm raised": grown(bust, deltoid=0.8, dorsi=0.5, pectoral=-0.15), "Arm lowered": lowered}


def elbow_shapes(bust: Bust) -> dict[str, np.ndarray]:
    """Half fold and Folded: the biceps bulges, the forearm's soft tissue goes sideways, the crook keeps clear of
    itself.
    """
    half = lumps(
        bust,
        (1, 0, -0.12, 0.05, 0.012),
        (-1, 0, 0.0, 0.045, 0.007),
        (0, 1, 0.05, 0.05, 0.003), (0, -1, 0.05, 0.05, 0.003),
    )  # fmt: skip
    folded = lumps(
        bust,
        (1, 0, -0.135, 0.06, 0.018),
        (0.7, 0.7, -0.11, 0.05, 0.008), (0.7, -0.7, -0.11, 0.05, 0.008),
        (-1, 0, -0.12, 0.06, 0.006),
        (-1, 0, 0.0, 0.045, 0.015),
        (0, 1, -0.03, 0.05, 0.008), (0, -1, -0.03, 0.05, 0.008),
        (0, 1, 0.06, 0.05, 0.008), (0, -1, 0.06, 0.05, 0.008),
    )  # fmt: skip
    angles = (HALF, FOLDED)
    shapes = make_room(bust, [half, folded], elbow_partings(bust, angles), elbow_region(bust))
    return dict(zip(("Half fold", "Folded"), shapes, strict=True))
