# SPDX-License-Identifier: GPL-3.0-or-later
"""What is between Blender and the engine, on plain arrays. Never imports bpy."""
