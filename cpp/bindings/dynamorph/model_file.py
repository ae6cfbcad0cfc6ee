# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes model files: named arrays and a JSON description, in the layout of safetensors::

    8 bytes   length of the header, little-endian
    header    JSON, padded with spaces to a multiple of 8:
                {name: {dtype, shape, data_offsets: [begin, end]}, ...,
                 "__metadata__": {format, version, meta, hashes, header_hash}}
    data      the arrays, little-endian, C order, one after the other without gaps

safetensors checks sizes but not contents, so each array carries its SHA-256, and the header ends with its own, that of
its bytes without the hash and the padding: no byte of the file can change unnoticed. `unpack_model` reads it
(cpp/dynamorph/file/model_file.hpp), and so can programs in C++.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence

import numpy as np

from dynamorph._core import Blending, Embedding, MorphTarget, ReducedModel, ReducedTables, SoftBody, TetMesh

FORMAT = "dynamorph model"
VERSION = 1
TAGS = {
    "<f8": "F64", "<f4": "F32", "<i8": "I64", "<i4": "I32", "<i2": "I16", "|i1": "I8",
    "<u8": "U64", "<u4": "U32", "<u2": "U16", "|u1": "U8", "|b1": "BOOL",
}  # fmt: skip


def pack_model(arrays: Mapping[str, np.ndarray], description: str) -> bytes:
    """Returns a model file's bytes from arrays by name and a description in JSON; the inverse of `unpack_model`.

    The same arrays give the same bytes. Raises ValueError for an array of anything but numbers.
    """
    tensors, hashes, chunks, offset = {}, {}, [], 0
    for name, array in arrays.items():
        array = np.asarray(array)
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(array.shape)
        if little.dtype.str not in TAGS:
            raise ValueError(f"array '{name}' has type {array.dtype}: only numbers can be stored")
        chunk = little.tobytes()
        tensors[name] = {
            "dtype": TAGS[little.dtype.str],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + len(chunk)],
        }
        hashes[name] = hashlib.sha256(chunk).hexdigest()
        chunks.append(chunk)
        offset += len(chunk)
    return _header_bytes(tensors, description, json.dumps(hashes)) + b"".join(chunks)


def _header_bytes(tensors: Mapping[str, object], description: str, hashes: str) -> bytes:
    metadata = {"format": FORMAT, "version": str(VERSION), "meta": description, "hashes": hashes, "header_hash": ""}
    text = json.dumps({**tensors, "__metadata__": metadata}).encode()
    closing = b'"}}'
    text = text.removesuffix(closing) + hashlib.sha256(text).hexdigest().encode() + closing
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def pack_soft_skin(
    mesh: TetMesh,
    fill: np.ndarray,
    stiffness: np.ndarray,
    region_weights: np.ndarray,
    pinned: Sequence[bool],
    weights: np.ndarray,
    hold: np.ndarray | None = None,
    *,
    targets: Sequence[MorphTarget],
    tables: ReducedTables,
    embedding: Embedding,
    bone_names: Sequence[str],
    residual_shapes: np.ndarray | None = None,
    parents: np.ndarray | None = None,
    rest: np.ndarray | None = None,
) -> bytes:
    """Returns the bytes of a model file, which programs in C++ load: a reduced soft skin, without materials.

    mesh to hold: as SoftBody takes them, with weights (n, B). targets (J): their shapes and sets. tables: of `reduce`.
    embedding: of the V points of the surface in the mesh. bone_names (B). residual_shapes (J, V, 3): meters, what the
    mesh cannot carry of each target's shape; zero by default. parents (B,): the index of each bone's parent, -1 for
    none, the default. rest (B, 4, 4): the bones at rest in bind space, the identity by default. In the file one more
    bone comes last, which is Blender's object and carries nothing. Raises ValueError or Error where they do not fit.
    """
    weights = np.asarray(weights, float)
    if weights.ndim != 2:
        raise ValueError(f"weights: expected shape (n, B), got {weights.shape}")
    n, V, J, B = len(mesh.nodes), len(embedding.nodes), len(targets), weights.shape[1]
    ReducedModel(SoftBody(mesh, fill, stiffness, region_weights, pinned, weights, hold), targets, tables, Blending.EVEN)
    if embedding.nodes.size and embedding.nodes.max() >= n:
        raise ValueError("embedding: it belongs to another mesh")
    if len(bone_names) != B:
        raise ValueError(f"bone_names: expected {B}, got {len(bone_names)}")
    none, h = np.zeros((0, 0)), tables.responses.shape[1]
    response_lambda, response_mu = np.array(tables.response_lambda), np.array(tables.response_mu)
    arrays: dict[str, np.ndarray] = {
        "nodes": mesh.nodes, "tets": mesh.tets, "fill": fill, "stiffness": stiffness, "region_weights": region_weights,
        "pinned": np.asarray(pinned, bool), "hold_strength": none if hold is None else hold,
        "hold": none, "thickness": none, "unpainted_stiffness": none, "unpainted_hold": none,
        "node_weights": np.hstack([weights, np.zeros((n, 1))]),
        "embedding_nodes": embedding.nodes, "embedding_weights": embedding.weights,
        "target_sets": np.array([target.set for target in targets], np.int32),
        "displacements": np.array([target.displacement for target in targets]),
        "residual_shapes": _of_shape("residual_shapes", residual_shapes, np.zeros((J, V, 3))),
        "to_bind": np.eye(3), "parents": _of_shape("parents", parents, np.full(B, -1, np.int32)),
        "rest": _of_shape("rest", rest, np.tile(np.eye(4), (B, 1, 1))),
        "basis": tables.basis, "table_lambda": np.array(tables.lame_lambda), "table_mu": np.array(tables.lame_mu),
        "responses": tables.responses,
        "response_lambda": response_lambda[:, :h] if h else none, "response_mu": response_mu[:, :h] if h else none,
        "coupling_lambda": response_lambda[:, h:].astype(np.float32) if h else none,
        "coupling_mu": response_mu[:, h:].astype(np.float32) if h else none,
        "relaxation": np.array(tables.relaxation) if h else none,
    }  # fmt: skip
    settings = {
        "method": "SHAPE" if targets[0].shifted else "DYNAMIC",
        "solver": "REDUCED",
        "material_model": tables.material_model.name,
    }
    return pack_model(arrays, json.dumps({"settings": settings, "bone_names": list(bone_names)}))


def _of_shape(name: str, given: np.ndarray | None, default: np.ndarray) -> np.ndarray:
    """An array like the default one. Raises ValueError."""
    array = default if given is None else np.asarray(given, default.dtype)
    if array.shape != default.shape:
        raise ValueError(f"{name}: expected shape {default.shape}, got {array.shape}")
    return array
