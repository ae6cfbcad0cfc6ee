# SPDX-License-Identifier: GPL-3.0-or-later
"""The errors that an artist can do something about: one tree with one base. Everything else that is raised is a bug."""

from __future__ import annotations

import errno

from .message import Message

NO_MEMORY = "There is not enough memory for this. Close other programs, bake fewer frames, or lower Cage Nodes or Modes"

# Errors that come back however often the call is repeated. All others may pass: a full disk, a lost network, another
# process.
PERMANENT = {
    errno.EACCES, errno.EEXIST, errno.EFBIG, errno.EINVAL, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.ENODEV,
    errno.ENOENT, errno.ENOSYS, errno.ENOTDIR, errno.ENXIO, errno.EOPNOTSUPP, errno.EPERM, errno.EROFS,
}  # fmt: skip
LOST = {53, 54, 55, 59, 64, 67, 121, 1231}  # codes of Windows for a network that went away, whatever errno says
FULL = "Free some space, or choose another folder"
PROTECTED = "Choose a folder and a file that can be written to"
REMEDIES = {
    errno.ENOSPC: FULL, errno.EDQUOT: FULL, errno.EROFS: PROTECTED, errno.EACCES: PROTECTED, errno.EPERM: PROTECTED,
    errno.ENOENT: "Check the path, or make that folder first", errno.ENAMETOOLONG: "Choose a shorter name",
    errno.EISDIR: "This is a folder: add a file name",
    errno.ENOTDIR: "Part of this path is a file, not a folder: choose another path",
    errno.EINVAL: "Choose another name",
}  # fmt: skip
CHECK_DISK = "Check the disk or the network"
# What the engine advises, which knows nothing of Blender -> what an artist does there.
IN_BLENDER = {
    "Delete them, or repair what moves them.": "Delete them, or reset the shape key or modifier that moves them.",
    "Give it some.": "Model or unhide some, then build again.",
    "Scale it.": "Scale it and apply the scale.",
    "Give it thickness.": "Give it thickness (Solidify modifier, applied).",
    "Check the scale of the bones.": "Check the scale of the armature.",
    "Repair that shape.": "Repair its shape key.",
    "Pin fewer nodes,": "Lower Bone Pinning,",
    ", or hold the body.": ", raise Bone Pinning, or set Hold to Thickness.",
    "Use more nodes,": "Raise Cage Nodes,",
    "or use more nodes.": "or raise Cage Nodes.",
    "Ask for fewer, or use make_basis.": "Lower Detail, or take the modes from Vibration.",
    "Check what poses it.": "Check its drivers and constraints.",
    "Check what poses it at this step.": "Check its drivers and constraints at this frame.",
    "Give one of them another.": "Pose the character differently and capture one of them again.",
    "Give them poses that differ more,": "Capture poses that differ more,",
    "or merge vertices that are close together.": "or clean the mesh (Mesh > Clean Up > Merge by Distance).",
    "Close them, or use": "Close them (Mesh > Clean Up > Fill Holes), or use",
    "or install it again.": "or reinstall Blender.",
}


class DynamorphError(Exception):
    """The message is for the artist: it says what is wrong and what to do.

    text: in English, with {names} where values belong, if there are any: see `message.Message`.
    """

    def __init__(self, text: str = "", /, **values: object):
        super().__init__(Message(text, **values) if values else text)


class InputError(DynamorphError):
    """The command line or the file does not say what to do. The message does."""


class ReportPageError(DynamorphError):
    """Reports are missing or wrong. The message lists them."""


class ExportError(DynamorphError):
    """The character cannot be exported so. The message names what is in the way and what to do."""


class SceneError(DynamorphError):
    """The scene cannot be simulated as it is. The message names the object and what to do."""


class MemoryShortError(DynamorphError, MemoryError):
    """Too little memory is free now. The message says how much is needed, and what to lower."""


class Cancelled(DynamorphError):
    """The user stopped the job."""


class EngineNotFoundError(DynamorphError):
    """The compiled engine cannot be imported. The message says why and what to do."""


class ProcessError(DynamorphError):
    """The process that computes cannot be started, or crashes. The message says what to do."""


class SelfCheckError(DynamorphError):
    """The engine returned something that cannot be right."""


class ModelFileError(DynamorphError):
    """The bytes are not a model that this version can read. The message says why."""


class FitError(DynamorphError):
    """A material cannot be fitted to what was measured. The message says why."""


class FileInUseError(DynamorphError, OSError):
    """Another program has a file open, or has just written it. Trying again later may help."""


class RecordError(DynamorphError):
    """What an earlier build or bake has noted in the .blend cannot be read. The message says what to do."""


class SetupError(DynamorphError):
    """A setup cannot be read. The message says what is wrong in it."""


class WriteError(DynamorphError):
    """The result cannot be written here. The message names the data and what to do."""


def sentence(error: BaseException) -> str:
    """What the artist reads of an expected error (see `engine.expected_errors`), for `message.translated`."""
    if isinstance(error, DynamorphError):
        return error.args[0]
    if isinstance(error, MemoryError):
        return NO_MEMORY
    if isinstance(error, OSError) and error.strerror:
        remedy = Message(REMEDIES.get(error.errno or 0, CHECK_DISK))
        text = "'{file}': {reason}. {remedy}" if error.filename else "{reason}. {remedy}"
        return Message(text, file=error.filename, reason=error.strerror, remedy=remedy)
    first = error.args[0] if error.args else ""
    text = first if isinstance(first, str) else str(error)  # first: perhaps a Message
    return text if isinstance(error, DynamorphError) else _in_blender(text)


def _in_blender(text: str) -> str:
    """A sentence of the engine's with what an artist does instead of what it advises; all others as they are."""
    for advice, remedy in IN_BLENDER.items():
        if advice in text:
            text = text.replace(advice, remedy)
    return text


def is_transient(error: BaseException) -> bool:
    """Whether the same may succeed at another time: the fault is the machine's, not of what was asked for."""
    if isinstance(error, OSError):
        return getattr(error, "winerror", None) in LOST or error.errno not in PERMANENT
    return isinstance(error, MemoryError)
