# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain data that the modules pass to each other. NumPy only, never bpy.

`extract` fills these from a Blender scene, `build` and `simulate` consume them, `sinks` writes the result back.

Spaces: *local* is the mesh object's own space (what shape keys store), *bind* is local space with the object's scale
applied, so lengths are metres there, *world* is Blender's world space in metres (`extract.unit_scale`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np


def determinant(matrices: np.ndarray) -> np.ndarray:
    """Determinants (...) of 3 x 3 matrices (..., 3, 3).

    Written out, like `inverse`, because LAPACK wakes its threads for each matrix of a stack: on a busy machine that
    takes seconds for a shot.
    """
    return np.einsum("...i,...i", matrices[..., 0, :], np.cross(matrices[..., 1, :], matrices[..., 2, :]))


def inverse(transforms: np.ndarray) -> np.ndarray:
    """Inverses of linear (..., 3, 3) or affine (..., 4, 4) transforms, which must not be singular."""
    linear = transforms[..., :3, :3]
    next_rows, last_rows = linear[..., [1, 2, 0], :], linear[..., [2, 0, 1], :]
    cofactors = next_rows[..., [1, 2, 0]] * last_rows[..., [2, 0, 1]]
    cofactors -= next_rows[..., [2, 0, 1]] * last_rows[..., [1, 2, 0]]
    determinants = np.einsum("...i,...i", linear[..., 0, :], cofactors[..., 0, :])
    back = cofactors.swapaxes(-1, -2) / determinants[..., None, None]
    if transforms.shape[-1] == 3:
        return back
    out = np.zeros_like(transforms)
    out[..., :3, :3] = back
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", back, transforms[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def turned(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angle (B,), in radians, between the rotations of two arrays of transforms (B, 4, 4)."""

    def rotation(transforms):
        u, _, vt = np.linalg.svd(transforms[:, :3, :3])
        return u @ vt

    # From the chord, because the arc cosine of the trace loses small angles.
    chord = np.linalg.norm(rotation(first) - rotation(second), axis=(1, 2)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))


