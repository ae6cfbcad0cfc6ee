# SPDX-License-Identifier: GPL-3.0-or-later
"""What artists author, as properties of the object."""
