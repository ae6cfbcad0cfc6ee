# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes a bake, and takes it back."""
