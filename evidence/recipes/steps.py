# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of each page of docs/recipes, by the buttons and settings that the page names."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from stage import add_ball, add_material, paint_for_workbench

from . import cast

OPS = bpy.ops.dynamorph
DRAFT_NODES, DRAFT_MODES = 400, 20
SCULPT = "Biceps sculpt"  # the mesh attribute that stands for the sculptor's strokes
HANDS, FEET = ("hand", "thumb", "index", "middle", "ring", "pinky"), ("foot", "ball")
NAVEL, BELLY = (0.0, -0.2, 0.98), 0.2  # of Herbert: where his belly is, and its radius, meters
FLEXED = 80  # frame of the shoulder
LIFTED = 24  # frame in which the knee is lifted
HELD = 6  # frame in which a ball touches the belly
DRAG = range(4, 13)  # frames in which a hand drags


@dataclass
class Hands:
    """Whoever follows a recipe. draft: with a coarse cage and few modes, as tests do; seconds: of build and bake."""

    draft: bool = False
    seconds: dict[str, float] = field(default_factory=dict)

    def add_soft_skin(self, body: bpy.types.Object) -> None:
        cast.activate(body)
        OPS.add_soft_skin()
        if self.draft:
            body.dynamorph.model.cage_nodes, body.dynamorph.model.modes = DRAFT_NODES, DRAFT_MODES

    def bake(self, body: bpy.types.Object) -> None:
        """Press Bake, which builds the model first if it must."""
        if "build" not in self.seconds:
            self.build(body)
        cast.activate(body)
        self.timed("bake", OPS.bake)

    def build(self, body: bpy.types.Object) -> None:
        """Press Build Model."""
        cast.activate(body)
        self.timed("build", OPS.build)

    def timed(self, name: str, press: Callable) -> None:
        began = time.perf_counter()
        press()
        self.seconds[name] = time.perf_counter() - began


@dataclass(frozen=True)
class Recipe:
    """start: makes the scene of NAME_start.blend, and returns its body; steps: all that the page says then. draft: the
    frames that a draft bakes, all if none are given. Of the picture, frame: by default that of the largest motion;
    since: a frame that is shown on the left, and from which on the motion is measured, instead of plain skinning;
    close: the part of what the camera sees, around `focus`, world space; hidden: an object that is not shown on the
    right. export: suffix of a file beside the .blend.
    """

    start: Callable[[Hands], bpy.types.Object]
    steps: Callable[[Hands, bpy.types.Object], None]
    title: str
    about: str
    draft: tuple[int, int] | None = None
    frame: int = 0
    since: int = 0
    close: float = 0.62
    focus: Sequence[float] = (0.0, 0.0, 0.95)
    panes: tuple[str, str] = ("plain skinning", "baked")
    hidden: str = ""
    export: str = ""


