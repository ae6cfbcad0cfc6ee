# SPDX-License-Identifier: GPL-3.0-or-later
"""What the 3D viewport draws of a soft skin: its cage, posed; its surface, colored; the targets' weights over the
frames.

Callbacks of Blender's drawing: they only look, and what cannot be shown at the moment is not drawn. Batches are kept
for as long as what they show is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import blf
import bpy
import gpu
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from mathutils import Matrix

from . import extract, heat, influence, jobs, properties
from .scene_data import RigSamples

HEIGHT = 120.0  # of the graph; this and the other lengths are in pixels at a resolution scale of 1
MARGIN, PADDING, TEXT, SQUARE = 8.0, 6.0, 11.0, 8.0
NARROW = 160.0  # than this a graph is not worth drawing
SHADES = 32  # in the legend of the surface's colors
GIZMOS = 90.0  # that Blender's own buttons take at the right
LEGEND = 160.0  # wide, of what the colors of the surface mean
SHADED = 0.55  # how light the colored surface is where it is seen from the side
NEARER = 2e-3  # of the body's size: that the colored surface is drawn before the mesh
HELD = 2  # of the theme's collection colours: unlike those of selected and of unselected vertices
HUES = (4, 1, 3, 6, 0, 5, 2, 7)  # of them, so that neighbours in the list differ


# The cage ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cage:
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


def cage_of(model) -> Cage:
    """Of a build.Model with tetrahedra."""
    edges = surface_edges(model.tets)
    held = model.pinned.astype(bool)
    if len(model.hold):  # by thickness: nothing is pinned
        held = held | (model.hold > 0.5)
    drawn = np.zeros(len(model.nodes), bool)
    drawn[edges] = True
    drawn |= held
    place = np.cumsum(drawn) - 1
    return Cage(
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


@lru_cache(maxsize=4)
def _cage(session_uid: int, _content_id: str) -> Cage | None:
    try:
        model = jobs.load_model(jobs.find(session_uid))
    except jobs.expected_errors():  # the panel says it
        return None
    return cage_of(model) if len(model.tets) else None


@lru_cache(maxsize=4)
def _order(session_uid: int, _bones: tuple) -> list[int]:
    rig = jobs.find(session_uid)
    return extract.pose_order(rig, properties.rest_skeleton(rig.data))


def skin_matrices(obj, depsgraph) -> np.ndarray | None:
    """Skin matrices (B + 1, 3, 4) float32 of the built model: of the pose in which the mesh is shown.

    They lead to the world in Blender units, which is where it is drawn. Linear also where Blender's skinning is not,
    which is near enough to be looked at. None if the armature has other bones now than when it was built.
    """
    model = jobs.load_model(obj)
    modifier = extract.armature_modifier(obj)
    rig = modifier.object
    order = _order(rig.session_uid, properties.bones_key(rig.data))
    posed = rig.evaluated_get(depsgraph)
    if not len(order) == len(posed.pose.bones) == len(model.rest):
        return None
    edited = obj.mode == "EDIT" and not modifier.show_in_editmode
    pose = model.rest if edited else extract.pose_matrices(posed, order)
    worlds = [np.array(moving.matrix_world)[None] for moving in (posed, obj.evaluated_get(depsgraph))]
    bones = RigSamples(pose[None], *worlds).skin_matrices(model.skeleton, model.to_bind)[0]
    return bones.astype(np.float32) if np.isfinite(bones).all() else None


@lru_cache(maxsize=4)
def _cage_batches(session_uid: int, content_id: str, bones: bytes):
    """Batches of the edges and of the held nodes, world space."""
    cage = _cage(session_uid, content_id)
    points = cage.posed(np.frombuffer(bones, np.float32).reshape(-1, 3, 4))
    return _batch("LINES", points, cage.edges), _batch("POINTS", points[cage.held])


def _draw_cage():
    """POST_VIEW."""
    context = bpy.context
    obj = properties.mesh_in(context)
    if not context.window_manager.dynamorph.cage or not _is_shown(context, obj):
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
    _draw_lines(edges, (*theme.view_3d.bone_pose, 0.6), 1.0)
    gpu.state.depth_test_set("NONE")  # they are near the bones, inside the body
    _draw_points(held, (*theme.collection_color[HELD].color, 0.9), 3.0)


# The surface -------------------------------------------------------------------------------------------------------


def painted(context, obj) -> tuple[dict[int, np.ndarray], str, str, str] | None:
    """What surfaces are colored by, if they are: values (V,) by session_uid; the legend's title, words for 0 and 1.

    Raises what is in the way.
    """
    display = context.window_manager.dynamorph
    if display.heat:
        limit = f"{heat.limit_of(obj):.1%}"
        return heat.displacements(obj), iface_("Displacement"), "0", iface_("{limit} of size").format(limit=limit)
    if display.hold:
        return heat.holds(obj), iface_("Hold"), iface_("soft"), iface_("held")
    return None


def shown_points(obj, depsgraph) -> np.ndarray:
    """World positions (V, 3) of the mesh's own vertices as shown; modifiers that add some put theirs after them.

    Raises SceneError where modifiers take some away.
    """
    evaluated = obj.evaluated_get(depsgraph)
    count = len(obj.data.vertices)
    if len(evaluated.data.vertices) < count:
        raise extract.SceneError(f"Modifiers take vertices of '{obj.name}' away, so it cannot be colored")
    points = np.empty((len(evaluated.data.vertices), 3), np.float32)
    evaluated.data.attributes["position"].data.foreach_get("vector", points.ravel())
    world = np.array(evaluated.matrix_world, np.float32)
    return points[:count] @ world[:3, :3].T + world[:3, 3]


def _draw_surface():
    """POST_VIEW."""
    context = bpy.context
    obj = properties.mesh_in(context)
    if not _is_shown(context, obj) or obj.mode == "EDIT":
        return
    shown = painted(context, obj)
    if shown is None:
        return
    meshes = {jobs.find(uid): values for uid, values in shown[0].items()}
    in_view = {mesh: values for mesh, values in meshes.items() if mesh.visible_in_viewport_get(context.space_data)}
    _draw_surfaces(in_view, context.view_layer.depsgraph, NEARER * max(obj.dimensions))


def _draw_surfaces(meshes: dict, depsgraph, nearer: float):
    """Meshes with values (V,) each, colored; nearer: to the viewer, in view space, than they are."""
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    with gpu.matrix.push_pop():
        view = gpu.matrix.get_model_view_matrix()
        gpu.matrix.load_matrix(Matrix.Translation((0.0, 0.0, nearer)) @ view)
        for mesh, values in meshes.items():
            if len(values) == len(mesh.data.vertices):
                points, corners = shown_points(mesh, depsgraph), triangles(mesh)
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


def triangles(obj) -> np.ndarray:
    """Of the mesh as it is, (T, 3) vertices."""
    mesh = obj.data
    mesh.calc_loop_triangles()
    corners = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", corners.ravel())
    return corners


def _colored(points: np.ndarray, colors: np.ndarray, corners: np.ndarray):
    """Triangles (T, 3) between points (V, 3) with RGB (V, 3)."""
    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id="pos", comp_type="F32", len=3, fetch_mode="FLOAT")
    layout.attr_add(id="color", comp_type="F32", len=4, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(layout, len(points))
    vertices.attr_fill("pos", np.ascontiguousarray(points, np.float32))
    opaque = np.column_stack([colors, np.ones(len(colors), np.float32)])
    vertices.attr_fill("color", np.ascontiguousarray(opaque, np.float32))
    return gpu.types.GPUBatch(type="TRIS", buf=vertices, elem=gpu.types.GPUIndexBuf(type="TRIS", seq=corners))


def _draw_surface_legend():
    """POST_PIXEL."""
    context = bpy.context
    obj = properties.mesh_in(context)
    first = next(region for region in context.area.regions if region.type == "WINDOW")
    if context.region != first or not _is_shown(context, obj):
        return
    others = [region for region in context.area.regions if region.type != "WINDOW"]
    left, bottom, right, top = free_rectangle(context.region, others)
    try:
        shown = painted(context, obj)
    except jobs.expected_errors() as error:
        text = context.preferences.themes[0].user_interface.wcol_box.text
        _draw_text(str(error), left + pixels(PADDING), bottom + pixels(MARGIN), text)
        return
    right, top = right - pixels(GIZMOS), top - pixels(MARGIN)
    if shown and right - pixels(LEGEND) > left:
        _draw_scale(right, top, *shown[1:])


def _draw_scale(right: float, top: float, title: str, low: str, high: str):
    """What the colors of the surface mean."""
    box = bpy.context.preferences.themes[0].user_interface.wcol_box
    pad, line, width = pixels(PADDING), pixels(TEXT + 4.0), pixels(LEGEND)
    left, bottom = right - width, top - 3.0 * line - 2.0 * pad
    _draw_rectangle(left, bottom, right, top, (*box.inner[:3], 0.85))
    left, right, top = left + pad, right - pad, top - pad
    _draw_text(title, left, top - 0.8 * line, box.text)
    for k, color in enumerate(heat.colors(np.linspace(0.0, 1.0, SHADES)).tolist()):
        begin, end = (left + (right - left) * at / SHADES for at in (k, k + 1))
        _draw_rectangle(begin, top - 1.9 * line, end, top - 1.2 * line, (*color, 1.0))
    _draw_text(low, left, top - 2.8 * line, box.text)
    _draw_text(high, right - _text_width(high), top - 2.8 * line, box.text)


# The graph ---------------------------------------------------------------------------------------------------------


def free_rectangle(region, others) -> tuple[float, float, float, float]:
    """Left, bottom, right and top of what the regions over `region` leave of it, in its own pixels."""
    left, bottom, right, top = 0.0, 0.0, region.width, region.height
    for other in others:
        begin, end = other.x - region.x, other.x - region.x + other.width
        low, high = other.y - region.y, other.y - region.y + other.height
        over = begin < region.width and end > 0 and low < region.height and high > 0
        if not over or min(other.width, other.height) <= 1:  # beside it, or hidden
            continue
        if other.alignment == "LEFT":
            left = max(left, end)
        elif other.alignment == "RIGHT":
            right = min(right, begin)
        elif other.alignment == "BOTTOM":
            bottom = max(bottom, high)
        elif other.alignment == "TOP":
            top = min(top, low)
    return left, bottom, right, top


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each run of True in (F,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(begin), int(end) - 1) for begin, end in edges.reshape(-1, 2)]


def curve_colors(shown: influence.Influence, theme) -> dict[int, tuple[float, ...]]:
    """A colour for each curve that is drawn, by index of its target: of neutral targets the text's."""
    hues = [tuple(theme.collection_color[hue].color) for hue in HUES]
    colors, others = {}, 0
    for _, targets in shown.by_set():
        colors[targets.start] = tuple(theme.user_interface.wcol_box.text)
        for target in targets[1:]:
            colors[target] = hues[others % len(hues)]
            others += 1
    return colors


