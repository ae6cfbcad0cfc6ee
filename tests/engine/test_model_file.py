# SPDX-License-Identifier: GPL-3.0-or-later
"""The file of a built model: what goes in comes out, and nothing damaged comes out."""

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from costs import cost
from dynamic_morph_targets.core.errors import ModelFileError
from dynamic_morph_targets.core.model import schema
from dynamic_morph_targets.core.model.build import build, stale_reasons
from dynamic_morph_targets.core.model.model import Model
from dynamic_morph_targets.core.model.summary import Summary
from dynamic_morph_targets.io.model_file import pack, unpack
from dynamorph.model_file import FORMAT, VERSION

sys.path.append(str(Path(__file__).parents[1] / "golden"))

import kept_model

ARRAYS = {
    "nodes": np.arange(12.0).reshape(4, 3),
    "tets": np.array([[0, 1, 2, 3]], np.int32),
    "quartic": np.linspace(0, 1, 5, dtype=np.float32),
    "pinned": np.array([True, False, True, False]),
    "empty": np.zeros((0, 3)),
    "scalar": np.array(2.5),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big endian": np.arange(3, dtype=">i8"),
}
META = {"name": "Körper 😀", "modes": 20, "seconds": {"build": 1.5}, "dependencies": {"mesh": "a1"}, "list": [1, None]}


@pytest.fixture(scope="module")
def packed():
    return pack(ARRAYS, META)


def test_round_trip(packed):
    arrays, meta = unpack(packed)
    assert meta == META
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].shape == array.shape
        assert arrays[name].dtype == array.dtype.newbyteorder("<")
        np.testing.assert_array_equal(arrays[name], array)
        assert arrays[name].flags.writeable


@pytest.mark.fault("F07")
def test_the_bytes_are_little_endian_on_every_processor():
    """Whatever order the numbers had in memory, as on another processor."""
    arrays = {"real": np.array([1.5, -2.0]), "whole": np.arange(1, 4, dtype=">i4"), "short": np.array([258], ">u2")}
    swapped = {name: array.astype(array.dtype.newbyteorder()) for name, array in arrays.items()}
    packed = pack(arrays, {})
    begin = 8 + int.from_bytes(packed[:8], "little")
    assert packed[begin:].hex() == "000000000000f83f00000000000000c0" + "010000000200000003000000" + "0201"
    assert pack(swapped, {}) == packed
    for name, array in unpack(packed)[0].items():
        np.testing.assert_array_equal(array, arrays[name])


def test_same_content_gives_same_bytes(packed):
    assert pack(ARRAYS, META) == packed


@pytest.mark.fault("F01")
def test_every_truncation_is_refused(packed):
    for length in range(len(packed)):
        with pytest.raises(ModelFileError):
            unpack(packed[:length])
    with pytest.raises(ModelFileError, match="after its end"):
        unpack(packed + b"\0")


@pytest.mark.fault("F02")
def test_every_byte_is_guarded(packed):
    rng = np.random.default_rng(0)
    for position in range(len(packed)):
        damaged = bytearray(packed)
        damaged[position] ^= 1 << rng.integers(8)
        with pytest.raises(ModelFileError):
            unpack(damaged)


def forged(tensors, data=b"", **changes):
    """A file by somebody who computes the hashes correctly, with any table of arrays."""
    metadata = {
        "format": FORMAT,
        "version": str(VERSION),
        "meta": "{}",
        "hashes": json.dumps({name: hashlib.sha256(data).hexdigest() for name in tensors}),
        "header_hash": "",
        **changes,
    }
    header = {**tensors, "__metadata__": metadata}
    metadata["header_hash"] = hashlib.sha256(json.dumps(header).encode()).hexdigest()
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data


@pytest.mark.fault("F03", "F04")
@pytest.mark.parametrize(
    "tensor",
    [
        {"dtype": "F64", "shape": [2**40], "data_offsets": [0, 2**43]},
        {"dtype": "F64", "shape": [2**60, 2**60], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [0, 2**80], "data_offsets": [0, 0]},
        {"dtype": "F64", "shape": [-1], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [1.0], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [True], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [1], "data_offsets": [8, 16]},
        {"dtype": "F64", "shape": [1], "data_offsets": [0]},
        {"dtype": "F64", "shape": [1] * 40, "data_offsets": [0, 8]},
        {"dtype": "O", "shape": [1], "data_offsets": [0, 8]},
        {"dtype": ["F64"], "shape": [1], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": 1, "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [1]},
        [],
        None,
    ],
)
def test_hostile_table_is_refused(tensor):
    with pytest.raises(ModelFileError):
        unpack(forged({"a": tensor}, bytes(8)))


def test_forgery_helper_is_right():
    arrays, _ = unpack(forged({"a": {"dtype": "F64", "shape": [1], "data_offsets": [0, 8]}}, bytes(8)))
    assert arrays["a"] == 0.0


@pytest.mark.fault("F03", "F04")
@pytest.mark.parametrize(
    "buffer",
    [
        b"",
        (2**63).to_bytes(8, "little") + b"{}",
        (8).to_bytes(8, "little") + b"[1, 2]  ",
        (8).to_bytes(8, "little") + b"\xff" * 8,
        (200_000).to_bytes(8, "little") + b"[" * 200_000,
        (200_000).to_bytes(8, "little") + b"9" * 200_000,
        b"\x80\x04\x95pickle",
        bytes(100),
    ],
)
def test_hostile_header_is_refused_at_once(buffer):
    """About as fast as a small file is read."""
    small = pack({"numbers": np.zeros(25_000)}, {})
    assert cost(lambda: refuse(buffer)) < 20 * cost(lambda: unpack(small))


