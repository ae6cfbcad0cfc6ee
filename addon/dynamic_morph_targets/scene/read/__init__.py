# SPDX-License-Identifier: GPL-3.0-or-later
"""An object and its rig as Blender has them: meshes, weights, transforms."""
