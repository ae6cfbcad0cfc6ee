# SPDX-License-Identifier: GPL-3.0-or-later
"""Models that were built, and whether they and the bakes are up to date."""
