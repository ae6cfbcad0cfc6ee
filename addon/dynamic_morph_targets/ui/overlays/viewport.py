# SPDX-License-Identifier: GPL-3.0-or-later
"""What the 3D viewport draws of a soft skin: its cage, posed; where it touches something; its surface, colored; the
targets' weights over the frames.

Callbacks of Blender's drawing: they only look, and what cannot be shown at the moment is not drawn. Batches are kept
for as long as what they show is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as iface_
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Matrix, Vector

from ...core import engine, errors, logger, states
from ...core.model.model import Model
from ...core.motion.rig_samples import RigSamples
from ...run import live
from ...run.playing import touching
from ...run.tools import heat
from ...scene import events, references, registration, skin
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.read import mesh_data
from ...scene.remembered import opened
from ...scene.store import model_store
from ...write.display import beside, comparison
from .gpu_drawing import (
    MARGIN,
    PADDING,
    TEXT,
    draw_lines,
    draw_points,
    draw_rectangle,
    draw_text,
    is_shown,
    make_batch,
    pixels,
    text_width,
)
from .graph import draw_graph, free_rectangle

SHADES = 32  # in the legend of the surface's colors
GIZMOS = 90.0  # that Blender's own buttons take at the right
LEGEND = 160.0  # wide, of what the colors of the surface mean
SHADED = 0.55  # how light the colored surface is where it is seen from the side
NEARER = 2e-3  # of the body's size: that the colored surface is drawn before the mesh
CONTACT_COLORS = 3, 0  # of the theme's collection colors, where the skin is pushed, and where inside: green and red
HELD_COLOR = 2  # of the theme's collection colors: unlike those of selected and of unselected vertices


# The cage ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CageDrawing:
    """What is drawn of a model's tetrahedra: k of its nodes.

    rest (k, 3) bind space; weights (k, B + 1); edges (E, 2) of the surface and held (h,), both indices of those k.
    """

    rest: np.ndarray
    weights: np.ndarray
    edges: np.ndarray
    held: np.ndarray

    def posed(self, bones: np.ndarray) -> np.ndarray:
        """Positions (k, 3), in the space that skin matrices (B + 1, 3, 4) lead to."""
        skin = (self.weights @ bones.reshape(len(bones), 12).astype(np.float32)).reshape(-1, 3, 4)
        return np.einsum("kij,kj->ki", skin[:, :, :3], self.rest) + skin[:, :, 3]


def cage_of(model: Model) -> CageDrawing:
    """The drawing of the cage of a model.Model with tetrahedra."""
    edges = surface_edges(model.tets)
    held = model.pinned.astype(bool)
    if len(model.hold):  # by thickness: nothing is pinned
        held = held | (model.hold > 0.5)
    drawn = np.zeros(len(model.nodes), bool)
    drawn[edges] = True
    drawn |= held
    place = np.cumsum(drawn) - 1
    return CageDrawing(
        rest=model.nodes[drawn].astype(np.float32),
        weights=model.node_weights[drawn].astype(np.float32),
        edges=place[edges].astype(np.uint32),
        held=place[held],
    )


def surface_edges(tets: np.ndarray) -> np.ndarray:
    """Edges (E, 2) of the triangles that belong to one tetrahedron of (m, 4) only."""
    faces = np.sort(tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    outer = faces[count == 1]
    return np.unique(outer[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=0)


@states.cached(opened, 4)
def _cage(session_uid: int, _content_id: str) -> CageDrawing | None:
    try:
        model = model_store.load_model(skin.find(session_uid))
    except engine.expected_errors():  # the panel says it
        return None
    return cage_of(model) if len(model.tets) else None


@states.cached(opened, 4)
def _order(session_uid: int, _bones: tuple) -> list[int]:
    rig = skin.find(session_uid)
    return rig_motion.pose_order(rig, references.rest_skeleton(rig.data))


def skin_matrices(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> np.ndarray | None:
    """Skin matrices (B + 1, 3, 4) float32 of the built model: of the pose in which the mesh is shown.

    They lead to the world in Blender units, which is where it is drawn. Linear also where Blender's skinning is not,
    which is near enough to be looked at. None if the armature has other bones now than when it was built.
    """
    model = model_store.load_model(obj)
    modifier = checks.armature_modifier(obj)
    rig = modifier.object
    order = _order(rig.session_uid, references.bones_key(rig.data))
    posed = rig.evaluated_get(depsgraph)
    if not len(order) == len(posed.pose.bones) == len(model.rest):
        return None
    edited = obj.mode == "EDIT" and not modifier.show_in_editmode
    pose = model.rest if edited else rig_motion.pose_matrices(posed, order)
    rig_world, world = (np.array(moving.matrix_world)[None] for moving in (posed, obj.evaluated_get(depsgraph)))
    bones = RigSamples(pose[None], rig_world, world).skin_matrices(model.skeleton, model.to_bind)[0]
    return bones.astype(np.float32) if np.isfinite(bones).all() else None


@states.cached(opened, 4)
def _cage_batches(session_uid: int, content_id: str, bones: bytes) -> tuple[gpu.types.GPUBatch, gpu.types.GPUBatch]:
    """Batches of the edges and of the held nodes, world space."""
    cage = _cage(session_uid, content_id)
    assert cage is not None  # otherwise nothing is drawn
    points = cage.posed(np.frombuffer(bones, np.float32).reshape(-1, 3, 4))
    return make_batch("LINES", points, cage.edges), make_batch("POINTS", points[cage.held])


def _draw_cage() -> None:
    """POST_VIEW."""
    context = bpy.context
    obj = skin.mesh_in(context)
    if not context.window_manager.dynamorph.cage or not is_shown(context, obj):
        return
    content_id = obj.dynamorph.model.content_id
    if not content_id or _cage(obj.session_uid, content_id) is None:
        return
    bones = skin_matrices(obj, context.view_layer.depsgraph)
    if bones is None:
        return
    edges, held = _cage_batches(obj.session_uid, content_id, bones.tobytes())
    theme = context.preferences.themes[0]
    gpu.state.depth_test_set("LESS_EQUAL")
    draw_lines(edges, (*theme.view_3d.bone_pose, 0.6), 1.0)
    gpu.state.depth_test_set("NONE")  # they are near the bones, inside the body
    draw_points(held, (*theme.collection_color[HELD_COLOR].color, 0.9), 3.0)


# Contact -----------------------------------------------------------------------------------------------------------


def _draw_contact() -> None:
    """POST_VIEW."""
    context = bpy.context
    obj = skin.mesh_in(context)
    if not context.window_manager.dynamorph.contact or not is_shown(context, obj):
        return
    depsgraph, colors = context.view_layer.depsgraph, context.preferences.themes[0].collection_color
    points = mesh_data.shown_points(obj, depsgraph)
    for vertices, color, size in zip(
        touching.touching(obj, points, depsgraph), CONTACT_COLORS, (4.0, 8.0), strict=True
    ):
        if len(vertices):  # on top, because what pushes them hides them
            draw_points(make_batch("POINTS", points[vertices]), (*colors[color].color, 0.9), size)


# The surface -------------------------------------------------------------------------------------------------------


def painted(context: bpy.types.Context, obj: bpy.types.Object) -> tuple[dict[int, np.ndarray], str, list[str]] | None:
    """What surfaces are colored by, if they are: values (V,) by session_uid; the legend's title, and what it says of
    the values 0, 0.5 and 1.

    Raises what is in the way.
    """
    display = context.window_manager.dynamorph
    if display.heat:
        limit = heat.limit_of(obj)
        return heat.displacements(obj), iface_("Displacement, of Size"), ["0", f"{limit / 2:.2%}", f"{limit:.2%}"]
    if display.firmness:
        return heat.firmness(obj), iface_("Firmness"), [iface_("soft"), iface_("unchanged"), iface_("held")]
    if display.max_distance:
        return heat.max_distance(obj), iface_("Max Distance"), [iface_("bones only"), "50%", iface_("as set")]
    return None


def _draw_surface() -> None:
    """POST_VIEW."""
    context = bpy.context
    obj = skin.mesh_in(context)
    if not is_shown(context, obj) or obj.mode == "EDIT":
        return
    shown = painted(context, obj)
    if shown is None:
        return
    meshes = {skin.find(uid): values for uid, values in shown[0].items()}
    in_view = {mesh: values for mesh, values in meshes.items() if mesh.visible_in_viewport_get(context.space_data)}
    _draw_surfaces(in_view, context.view_layer.depsgraph, NEARER * max(obj.dimensions))


def _draw_surfaces(meshes: dict, depsgraph: bpy.types.Depsgraph, nearer: float) -> None:
    """Meshes with values (V,) each, colored; nearer: to the viewer, in view space, than they are."""
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    with gpu.matrix.push_pop():
        view = gpu.matrix.get_model_view_matrix()
        gpu.matrix.load_matrix(Matrix.Translation((0.0, 0.0, nearer)) @ view)
        for mesh, values in meshes.items():
            if len(values) == len(mesh.data.vertices):
                points, corners = mesh_data.shown_points(mesh, depsgraph), triangles(mesh)
                light = shade(points, corners, np.array(view)[2, :3])
                batch = _colored(points, heat.colors(values) * light[:, None], corners)
                batch.draw(gpu.shader.from_builtin("SMOOTH_COLOR"))
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def shade(points: np.ndarray, corners: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """How light points (V, 3) of triangles (T, 3) are, seen from the direction `toward` (3,): SHADED to 1, so that the
    form shows.
    """
    a, b, c = points[corners].swapaxes(0, 1)
    across = np.cross(b - a, c - a)
    normals = np.column_stack([np.bincount(corners.ravel(), np.repeat(axis, 3), len(points)) for axis in across.T])
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(toward)
    facing = np.abs(normals @ toward) / np.where(lengths > 0.0, lengths, 1.0)
    return (SHADED + (1.0 - SHADED) * facing).astype(np.float32)


def triangles(obj: bpy.types.Object) -> np.ndarray:
    """The triangles of the mesh as it is, (T, 3) vertices."""
    mesh = obj.data
    mesh.calc_loop_triangles()
    corners = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", corners.ravel())
    return corners


def _colored(points: np.ndarray, colors: np.ndarray, corners: np.ndarray) -> gpu.types.GPUBatch:
    """Triangles (T, 3) between points (V, 3) with RGB (V, 3)."""
    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id="pos", comp_type="F32", len=3, fetch_mode="FLOAT")
    layout.attr_add(id="color", comp_type="F32", len=4, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(layout, len(points))
    vertices.attr_fill("pos", np.ascontiguousarray(points, np.float32))
    opaque = np.column_stack([colors, np.ones(len(colors), np.float32)])
    vertices.attr_fill("color", np.ascontiguousarray(opaque, np.float32))
    return gpu.types.GPUBatch(type="TRIS", buf=vertices, elem=gpu.types.GPUIndexBuf(type="TRIS", seq=corners))


def _draw_surface_legend() -> None:
    """POST_PIXEL."""
    context = bpy.context
    obj = skin.mesh_in(context)
    first = next(region for region in context.area.regions if region.type == "WINDOW")
    if context.region != first or not is_shown(context, obj):
        return
    others = [region for region in context.area.regions if region.type != "WINDOW"]
    left, bottom, right, top = free_rectangle(context.region, others)
    try:
        shown = painted(context, obj)
    except engine.expected_errors() as error:
        text = context.preferences.themes[0].user_interface.wcol_box.text
        draw_text(errors.sentence(error), left + pixels(PADDING), bottom + pixels(MARGIN), text)
        return
    right, top = right - pixels(GIZMOS), top - pixels(MARGIN)
    if shown and right - pixels(LEGEND) > left:
        _draw_scale(right, top, *shown[1:])


def _draw_scale(right: float, top: float, title: str, texts: list[str]) -> None:
    """What the colors of the surface mean."""
    box = bpy.context.preferences.themes[0].user_interface.wcol_box
    pad, line, width = pixels(PADDING), pixels(TEXT + 4.0), pixels(LEGEND)
    left, bottom = right - width, top - 3.0 * line - 2.0 * pad
    draw_rectangle(left, bottom, right, top, (*box.inner[:3], 0.85))
    left, right, top = left + pad, right - pad, top - pad
    draw_text(title, left, top - 0.8 * line, box.text)
    for k, color in enumerate(heat.colors(np.linspace(0.0, 1.0, SHADES)).tolist()):
        begin, end = (left + (right - left) * at / SHADES for at in (k, k + 1))
        draw_rectangle(begin, top - 1.9 * line, end, top - 1.2 * line, (*color, 1.0))
    for part, text in enumerate(texts):  # at the left, in the middle, at the right
        at = part / (len(texts) - 1)
        draw_text(text, left + at * (right - left - text_width(text)), top - 2.8 * line, box.text)


# Side by side ------------------------------------------------------------------------------------------------------


def names_beside(obj: bpy.types.Object, empty: bpy.types.Object) -> tuple[str, str]:
    """What the soft skin `obj` shows, and what the copy beside it does."""
    if comparison.is_plain(obj) or not comparison.can_show(obj):
        name = iface_("Bones Only")
    elif live.is_on(obj):
        name = iface_("Live {slot}").format(slot=obj.dynamorph.live.slot)
    else:
        name = iface_("Bake {slot}").format(slot=obj.dynamorph.bake.slot)
    slot = empty.dynamorph.live.beside_slot
    return name, iface_("Bake {slot}").format(slot=slot) if slot else iface_("Bones Only")


def _draw_names_beside() -> None:
    """POST_PIXEL. Above each of two bodies that are compared, what it shows."""
    context = bpy.context
    obj = skin.mesh_in(context)
    empty = beside.find(obj) if is_shown(context, obj) else None
    if empty is None:
        return
    evaluated = obj.evaluated_get(context.view_layer.depsgraph)
    corners = [evaluated.matrix_world @ Vector(corner) for corner in evaluated.bound_box]
    low, high = (Vector(map(extreme, zip(*corners, strict=True))) for extreme in (min, max))
    above = Vector((0.5 * (low.x + high.x), 0.5 * (low.y + high.y), high.z))
    box = context.preferences.themes[0].user_interface.wcol_box
    for name, point in zip(names_beside(obj, empty), (above, above + empty.location), strict=True):
        place = location_3d_to_region_2d(context.region, context.region_data, point)
        if place is None:  # behind the view
            continue
        pad, width = pixels(PADDING), text_width(name)
        left, bottom = place.x - 0.5 * width, place.y + 2.0 * pad
        draw_rectangle(
            left - pad, bottom - pad, left + width + pad, bottom + pixels(TEXT) + pad, (*box.inner[:3], 0.85)
        )
        draw_text(name, left, bottom, box.text)


def quietly(draw: Callable[[], object]) -> Callable[[], None]:
    """A callback that draws nothing where `draw` fails, and logs a bug once: it would come back at every redraw.

    What is expected the panel or the legend says.
    """

    def callback() -> None:
        try:
            draw()
        except Exception as error:
            if not isinstance(error, engine.expected_errors()):
                logger.log_once(error)
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            gpu.state.blend_set("NONE")

    return callback


@persistent
def _painted(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """depsgraph_update_post."""
    if depsgraph.id_type_updated("MESH"):
        heat.edited()


@persistent
def _undone(*_args: object) -> None:
    """undo_post, redo_post."""
    heat.edited()


HANDLERS = {
    "depsgraph_update_post": _painted,
    "undo_post": _undone,
    "redo_post": _undone,
}


def register() -> None:
    events.add(HANDLERS)
    if not bpy.app.background:
        in_view = (_draw_surface, _draw_cage, _draw_contact)
        on_top = (draw_graph, _draw_names_beside, _draw_surface_legend)
        for draw, moment in [(draw, "POST_VIEW") for draw in in_view] + [(draw, "POST_PIXEL") for draw in on_top]:
            registration.draw_in_view(__name__, quietly(draw), moment)


def unregister() -> None:
    events.remove(HANDLERS)
    registration.take_back(__name__)
