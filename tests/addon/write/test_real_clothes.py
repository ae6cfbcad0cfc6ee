# SPDX-License-Identifier: GPL-3.0-or-later
"""The swimsuit and the eyes of a body made by others."""

import bpy
import builders
import numpy as np
import pytest
import real_character
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from builders import evaluated_points
from robustness import OPS, bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
pytestmark = pytest.mark.skipif(
    not real_character.CHARACTER.exists(), reason="needs ../shared/assets/mh_male_53bones.blend"
)
FRAMES = range(9, 46, 4)


def depths(suit, body):
    """How deep the vertices of `suit` are inside `body`, as Blender shows them: (F, V) in meters."""
    triangles = mesh_data.mesh_triangles(body.data).tolist()
    out = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        out.append(builders.depths(evaluated_points(suit), evaluated_points(body), triangles))
    return np.maximum(out, 0.0)


def test_the_swimsuit_stays_on_the_body(addon):
    """The swinging body passes through a plainly skinned suit, but no deeper through a baked one than in the file."""
    body = real_character.open_character("gen_jump")
    suit = bpy.data.objects["Swimsuit"]
    suit.data.shape_keys.animation_data.action = None
    as_authored = depths(suit, body)
    OPS.find_attachments()
    choices = {piece.object.name: piece for piece in body.dynamorph.attachments}
    assert {name: piece.attached_by for name, piece in choices.items()} == {"Eyes": "RIGID", "Swimsuit": "WITH_BODY"}
    choices["Swimsuit"].attached_by = "RIGID"
    bake(body, frames=(1, 45), substeps=2)
    skinned = depths(suit, body)
    choices["Swimsuit"].attached_by = "WITH_BODY"
    bake(body, frames=(1, 45), substeps=2)
    carried = depths(suit, body)
    assert skinned.max() > 0.010 > 0.008 > carried.max()
    assert (carried > 0.001).mean() < 1.5 * (as_authored > 0.001).mean() < 0.5 * (skinned > 0.001).mean()
