# SPDX-License-Identifier: GPL-3.0-or-later
"""What docs/results.md claims of the sample scenes holds in reduced models, as artists bake them."""

from itertools import pairwise

import pytest

pytest.importorskip("dynamorph", reason="needs the engine")
import claims
import subjects

DMT = "DMT reduced"


@pytest.fixture(scope="module")
def cylinder(addon):
    shot = subjects.open_shot(subjects.CYLINDER)
    return claims.cylinder(shot, shot.runs(claims.FAST))


def test_the_flexed_limb_bulges_and_other_methods_lose_volume(cylinder):
    flexed = {name: gained[-1] for name, gained in cylinder["bulge"].items()}
    assert flexed[claims.PLAIN] < -100e-6
    assert flexed["single material"] < -100e-6
    for name in (DMT, "static morphs", "pose-dependent shape"):
        assert flexed[name] > 500e-6


def test_the_bulge_grows_with_the_bend(cylinder):
    gained = cylinder["bulge"][DMT]
    forward = [volume for bend, volume in zip(cylinder["bend"], gained, strict=True) if bend > 5]
    assert len(forward) > 10
    assert all(later > earlier - 10e-6 for earlier, later in pairwise(forward))


def test_the_same_push_finds_it_soft_when_straight_and_stiff_when_flexed(cylinder):
    give = cylinder["give"]
    ratio = {name: give[name][claims.STRAIGHT] / give[name][claims.FLEXED] for name in (DMT, "pose-dependent shape")}
    assert ratio[DMT] >= 4
    assert ratio["pose-dependent shape"] == pytest.approx(1, abs=0.15)
    assert give["static morphs"] == {claims.STRAIGHT: 0, claims.FLEXED: 0}
    assert give[DMT][claims.STRAIGHT] > 0.003


def test_the_same_shake_swings_it_when_straight_and_not_when_flexed(cylinder):
    swing = cylinder["swing"]
    assert swing[DMT][claims.STRAIGHT] > 4 * swing[DMT][claims.FLEXED]
    assert swing["single material"][claims.STRAIGHT] < 2 * swing["single material"][claims.FLEXED]
    assert max(swing["static morphs"].values()) < 1e-12


@pytest.fixture(scope="module")
def folding(addon):
    """The shoulder with plain skinning, a single material and dynamic morph targets."""
    shot = subjects.open_shot(subjects.SHOULDER)
    return shot, shot.runs({name: claims.FAST[name] for name in ("single material", DMT)})


@pytest.mark.parametrize("way", claims.FOLDS)
def test_the_elbow_folds_both_ways_without_running_into_itself(folding, way):
    """All along the path, at every second frame; plain skinning and a single material do in its deepest fold."""
    shot, runs = folding
    frames = claims.FOLDS[way][::2]
    assert max(claims.path(shot, DMT, runs[DMT], frames)["pairs"]) == 0
    deepest = frames[len(frames) // 2 :][:1]
    for name in (claims.PLAIN, "single material"):
        found = claims.path(shot, name, runs.get(name), deepest)
        assert found["pairs"][0] > 50 and found["depth"][0] > 0.01


def test_the_chest_bulges_instead_of_collapsing_as_the_arm_lowers(folding):
    shot, runs = folding
    chest = claims.between(shot.rest, *claims.CHEST)

    def grows(run):
        first, last = (
            claims.measures.depth(claims.surface(shot, run, frame), chest, claims.BACKWARD)
            for frame in (claims.LOWERING[0], claims.LOWERING[-1])
        )
        return last - first

    assert grows(runs[DMT]) > 0.010
    assert grows(None) < 0.005 and grows(runs["single material"]) < 0.005


def test_the_same_shake_swings_the_relaxed_biceps_and_not_the_flexed_one(folding):
    shot, runs = folding
    biceps = claims.between(shot.rest, *claims.BICEPS)

    def ratio(run):
        relaxed, flexed = (claims.swing(shot, run, *claims.ARM_SHAKEN[p], biceps) for p in ("relaxed", claims.FLEXED))
        return relaxed / flexed

    assert ratio(runs[DMT]) > 4
    assert ratio(runs["single material"]) < 2


@pytest.fixture(scope="module")
def herbert(addon):
    shot = subjects.open_shot(subjects.HERBERT)
    return claims.herbert(shot, shot.runs(claims.FAST))


def test_herbert_bulges_in_the_tuck_and_stays_so(herbert):
    tuck = slice(len(claims.IN_THE_TUCK))
    out = {name: out["belly"][tuck] for name, out in herbert["out"].items()}
    assert min(out[DMT]) > 0.02
    assert max(out["single material"]) < 0.01
    assert max(out[DMT]) - min(out[DMT]) < 0.25 * (max(out["pose-dependent shape"]) - min(out["pose-dependent shape"]))


def test_the_wall_throws_herbert_s_belly_and_back(herbert):
    wall = slice(len(claims.IN_THE_TUCK), None)
    for patch in ("belly", "back"):
        thrown = herbert["out"][DMT][patch][wall]
        assert max(thrown) - min(thrown) > 0.02
        assert max(map(abs, herbert["out"]["static morphs"][patch][wall])) < 0.01


def test_the_same_shake_swings_the_belly_upright_and_not_tucked(herbert):
    swing = herbert["swing"]
    ratio = {name: swing[name][claims.UPRIGHT] / swing[name][claims.TUCKED] for name in (DMT, "single material")}
    assert ratio[DMT] > 4
    assert 0.5 < ratio["single material"] < 2
    assert max(swing["static morphs"].values()) < 1e-12


def test_the_belly_meets_the_thighs_in_the_tuck(herbert):
    inside = herbert["inside"]
    assert min(inside[claims.PLAIN], inside[DMT]) > 100 and inside[DMT + claims.ITSELF] <= 0.05 * inside[DMT]