@dataclass(frozen=True)
class Skeleton:
    """The armature at rest: B bones, parents before children.

    names (B,), parents (B,) index or -1, rest (B, 4, 4) = bone.matrix_local, armature space.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    rest: np.ndarray

    @cached_property
    def rest_inverse(self) -> np.ndarray:
        """(B, 4, 4)."""
        return inverse(self.rest)

    def local_transforms(self, pose: np.ndarray, bones: np.ndarray | None = None) -> np.ndarray:
        """Each bone's transform relative to its evaluated parent, rest removed: identity in the rest pose.

        pose (..., B, 4, 4): evaluated pose_bone.matrix, armature space. bones: indices of those that are asked for, all
        by default; the others get the identity. Returns (..., B, 4, 4).
        Uses the evaluated matrices, so constraints and IK count.
        """
        asked = np.arange(len(self.rest)) if bones is None else np.array(bones, int)
        unposed = np.broadcast_to(self.rest[asked], (*pose.shape[:-3], len(asked), 4, 4)).copy()
        child = self.parents[asked] >= 0
        parent = self.parents[asked[child]]
        unposed[..., child, :, :] = pose[..., parent, :, :] @ (self.rest_inverse[parent] @ self.rest[asked[child]])
        local = np.broadcast_to(np.eye(4), pose.shape).copy()
        local[..., asked, :, :] = inverse(unposed) @ pose[..., asked, :, :]
        return local

    def pose(self, local: np.ndarray) -> np.ndarray:
        """The inverse of `local_transforms`: armature-space pose matrices (..., B, 4, 4) of local transforms."""
        pose = np.empty_like(local)
        for b, parent in enumerate(self.parents):
            unposed = self.rest[b] if parent < 0 else pose[..., parent, :, :] @ self.rest_inverse[parent] @ self.rest[b]
            pose[..., b, :, :] = unposed @ local[..., b, :, :]
        return pose


@dataclass(frozen=True)
class ForceField:
    """A force field of the scene at S sample times, with Blender's own falloff.

    kind: WIND blows along the object's Z axis, FORCE away from it. plane: distance is from the object's plane, not its
    origin. world (S, 4, 4); strength (S,) newtons on each square metre of skin at rest; nearest, farthest: metres,
    within which it is constant and beyond which it is nothing.
    """

    kind: str
    plane: bool
    power: float
    nearest: float
    farthest: float
    world: np.ndarray
    strength: np.ndarray

    def __getitem__(self, samples: slice) -> ForceField:
        return replace(self, world=self.world[samples], strength=self.strength[samples])

    def pull(self, sample: int, points: np.ndarray) -> np.ndarray:
        """Force on each square metre (V, 3), world space, at points (V, 3) in world space."""
        away = points - self.world[sample, :3, 3]
        axis = self.world[sample, :3, 2]
        if self.plane:
            away = np.outer(away @ axis, axis) / (axis @ axis)
        distance = np.linalg.norm(away, axis=1)
        direction = axis if self.kind == "WIND" else away
        direction = direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
        fall = (1.0 + np.maximum(distance - self.nearest, 0.0)) ** -self.power * (distance <= self.farthest)
        return self.strength[sample] * fall[:, None] * direction


@dataclass(frozen=True)
class PosedNodes:
    """n nodes of the flesh where Blender's own modifiers put them, at S sample times.

    rest (n, 3) bind space. points (S, 4, n, 3) float32, the object's space: of the nodes, and of the nodes moved by
    `reach` metres along each axis of bind space.
    """

    rest: np.ndarray
    reach: float
    points: np.ndarray

    def __getitem__(self, samples: slice) -> PosedNodes:
        return replace(self, points=self.points[samples])

    def transforms(self, object_world: np.ndarray) -> np.ndarray:
        """[A | a] (S, n, 3, 4), bind to world space; exact at rest. object_world (S, 4, 4)."""
        out = np.empty((len(self.points), len(self.rest), 3, 4))
        for points, world, frames in zip(self.points, object_world, out, strict=True):
            here, *beside = points @ world[:3, :3].T
            frames[..., 3] = here + world[:3, 3]
            for axis, moved in enumerate(beside):
                frames[..., axis] = (moved - here) / self.reach
                frames[..., 3] -= frames[..., axis] * self.rest[:, axis, None]
        return out


@dataclass(frozen=True)
class RigSamples:
    """The moving rig at S sample times: pose (S, B, 4, 4) armature space, rig_world and object_world (S, 4, 4).

    fields: what pushes the skin then. nodes: the free nodes as Blender poses them, where bones do not say it; held:
    the same (S = J) in the targets' captured poses, the objects being where they are at the first sample.
    """

    pose: np.ndarray
    rig_world: np.ndarray
    object_world: np.ndarray
    fields: tuple[ForceField, ...] = ()
    nodes: PosedNodes | None = None
    held: PosedNodes | None = None

    def __len__(self) -> int:
        return len(self.pose)

    def __getitem__(self, samples: slice) -> RigSamples:
        fields = tuple(field[samples] for field in self.fields)
        nodes = self.nodes and self.nodes[samples]
        own = (part[samples] for part in (self.pose, self.rig_world, self.object_world))
        return RigSamples(*own, fields, nodes, self.held)

    def and_then(self, other: RigSamples) -> RigSamples:
        """These samples and others of the same rig, without fields."""
        parts = zip(*((s.pose, s.rig_world, s.object_world) for s in (self, other)), strict=True)
        points = self.nodes and np.concatenate([self.nodes.points, other.nodes.points])
        nodes = self.nodes and replace(self.nodes, points=points)
        return RigSamples(*map(np.concatenate, parts), nodes=nodes, held=self.held)

    def moved(self, transforms: np.ndarray) -> RigSamples:
        """The first of these samples, moved as a whole by transforms (S, 4, 4) of the world, without fields."""
        count = len(transforms)
        pose = np.broadcast_to(self.pose[0], (count, *self.pose.shape[1:]))
        nodes = self.nodes
        if nodes:
            nodes = replace(nodes, points=np.broadcast_to(nodes.points[0], (count, *nodes.points.shape[1:])))
        own = transforms @ self.rig_world[0], transforms @ self.object_world[0]
        return RigSamples(pose, *own, nodes=nodes, held=self.held)

    @property
    def nbytes(self) -> int:
        """Bytes of what grows with the samples, about."""
        return self.pose.nbytes + (self.nodes.points.nbytes if self.nodes else 0)

    def skin_matrices(self, skeleton: Skeleton, to_bind: np.ndarray) -> np.ndarray:
        """The transforms that carry bind space to world space, one for each bone and one for the object itself.

        Returns (S, B + 1, 3, 4). The last one moves vertices without weights, as Blender's Armature modifier leaves
        those where the object puts them.
        """
        from_bind = np.eye(4)
        from_bind[:3, :3] = inverse(to_bind)
        object_from_bind = self.object_world @ from_bind
        rig_from_bind = inverse(self.rig_world) @ object_from_bind
        out = np.empty((len(self), len(skeleton.rest) + 1, 3, 4))
        out[:, :-1] = (self.rig_world[:, None, :3] @ self.pose @ skeleton.rest_inverse) @ rig_from_bind[:, None]
        out[:, -1] = object_from_bind[:, :3]
        return out


@dataclass(frozen=True)
class Material:
    """Elastic properties at one target, SI: stiffness is Young's modulus in Pa, damping is Rayleigh's."""

    stiffness: float = 2.0e4
    poisson: float = 0.4
    density: float = 1000.0
    mass_damping: float = 1.0  # alpha, 1/s
    stiffness_damping: float = 0.005  # beta, s

    def lame(self) -> tuple[float, float]:
        """Lame's lambda and mu, Pa."""
        e, nu = self.stiffness, self.poisson
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))


