# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of evidence/gaps.py: python evidence/gaps_scene.py FILE VERTICES, a process of its own."""

import sys

from project import ROOT  # noqa: F401

import bpy
from how_long import character

body = character(int(sys.argv[2]))
bpy.context.view_layer.objects.active = body
body.select_set(True)
bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 120
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1], compress=False)
print(len(body.data.vertices), "vertices")
