# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves over a shot: the rig, force fields, colliders."""
