# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons, one file for each family."""
