# SPDX-License-Identifier: GPL-3.0-or-later
"""Nine characters, most of them made elsewhere and as messy as they came: opened, made soft, built, baked, baked again,
and the bake deleted.
"""

from dataclasses import replace

import bpy
import characters
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import assert_shows, fingerprint, warnings_of

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


def opened(shot):
    if not shot.path.exists():
        pytest.skip(f"needs ../shared/assets/{shot.file}")
    return characters.open_shot(shot)


@pytest.fixture(scope="module", params=characters.SHOTS.values(), ids=list(characters.SHOTS))
def baked_from(addon, request):
    """A character as its bake found it (`fingerprint`), and the bake."""
    body = opened(request.param)
    return fingerprint(body), characters.bake(batch, body)


@pytest.fixture
def baked(baked_from):
    return baked_from[1]


def test_the_tissue_moves_but_stays_on_the_body(baked):
    moved = baked.displacements
    assert np.isfinite(moved).all()
    assert 1e-3 * baked.size < np.linalg.norm(moved, axis=2).max() < 0.5 * baked.size
    swings = np.linalg.norm(np.ptp(moved, axis=0), axis=1)
    assert swings.max() > 1e-3 * baked.size  # it swings, and does not only sag


def test_the_skin_is_inside_its_cage(baked):
    assert baked.inside.mean() > 0.995  # a few stand out by less than the grid on which it is meshed


def test_blender_shows_what_the_engine_computed(baked):
    assert_shows(baked.body, baked.job.outcome.bake)


def test_a_second_bake_equals_the_first_and_delete_bake_restores(baked_from):
    before, baked = baked_from
    again = characters.bake(batch, baked.body).job
    assert again.input.reasons == []  # the model is equivalent to a new one
    np.testing.assert_array_equal(again.outcome.bake.coordinates, baked.job.outcome.bake.coordinates)
    writer.free(baked.body)
    bpy.context.scene.frame_set(bpy.context.scene.frame_start)
    assert fingerprint(baked.body) == before


def largest_displacement(baked) -> float:
    return np.linalg.norm(baked.displacements, axis=2).max()


@pytest.mark.fault("M04")
@pytest.mark.parametrize("name", ["Fox", "T-rex"])
def test_a_body_of_no_likely_size_is_baked_all_the_same(addon, name):
    """It is tens of meters long as imported, and far too soft for that: there is a warning, and it moves as far as an
    unreduced body does, within a factor that tables of small motion may be off at twice the body's size.
    """
    body = opened(replace(characters.SHOTS[name], scale=1.0))
    assert any("check the scale" in text for text in warnings_of(body))
    reduced = largest_displacement(characters.bake(batch, body))
    body.dynamorph.model.solver = "FULL"
    unreduced = largest_displacement(characters.bake(batch, body))
    assert unreduced / 3.0 < reduced < 3.0 * unreduced
