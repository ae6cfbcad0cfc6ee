# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads Blender: what the artist authored, and the scene as arrays."""
