# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are neither Blender's nor the engine's. Never imports bpy."""
