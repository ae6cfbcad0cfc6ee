# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes with work and Live: first look, previews, the artist's hand, colors, curves, and what follows edits."""