@dataclass(frozen=True)
class Target:
    """One dynamic morph target.

    name: the shape key's name (or "Neutral"). shape (V, 3): displacement of the vertices, local space, zero for the
    neutral. bones: names of the bones whose rotations place it in pose space. local (B, 4, 4): the captured pose of
    the whole skeleton as `Skeleton.local_transforms`; rig_world (4, 4): where the armature stood then. radius: joint
    angle from its pose, radians, at which the target has faded out; 0 for never. influence: how much of the flesh's
    motion shows in its pose, 0 to 1. frequency: Hz that a build gives its stiffness, 0 where the material says it;
    by_hand: whether the artist has set it, so that no rehearsal changes it and it does not follow the neutral target.
    """

    name: str
    shape: np.ndarray
    bones: tuple[str, ...]
    local: np.ndarray
    rig_world: np.ndarray
    material: Material
    radius: float = 0.0
    influence: float = 1.0
    frequency: float = 0.0
    by_hand: bool = False


@dataclass(frozen=True)
class TargetSet:
    """Targets whose weights sum to one; the first is the neutral. docs/theory.md, Targets.

    share (V,): how much of the flesh at each vertex follows this set; the shares of all sets sum to one.
    """

    name: str
    targets: tuple[Target, ...]
    share: np.ndarray


# What targets do to the flesh: the same names in the interface and on the command line.
METHODS = {
    "DYNAMIC": ("Dynamic", "Shape, stiffness, damping and density follow the pose"),
    "SHAPE": ("Shape", "The rest shape follows the pose, the flesh is the neutral one's everywhere"),
    "SINGLE": ("Single", "The neutral target alone: an ordinary soft body"),
    "STATIC": ("Static", "Geometric morph targets: the shape follows the pose, nothing moves by itself"),
}

# What `dynamorph report` compares: changes of ModelSettings. What they do not name stays the object's own.
VARIANTS: dict[str, dict[str, str]] = {
    "static morphs": {"method": "STATIC"},
    "pose-dependent shape": {"method": "SHAPE"},
    **{
        f"{material} {law} {solver}": {"method": method, "law": law.replace(" ", "_").upper(), "solver": solver.upper()}
        for law in ("linear", "StVK", "stable StVK")
        for solver in ("full", "reduced")
        for material, method in (("single", "SINGLE"), ("DMT", "DYNAMIC"))
    },
}


