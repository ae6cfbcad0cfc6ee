# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels: their table, and a file for each section."""
