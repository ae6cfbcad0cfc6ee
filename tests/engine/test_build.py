# SPDX-License-Identifier: GPL-3.0-or-later
"""What building makes of a character: the cage alone first, painted firmness, and why a model is out of date."""

import threading
from dataclasses import replace

import dynamorph
import numpy as np
import pytest
import scenes
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.errors import SceneError
from dynamic_morph_targets.core.model import build as building
from dynamic_morph_targets.core.model.build import build, build_cage, has_cage, stale_reasons
from dynamic_morph_targets.core.model.model import CAGE, HOLD, MODES, first_part
from dynamic_morph_targets.core.settings import Material, ModelSettings
from dynamic_morph_targets.io import model_file

LENGTH, FOOT = 0.8, 0.1  # meters; the bar is held up to this height
BONES = np.tile(np.eye(3, 4), (2, 1, 1))
TISSUE = Material(stiffness=2e4, poisson=0.0)


def bar(firmness=0.5, material=TISSUE, **settings):
    """A bar along z that stands on its held foot. firmness: painted, a number or a function of the height."""
    vertices, faces = scenes.tube(rings=33, around=16, radius=0.08, length=LENGTH)
    every = np.ones(len(vertices))
    at_rest = np.eye(4)[None]
    neutral = Target("Neutral", 0 * vertices, (), at_rest, np.eye(4), material)
    return Character(
        name="Bar",
        vertices=vertices,
        triangles=np.array([[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)], np.int32),
        to_bind=np.eye(3),
        weights=np.tile([1.0, 0.0], (len(vertices), 1)),
        rigidity=np.where(vertices[:, 2] <= FOOT, 1.0, 0.0),
        firmness=every * (firmness(vertices[:, 2]) if callable(firmness) else firmness),
        bone_segments=np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]]),
        skeleton=Skeleton(("root",), np.array([-1]), at_rest),
        authored_sets=(TargetSet("Bar", (neutral,), every),),
        settings=ModelSettings(
            **scenes.PINNED | {"material_model": "LINEAR", "solver": "FULL", "cage_nodes": 900, "modes": 8, **settings}
        ),
    )


@pytest.fixture(scope="module")
def cage():
    return build_cage(bar())


def pulled(character, cage, direction):
    """Displacement (V, 3) of the bar by 1 N on its top; the cage is that of `cage`."""
    model = build(character, previous=cage)
    engine = model.engine(character)
    simulation = dynamorph.Simulation(engine, 1.0, tolerance=1e-10, max_iterations=100)
    top = character.vertices[:, 2] > LENGTH - 1e-6
    force = np.zeros_like(character.vertices)
    force[top, direction] = 1.0 / top.sum()
    coordinates, report = simulation.solve_static(BONES, np.ones(1), model.on_nodes(force))
    assert report.converged
    return model.surface(engine.displacement(coordinates))


# Painted firmness --------------------------------------------------------------------------------------------------


def test_nothing_painted_is_exactly_one(cage):
    model = build(bar(), previous=cage)
    np.testing.assert_array_equal(model.stiffness, np.ones(len(model.tets)))
    assert model.unpainted is model


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_painted_everywhere_is_a_stiffer_material(cage, solver):
    painted = pulled(bar(firmness=0.9, solver=solver), cage, 0)
    stiffer = pulled(bar(material=replace(TISSUE, stiffness=8e4), solver=solver), cage, 0)
    np.testing.assert_allclose(painted, stiffer, rtol=1e-6, atol=1e-9 * np.abs(stiffer).max())


def test_the_painted_half_stretches_by_its_own_stiffness(cage):
    """A pulled bar has the same force in each section: the upper half, painted 0.9, stretches by a quarter."""
    plain = pulled(bar(), cage, 2)
    half = pulled(bar(firmness=lambda z: np.where(z > 0.45, 0.9, 0.5)), cage, 2)

    def stretch(displacement, low, high):
        height = bar().vertices[:, 2]
        ends = [displacement[np.isclose(height, z), 2].mean() for z in (low, high)]
        return ends[1] - ends[0]

    assert stretch(half, 0.2, 0.35) == pytest.approx(stretch(plain, 0.2, 0.35), rel=0.03)
    assert stretch(half, 0.6, 0.75) == pytest.approx(stretch(plain, 0.6, 0.75) / 4, rel=0.03)
    # The bar is soft up to the paint, in between the cage interpolates.
    assert stretch(half, 0.2, 0.7) / stretch(plain, 0.2, 0.7) == pytest.approx((0.25 + 0.25 / 4) / 0.5, rel=0.05)


