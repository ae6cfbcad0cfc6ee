# SPDX-License-Identifier: GPL-3.0-or-later
"""What the compiled classes have besides: errors in a sentence, a repr, and pickling that refuses."""

import copy
import pickle

import dynamorph
import numpy as np
import pytest
from contracts import scene

CLASSES = [
    name
    for name, found in vars(dynamorph).items()
    if isinstance(found, type) and found.__module__ == "dynamorph._core" and not issubclass(found, Exception)
]


def made():
    """One of each class that the scene has, by its name."""
    found = {type(value).__name__: value for value in vars(scene()).values()}
    found |= {"LimitedTissue": scene().limit.tissue, "StepReport": dynamorph.StepReport()}
    return {name: value for name, value in found.items() if type(value).__module__ == "dynamorph._core"}


def wrong_calls():
    s, dm = scene(), dynamorph
    law, blending = s.material_model, s.blending
    simulation = {"model": s.reduced, "h": 0.01}
    yield lambda: dm.FullModel(s.body, s.targets, "STVK", blending), "material_model: expected one of dynamorph.Mater"
    yield (
        lambda: dm.FullModel(s.body, s.targets, law, "EVEN"),
        "blending: expected one of dynamorph.Blending: PLAIN|ble",
    )
    yield lambda: dm.Simulation(**simulation, integrator="bdf2"), "integrator: expected one of .* not 'bdf2'"
    yield lambda: dm.Simulation(**simulation, limits=s.limit), "it has no 'limits', but model, h, limit"
    yield lambda: dm.Simulation(None, 0.01), "model: expected FullModel or ReducedModel, not None"
    yield lambda: dm.Simulation(s.reduced, "fast"), "h: expected a number, not 'fast'"
    yield lambda: dm.Simulation(s.reduced), "h is missing"
    yield lambda: dm.MorphTarget("rest", s.shape), "lame_lambda, lame_mu, density are missing"
    yield lambda: dm.MorphTarget("rest", s.shape, lame_lambda=None, lame_mu=1, density=1), "lame_lambda: expected a num"
    yield lambda: dm.MorphTarget(3, s.shape, **s.material), "name: expected str, not 3"
    yield lambda: dm.TetMesh("nodes", s.tets), "nodes: expected an array of numbers, not 'nodes'"
    yield lambda: dm.TetMesh(s.nodes, s.tets, s.tets), "it takes 2 arguments at most, and got 3"
    yield lambda: dm.FullModel(s.body, [None], law, blending), "targets: expected a list of MorphTarget"
    yield lambda: dm.make_basis("model", 6), "model: expected FullModel, not 'model'"


@pytest.mark.parametrize("number", range(14))
def test_a_wrong_argument_is_named_in_a_sentence(number):
    call, words = list(wrong_calls())[number]
    with pytest.raises(TypeError, match=words) as raised:
        call()
    assert len(str(raised.value)) < 250 and "\n" not in str(raised.value)


def test_right_calls_and_other_errors_stay_as_they_are():
    s = scene()
    assert dynamorph.TetMesh(nodes=s.nodes, tets=s.tets).tets.shape == s.tets.shape
    with pytest.raises(ValueError, match="tets"):
        dynamorph.TetMesh(s.nodes, s.tets + 10**6)
    assert "body" in dynamorph.FullModel.__init__.__doc__


def test_a_repr_says_what_it_is():
    shown = {name: repr(value) for name, value in made().items()}
    assert shown["TetMesh"].startswith("<dynamorph.TetMesh: nodes=") and "tets=" in shown["TetMesh"]
    assert shown["ReducedModel"] == f"<dynamorph.ReducedModel: dofs={scene().reduced.dofs}>"
    assert not any(" at 0x" in text for text in shown.values())


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickling_works_or_refuses(protocol):
    """By old protocols pybind11 would end the process."""
    for name, value in made().items():
        if hasattr(type(value), "__setstate__") or hasattr(type(value), "__members__"):
            again = pickle.loads(pickle.dumps(value, protocol))
            assert type(again) is type(value), name
            continue
        with pytest.raises(TypeError, match=f"{name}: it cannot be copied or pickled"):
            pickle.dumps(value, protocol)


def test_a_copy_is_refused_too():
    for duplicate in (copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="TetMesh: it cannot be copied"):
            duplicate(scene().mesh)
    assert np.array_equal(pickle.loads(pickle.dumps(scene().dents)).shapes, scene().dents.shapes)
