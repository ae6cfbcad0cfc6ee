# SPDX-License-Identifier: GPL-3.0-or-later
"""Live: soft skins that move while Blender plays, previews, and the artist's hand."""