def refuse(buffer):
    with pytest.raises(ModelFileError):
        unpack(buffer)


def signed(text):
    """A file without arrays whose header is `text`, by somebody who computes its hash correctly."""
    digest = hashlib.sha256(text.encode()).hexdigest()
    text = text.replace('"header_hash": ""', f'"header_hash": "{digest}"').encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


METADATA = '{"format": "dynamorph model", "version": "1", "meta": "{}", "hashes": "{}", "header_hash": ""}'


def test_signing_helper_is_right():
    assert unpack(signed('{"__metadata__": ' + METADATA + "}")) == ({}, {})


def test_a_header_may_be_spelled_otherwise():
    """By another program that hashes what it writes."""
    header = '{"a":{"shape":[0],"dtype":"F64","data_offsets":[0,0]}, "__metadata__":' + METADATA.replace(" ", "") + "}"
    digest = hashlib.sha256(b"").hexdigest()
    header = header.replace("dynamorphmodel", "dynamorph model")
    header = header.replace('"hashes":"{}"', f'"hashes":"{{\\u0022a\\u0022:\\"{digest}\\"}}"')
    arrays, _ = unpack(signed(header.replace('"header_hash":""', '"header_hash": ""')))
    assert arrays["a"].shape == (0,)


@pytest.mark.parametrize(
    "header",
    [
        '{"__metadata__": ' + METADATA + "} ",
        '{"__metadata__": ' + METADATA + "}\n",
        '{"__metadata__": ' + METADATA + ', "__metadata__": ' + METADATA + "}",
        '{"__metadata__": ' + METADATA + ', "a": {"dtype": "F64", "shape": [0], "data_offsets": [0, 0]}}',
        '{"__metadata__": ' + METADATA.replace(', "header_hash": ""', "") + "}",
        '{"__metadata__": ' + METADATA.replace('"header_hash": ""', '"header_hash": "", "more": ""') + "}",
        '{"__metadata__": ' + METADATA.replace('"meta": "{}", ', "") + "}",
        '{"__metadata__": ' + METADATA.replace('"meta": "{}"', '"meta": {}') + "}",
        '{"__metadata__": ' + METADATA.replace('"hashes": "{}", ', "") + "}",
    ],
)
def test_a_header_that_lacks_something_or_does_not_end_with_its_hash_is_refused(header):
    with pytest.raises(ModelFileError, match="damaged"):
        unpack(signed(header))


@pytest.mark.parametrize(
    "part, count",
    [('"k%d": 0, ', 10**6), ('"k%d": {"dtype": "F64", "shape": [0], "data_offsets": [0, 0]}, ', 10**5)],
)
def test_a_table_without_end_is_refused_at_once(part, count):
    """Sooner than its JSON is read."""
    header = "{" + "".join(part % k for k in range(count)) + '"__metadata__": ' + METADATA + "}"
    file = signed(header)
    assert cost(lambda: refuse(file), times=2) < cost(lambda: json.loads(header), times=2)


def test_hashes_are_strings_for_every_array():
    entry = {"a": {"dtype": "F64", "shape": [1], "data_offsets": [0, 8]}}
    for hashes in ("{}", "[]", "", '{"a": 1}', '{"a": ""}', "[" * 10**5):
        with pytest.raises(ModelFileError):
            unpack(forged(entry, bytes(8), hashes=hashes))


def test_a_buffer_may_be_any_bytes(packed):
    for buffer in (bytearray(packed), memoryview(packed), np.frombuffer(packed, np.uint8)):
        assert unpack(buffer)[1] == META


@pytest.mark.fault("F06")
@pytest.mark.parametrize("version", ["0", "2", "9"])
def test_another_version_says_so(version):
    with pytest.raises(ModelFileError, match=rf"version {version}, .* reads version 1\. Build it again, or update"):
        unpack(forged({}, version=version))


def test_the_kept_file_is_read_and_written_alike():
    """It has something in every array. What it says is what a build says now, and it moves as a model that is built
    now; otherwise the format has changed, and before the first release `make golden` writes it again.
    """
    kept = kept_model.KEPT.read_bytes()
    arrays, meta = unpack(kept)
    assert all(array.size for array in arrays.values())
    model, bar = Model.from_arrays(arrays, meta), kept_model.bar()
    assert pack(*model.to_arrays()) == kept
    assert stale_reasons(model, bar) == []
    moved, again = kept_model.settled(model), kept_model.settled(build(bar, previous=model))
    assert np.abs(moved).max() > 1e-3
    np.testing.assert_allclose(moved, again, atol=1e-4 * np.abs(moved).max())


def test_a_summary_is_stored_without_its_seconds():
    full = Summary(
        nodes=4, tets=1, pinned=2, held=0.5, held_parts=1, defects={"components": 2}, quality={"under_5": 0.25},
        glued={"tets": 3}, dofs=12, modes=6, tabulated=5, targets=2, fitted=(1, 20),
        warnings=("The brace { stays",), seconds={"modes": 0.5},
    )  # fmt: skip
    assert all(getattr(full, name) != value for name, value in vars(Summary()).items())
    read = Summary.from_stored(json.loads(json.dumps(full.stored)))
    assert read == replace(full, seconds={})
    assert full.stored.keys() == schema.SUMMARY.keys()


def test_other_format_says_so():
    with pytest.raises(ModelFileError, match="not a Dynamorph model"):
        unpack(forged({}, format="pt"))


@pytest.mark.parametrize(
    "arrays, meta", [({"a": np.array([object()])}, {}), ({}, {"x": float("nan")}), ({}, {"x": {1, 2}})]
)
def test_only_numbers_and_json_are_stored(arrays, meta):
    with pytest.raises(ModelFileError):
        pack(arrays, meta)