def connected_parts(elements: np.ndarray, count: int) -> np.ndarray:
    """The part (count,) that each point of a mesh of edges, triangles or tetrahedra (m, k) belongs to: the smallest
    number of its points.
    """
    part = np.arange(count)
    while True:  # each round joins parts that share an element, by their smallest points
        joined = part[elements]
        lowest = np.broadcast_to(joined.min(axis=1, keepdims=True), joined.shape)
        if np.array_equal(joined, lowest):
            return part
        np.minimum.at(part, joined, lowest)
        while not np.array_equal(part, part[part]):
            part = part[part]


WELD = 1e-6  # of a mesh's diagonal: points nearer than this are one, as imported meshes are split at every seam


def welded(points: np.ndarray) -> np.ndarray:
    """Numbers (V,), from 0, of the places of points (V, 3), which those of a split seam share."""
    size = np.linalg.norm(np.ptp(points, axis=0)) or 1.0
    cells = np.nan_to_num(np.round(points / (WELD * size)))
    cells = (cells - cells.min(axis=0, initial=np.inf)).astype(np.int64)
    rows = cells.max(axis=0, initial=0) + 1
    numbers = (cells[:, 0] * rows[1] + cells[:, 1]) * rows[2] + cells[:, 2]  # one each: rows take ten times as long
    return np.unique(numbers, return_inverse=True)[1].ravel()


def loose_parts(points: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Numbers (V,), from 0, of the parts of points (V, 3) that edges or faces (m, k) and seams connect."""
    place = welded(points)
    part = connected_parts(place[elements], place.max() + 1)
    return np.unique(part[place], return_inverse=True)[1].ravel()


# Settings that a built model does not depend on: they are applied when it is simulated.
FREE_SETTINGS = {"blending"}
ENGINE = 1  # of what is computed: raised when the same scene gives another model or another motion than before
# Settings that came later, at the value that builds what was built before: a model from then stays up to date.
LATER_SETTINGS = {
    "cage_thickness": 0.0,
    "cage_grading": 0.0,
    "separate": True,
    "hold": "BONES",
    "one_cage": False,
    "hold_head": False,
}


@dataclass(frozen=True)
class ModelSettings:
    """What a built model depends on, apart from the character itself. method: see METHODS."""

    method: str = "DYNAMIC"
    law: str = "STABLE_STVK"
    solver: str = "REDUCED"
    blending: str = "EVEN"
    modes: int = 20
    fit_to_shot: bool = False  # choose the modes from how the shot moves
    cage_nodes: int = 2000
    cage_thickness: float = 0.0  # metres that the cage stands off the skin at least
    cage_grading: float = 0.0  # 0 for tets of one size .. 1 for much finer ones where targets move the skin
    pin_radius: float = 0.4  # fraction of the way from a bone to the skin that is held by the bone
    separate: bool = True  # cut the tetrahedra that join parts of the skin that merely touch
    hold: str = "BONES"  # what holds the body: pins near the bones, or its THICKNESS, by a continuous energy
    one_cage: bool = False  # the meshes that are With Body share one cage with it, instead of being carried by its own
    hold_head: bool = False  # the skin of the head is held like something rigid; with one_cage


class OwnCage(NamedTuple):
    """The artist's cage: points (C, 3) bind space, triangles (D, 3); name: of its object."""

    name: str
    points: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True)
