# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean bodies spoiled in every way that artists' meshes are: built and baked, or refused with advice; never worse."""

from __future__ import annotations

import itertools
import re
import time
from dataclasses import dataclass, replace
from pathlib import Path

import dynamorph
import numpy as np
import pytest
import scenes
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.model import cage
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.settings import Material, ModelSettings, SimulationSettings
from fuzzing import target
from hypothesis import event
from hypothesis import strategies as st

SHARED = Path(__file__).resolve().parents[3] / "shared"
LONGEST = 60.0  # seconds for a build and a bake: the mesher gives up earlier
FRAMES, SUBSTEPS = 5, 2
ADVICE = re.compile(
    r"\b(add|apply|check|choose|clean|close|delete|give|lower|merge|model|move|raise|recalculate|remove|repair|"
    r"scale|separate|weight)\b",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Body:
    """vertices (V, 3) and triangles (T, 3) of a skin around `bones` (B, 2, 3), heads and tails of a chain, meters."""

    vertices: np.ndarray
    triangles: np.ndarray
    bones: np.ndarray

    @property
    def size(self) -> float:
        """Diagonal of the bones and the skin, as far as they are numbers."""
        points = np.concatenate([self.vertices[np.unique(self.triangles)], self.bones.reshape(-1, 3)])
        return float(np.linalg.norm(np.ptp(points[np.isfinite(points).all(axis=1)], axis=0)))

    @property
    def visible(self) -> np.ndarray:
        """The vertices of triangles that have an area."""
        a, b, c = self.vertices[self.triangles].swapaxes(0, 1)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return np.unique(self.triangles[area > 1e-12 * self.size**2])

    def moved(self, transform: np.ndarray, offset=0.0) -> Body:
        """Skin and bones under an affine map."""
        return replace(self, vertices=self.vertices @ transform.T + offset, bones=self.bones @ transform.T + offset)

    def joined(self, vertices: np.ndarray, triangles: np.ndarray) -> Body:
        """With more skin; its triangles count its own vertices."""
        triangles = np.concatenate([self.triangles, triangles + len(self.vertices)])
        return replace(self, vertices=np.concatenate([self.vertices, vertices]), triangles=triangles)


# Clean bodies --------------------------------------------------------------------------------------------------------


def grid_triangles(rows: int, columns: int) -> np.ndarray:
    """Of a grid of vertices whose columns are closed to a ring: (2 (rows - 1) columns, 3)."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1], np.roll(index, -1, 1)[:-1], np.roll(index, -1, 1)[1:], index[1:]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def revolved(profile: np.ndarray, around: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """Points (radius, height) turned about z; where the radius is 0 triangles are degenerate, as in a UV sphere."""
    angle = np.arange(around) * 2 * np.pi / around
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(around)], -1)
    vertices = profile[:, :1, None] * circle + profile[:, 1:, None] * [0.0, 0.0, 1.0]
    return vertices.reshape(-1, 3), grid_triangles(len(profile), around)


def chain(*joints) -> np.ndarray:
    """Bones (B, 2, 3) from joint to joint."""
    joints = np.array(joints, float)
    return np.stack([joints[:-1], joints[1:]], axis=1)


def ball() -> Body:
    turn = np.linspace(0.0, np.pi, 10)
    skin = revolved(np.column_stack([np.sin(turn), -np.cos(turn)]))
    return Body(*skin, chain((0, 0, -0.6), (0, 0, 0), (0, 0, 0.6)))


def block() -> Body:
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) - [0.5, 0.5, 0.0]
    triangles = np.array([*map(int, "021123456576014154263367042246135375")]).reshape(-1, 3)
    return Body(corners * [0.6, 0.4, 2.0], triangles, chain((0, 0, 0.1), (0, 0, 1), (0, 0, 1.9)))


def limb() -> Body:
    turn = np.linspace(0.0, np.pi / 2, 5)
    low, high = (np.column_stack([0.3 * np.sin(turn), z - s * 0.3 * np.cos(turn)]) for z, s in ((0.3, 1), (1.7, -1)))
    skin = revolved(np.concatenate([low, [[0.3, 0.75], [0.3, 1.0], [0.3, 1.25]], high[::-1]]))
    return Body(*skin, chain((0, 0, 0.1), (0, 0, 1), (0, 0, 1.9)))


def arm() -> Body:
    vertices, faces = scenes.tube(around=12)
    triangles = np.array([[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)])
    return Body(vertices, triangles, chain((0, 0, 0), (0, 0, 1), (0, 0, 2)))


def ring() -> Body:
    turn, around = np.meshgrid(np.arange(20) * np.pi / 10, np.arange(10) * np.pi / 5, indexing="ij")
    radius = 1.0 + 0.3 * np.cos(around)
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.3 * np.sin(around)], -1).reshape(-1, 3)
    triangles = grid_triangles(21, 10) % len(vertices)
    return Body(vertices, triangles, chain((1, 0, 0), (0.7, 0.7, 0), (0, 1, 0)))


BODIES = {made.__name__: made for made in (ball, block, limb, arm, ring)}


# Defects -------------------------------------------------------------------------------------------------------------
# Each spoils about the share `amount` (0..1) of a body, at random places.


def some(body: Body, amount: float, random) -> np.ndarray:
    """Indices of random triangles, at least one."""
    count = len(body.triangles)
    return random.choice(count, max(1, round(amount * count)), replace=False)


def hole(body, amount, random):
    """Around a random vertex."""
    middles = body.vertices[body.triangles].mean(axis=1)
    far = np.linalg.norm(middles - middles[random.integers(len(middles))], axis=1)
    return replace(body, triangles=body.triangles[np.argsort(far)[max(1, round(amount * len(far))) :]])


def scattered_holes(body, amount, random):
    return replace(body, triangles=np.delete(body.triangles, some(body, amount, random), axis=0))


def flipped_faces(body, amount, random):
    triangles, turned = body.triangles.copy(), some(body, amount, random)
    triangles[turned] = triangles[turned, ::-1]
    return replace(body, triangles=triangles)


def duplicate_faces(body, amount, random):
    again = body.triangles[some(body, amount, random)]
    return replace(body, triangles=np.concatenate([body.triangles, again, again[:, [1, 0, 2]]]))


def degenerate_faces(body, amount, random):
    """Of two vertices, and of three at one place or on one line."""
    flat = body.triangles[some(body, amount, random)].copy()
    flat[:, 2] = flat[:, 0]
    ends = body.vertices[flat[:, :2]]
    line = np.concatenate([ends, ends.mean(axis=1, keepdims=True)], axis=1).reshape(-1, 3)
    return replace(body, triangles=np.concatenate([body.triangles, flat])).joined(
        line, np.arange(len(line)).reshape(-1, 3)
    )


def collapsed_vertices(body, amount, random):
    vertices, (a, b, _) = body.vertices.copy(), body.triangles[some(body, amount, random)].T
    vertices[a] = vertices[b]
    return replace(body, vertices=vertices)


def internal_faces(body, amount, random):
    """A smaller body inside."""
    middle = np.nanmean(body.vertices, axis=0)
    inner = middle + (0.1 + 0.85 * amount) * (body.vertices - middle)
    return body.joined(inner, body.triangles[:, :: random.choice([-1, 1])])


def self_intersections(body, amount, random):
    """A second body through the first."""
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return body.joined(body.vertices @ turn.T + amount * body.size * random.uniform(-0.3, 0.3, 3), body.triangles)


def coincident_layers(body, amount, random):
    """A second skin on the first, or hardly off it."""
    off = 1e-2 * amount * body.size * random.choice([0.0, 1e-4, 1.0])
    return body.joined(body.vertices + off * random.normal(size=3), body.triangles)


def disconnected_triangles(body, amount, random):
    count = max(1, round(20 * amount))
    corners = random.normal(size=(count, 1, 3)) + 0.2 * random.normal(size=(count, 3, 3))
    loose = np.nanmean(body.vertices, axis=0) + 0.3 * body.size * corners.reshape(-1, 3)
    return body.joined(loose, np.arange(3 * count).reshape(-1, 3))


def stray_vertices(body, amount, random):
    stray = body.size * (1.0 + 99.0 * amount) * random.normal(size=(5, 3))
    return body.joined(stray, np.zeros((0, 3), int))


def not_numbers(body, amount, random):
    vertices = body.vertices.copy()
    vertices[body.triangles[some(body, 0.1 * amount, random), 0]] = random.choice([np.nan, np.inf, -np.inf])
    return replace(body, vertices=vertices)


def t_junctions(body, amount, random):
    """Triangles cut in two at an edge whose other triangle stays whole."""
    cut = some(body, amount, random)
    a, b, c = body.triangles[cut].T
    new = len(body.vertices) + np.arange(len(cut))
    halves = np.concatenate([np.column_stack([a, new, c]), np.column_stack([new, b, c])])
    vertices = np.concatenate([body.vertices, 0.5 * (body.vertices[a] + body.vertices[b])])
    return replace(body, vertices=vertices, triangles=np.concatenate([np.delete(body.triangles, cut, axis=0), halves]))


def unwelded(body, _amount, _random):
    """Each triangle with vertices of its own, as importers split them."""
    vertices = body.vertices[body.triangles].reshape(-1, 3)
    return replace(body, vertices=vertices, triangles=np.arange(len(vertices)).reshape(-1, 3))


def crumpled(body, amount, random):
    return replace(body, vertices=body.vertices + 0.1 * amount * body.size * random.normal(size=body.vertices.shape))


def wild_faces(body, amount, random):
    """Between any vertices."""
    count = max(1, round(0.2 * amount * len(body.triangles)))
    wild = random.integers(len(body.vertices), size=(count, 3))
    return replace(body, triangles=np.concatenate([body.triangles, wild]))


def hardly_a_body(body, amount, random):
    return replace(body, triangles=body.triangles[some(body, 0.05 * amount, random)])


def scaled(body, amount, random):
    return body.moved(10.0 ** (random.choice([-6, 6]) * amount) * np.eye(3))


def stretched(body, amount, random):
    return body.moved(np.diag(10.0 ** (amount * random.uniform(-3, 3, 3))))


def flattened(body, amount, random):
    transform = np.eye(3)
    axis = random.integers(3)
    transform[axis, axis] = max(0.0, 0.1 - 0.2 * amount)
    return body.moved(transform)


def far_away(body, amount, random):
    return body.moved(np.eye(3), 10.0 ** (4.0 * amount) * body.size * random.normal(size=3))


def bones_outside(body, amount, random):
    return replace(body, bones=body.bones + amount * body.size * random.normal(size=3))


DEFECTS = {
    spoil.__name__: spoil
    for spoil in (
        hole, scattered_holes, flipped_faces, duplicate_faces, degenerate_faces, collapsed_vertices, internal_faces,
        self_intersections, coincident_layers, disconnected_triangles, stray_vertices, not_numbers, t_junctions,
        unwelded, crumpled, wild_faces, hardly_a_body, scaled, stretched, flattened, far_away, bones_outside,
    )
}  # fmt: skip


def spoiled(body: Body, defects) -> Body:
    """defects: (name, amount, seed) one after the other, while there is something to spoil."""
    for name, amount, seed in defects:
        if not len(body.triangles):
            break
        body = DEFECTS[name](body, amount, np.random.default_rng(seed))
    return body


# What must come of it ------------------------------------------------------------------------------------------------


def soft(body: Body, cage_nodes: int) -> Character:
    """A soft skin that swings alike at any size: gravity and inertia of a body grow with it, and its stiffness too."""
    heads = body.bones[:, 0]
    nearest = np.linalg.norm(body.vertices[:, None] - body.bones.mean(axis=1), axis=2)
    weights = np.where(np.isfinite(nearest), 1.0 / np.maximum(nearest, 1e-3 * body.size + 1e-9) ** 2, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    rest = np.tile(np.eye(4), (len(heads), 1, 1))
    rest[:, :3, 3] = heads
    every = np.ones(len(body.vertices))
    material = Material(stiffness=1e5 * max(body.size, 1e-9) ** 2)
    at_rest = np.tile(np.eye(4), (len(heads), 1, 1))
    neutral = Target("Neutral", 0.0 * np.nan_to_num(body.vertices), (), at_rest, np.eye(4), material)
    return Character(
        name="Body",
        vertices=body.vertices,
        triangles=body.triangles.astype(np.int32),
        to_bind=np.eye(3),
        weights=np.column_stack([weights, 0.0 * every]),
        bone_segments=body.bones,
        skeleton=Skeleton(("root", "tip"), np.array([-1, 0]), rest),
        authored_sets=(TargetSet("Body", (neutral,), every),),
        settings=ModelSettings(**scenes.PINNED, method="SINGLE", cage_nodes=cage_nodes, modes=6),
    )


def shot(character: Character, size: float) -> tuple[RigSamples, SimulationSettings]:
    """The chain is carried along while its tip turns by 40 degrees."""
    chosen = SimulationSettings(1, FRAMES, substeps=SUBSTEPS, gravity=(0.0, 0.0, -9.81 * size))
    samples = 1 + (FRAMES - 1) * SUBSTEPS
    time = np.linspace(0.0, 1.0, samples)
    local = np.tile(np.eye(4), (samples, 2, 1, 1))
    cosine, sine = np.cos(0.7 * time), np.sin(0.7 * time)
    local[:, 1, 1:3, 1:3] = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    world = np.tile(np.eye(4), (samples, 1, 1))
    world[:, 0, 3] = 0.2 * size * time
    return RigSamples(character.skeleton.pose(local), world, world), chosen


def assert_survives(body: Body, cage_nodes: int = 120) -> bool:
    """Built and baked in time, all skin in its cage, finite and in place; or refused with advice, then False."""
    began = time.monotonic()
    character = soft(body, cage_nodes)
    try:
        model = build(character)
        baked, _ = simulate.bake(model, character, *shot(character, body.size))
    except (dynamorph.Error, ValueError) as error:
        assert ADVICE.search(str(error)), f"no advice: {error}"
        return False
    finally:
        assert time.monotonic() - began < LONGEST
    used = body.visible
    outside = dynamorph.embed(dynamorph.TetMesh(model.nodes, model.tets), body.vertices[used]).distances
    assert outside.max() < cage.GRID * body.size  # on which it is meshed
    moved = np.array([baked.displacement(k) for k in range(FRAMES)])[:, used]
    assert np.isfinite(moved).all()
    assert np.linalg.norm(moved, axis=2).max() < body.size
    return True


# These may leave nothing that bones could hold.
MAY_BE_REFUSED = {"not_numbers", "wild_faces", "hardly_a_body", "stretched", "flattened", "bones_outside"}


@pytest.mark.fault("M03", "M05", "M07", "M09", "M10")
@pytest.mark.filterwarnings("ignore:invalid value encountered")  # of infinity, before it is refused
@pytest.mark.parametrize(("name", "defect"), list(zip(itertools.cycle(BODIES), DEFECTS, strict=False)))
def test_each_defect_alone(name, defect):
    assert assert_survives(spoiled(BODIES[name](), [(defect, 0.3, 1)])) or defect in MAY_BE_REFUSED


def test_a_skin_that_is_there_twice_is_not_cut_from_itself():
    body = spoiled(ball(), [("coincident_layers", 0.02, 1)])  # joined where the first has a seam
    assert build(soft(body, 120)).summary.glued["tets"] == 0


DEFECT = st.tuples(st.sampled_from(sorted(DEFECTS)), st.sampled_from([0.02, 0.1, 0.3, 0.6, 1.0]), st.integers(0, 10**6))


@pytest.mark.filterwarnings("ignore:invalid value encountered")  # of infinity, before it is refused
@target(
    st.sampled_from(sorted(BODIES)),
    st.lists(DEFECT, min_size=1, max_size=4),
    st.sampled_from([60, 120, 300]),
    examples=40,
)
def test_any_mix_of_defects_is_built_or_refused_with_advice(name, defects, cage_nodes):
    event("built" if assert_survives(spoiled(BODIES[name](), defects), cage_nodes) else "refused with advice")
