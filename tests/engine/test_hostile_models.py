# SPDX-License-Identifier: GPL-3.0-or-later
"""Model files whose hashes are right and whose contents are not: each is refused with the error of model files, or it
can be used.
"""

from __future__ import annotations

import hashlib
import json
import time
from contextlib import nullcontext, suppress
from dataclasses import asdict, replace
from functools import cache
from math import comb

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core import memory
from dynamic_morph_targets.core.character import Character
from dynamic_morph_targets.core.errors import ModelFileError
from dynamic_morph_targets.core.model import build as building
from dynamic_morph_targets.core.model.model import Model
from dynamic_morph_targets.io import model_file
from test_defects import BODIES, soft
from test_model_file import forged

KINDS = {
    "modes": {},
    "responses": {"basis": "RESPONSES", "modes": 12},
    "full": {"solver": "FULL"},
    "thickness": {"hold": "THICKNESS"},
    "linear": {"material_model": "LINEAR"},
    "static": {"method": "STATIC"},
    "cage": {},
}
REFUSED_WITHIN = 5.0  # seconds of the processor, so that what else runs does not count; sanitizers are slow


@cache
def character(kind: str) -> Character:
    return soft(BODIES["ball"](), 80).with_settings(**KINDS[kind])


@cache
def stored(kind: str) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays and description of a model of this kind, as a build writes them."""
    build = building.build_cage if kind == "cage" else building.build
    return build(character(kind)).to_arrays()


def load(arrays: dict, meta: dict) -> Model:
    return Model.from_arrays(*model_file.unpack(model_file.pack(arrays, meta)))


def refused_or_usable(kind: str, arrays: dict, meta: dict) -> bool:
    """Whether the file is refused; otherwise everything that reads a model must work on it."""
    began = time.process_time()
    try:
        model = load(arrays, meta)
    except ModelFileError as error:
        assert "uild it again" in str(error)
        return True
    finally:
        assert time.process_time() - began < REFUSED_WITHIN
    who = character(kind)
    assert isinstance(building.stale_reasons(model, who), list)
    building.has_cage(model, who)
    model.skeleton.rest_inverse  # noqa: B018
    if len(model.nodes):
        assert np.isfinite(model.at_nodes(np.ones((model.residual_shapes.shape[1], 1)))).all()
        model.surface(model.displacements)
    if kind not in ("static", "cage") and len(model.displacements) == len(who.targets):
        engine = model.engine(who)
        bones = np.tile(np.eye(3, 4), (model.node_weights.shape[1], 1, 1))
        simulation = dynamorph.Simulation(engine, 0.01)
        with suppress(dynamorph.Error):  # of forces that are not finite, which the artist sees
            simulation.start(bones, bones, np.ones(1))
            simulation.advance(bones[None], np.ones((1, 1)))
        assert np.isfinite(simulation.coordinates).all()
    return False


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_build_writes_is_read(kind):
    arrays, meta = stored(kind)
    assert not refused_or_usable(kind, arrays, meta)
    again, described = load(arrays, meta).to_arrays()
    assert described == meta
    assert all(np.array_equal(again[name], arrays[name]) for name in arrays)


def test_a_small_file_that_takes_much_memory_is_refused_at_once(monkeypatch):
    """The inertia has a tensor for each pair of bones that move one node together, which no build makes so many of."""
    arrays, meta = stored("modes")
    bones, shape = 60, arrays["node_weights"].shape
    arrays = arrays | {
        "node_weights": np.full((shape[0], bones + 1), 1.0 / (bones + 1)),
        "parents": np.arange(bones) - 1,
        "rest": np.tile(np.eye(4), (bones, 1, 1)),
    }
    meta = meta | {"bone_names": [f"bone {b}" for b in range(bones)]}
    sets, modes = arrays["region_weights"].shape[1], arrays["basis"].shape[1]
    needed = 8 * (sets + 1) * (61 * 62 // 2) * (18 * modes + 9 * comb(modes, 2))
    for most, free, refusal in ((2, 2, None), (2, 0.5, MemoryError), (0.5, 0.5, ModelFileError)):
        room = memory.Room(most * needed, free * needed)
        monkeypatch.setattr(memory, "room", lambda room=room: room)
        began = time.process_time()
        with nullcontext() if refusal is None else pytest.raises(refusal):
            load(arrays, meta)
        assert refusal is None or time.process_time() - began < REFUSED_WITHIN
    few = arrays["node_weights"]  # a cage has a little of nearly all bones at each node, which the engine leaves out
    few[:, 3:] = 1e-4
    assert memory.inertia_bytes(few, modes, sets) < 0.01 * needed


def test_more_modes_than_degrees_of_freedom_are_refused():
    arrays, meta = stored("linear")
    rows = len(arrays["basis"])
    for columns, words in (
        (rows + 1, "more modes than degrees of freedom"),
        (20_000, "more memory|more modes"),
    ):
        with pytest.raises(ModelFileError, match=words):
            load(arrays | {"basis": np.zeros((rows, columns))}, meta)


def test_more_sets_than_targets_are_refused():
    arrays, meta = stored("modes")
    sets = len(arrays["displacements"]) + 1
    with pytest.raises(ModelFileError, match="more sets than targets"):
        load(arrays | {"region_weights": np.full((len(arrays["tets"]), sets), 1.0 / sets)}, meta)


def other_shapes(array: np.ndarray) -> dict[str, np.ndarray]:
    """The array in every plausible wrong shape."""
    found = {
        "scalar": np.zeros((), array.dtype),
        "none": array[:0],
        "flat": array.reshape(-1),
        "deeper": array[None],
        "one": np.ones((1,) * array.ndim, array.dtype),
        "long": np.zeros((500, *array.shape[1:]), array.dtype),
    }
    for axis in range(array.ndim):
        found[f"shorter in {axis}"] = np.delete(array, slice(-1, None), axis)
        found[f"longer in {axis}"] = np.concatenate([array, np.take(array, [0] * (array.shape[axis] > 0), axis)], axis)
        found[f"without {axis}"] = np.take(array, [], axis)
    if array.ndim > 1:
        found["turned"] = np.ascontiguousarray(array.swapaxes(0, 1))
    return found


def other_types(array: np.ndarray) -> dict[str, np.ndarray]:
    with np.errstate(invalid="ignore"):
        return {kind: array.astype(kind) for kind in ("f8", "f4", "i8", "i4", "u1", "u8", "?") if array.dtype != kind}


def other_numbers(array: np.ndarray) -> dict[str, np.ndarray]:
    """One number, or all of them, are not what they should be."""
    numbers = {"f": (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-320, 0.0, -1.0), "i": (-1, -2, 2**31 - 1, -(2**31), 0)}
    found = {}
    for number in numbers.get(array.dtype.kind, (True, False)) if array.size else ():
        found[f"one {number}"] = array.copy()
        found[f"one {number}"].flat[-1] = number
        found[f"all {number}"] = np.full_like(array, number)
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", [other_shapes, other_types, other_numbers])
@pytest.mark.parametrize("name", stored("modes")[0])
@pytest.mark.filterwarnings("ignore:overflow encountered")  # of numbers that are finite still
def test_an_array_that_does_not_fit(kind, change, name):
    arrays, meta = stored(kind)
    for array in change(arrays[name]).values():
        refused_or_usable(kind, arrays | {name: array}, meta)
    without = {other: array for other, array in arrays.items() if other != name}
    refused_or_usable(kind, without, meta)


@pytest.mark.parametrize("kind", KINDS)
def test_most_of_them_are_refused(kind):
    """Else the tests above prove little: shapes of arrays that matter are never accepted."""
    arrays, meta = stored(kind)
    for name in ("to_bind", "rest", "parents", *(() if kind == "static" else ("nodes", "tets", "node_weights"))):
        for how, array in other_shapes(arrays[name]).items():
            assert array.shape == arrays[name].shape or refused_or_usable(kind, arrays | {name: array}, meta), how


VALUES = (None, True, 0, -1, 10**400, 1e300, "x", "", [], [0], ["x"], {}, {"x": 0}, [[[]]])


@pytest.mark.parametrize("kind", ["modes", "static", "cage"])
@pytest.mark.parametrize("place", ["", "settings", "summary", "dependencies"])
def test_a_description_that_does_not_fit(kind, place):
    arrays, meta = stored(kind)
    described = meta[place] if place else meta
    for name in [*described, "unknown"]:
        without = {other: value for other, value in described.items() if other != name}
        for changed in (without, *({**described, name: value} for value in VALUES)):
            refused_or_usable(kind, arrays, {**meta, place: changed} if place else changed)


def test_two_models_in_one_file():
    """Each array by itself is right, but together they are of two bodies."""
    block = replace(soft(BODIES["block"](), 120), settings=replace(character("modes").settings, cage_nodes=120))
    other = building.build(block).to_arrays()[0]
    arrays, meta = stored("modes")
    for name in arrays:
        refused_or_usable("modes", arrays | {name: other[name]}, meta)
    assert refused_or_usable("modes", arrays | {"basis": other["basis"]}, meta)


def test_a_refusal_says_what_is_wrong():
    arrays, meta = stored("modes")
    with pytest.raises(ModelFileError, match=r"damaged \(array 'fill' is float64 \(3,\)\): build it again"):
        load(arrays | {"fill": np.ones(3)}, meta)
    with pytest.raises(ModelFileError, match=r"damaged \(setting 'modes'\)"):
        load(arrays, {**meta, "settings": asdict(character("modes").settings) | {"modes": "20"}})
    with pytest.raises(ModelFileError, match="tet .* is flat or inside out|inside out"):
        load(arrays | {"tets": arrays["tets"][:, [1, 0, 2, 3]]}, meta)


@pytest.mark.parametrize(
    "shapes",
    [
        {"tets": (2**28, 0)},
        {"tets": (2**62, 0)},
        {"basis": (0, 400), "table_mu": (0, 1_093_567_100)},
        {"nodes": (2**20, 0)},
    ],
)
def test_an_empty_array_with_a_dimension_beyond_the_file(shapes):
    """Whoever reads it would allocate, or count, to that dimension."""
    entries = {name: {"dtype": "F64", "shape": list(shape), "data_offsets": [0, 0]} for name, shape in shapes.items()}
    began = time.process_time()
    with pytest.raises(ModelFileError, match="impossible shape"):
        hashes = json.dumps(dict.fromkeys(entries, hashlib.sha256(b"").hexdigest()))
        model_file.unpack(forged(entries, hashes=hashes))
    assert time.process_time() - began < REFUSED_WITHIN