@pytest.mark.parametrize("method", ["DYNAMIC", "SHAPE", "SINGLE"])
def test_every_method_and_region_keeps_the_paint(cage, method):
    upper = np.clip(bar().vertices[:, 2] / LENGTH, 0.0, 1.0)
    (whole,) = bar().target_sets
    regions = (replace(whole, region_weights=1.0 - upper), replace(whole, name="upper", region_weights=upper))
    character = replace(bar(firmness=lambda z: 0.5 + 0.4 * z / LENGTH, method=method), authored_sets=regions)
    model = build(character, previous=cage)
    assert model.stiffness.min() < 1.5 and model.stiffness.max() > 3.5
    assert model.engine(character).dofs == 3 * (len(model.nodes) - model.pinned.sum())


def test_paint_is_a_reason_to_build_again(cage):
    plain, painted = bar(), bar(firmness=0.9)
    for first, second in ((plain, painted), (painted, plain), (painted, bar(firmness=0.7))):
        model = build(first, previous=cage)
        assert stale_reasons(model, first) == []
        assert stale_reasons(model, second) == ["Firmness changed"]


# The cage alone ----------------------------------------------------------------------------------------------------


def test_only_the_cage_is_built_and_then_built_on(cage, monkeypatch):
    assert len(cage.tets) and cage.summary.nodes == len(cage.nodes) and 0 < cage.summary.pinned < len(cage.nodes)
    assert stale_reasons(cage, bar()) == ["only the cage is built"]
    stored = building.Model.from_arrays(*model_file.unpack(model_file.pack(*cage.to_arrays())))
    monkeypatch.setattr(dynamorph, "Meshing", None)  # must not be needed
    model = build(bar(), previous=stored)
    np.testing.assert_array_equal(model.tets, cage.tets)
    np.testing.assert_array_equal(model.pinned, cage.pinned)
    assert stale_reasons(model, bar()) == []


def test_a_cage_is_current_until_something_moves_it(cage):
    assert has_cage(cage, bar()) and has_cage(build(bar(), previous=cage), bar())
    assert has_cage(cage, bar(modes=12, method="SINGLE"))
    assert not has_cage(cage, bar(cage_nodes=500)) and not has_cage(cage, bar(pin_radius=0.2))
    assert "Cage Nodes changed" in stale_reasons(cage, bar(cage_nodes=500))


def test_the_cage_says_what_it_is_made_of(cage):
    assert cage.summary.defects["components"] == 1 and not cage.summary.defects["open_edges"]
    assert 0 < cage.summary.quality["min_dihedral"] < 60


def test_firmer_skin_is_held_otherwise_in_the_same_tetrahedra(cage):
    firmer = bar(firmness=lambda z: np.where(z <= 2 * FOOT, 1.0, 0.5))
    assert not has_cage(cage, firmer)
    again = build_cage(firmer, previous=cage)
    np.testing.assert_array_equal(again.tets, cage.tets)
    assert again.pinned.sum() > cage.pinned.sum() and has_cage(again, firmer)


def with_regions(character):
    (whole,) = character.target_sets
    upper = np.clip(character.vertices[:, 2] / LENGTH, 0.0, 1.0)
    sets = (replace(whole, region_weights=1.0 - upper), replace(whole, name="upper", region_weights=upper))
    return replace(character, authored_sets=sets)


def with_sculpt(character):
    (whole,) = character.target_sets
    (neutral,) = whole.targets
    bulge = 0.02 * np.array([1.0, 0.0, 0.0]) * np.sin(np.pi * character.vertices[:, 2:] / LENGTH)
    pose = np.array([np.diag([1.0, -1.0, -1.0, 1.0])])
    flexed = Target("Flexed", bulge, (0,), pose, np.eye(4), TISSUE)
    return replace(character, authored_sets=(replace(whole, targets=(neutral, flexed)),))