def jiggle(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    OPS.apply_feel(feel="CARTOON")
    hands.bake(body)


# A biceps -------------------------------------------------------------------------------------------------------------


def relaxed_arm(_hands: Hands) -> bpy.types.Object:
    """The shoulder without its targets. What its elbow was sculpted to is kept as the strokes of the page."""
    body = cast.opened("shoulder", "Shoulder")
    keys = body.data.shape_keys.key_blocks
    strokes = points_of(keys["Folded"]) - points_of(keys["Basis"])
    body.shape_key_clear()
    body.vertex_groups.remove(body.vertex_groups["Elbow"])
    attribute = body.data.attributes.new(SCULPT, "FLOAT_VECTOR", "POINT")
    attribute.data.foreach_set("vector", strokes.astype(np.float32).ravel())
    body.dynamorph.firmness_group = "Firmness"  # where the bust is cut
    paint_for_workbench()
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 38, 104
    bpy.context.scene.frame_set(38)
    return body


def bulge(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    bpy.context.scene.frame_set(FLEXED)
    OPS.new_from_pose(key="Biceps", mode="SCULPT")
    sculpt(body, "Biceps")
    OPS.finish_sculpt()
    OPS.apply_material(preset="MUSCLE_FLEXED")
    hands.bake(body)


def shape(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    bpy.context.scene.frame_set(LIFTED)
    cast.activate(body)
    OPS.shape_by_physics()
    hands.bake(body)


def still_arm(hands: Hands) -> bpy.types.Object:
    """The same, and the arm stays as it is while it is carried to the side and back."""
    body, scene = relaxed_arm(hands), bpy.context.scene
    rig = body.find_armature()
    rig.animation_data_clear()
    root = next(bone for bone in rig.pose.bones if bone.parent is None)
    for frame, place in ((1, 0.0), (10, 0.0), (14, 0.06), (18, 0.0), (46, 0.0), (50, 0.06), (54, 0.0)):
        root.location.x = place
        root.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 72
    scene.frame_set(1)
    return body


def flex(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    OPS.add_tension()
    OPS.sculpt_target(mode="SCULPT")
    sculpt(body, "Tension")
    OPS.finish_sculpt()
    OPS.region_from_sculpt()
    for frame, value in ((24, 0.0), (30, 1.0), (62, 1.0), (68, 0.0)):
        body.dynamorph.channels["Tension"].value = value
        body.dynamorph.channels["Tension"].keyframe_insert("value", frame=frame)
    hands.bake(body)


def sculpt(body: bpy.types.Object, name: str) -> None:
    """What the brush does in Sculpt Mode: the strokes that the body has as an attribute."""
    strokes = np.empty(3 * len(body.data.vertices), np.float32)
    body.data.attributes[SCULPT].data.foreach_get("vector", strokes)
    key = body.data.shape_keys.key_blocks[name]
    key.points.foreach_set("co", (points_of(key) + strokes.reshape(-1, 3)).astype(np.float32).ravel())


def breathing(_hands: Hands) -> bpy.types.Object:
    """Herbert with a key for a full breath, whose value is animated, as animators have them."""
    body = cast.herbert(cast.stand, "Stand")
    body.shape_key_add(name="Basis", from_mix=False)
    key = body.shape_key_add(name="Breath", from_mix=False)
    points = points_of(key)
    near = np.linalg.norm((points - NAVEL) / (1.3 * BELLY), axis=1)[:, None]
    outward = points - np.array(NAVEL) * (1.0, 0.0, 1.0)
    swell = 0.05 * (1.0 - near**2).clip(0.0) ** 2 * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    key.points.foreach_set("co", (points + swell).astype(np.float32).ravel())
    scene = bpy.context.scene
    for frame, value in ((1, 0.0), (18, 1.0), (36, 0.0), (54, 1.0), (72, 0.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    scene.frame_start, scene.frame_end = 1, 72
    scene.frame_set(1)
    return body


def breathe(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    OPS.add_target(key="Breath")
    OPS.add_channel(data_path=f'{body.data.shape_keys!r}.key_blocks["Breath"].value')
    hands.bake(body)


def points_of(key: bpy.types.ShapeKey) -> np.ndarray:
    points = np.empty(3 * len(key.data), np.float32)
    key.points.foreach_get("co", points)
    return points.reshape(-1, 3)


# Where it is soft, what stops it, what drags it -----------------------------------------------------------------------


def firm_parts(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    OPS.apply_feel(feel="CARTOON")
    select_bones(body.parent, (*HANDS, *FEET))
    OPS.hold_bones()
    cast.activate(body)
    body.dynamorph.parts["Belly"].firmness = 0.2
    hands.bake(body)


def select_bones(rig: bpy.types.Object, beginnings: tuple[str, ...]) -> None:
    """In Pose Mode, the bones whose names begin so."""
    cast.activate(rig)
    bpy.ops.object.mode_set(mode="POSE")
    for bone in rig.pose.bones:
        (bone if hasattr(bone, "select") else bone.bone).select = bone.name.startswith(beginnings)


def ball(_hands: Hands) -> bpy.types.Object:
    """The torso and the ball that falls on it, until the ball has rolled over the belly."""
    body = cast.opened("rolling_ball", "Torso")
    bpy.context.scene.frame_end = 48
    return body


def collision(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    cast.activate(body, bpy.data.objects["Ball"])
    OPS.collide()
    hands.bake(body)


def grab(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    hands.build(body)
    OPS.live()
    OPS.record_drags()
    drag(body)
    OPS.record_drags()
    OPS.live()
    hands.bake(body)


def touched(_hands: Hands) -> bpy.types.Object:
    """Herbert, and a ball that touches his belly, goes away and stays there."""
    body = cast.herbert(cast.stand, "Stand")
    points = shown(body)
    place = points[np.linalg.norm(points - NAVEL, axis=1).argmin()]
    ball = add_ball("Ball", 0.02, add_material("Ball", (0.95, 0.62, 0.08), 0.4))
    for frame, way in ((1, (0.0, -0.3, 0.0)), (HELD, (0.0, 0.0, 0.0)), (20, (0.09, -0.17, 0.03))):
        ball.location = place + way
        ball.keyframe_insert("location", frame=frame)
    cast.activate(body)
    return body


def strap(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    bpy.context.scene.frame_set(HELD)
    cast.activate(body, bpy.data.objects["Ball"])
    OPS.attach()
    grip = body.dynamorph.grips[0]
    for frame, strength in ((HELD - 1, 0.0), (HELD, 1.0), (24, 1.0), (25, 0.0)):
        grip.strength = strength
        grip.keyframe_insert("strength", frame=frame)
    hands.bake(body)


def drag(body: bpy.types.Object) -> None:
    """Play once, and meanwhile pull the belly forward and let go: what the mouse does with the tool."""
    package = type(body.dynamorph).__module__.rpartition(".scene.")[0]
    grabbing = importlib.import_module(f"{package}.run.tools.grabbing")
    scene, hand, number, place = bpy.context.scene, None, 0, np.array(NAVEL)
    for frame in range(scene.frame_start, scene.frame_end + 1):
        if frame == DRAG[0]:
            points = shown(body)
            place = points[np.linalg.norm(points - NAVEL, axis=1).argmin()]
            hand = grabbing.begin(body)
            number = hand.take(place, points)
        if hand and frame in DRAG:
            hand.lead(number, place + (frame - DRAG[0] + 1) / len(DRAG) * np.array((0.08, -0.16, 0.02)))
        elif hand:
            hand.let_go(number)
        scene.frame_set(frame)
    grabbing.end()


def shown(obj: bpy.types.Object) -> np.ndarray:
    """Where Blender shows the vertices (V, 3) at this frame, world space."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    world = np.array(evaluated.matrix_world)
    return cast.coordinates(evaluated.data) @ world[:3, :3].T + world[:3, 3]


# Characters, engines, pictures, repairs -------------------------------------------------------------------------------


def dressed(_hands: Hands) -> bpy.types.Object:
    body = cast.herbert(cast.hop, "Hop")
    cast.dress(body)
    return body


def one_click(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    hands.bake(body)


def walker(_hands: Hands) -> bpy.types.Object:
    body = cast.herbert(cast.walk, "Walk")
    action = body.parent.animation_data.action
    action.use_frame_range = action.use_cyclic = True
    action.frame_start, action.frame_end = 1, bpy.context.scene.frame_end
    return body


def walk_cycle(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    OPS.apply_feel(feel="CARTOON")
    body.dynamorph.simulation.loop = True
    body.dynamorph.output.keys = 8
    hands.bake(body)


def motion_blur(hands: Hands, body: bpy.types.Object) -> None:
    hands.add_soft_skin(body)
    OPS.apply_feel(feel="CARTOON")
    body.dynamorph.simulation.samples = 4
    hands.bake(body)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.use_motion_blur = True
    body.cycles.use_deform_motion, body.cycles.motion_steps = True, 3


def bad_bake(hands: Hands) -> bpy.types.Object:
    """Herbert with a bounce that is too low, and without limits."""
    body = cast.herbert(cast.hop, "Hop")
    hands.add_soft_skin(body)
    hands.build(body)
    body.dynamorph.targets[0].bounce = 1.5
    body.dynamorph.simulation.max_displacement = body.dynamorph.simulation.max_thickness = 0.0
    hands.bake(body)
    return body


def repair(hands: Hands, body: bpy.types.Object) -> None:
    OPS.show_worst()
    OPS.apply_feel(feel="NATURAL")
    hands.bake(body)


def hopping(_hands: Hands) -> bpy.types.Object:
    return cast.herbert(cast.hop, "Hop")


RECIPES = {
    "jiggle": Recipe(hopping, jiggle, "A belly that jiggles", "He lands, and his belly swings on."),
    "bulge": Recipe(
        relaxed_arm, bulge, "A biceps that bulges", "The flexed biceps bulges as sculpted and is firm.",
        draft=(76, 84), frame=FLEXED, close=0.36, focus=(0.4, 0.0, 0.74),
    ),
    "shape": Recipe(
        lambda _hands: cast.herbert(cast.lift_knee, "Lift Knee"), shape, "Shape a pose by physics",
        "Knee and hip bend as soft tissue does, and nobody sculpted them.",
        draft=(16, 28), frame=LIFTED, close=0.45, focus=(0.1, -0.15, 0.8),
    ),
    "flex": Recipe(
        still_arm, flex, "Flex without moving", "A slider tenses the biceps: it bulges and is firm, and no bone moves.",
        draft=(20, 34), frame=40, close=0.36, focus=(0.4, 0.0, 0.6),
    ),
    "breathe": Recipe(
        breathing, breathe, "Breathe", "A key that is animated already becomes soft tissue that swings on.",
        draft=(1, 20), frame=18, since=1, focus=(0.0, 0.0, 1.0), panes=("before a breath", "breathed in"),
    ),
    "firm_parts": Recipe(
        hopping, firm_parts, "Hands and feet that stay still",
        "Paint says where the body is soft, and where it is held.",
        panes=("Firmness", "baked"),
    ),
    "collision": Recipe(
        ball, collision, "A ball that leaves a dent",
        "Objects, the floor and the body itself stop the skin.",
        draft=(1, 16), frame=20, close=0.5, focus=(0.45, 0.0, 0.34),
        panes=("plain skinning", "baked; the ball is not shown"), hidden="Ball",
    ),
    "grab": Recipe(
        lambda _hands: cast.herbert(cast.stand, "Stand"), grab, "Grab it by hand",
        "Drag the skin with the mouse, let go, and keep the drag in the shot.", draft=(1, 24),
    ),
    "strap": Recipe(
        touched, strap, "A strap, a hand", "An object takes hold of the skin, pulls it, and lets go.",
        draft=(1, 30), frame=23,
    ),
    "clothes": Recipe(
        dressed, one_click, "Clothes and eyes", "Shirt and shorts follow the belly; eyes and cap do not."
    ),
    "walk_cycle": Recipe(
        walker, walk_cycle, "A walk cycle for a game engine", "The loop closes, in eight morph targets or fewer.",
        close=0.85, focus=(0.0, 0.0, 0.85), export=".glb",
    ),
    "rigify": Recipe(
        lambda _hands: cast.rigify(), one_click, "A Rigify character", "From a generated rig to a soft body."
    ),
    "mixamo": Recipe(
        lambda _hands: cast.mixamo(), one_click, "A Mixamo character", "Centimeters and scales need no setting."
    ),
    "vrm": Recipe(lambda _hands: cast.vrm(), one_click, "A VRM character", "Face and body stay closed at the neck."),
    "motion_blur": Recipe(
        hopping, motion_blur, "Render with motion blur", "Soft motion that is sharp where it turns.",
        focus=(0.0, 0.0, 1.1), panes=("without motion blur", "four samples per frame"),
    ),
    "repair": Recipe(
        bad_bake, repair, "Repair a bake", "A bake that moves too much, flickers, or runs through something.",
        focus=(0.0, 0.0, 1.1), panes=("the first bake", "repaired"),
    ),
}  # fmt: skip


def cook(
    name: str, draft: bool = False, started: Callable[[bpy.types.Object], None] | None = None
) -> tuple[bpy.types.Object, Hands]:
    """Follow a recipe: (body, hands). `started` is called with the body before its first step."""
    recipe, hands = RECIPES[name], Hands(draft)
    body = recipe.start(hands)
    if draft and recipe.draft:
        bpy.context.scene.frame_start, bpy.context.scene.frame_end = recipe.draft
    if started:
        started(body)
    recipe.steps(hands, body)
    return body, hands


def export(body: bpy.types.Object, path: Path) -> None:
    """Export glTF, in Result."""
    cast.activate(body)
    OPS.export(filepath=str(path), format="GLTF", clips="SCENE")
