# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes what the artist authored."""