@lru_cache(maxsize=2)
def _graph_batches(shown: influence.Influence):
    """Curves by index of their target, and the frames outside: x in frames from the first, y in weight."""
    frames = np.arange(len(shown.weights), dtype=np.float32)
    curves = {
        target: _batch("LINE_STRIP", np.column_stack([frames, shown.weights[:, target], 0.0 * frames]))
        for _, targets in shown.by_set()
        for target in targets
    }
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], np.float32)
    quads = [np.zeros((0, 3), np.float32)]
    for first, last in runs(shown.outside.any(axis=1)):
        begin, end = max(first - 0.5, 0.0), min(last + 0.5, len(frames) - 1.0)
        quads.append(np.column_stack([begin + (end - begin) * corners[:, 0], corners[:, 1], np.zeros(6)]))
    return curves, _batch("TRIS", np.concatenate(quads))


def _draw_graph():
    """POST_PIXEL."""
    context = bpy.context
    obj = properties.mesh_in(context)
    first = next(region for region in context.area.regions if region.type == "WINDOW")
    if not context.window_manager.dynamorph.influence or not _is_shown(context, obj) or context.region != first:
        return
    known = influence.drawn(obj)
    if known is None or len(known[1].weights) < 2:
        return
    others = [region for region in context.area.regions if region.type != "WINDOW"]
    left, bottom, right, top = free_rectangle(context.region, others)
    margin, height = pixels(MARGIN), pixels(HEIGHT)
    if right - left > pixels(NARROW) and top - bottom > 2 * height:
        _draw_graph_in(left + margin, bottom + margin, right - margin, bottom + margin + height, *known)


