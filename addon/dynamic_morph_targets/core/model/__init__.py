# SPDX-License-Identifier: GPL-3.0-or-later
"""A body as the engine computes with it: cage, hold, rigid parts, the model and its build."""
