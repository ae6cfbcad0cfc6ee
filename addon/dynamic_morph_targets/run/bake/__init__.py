# SPDX-License-Identifier: GPL-3.0-or-later
"""Build and Bake: what a job reads, computes and writes."""
