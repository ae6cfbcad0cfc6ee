# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder that processes share, on one machine or many: built models, and bakes that were not finished.

Files are named by a hash of all that they depend on, written whole or not at all, and never changed: whoever finds one
may use it. What a process was killed over, another goes on with.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np

from . import model_file

VERSION = 1  # of what an unfinished bake holds
BLOCK = 2**20


class Share:
    """The folder; made when something is first kept there. Raises OSError where it cannot be used."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._names: dict[int, str] = {}  # of a job's unfinished bake

    def built(self, character):
        """A model that was built for such a character, or None."""
        from . import build

        found = self._read(self._model_path(build.dependencies(character)))
        return found and build.Model.from_arrays(*found)

    def keep_model(self, model):
        model_file.save(self._model_path(model.dependencies), model_file.pack(*model.to_arrays()))

    def unfinished(self, job) -> dict[str, np.ndarray]:
        """What `simulate.Shot.resume` asks for, and the last `pose`, of such a bake; empty when there is none."""
        self._names[id(job)] = self._name(job)
        found = self._read(self._path(job))
        return found[0] if found else {}

    def keep(self, job):
        """What is done of the bake, in place of what was kept before."""
        if not len(job.rig):  # nothing was left to do
            return
        arrays = job.shot.kept() | {"pose": job.rig.pose[-1]}
        model_file.save(self._path(job), model_file.pack(arrays, {}))

    def forget(self, job):
        """The bake is saved elsewhere now."""
        self._path(job).unlink(missing_ok=True)

    def _path(self, job) -> Path:
        return self.folder / f"{self._names[id(job)]}.unfinished"

    def _model_path(self, dependencies: dict[str, str]) -> Path:
        return self.folder / f"{_hash(dependencies)}.dynamorph"

    @staticmethod
    def _name(job) -> str:
        """A hash of all that a bake depends on: what was authored, and the files that hold what moves it."""
        from . import build

        files = [bpy.data.filepath, *(bpy.path.abspath(library.filepath) for library in bpy.data.libraries)]
        dependencies = build.dependencies(job.character)
        return _hash([VERSION, job.name, job.inputs, dependencies, [_file_hash(Path(file)) for file in files]])

    @staticmethod
    def _read(path: Path):
        """(arrays, metadata) of a file, or None. A damaged one is as good as none: it is written again."""
        with suppress(FileNotFoundError, model_file.ModelFileError):
            return model_file.unpack(path.read_bytes())
        return None


def _hash(what) -> str:
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:32]


def _file_hash(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()
