# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh shows for a while: Live, and comparisons."""
