# SPDX-License-Identifier: GPL-3.0-or-later
"""What computes: in a process of its own while a window waits."""
