# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported before bpy, it keeps anybody's own preferences and extensions out of what is measured."""

import os
import tempfile

os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="dynamorph_evidence_")