# What an artist changes, and the part of the model from which a build makes it again.
EDITS = {
    "stroke": (lambda was: replace(was, firmness=np.where(was.vertices[:, 2] > 0.4, 0.8, 0.5)), HOLD),
    "rigid": (lambda was: replace(was, rigidity=np.where(was.vertices[:, 2] <= 2 * FOOT, 1.0, 0.0)), HOLD),
    "weights": (lambda was: replace(was, weights=np.abs(was.weights - 0.25)), HOLD),
    "sculpt": (with_sculpt, MODES),
    "regions": (with_regions, MODES),
    "modes": (lambda was: was.with_settings(modes=12), MODES),
    "material": (lambda was: was.with_settings(material_model="STVK"), MODES),
    "nodes": (lambda was: was.with_settings(cage_nodes=500), CAGE),
}


@pytest.mark.parametrize("hold", ["BONES", "THICKNESS"])
@pytest.mark.parametrize("edit", EDITS)
def test_only_what_depends_on_an_edit_is_built_again(edit, hold, monkeypatch):
    """And the model is that of a build from nothing, to the last bit."""
    settings = {"solver": "REDUCED", "hold": hold, "cage_nodes": 400}
    before = bar(**settings)
    change, part = EDITS[edit]
    after = change(before)
    previous = build(before)
    assert first_part(building.changes(previous, after)) == part
    fresh = build(after)
    if part != CAGE:
        for name in ("Meshing", "MeshCut", "embed", "fill_fractions", "Thickness"):
            monkeypatch.setattr(dynamorph, name, None)  # must not be needed
    stored = building.Model.from_arrays(*model_file.unpack(model_file.pack(*previous.to_arrays())))
    stored.made.update(previous.made)  # as of a model that was built since the file was opened
    again = build(after, previous=stored)
    assert model_file.pack(*again.to_arrays()) == model_file.pack(*fresh.to_arrays())


def test_what_is_static_has_no_cage():
    with pytest.raises(SceneError, match="'Bar' needs no cage"):
        build_cage(bar(method="STATIC"))


@pytest.mark.parametrize("hold", ["BONES", "THICKNESS"])
def test_progress_of_the_cage_is_the_whole_progress(hold):
    heard = []
    build_cage(bar(cage_nodes=200, hold=hold), lambda fraction, message: heard.append((fraction, message)) or True)
    fractions = [fraction for fraction, _ in heard]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] > 0.85
    assert {message for _, message in heard} == {"Meshing", "Embedding"}
    with pytest.raises(dynamorph.Cancelled):
        build_cage(bar(cage_nodes=200), lambda fraction, message: message != "Embedding")


def test_the_thickness_is_found_while_another_process_meshes(monkeypatch, children):
    """In this thread. What ends it ends that process."""
    threads, of = threading.enumerate(), bar(cage_nodes=200, hold="THICKNESS")

    def found(*_):
        assert children[0].poll() is None and threading.enumerate() == threads
        raise ZeroDivisionError

    monkeypatch.setenv("DYNAMORPH_MESHER_FAULT", "hang")
    with monkeypatch.context() as patch, pytest.raises(ZeroDivisionError):
        patch.setattr(dynamorph, "Thickness", found)
        build_cage(of)
    with pytest.raises(dynamorph.Cancelled):
        build_cage(of, lambda _fraction, _message: not children[1:])
    assert len(children) == 2 and all(child.returncode is not None for child in children)


def test_models_of_another_engine_are_out_of_date(monkeypatch, cage):
    of = bar()
    first = build(of, previous=cage)
    assert stale_reasons(first, of) == [] and has_cage(first, of)
    monkeypatch.setattr(building, "ENGINE", 2)
    assert stale_reasons(first, of) == ["engine changed"] and not has_cage(first, of)


def test_the_same_model_is_the_same_bytes(cage):
    """Whenever, and however long it took."""
    first, second = (model_file.pack(*build(bar(), previous=cage).to_arrays()) for _ in range(2))
    assert first == second


def test_a_stored_model_makes_the_same_digits(cage):
    """In products of NumPy's, which sums by the layout in memory."""
    model = build(bar(), previous=cage)
    stored = building.Model.from_arrays(*model_file.unpack(model_file.pack(*model.to_arrays())))
    for name in model.array_names():
        first, second = getattr(model, name), getattr(stored, name)
        assert first.dtype == second.dtype and first.flags.c_contiguous and second.flags.c_contiguous, name
        assert np.array_equal(first, second), name
    assert model.modes.flags.c_contiguous and stored.modes.flags.c_contiguous
