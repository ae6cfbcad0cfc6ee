# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders of all the kinds that artists have are where Blender shows them, or are named."""

import struct
from itertools import pairwise

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import SceneError
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders
from bl_ext.user_default.dynamic_morph_targets.scene.read.source import Source
from builders import BOX, make_box, rig_of, skinning_of
from layout import drawn
from test_colliders import assert_is_where_blender_has_it, tracks


@pytest.fixture
def arm(soft_arm):
    soft_arm.dynamorph.collision.use = True
    return soft_arm


def keyed(owner, path, first, last):
    for frame, value in ((1, first), (3, last)):
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)


def moving_box():
    """It goes along x, and is twisted by a modifier before its Collision."""
    box = make_box()
    keyed(box, "location", (0.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    twisted(box)
    box.modifiers.move(1, 0)
    return box


def twisted(box):
    twist = box.modifiers.new("Twist", "SIMPLE_DEFORM")
    twist.deform_method = "TWIST"
    keyed(twist, "angle", 0.0, 1.0)


def moving_empty():
    empty = bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(empty)
    keyed(empty, "location", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    return empty


def with_nodes(box, *kinds):
    """Its Geometry Nodes, before its Collision: (group, input, output, more nodes)."""
    group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    modifier = box.modifiers.new("Nodes", "NODES")
    modifier.node_group = group
    box.modifiers.move(1, 0)
    return group, *(group.nodes.new(kind) for kind in ("NodeGroupInput", "NodeGroupOutput", *kinds))


def chained(group, *nodes):
    for before, after in pairwise(nodes):
        group.links.new(before.outputs["Geometry"], after.inputs["Geometry"])


# Where Blender shows them ---------------------------------------------------------------------------------------------


def linked(folder):
    box, file = moving_box(), str(folder / "library.blend")
    bpy.data.libraries.write(file, {box}, fake_user=True)
    bpy.data.objects.remove(box)
    with bpy.data.libraries.load(file, link=True) as (_, wanted):
        wanted.objects = ["Box"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    return wanted.objects[0]


def overridden(folder):
    box = linked(folder)
    local = box.override_create()
    bpy.context.scene.collection.objects.unlink(box)
    bpy.context.scene.collection.objects.link(local)
    return local


def bent_after_collision(_folder):
    box = make_box()
    twisted(box)
    return box


def simplified(_folder):
    """As the viewport shows it: with Simplify, which a shot for speed alone has."""
    box, render = make_box(), bpy.context.scene.render
    keyed(box, "location", (0.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    box.modifiers.new("Smooth", "SUBSURF").levels = 3
    render.use_simplify, render.simplify_subdivision = True, 1
    return box


def from_a_mesh_cache(folder):
    box, file = make_box(), folder / "box.pc2"
    head = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, len(BOX), 0.0, 1.0, 4)
    file.write_bytes(head + b"".join((BOX * (1.0 + 0.2 * k)).astype("<f4").tobytes() for k in range(4)))
    cache = box.modifiers.new("Cache", "MESH_CACHE")
    cache.cache_format, cache.filepath, cache.frame_start = "PC2", str(file), 1
    cache.forward_axis, cache.up_axis = "POS_Y", "POS_Z"
    return box


def from_alembic(folder):
    box, file = moving_box(), str(folder / "box.abc")
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == box)
    bpy.ops.wm.alembic_export(filepath=file, selected=True, start=1, end=3, as_background_job=False)
    bpy.data.objects.remove(box)
    bpy.ops.wm.alembic_import(filepath=file, as_background_job=False)
    box = bpy.data.objects["Box"]
    assert [each.type for each in box.modifiers] == ["MESH_SEQUENCE_CACHE"]
    box.modifiers.new("Collision", "COLLISION")
    return box


def parented(_folder):
    box = make_box()
    box.parent = moving_empty()
    return box


def driven(_folder):
    box = make_box()
    box.driver_add("location", 0).driver.expression = "frame / 10"
    return box


def on_a_path(_folder):
    box = make_box()
    bpy.ops.curve.primitive_bezier_curve_add()
    follows = box.constraints.new("FOLLOW_PATH")
    follows.target, follows.use_fixed_location = bpy.context.object, True
    keyed(follows, "offset_factor", 0.0, 1.0)
    return box


def hooked(_folder):
    box = make_box()
    hook = box.modifiers.new("Hook", "HOOK")
    hook.object = moving_empty()
    hook.vertex_indices_set([0, 1, 2])
    return box


def on_another_rig(_folder):
    box, rig = make_box(), rig_of(bpy.data.objects["Arm"])
    box.vertex_groups.new(name="lower").add(range(8), 1.0, "REPLACE")
    other = rig.copy()
    bpy.context.scene.collection.objects.link(other)
    box.modifiers.new("Armature", "ARMATURE").object = other
    return box


def moved_by_nodes(_folder):
    box = make_box()
    group, start, end, offset, time = with_nodes(box, "GeometryNodeSetPosition", "GeometryNodeInputSceneTime")
    chained(group, start, offset, end)
    group.links.new(time.outputs["Frame"], offset.inputs["Offset"])
    return box


KINDS = (
    linked, overridden, bent_after_collision, simplified, from_a_mesh_cache, from_alembic, parented, driven, on_a_path,
    hooked, on_another_rig, moved_by_nodes,
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_a_collider_is_where_blender_shows_it(arm, tmp_path, kind):
    box = kind(tmp_path)
    bpy.context.view_layer.update()
    assert colliders.colliders(arm) == [box]
    found = tracks(arm)[box.name]
    assert abs(found.points(4) - found.points(0)).max() > 0.01
    assert_is_where_blender_has_it(box, found)


# What depends on the frames before ------------------------------------------------------------------------------------


def painted(box):
    bpy.context.view_layer.objects.active = box
    paint = box.modifiers.new("Paint", "DYNAMIC_PAINT")
    bpy.ops.dpaint.type_toggle(type="CANVAS")
    paint.canvas_settings.canvas_surfaces[0].surface_type = "WAVE"
    return paint


def exploded(box):
    box.modifiers.new("Particles", "PARTICLE_SYSTEM")
    return box.modifiers.new("Explode", "EXPLODE")


def on_particles(box):
    emitter = make_box("Emitter", location=(5.0, 5.0, 5.0), collision=False)
    emitter.modifiers.new("Particles", "PARTICLE_SYSTEM")
    modifier = box.modifiers.new("Instances", "PARTICLE_INSTANCE")
    modifier.object = emitter
    return modifier


@pytest.mark.parametrize("kind", [painted, exploded, on_particles])
def test_a_simulation_that_is_not_baked_is_refused(arm, kind):
    modifier = kind(make_box())
    with pytest.raises(SceneError, match=f"'Box' collides and is simulated by modifier '{modifier.name}': bake that"):
        tracks(arm)
    modifier.show_viewport = False
    assert tracks(arm)


@pytest.mark.parametrize("nested", [False, True])
def test_a_simulation_by_nodes_is_named_and_read_once_it_is_known(arm, scene, nested):
    box = make_box()
    group, start, end, first, last, offset = with_nodes(
        box, "GeometryNodeSimulationInput", "GeometryNodeSimulationOutput", "GeometryNodeSetPosition"
    )
    first.pair_with_output(last)
    offset.inputs["Offset"].default_value = (0.1, 0.0, 0.0)
    chained(group, start, first, offset, last, end)
    if nested:
        outer, start, end, inner = with_nodes(box, "GeometryNodeGroup")
        box.modifiers.remove(next(each for each in box.modifiers if each.type == "NODES" and each.node_group == group))
        inner.node_tree = group
        chained(outer, start, inner, end)
    text = "'Box' collides and is simulated by modifier 'Nodes"
    warned = extract.warnings(Source.of(skinning_of(arm)))
    assert text in " ".join(drawn(arm)) and any(each.startswith(text) for each in warned)
    for frame in range(1, 4):
        scene.frame_set(frame)
        bpy.context.view_layer.update()
    found = tracks(arm)["Box"]
    assert found.points(4)[0, 0] - found.points(0)[0, 0] == pytest.approx(0.2, abs=1e-5)
    assert_is_where_blender_has_it(box, found)
    arm.dynamorph.collision.use = False
    assert text not in " ".join(drawn(arm))