def _draw_graph_in(left, bottom, right, top, shot: influence.Shot, shown: influence.Influence):
    context = bpy.context
    theme = context.preferences.themes[0]
    box, colors = theme.user_interface.wcol_box, curve_colors(shown, theme)
    _draw_rectangle(left, bottom, right, top, (*box.inner[:3], 0.85))
    pad, line = pixels(PADDING), pixels(TEXT + 4.0)
    x, y, width, height = left + pad, bottom + pad + line, right - left - 2 * pad, top - bottom - 2 * (pad + line)
    frames = shot.end - shot.start
    curves, outside = _graph_batches(shown)
    with gpu.matrix.push_pop():
        gpu.matrix.translate((x, y, 0.0))
        gpu.matrix.scale((width / frames, height, 1.0))
        _draw(outside, "UNIFORM_COLOR", (*theme.user_interface.wcol_state.warning[:3], 0.2))
        for target, batch in curves.items():
            _draw_lines(batch, (*colors[target], 1.0), 1.5)
        now = context.scene.frame_current_final - shot.start
        if 0 <= now <= frames:
            playhead = _batch("LINES", np.array([[now, 0.0, 0.0], [now, 1.0, 0.0]]))
            _draw_lines(playhead, theme.user_interface.wcol_regular.inner_sel, 2.0)
    _draw_legend(x, top - line, right - pad, shown, colors, box.text)
    _draw_text(str(shot.start), x, bottom + pad, box.text)
    _draw_text(str(shot.end), right - pad - _text_width(str(shot.end)), bottom + pad, box.text)


