# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes Blender: shape keys, curves, modifiers, stored models, settings."""
