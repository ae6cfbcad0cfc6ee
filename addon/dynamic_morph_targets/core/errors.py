# SPDX-License-Identifier: GPL-3.0-or-later
"""What can go wrong that an artist can mend: one tree with one base."""

from __future__ import annotations


class InputError(ValueError):
    """The command line or the file does not say what to do. The message does."""


class ClipError(ValueError):
    """A bake cannot become that. The message says what to do."""


class CollectError(ValueError):
    """Reports are missing or wrong. The message lists them."""


class ExportError(ValueError):
    """The character cannot be exported so. The message names what is in the way and what to do."""


class SceneError(ValueError):
    """The scene cannot be simulated as it is. The message names the object and what to do."""


class Cancelled(Exception):
    """The user stopped the job."""


class NativeMissing(Exception):
    """The compiled engine cannot be imported. The message says why and what to do."""


class SelfCheckError(Exception):
    """The engine returned something that cannot be right."""


class ModelFileError(ValueError):
    """The bytes are not a model that this version can read. The message says why."""


class SetupError(ValueError):
    """A setup cannot be read. The message says what is wrong in it."""


class SinkError(ValueError):
    """The result cannot be written here. The message names the data and what to do."""