def _draw_legend(x, y, right, shown: influence.Influence, colors, text_color):
    """Names with their colours from left to right, as far as there is room; the neutral target's once."""
    names = [target.name for target_set in shown.sets for target in target_set.targets]
    again = [targets.start for _, targets in shown.by_set()[1:]]
    square, space = pixels(SQUARE), pixels(4.0)
    for target in (target for target in colors if target not in again):
        end = x + square + space + _text_width(names[target])
        if end > right:
            return
        _draw_rectangle(x, y, x + square, y + square, (*colors[target], 1.0))
        _draw_text(names[target], x + square + space, y, text_color)
        x = end + 3 * space


# Pieces ------------------------------------------------------------------------------------------------------------


def _batch(kind: str, points: np.ndarray, indices: np.ndarray | None = None):
    """Points (k, 3), joined as `indices` says or one after the other."""
    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id="pos", comp_type="F32", len=3, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(layout, len(points))
    vertices.attr_fill("pos", np.ascontiguousarray(points, np.float32))
    if indices is None:
        return gpu.types.GPUBatch(type=kind, buf=vertices)
    return gpu.types.GPUBatch(type=kind, buf=vertices, elem=gpu.types.GPUIndexBuf(type=kind, seq=indices))


def _draw(batch, shader: str, color, **uniforms):
    shader = gpu.shader.from_builtin(shader)
    shader.bind()
    shader.uniform_float("color", color)
    for name, value in uniforms.items():
        shader.uniform_float(name, value)
    gpu.state.blend_set("ALPHA")
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def _draw_lines(batch, color, width: float):
    size = gpu.state.viewport_get()[2:]
    _draw(batch, "POLYLINE_UNIFORM_COLOR", color, viewportSize=size, lineWidth=pixels(width))


def _draw_points(batch, color, size: float):
    gpu.state.program_point_size_set(True)
    _draw(batch, "POINT_UNIFORM_COLOR", color, size=pixels(size))
    gpu.state.program_point_size_set(False)


def _draw_rectangle(left, bottom, right, top, color):
    corners = [(left, bottom, 0), (right, bottom, 0), (left, top, 0), (right, top, 0)]
    _draw(_batch("TRI_STRIP", np.array(corners)), "UNIFORM_COLOR", color)


def _draw_text(text: str, x, y, color):
    blf.size(0, pixels(TEXT))
    blf.color(0, *color, 1.0)
    blf.position(0, x, y, 0.0)
    blf.draw(0, text)


def _text_width(text: str) -> float:
    blf.size(0, pixels(TEXT))
    return blf.dimensions(0, text)[0]


def pixels(length: float) -> float:
    """Of a length that is given for a resolution scale of 1."""
    return length * bpy.context.preferences.system.ui_scale


def _is_shown(context, obj) -> bool:
    """Whether this viewport shows the soft skin `obj`, and overlays."""
    space = context.space_data
    if obj is None or not obj.dynamorph.targets or not space.overlay.show_overlays:
        return False
    return obj.visible_in_viewport_get(space)


def _quietly(draw):
    """A callback that draws nothing where `draw` fails: an error would come back at every redraw, in the console."""

    def callback():
        try:
            draw()
        except Exception:  # the object, its rig or its model is going, or being edited
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            gpu.state.blend_set("NONE")

    return callback


_handles = []


def register():
    if not bpy.app.background:
        in_view, on_top = (_draw_surface, _draw_cage), (_draw_graph, _draw_surface_legend)
        for draw, moment in [(draw, "POST_VIEW") for draw in in_view] + [(draw, "POST_PIXEL") for draw in on_top]:
            _handles.append(bpy.types.SpaceView3D.draw_handler_add(_quietly(draw), (), "WINDOW", moment))


def unregister():
    while _handles:
        bpy.types.SpaceView3D.draw_handler_remove(_handles.pop(), "WINDOW")
    forget()


def forget():
    """Free what is kept on the graphics card, and cages."""
    for cache in (_cage, _order, _cage_batches, _graph_batches):
        cache.cache_clear()
    heat.forget()
