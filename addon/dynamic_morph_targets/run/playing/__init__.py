# SPDX-License-Identifier: GPL-3.0-or-later
"""What Live plays: soft skins that move while Blender does."""
