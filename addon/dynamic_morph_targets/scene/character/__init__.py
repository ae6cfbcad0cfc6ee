# SPDX-License-Identifier: GPL-3.0-or-later
"""What was read and checked, as one character."""
