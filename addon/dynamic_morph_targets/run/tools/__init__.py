# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes with the work: the first look, colors, curves, and what follows the artist's edits."""
