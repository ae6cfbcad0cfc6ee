# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons, panels and what the viewport draws."""