class Character:
    """One soft skin, as authored.

    vertices (V, 3) local space, triangles (T, 3); to_bind (3, 3): bind = to_bind @ local; weights (V, B + 1): skin
    weights as Blender normalises them, last column 1 for vertices that no bone moves; softness (V,): 1 soft, 0 held by
    the bones; stiffness (V,): factor on the targets' stiffness; bone_segments (D, 2, 3): heads and tails of the
    deforming bones, bind space. probed: Blender skins it in a way that is not linear in the bones, so the nodes'
    transforms are read from it (`RigSamples.nodes`), and the weights say only where a bone's flesh is. pieces (V,): 0
    with the body, -1 moved by the bones alone, k >= 1 in a cage of its own. cage: the artist's own, if there is one.
    rigidity (V,): 1 where the skin belongs to something hard (a head, a helmet that touches soft skin), 0 elsewhere;
    with the hold by thickness the cage is held there. painted: whether the artist painted `softness`, which then says
    alone what is held but for the core.

    With one_cage the arrays cover the vertices of several meshes: first those of the soft skin's own mesh (`own`), then
    those of `parts`. coincident (V,): the first vertex at the same place as each, which moves alike.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    to_bind: np.ndarray
    weights: np.ndarray
    softness: np.ndarray
    stiffness: np.ndarray
    bone_segments: np.ndarray
    skeleton: Skeleton
    target_sets: tuple[TargetSet, ...]
    settings: ModelSettings = field(default_factory=ModelSettings)
    probed: bool = False
    cage: OwnCage | None = None
    pieces: np.ndarray = None
    rigidity: np.ndarray = None
    painted: bool = False
    coincident: np.ndarray = None
    parts: tuple[Follower, ...] = ()

    def __post_init__(self):
        if self.pieces is None:
            object.__setattr__(self, "pieces", np.zeros(len(self.vertices), np.int32))
        if self.rigidity is None:
            object.__setattr__(self, "rigidity", np.zeros(len(self.vertices)))
        if self.coincident is None:
            object.__setattr__(self, "coincident", np.arange(len(self.vertices)))

    @property
    def own(self) -> slice:
        """Which of the vertices are those of the soft skin's own mesh."""
        return slice(0, self.parts[0].members.start if self.parts else len(self.vertices))

    @property
    def targets(self) -> list[Target]:
        """All targets, set after set: the order of every (..., J) array."""
        return [target for target_set in self.target_sets for target in target_set.targets]

    def with_settings(self, **changes) -> Character:
        """The same character, built otherwise."""
        return replace(self, settings=replace(self.settings, **changes))

    def with_materials(self, change) -> Character:
        """The same character with materials change(index, target) -> Material, index into `targets`."""
        sets, index = [], 0
        for target_set in self.target_sets:
            numbered = enumerate(target_set.targets, index)
            sets.append(replace(target_set, targets=tuple(replace(t, material=change(i, t)) for i, t in numbered)))
            index += len(target_set.targets)
        return replace(self, target_sets=tuple(sets))

    def by_method(self) -> Character:
        """The character that its method simulates: with the neutral target alone, or with the neutral's material."""
        neutral = self.target_sets[0].targets[0]
        if self.settings.method == "SINGLE":
            return replace(self, target_sets=(TargetSet(self.name, (neutral,), np.ones(len(self.vertices))),))
        if self.settings.method == "SHAPE":
            sets = tuple(
                replace(s, targets=tuple(replace(target, material=neutral.material) for target in s.targets))
                for s in self.target_sets
            )
            return replace(self, target_sets=sets)
        return self


@dataclass(frozen=True)
class SurfaceMap:
    """The nearest points of a triangle mesh to P points.

    corners (P, 3): vertices of the triangle each lies on; weights (P, 3): its barycentric coordinates there;
    distances (P,): to it.
    """

    corners: np.ndarray
    weights: np.ndarray
    distances: np.ndarray

    def carry(self, values: np.ndarray) -> np.ndarray:
        """The values (V, ...) of the mesh's vertices at the points: (P, ...)."""
        return np.einsum("pc,pc...->p...", self.weights, values[self.corners])


@dataclass(frozen=True)
class Follower:
    """Another mesh, of P vertices, that moves with the flesh of a character: clothes, say.

    session_uid: of its object. points (P, 3): its vertices at rest, local space; vertices (P, 3): the same in the
    character's bind space; from_body (3, 3) carries displacements in the character's local space to the mesh's own.
    What moves it is either `skin`, the points of the character's surface nearest to the vertices, or the character's
    cage, of whose vertices it is the `members`.
    """

    name: str
    session_uid: int
    points: np.ndarray
    vertices: np.ndarray
    from_body: np.ndarray
    skin: SurfaceMap | None = None
    members: slice | None = None


