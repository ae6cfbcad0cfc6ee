# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake becomes: shape keys and curves, and a verdict on them."""
