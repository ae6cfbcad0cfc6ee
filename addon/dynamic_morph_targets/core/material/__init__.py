# SPDX-License-Identifier: GPL-3.0-or-later
"""How soft tissue feels: stiffness, damping and density, and what calibrates them."""
