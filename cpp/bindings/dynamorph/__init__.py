# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamorph: the engine of dynamic morph targets, with NumPy arrays in and out."""

from importlib import metadata

from dynamorph import classes as classes  # before the others, because it completes what they use
from dynamorph._core import *  # noqa: F403
from dynamorph.meshing import Meshing as Meshing
from dynamorph.meshing import dismiss_mesher as dismiss_mesher
from dynamorph.meshing import mesh_body as mesh_body
from dynamorph.meshing import prepare_mesher as prepare_mesher
from dynamorph.meshing import tet_quality as tet_quality
from dynamorph.model_file import pack_model as pack_model
from dynamorph.model_file import pack_soft_skin as pack_soft_skin

try:
    __version__ = metadata.version("dynamorph")
except metadata.PackageNotFoundError:  # it runs from where it was compiled
    __version__ = ""