@dataclass(frozen=True)
class SimulationSettings:
    """One run: frames start..end at `fps`, each in `substeps` steps; gravity (3,) world, m/s^2.

    samples: states a frame that are kept, of which `substeps` is a multiple.
    begin: REST has the targets' shapes without motion at the first frame, SETTLE is in balance and moves with the rig.
    preroll: frames before `start`; preroll_pose: HELD at its pose, or ANIMATED as the rig moves there. loop: the range
    is a cycle. gains: factors on the modes' motion about the targets' shapes, 1 for modes beyond them; amount: on all
    of it.
    """

    start: int = 1
    end: int = 250
    fps: float = 24.0
    substeps: int = 5
    scheme: str = "BDF2"
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    samples: int = 1
    preroll: int = 0
    preroll_pose: str = "HELD"
    begin: str = "SETTLE"
    loop: bool = False
    gains: tuple[float, ...] = ()
    amount: float = 1.0

    def __post_init__(self):
        if self.substeps % self.samples:
            raise ValueError(f"substeps: expected a multiple of samples ({self.samples}), got {self.substeps}")

    @property
    def frames(self) -> np.ndarray:
        """Those of the result, with fractions for the samples between them."""
        return self.times[self.run_up * self.samples :]

    @property
    def run_up(self) -> int:
        """Frames that are simulated before `start` and dropped. A cycle needs none: it finds what came before."""
        return self.preroll if self.preroll_pose == "ANIMATED" and not self.loop else 0

    @property
    def held(self) -> int:
        """Frames in which the first pose is held."""
        return self.preroll if self.preroll_pose == "HELD" else 0

    @property
    def first(self) -> int:
        """The frame that the simulation begins with."""
        return self.start - self.run_up

    @property
    def simulated(self) -> np.ndarray:
        """The whole frames, with those that are dropped."""
        return np.arange(self.first, self.end + 1)

    @property
    def times(self) -> np.ndarray:
        """Of all states, as `frames`, with those that are dropped."""
        if self.samples == 1:
            return self.simulated
        return self.first + np.arange((self.end - self.first) * self.samples + 1) / self.samples

    def reached(self, states: int) -> int:
        """The frame that is done with so many states; the first without any."""
        return self.first + max(states - 1, 0) // self.samples

    @property
    def step(self) -> float:
        """Seconds a step."""
        return 1.0 / (self.fps * self.substeps)


@dataclass(frozen=True)
class OutputSettings:
    """What a bake becomes in Blender. sink: MODES, FRAMES, PC2 or MDD."""

    sink: str = "MODES"
    keys: int = 0  # of MODES, at most; 0: as many as there are
    every: int = 1  # of FRAMES: a key at every n-th frame,
    tolerance: float = 0.0  # or, if this is not 0, where the surface is off by more than so many metres without it


@dataclass(frozen=True)
class Bake:
    """A simulated shot in modal form: surface = vertices + modes . coordinates + details . weights, local space.

    frames (F,): numbers, or with fractions between the whole ones; coordinates (F, r), weights (F, J), modes (r, V, 3),
    details (J, V, 3): what the cage cannot carry of each target's shape. target_names (J,). dry (F, r): the coordinates
    of the targets' shapes alone, without motion. node_modes (r, n, 3): the modes of the cage's nodes, bind space, for
    what else moves with the flesh. key_names (r + J,): of the shape keys that modes and details become; empty:
    numbered, and by the targets.
    """

    frames: np.ndarray
    coordinates: np.ndarray
    weights: np.ndarray
    modes: np.ndarray
    details: np.ndarray
    target_names: tuple[str, ...]
    dry: np.ndarray
    node_modes: np.ndarray | None = None
    key_names: tuple[str, ...] = ()

    def displacement(self, index: int) -> np.ndarray:
        """Displacement (V, 3) of the bound surface at frame number `index`, local space."""
        return np.tensordot(self.coordinates[index], self.modes, 1) + np.tensordot(self.weights[index], self.details, 1)
