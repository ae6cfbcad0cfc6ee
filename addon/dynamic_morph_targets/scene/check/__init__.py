# SPDX-License-Identifier: GPL-3.0-or-later
"""What prevents a simulation, and what looks unintended."""
