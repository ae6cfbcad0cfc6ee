# SPDX-License-Identifier: GPL-3.0-or-later
"""Nine characters that nobody here made, messy as they are: opened, made soft, built, baked, baked again and freed."""

from dataclasses import dataclass, replace

import bpy
import characters
import numpy as np
import pytest
from builders import assert_shows, fingerprint, part

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@dataclass(frozen=True)
class Baked:
    """A character's object, what its bake must leave as it was, and the job that baked it."""

    body: object
    before: dict
    job: object

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, metres."""
        return float(np.linalg.norm(np.ptp(self.job.character.vertices @ self.job.character.to_bind.T, axis=0)))

    @property
    def displacements(self) -> np.ndarray:
        """(F, V, 3), bind space."""
        result = self.job.result
        local = np.array([result.displacement(k) for k in range(len(result.frames))])
        return local @ self.job.character.to_bind.T


def bake(body):
    """A job that baked the scene's frames."""
    jobs = part("jobs")
    job = jobs.Job(body, goal="BAKE", substeps=characters.SUBSTEPS)
    jobs.run(job)
    return job


def opened(shot):
    if not shot.path.exists():
        pytest.skip(f"needs ../shared/assets/{shot.file}")
    return characters.open_shot(shot)


@pytest.fixture(scope="module", params=characters.SHOTS.values(), ids=list(characters.SHOTS))
def baked(addon, request):
    body = opened(request.param)
    before = fingerprint(body)
    return Baked(body, before, bake(body))


def test_the_flesh_moves_but_stays_on_the_body(baked):
    moved = baked.displacements
    assert np.isfinite(moved).all()
    assert 1e-3 * baked.size < np.linalg.norm(moved, axis=2).max() < 0.5 * baked.size
    swings = np.linalg.norm(np.ptp(moved, axis=0), axis=1)
    assert swings.max() > 1e-3 * baked.size  # it does not only sag


def test_the_skin_is_inside_its_cage(baked):
    model, character = baked.job.model, baked.job.character
    assert (model.embedding_weights > -1e-9).all()
    carried = np.einsum("va,vac->vc", model.embedding_weights, model.nodes[model.embedding_nodes])
    skin = character.vertices @ character.to_bind.T
    assert np.linalg.norm(carried - skin, axis=1).max() < 1e-6 * baked.size


def test_blender_shows_what_the_engine_computed(baked):
    assert_shows(baked.body, baked.job.result)


def test_a_second_bake_is_the_first_and_free_bake_restores(baked):
    again = bake(baked.body)
    assert again.reasons == []  # the model is as good as new
    np.testing.assert_array_equal(again.result.coordinates, baked.job.result.coordinates)
    part("sinks").free(baked.body)
    bpy.context.scene.frame_set(bpy.context.scene.frame_start)
    assert fingerprint(baked.body) == baked.before


@pytest.mark.parametrize("name", ["Fox", "T-rex"])
def test_a_body_of_no_likely_size_is_baked_all_the_same(addon, name):
    """As it was imported, tens of metres long and far too soft for that: warned of, and still finite."""
    body = opened(replace(characters.SHOTS[name], scale=1.0))
    assert "check the scale" in body.dynamorph.model.warnings
    as_it_is = Baked(body, {}, bake(body))
    assert np.linalg.norm(as_it_is.displacements, axis=2).max() < 3.0 * as_it_is.size
