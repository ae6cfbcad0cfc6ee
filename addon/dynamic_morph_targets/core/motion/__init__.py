# SPDX-License-Identifier: GPL-3.0-or-later
"""A shot: samples of the rig, poses, forces, and the simulation of a model that follows them."""
