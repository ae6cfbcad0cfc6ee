# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder that processes share, on one machine or many, with built models and unfinished bakes.

Files are named by a hash of everything that they depend on, written completely or not at all, and never changed:
whoever finds one may use it. Another process can continue the work of one that was killed.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..core import errors
from ..core.character import Character
from ..core.model import build
from ..core.model.model import Model
from ..core.motion.player import STEP
from ..core.motion.simulate import Shot
from . import disk, model_file

VERSION = 2  # version of the content of an unfinished bake
BLOCK = 2**20


class CacheDir:
    """The folder. It is created when something is first kept in it. Raises OSError where it cannot be used."""

    def __init__(self, folder: Path):
        self.folder = folder

    def built(self, character: Character) -> Model | None:
        """A model that was built for such a character, or None."""
        found = self._read(self._model_path(build.dependencies(character)))
        with suppress(errors.ModelFileError):
            return Model.from_arrays(*found) if found else None
        return None

    def keep_model(self, model: Model) -> Path:
        """Returns its file."""
        path = self._model_path(model.dependencies)
        with suppress(errors.FileInUseError):  # another process reads it: it has kept the same model meanwhile
            disk.save(path, model_file.pack(*model.to_arrays()))
        return path

    def bake_path(
        self, name: str, inputs: dict, character: Character, files: list[Path], blender: tuple[int, int, int]
    ) -> Path:
        """The file of the unfinished bake of the object `name`.

        Except for the model, which may not exist yet, it depends on what was authored (`inputs`), on the `files` that
        contain what moves it, and on the version of Blender.
        """
        depends_on = [name, inputs, build.dependencies(character), [_file_hash(file) for file in files]]
        return self.folder / f"{_hash([VERSION, blender, *depends_on])}.unfinished"

    def unfinished(self, path: Path, model: Model, states: int) -> dict[str, np.ndarray]:
        """The arguments of `simulate.Shot.resume`, and the last `pose`, of a bake of so many states with this model;
        empty without one.
        """
        found = self._read(path)
        if not found or found[1].get("model") != _modes_hash(model):
            return {}
        return found[0] if _fits(found[0], model, states) else {}

    def keep(self, path: Path, shot: Shot, pose: np.ndarray) -> None:
        """Store the finished part of a `simulate.Shot` up to this pose (B, 4, 4), in place of the part stored
        before.
        """
        meta = {"model": _modes_hash(shot.player.model)}
        disk.save(path, model_file.pack(shot.kept() | {"pose": pose}, meta))

    def _model_path(self, dependencies: dict[str, str]) -> Path:
        return self.folder / f"{_hash(dependencies)}.dynamorph"

    @staticmethod
    def _read(path: Path) -> tuple[dict[str, np.ndarray], dict] | None:
        """(arrays, metadata) of a file, or None. A damaged file counts as missing and is written again."""
        with suppress(FileNotFoundError, errors.ModelFileError):
            return model_file.unpack(disk.read(path))
        return None


def _hash(what: object) -> str:
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:32]


def _fits(kept: dict[str, np.ndarray], model: Model, states: int) -> bool:
    """Whether these arrays are what `keep` stores of a bake of so many states with this model."""
    done, bones = next(iter(np.shape(kept.get("weights", ()))), 0), len(model.rest)
    dofs = 3 * int(model.free.sum()) if model.settings.solver == "FULL" else model.modes.shape[1]
    with_dents = max(dofs, next(iter(np.shape(kept.get("coordinates", ()))[1:]), 0))  # of collision
    shapes = {
        "coordinates": (done, with_dents),
        "weights": (done, len(model.residual_shapes)),
        "steps": (done, len(STEP)),
        "past": (4, dofs),
        "bones": (4, bones + 1, 12),
        "limit": (np.size(kept.get("limit", ())),),  # as much as it remembers
        "contact": (np.size(kept.get("contact", ())),),  # as much as was touched
        "dents": (with_dents - dofs,),
        "amounts": (done, 1 + len(model.residual_shapes)) if np.size(kept.get("amounts", ())) else (0, 0),
        "pose": (bones, 4, 4),
    }
    if model.settings.method == "STATIC":  # nothing moves
        shapes |= {"coordinates": (done, 0), "past": (0,), "bones": (0,)}
    return 0 < done <= states and all(
        name in kept and kept[name].shape == shape and kept[name].dtype == np.float64 and np.isfinite(kept[name]).all()
        for name, shape in shapes.items()
    )


def _modes_hash(model: Model) -> str:
    """A hash of the meaning of a bake's coordinates: modes computed on another machine may have other signs."""
    return hashlib.sha256(model.nodes.tobytes() + model.modes.tobytes()).hexdigest()


def _file_hash(path: Path) -> str:
    """The hash of a file; empty if it does not exist, because Blender shows nothing of it."""
    digest = hashlib.sha256()
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()
