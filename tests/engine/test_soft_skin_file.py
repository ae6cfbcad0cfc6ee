# SPDX-License-Identifier: GPL-3.0-or-later
"""A soft skin file has the model, rounded, and what a program needs beside it."""

import json
from dataclasses import replace

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.io import soft_skin_file
from test_examples import muscle

GRAVITY = (0.0, 0.0, -9.81)


def bent(target, index, names):
    """The target with the last bone turned, each by another angle."""
    local, angle = np.tile(np.eye(4), (len(names), 1, 1)), 0.3 * index
    local[-1, 1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return replace(target, local=local, bones=names[-1:])


@pytest.fixture(scope="module")
def written():
    """(model, character, where it is, arrays and description of its file)."""
    character = muscle(regions=2)
    character = character.with_targets(lambda index, target: bent(target, index, character.skeleton.names))
    model = build(character)
    bones = len(character.skeleton.names)
    world = np.eye(4)[None] + 0.0
    world[0, :3, 3] = 1.0, 2.0, 3.0
    present = RigSamples(np.tile(character.skeleton.rest, (1, 1, 1, 1)).reshape(1, bones, 4, 4), world, world)
    arrays, text = dynamorph.unpack_model(soft_skin_file.packed(model, character, present, GRAVITY))
    return model, character, present, arrays, json.loads(text)


def test_surface_and_targets_are_the_characters(written):
    _, character, present, arrays, described = written
    np.testing.assert_array_equal(arrays["vertices"], character.vertices.astype(np.float32))
    np.testing.assert_array_equal(arrays["triangles"], character.triangles)
    np.testing.assert_array_equal(arrays["gravity"], GRAVITY)
    np.testing.assert_array_equal(arrays["object_frames"][1], present.object_world[0])
    assert described["character"]["targets"] == [target.name for target in character.targets]
    assert [each["name"] for each in described["character"]["sets"]] == [each.name for each in character.target_sets]
    np.testing.assert_array_equal(arrays["target_materials"][:, 0], [t.material.stiffness for t in character.targets])
    np.testing.assert_array_equal(arrays["target_poses"], [target.local for target in character.targets])


def test_influences_are_the_skin_weights(written):
    _, character, _, arrays, _ = written
    weights = np.zeros_like(character.weights)
    np.put_along_axis(weights, arrays["influence_bones"].astype(int), arrays["influence_weights"].astype(float), 1)
    np.testing.assert_allclose(weights, character.weights, atol=1e-7)
    assert arrays["influence_bones"].shape[1] <= character.weights.shape[1]


def test_model_is_rounded_but_for_its_modes(written):
    model, _, _, arrays, _ = written
    stored, _ = model.to_arrays()
    for name in ("nodes", "basis"):
        np.testing.assert_array_equal(arrays[name], stored[name])
    for name in ("displacements", "residual_shapes", "table_mu", "node_weights"):
        np.testing.assert_array_equal(arrays[name], stored[name].astype(np.float32))
    for name in ("hold", "thickness", "unpainted_stiffness", "unpainted_hold"):
        assert arrays[name].size == 0
    assert all(array.dtype == np.int32 for array in arrays.values() if array.dtype.kind == "i")
