# SPDX-License-Identifier: GPL-3.0-or-later
"""Painting one part makes that part move more, or less, and leaves the rest as it was."""

import bpy
import numpy as np
import pytest
from builders import activate, make_mesh, make_rig
from robustness import bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
AROUND = 16
BELLY, CHEST = (0.35, 0.65), (1.35, 1.65)  # heights of the two swellings


@pytest.fixture(scope="module")
def motions(addon):
    """How far the belly and the chest of a body move at most, by what is painted on the belly."""
    return {weight: moved(weight) for weight in (None, 0.0, 0.5, 0.9, 1.0)}


def moved(weight, limit=0.0, of="firmness") -> np.ndarray:
    """limit: of the displacement, of the body's size; of: which map is painted."""
    bpy.ops.wm.read_homefile(use_empty=True)
    obj = body(bpy.context.scene)
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = 500, 40
    obj.dynamorph.simulation.max_displacement, obj.dynamorph.simulation.max_thickness = limit, 0.0
    height = np.array([vertex.co.z for vertex in obj.data.vertices])
    if weight is not None:
        group = obj.vertex_groups.new(name="Painted")
        group.add(np.flatnonzero(height < 0.95).tolist(), weight, "REPLACE")
        setattr(obj.dynamorph, f"{of}_group", group.name)
    job = bake(obj)
    assert obj.dynamorph.targets[0].bounce == pytest.approx(3.5, rel=1e-4)  # of the body without paint
    shown = np.einsum("fk,kvc->fvc", job.outcome.bake.coordinates, job.outcome.bake.modes)
    far = np.linalg.norm(shown, axis=2).max(axis=0)
    return np.array([far[(low < height) & (height < high)].max() for low, high in (BELLY, CHEST)])


def body(scene):
    """A body that narrows at the waist and at both ends, on a rig that hops."""
    heights = np.linspace(0.0, 2.0, 33)
    radius = 0.06 + 0.24 * np.abs(np.sin(np.pi * heights)) ** 0.7
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = [np.column_stack([r * around, np.full(AROUND, z)]) for z, r in zip(heights, radius, strict=True)]
    ring, k = (grid.ravel() for grid in np.mgrid[: len(rings) - 1, :AROUND])
    start, after = ring * AROUND, (k + 1) % AROUND
    faces = np.column_stack([start + k, start + after, start + AROUND + after, start + AROUND + k]).tolist()
    top = (len(rings) - 1) * AROUND
    faces += [[*range(AROUND - 1, -1, -1)], [*range(top, top + AROUND)]]
    obj = make_mesh(scene, "Body", np.concatenate(rings).tolist(), faces)
    rig = make_rig(scene, "Body Rig")
    obj.parent = rig
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    for bone, upper in (("lower", True), ("upper", False)):
        group = obj.vertex_groups.new(name=bone)
        group.add([v.index for v in obj.data.vertices if (v.co.z > 1.0) == upper], 1.0, "REPLACE")
    scene.frame_end = 24
    for frame in range(1, 25):
        rig.location.z = 0.15 * (frame // 4 % 2)
        rig.keyframe_insert("location", frame=frame)
    return obj


def test_a_softer_belly_moves_more_and_a_firmer_one_less(motions):
    belly = {weight: found[0] for weight, found in motions.items()}
    assert belly[0.0] > 1.5 * belly[0.5] > 1.5 * 1.5 * belly[0.9]
    assert belly[1.0] < 0.05 * belly[0.5]


def test_the_chest_stays_as_it_was(motions):
    chest = {weight: found[1] for weight, found in motions.items()}
    for weight in (0.0, 0.9, 1.0):
        assert chest[weight] == pytest.approx(chest[0.5], rel=0.05)


def test_a_new_map_changes_nothing(motions):
    np.testing.assert_array_equal(motions[0.5], motions[None])


@pytest.mark.parametrize("weight", [0.5, 0.3, 0.05])
def test_a_belly_stays_within_its_max_distance_and_the_chest_moves_as_it_did(addon, weight):
    limit = 0.02
    free, now = moved(None, limit), moved(weight, limit, "max_distance")
    size = np.linalg.norm([0.6, 0.6, 2.0])
    assert free[0] > 1.5 * weight * limit * size
    assert now[0] < 1.5 * weight * limit * size
    assert now[1] == pytest.approx(free[1], rel=0.1)
