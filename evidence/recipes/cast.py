# SPDX-License-Identifier: GPL-3.0-or-later
"""The characters of the recipes: Herbert of sample_blends/herbert.blend, CC0, with clips of his own and on the rigs
that other programs and add-ons make. World axes, meters; he faces -Y.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import addon_utils
import bpy
import numpy as np
from contact_sheet import quiet
from herbert_action import quaternions
from herbert_skeleton import SIDES, SPINE, Skeleton, about, arm_turns, curve
from mathutils import Matrix, Vector
from stage import add_box, add_camera, add_material, look_through_camera, paint_for_workbench, smoothstep, write_curves

SAMPLES = Path(__file__).resolve().parents[2] / "sample_blends"
FPS = 24
KNEES = 0.02  # meters by which they are never quite straight
HEAD_BONES = ("neck_01", "head")
SHIRT, SHORTS = (0.02, 0.14, 0.35), (0.75, 0.55, 0.1)  # colors

Turns = dict[str, np.ndarray]


def opened(name: str, body: str) -> bpy.types.Object:
    """A sample scene without its soft skin and collision, and its body, active."""
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"))
    obj = bpy.data.objects[body]
    activate(obj)
    bpy.ops.dynamorph.remove_soft_skin()
    reset(obj.dynamorph)
    for other in bpy.context.scene.objects:
        for modifier in [each for each in other.modifiers if each.type == "COLLISION"]:
            other.modifiers.remove(modifier)
    bpy.context.scene.frame_set(1)
    return obj


def reset(settings: bpy.types.PropertyGroup) -> None:
    """The settings that a new soft skin finds, which Remove Soft Skin leaves as they were."""
    settings.firmness_group = settings.max_distance_group = ""
    for group in (settings.model, settings.simulation, settings.collision, settings.output):
        for prop in group.bl_rna.properties:
            if not prop.is_readonly:
                group.property_unset(prop.identifier)


def activate(obj: bpy.types.Object, *others: bpy.types.Object) -> None:
    """Select an object as a click does, and others before it."""
    if bpy.context.object and bpy.context.object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.select_all(action="DESELECT")
    for each in (*others, obj):
        each.select_set(True)
    bpy.context.view_layer.objects.active = obj


# Herbert --------------------------------------------------------------------------------------------------------------


def herbert(clip: Callable[[Skeleton], tuple[np.ndarray, Turns]], name: str) -> bpy.types.Object:
    """Herbert in an empty room. `clip` gives the place of his pelvis (F, 3) and the turns of his bones."""
    body = opened("herbert", "Herbert")
    rig = body.parent
    kept = {body, rig, *rig.children}
    for obj in [each for each in bpy.data.objects if each not in kept and each.type != "LIGHT"]:
        bpy.data.objects.remove(obj)
    body.shape_key_clear()
    body.vertex_groups.remove(body.vertex_groups["Firmness"])
    rig.animation_data_clear()
    for action in [*bpy.data.actions]:
        bpy.data.actions.remove(action)
    bpy.context.scene.timeline_markers.clear()
    rig.rotation_euler.z = 0
    rig.show_in_front = True
    for bone in rig.pose.bones:
        bone.matrix_basis.identity()
    animate(rig, name, *clip(skeleton(rig)))
    add_box("Floor", (-9, -6, -0.1), (9, 14, 0), add_material("Floor", (0.30, 0.33, 0.36), 0.8))
    paint_for_workbench()
    bpy.context.scene.world.color = (0.25, 0.28, 0.32)
    add_camera((2.5, -3.9, 1.3), (0, 0, 0.86), 68)
    look_through_camera()
    activate(body)
    return body


def skeleton(rig: bpy.types.Object) -> Skeleton:
    bones = rig.data.bones
    return Skeleton(
        {bone.name: np.array(bone.head_local) for bone in bones},
        {bone.name: np.array(bone.tail_local) for bone in bones},
        {bone.name: bone.parent.name if bone.parent else "" for bone in bones},
    )


def animate(rig: bpy.types.Object, name: str, pelvis: np.ndarray, turns: Turns) -> None:
    """Key the turns of the bones, and the pelvis's place relative to rest, at every frame of the scene."""
    root = rig.data.bones["pelvis"]
    curves = {'pose.bones["pelvis"].location': pelvis @ np.array(root.matrix_local.to_3x3())}
    for bone, turn in turns.items():
        rest = np.array(rig.data.bones[bone].matrix_local.to_3x3())
        turn = np.broadcast_to(turn, (len(pelvis), 3, 3))
        curves[f'pose.bones["{bone}"].rotation_quaternion'] = quaternions(rest.T @ turn @ rest)
    write_curves(rig, name, curves)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, len(pelvis), FPS
    scene.frame_set(1)


# Clips ----------------------------------------------------------------------------------------------------------------


def crouched(bones: Skeleton, drop: np.ndarray) -> Turns:
    """Both legs bent so that the pelvis is `drop` (F,) lower above the feet."""
    bend = np.degrees(np.arccos(1 - np.clip(drop, 0, 0.4) / bones.leg()))
    turns: Turns = {}
    for side in SIDES:
        turns |= {f"thigh_{side}": about(0, -bend), f"calf_{side}": about(0, 2 * bend), f"foot_{side}": about(0, -bend)}
    return turns


def lift_knee(_bones: Skeleton) -> tuple[np.ndarray, Turns]:
    """He stands on his right leg, and lifts the left knee."""
    frames = np.arange(48)
    lifted = curve(frames, (0, 0), (8, 0), (18, 1), (32, 1), (42, 0))
    turns = {"thigh_l": about(0, -80 * lifted), "calf_l": about(0, 115 * lifted)}
    return np.zeros((len(frames), 3)), turns


def hop_height() -> np.ndarray:
    """How high he is (F,) above where he stands: he crouches, pushes himself off, falls back, and rises. 48 frames."""
    crouch, fast = 0.17, 4 / FPS  # meters, and seconds in which he pushes himself off, or is stopped
    speed = 2 * crouch / fast
    flight = 2 * speed / 9.81
    times = np.arange(48) / FPS
    down, off = 4 / FPS, 12 / FPS  # he begins to crouch, and to push
    up, landed = off + fast, off + fast + flight
    t = times - up
    height = -crouch * smoothstep((times - down) / (off - down))
    height = np.where(times > off, -crouch + 0.5 * speed / fast * (times - off) ** 2, height)
    height = np.where(times > up, speed * t - 0.5 * 9.81 * t**2, height)
    height = np.where(times > landed, -crouch + 0.5 * speed / fast * (landed + fast - times) ** 2, height)
    return np.where(times > landed + fast, -crouch * (1 - smoothstep((times - landed - fast) / 0.5)), height)


def hop(bones: Skeleton) -> tuple[np.ndarray, Turns]:
    """A hop, with arms that swing along."""
    height, frames = hop_height(), np.arange(48)
    turns = crouched(bones, KNEES + np.maximum(-height, 0))
    forward = curve(frames, (0, 0), (11, -40), (19, 45), (27, 15), (32, -25), (44, 0))
    outward = curve(frames, (0, 16), (11, 22), (19, 50), (30, 24), (44, 16))
    for side in SIDES:
        turns |= arm_turns(bones, side, forward, outward, np.full(48, 20.0))
    turns |= {bone: about(0, 25 * np.maximum(-height, 0)) for bone in SPINE}
    return np.stack([0 * height, 0 * height, height - KNEES], 1), turns


def walk(bones: Skeleton) -> tuple[np.ndarray, Turns]:
    """A heavy walk in place that repeats after 24 frames; the 25th pose is the first."""
    phase = 2 * np.pi * np.arange(25) / 24
    turns: Turns = {}
    for side, sign in (("l", 1), ("r", -1)):
        swing, ahead = sign * np.sin(phase), sign * np.cos(phase)
        knee = 6 + 52 * np.maximum(0.5 + 0.5 * ahead, 0) ** 3
        turns |= {f"thigh_{side}": about(0, -24 * swing - 6), f"calf_{side}": about(0, knee)}
        turns[f"foot_{side}"] = about(0, 24 * swing + 6 - knee + 14 * np.maximum(-swing, 0))
        turns |= arm_turns(bones, side, -28 * swing, np.full(25, 24.0), 25 - 10 * swing)
    turns |= {bone: about(2, 4 * np.sin(phase)) for bone in SPINE}
    turns["pelvis"] = about(2, -7 * np.sin(phase)) @ about(1, 3 * np.cos(phase))
    return np.stack([0.015 * np.cos(phase), 0 * phase, -0.05 + 0.04 * np.cos(2 * phase + 0.5)], 1), turns


def stand(bones: Skeleton) -> tuple[np.ndarray, Turns]:
    """He stands still: 48 frames."""
    turns: Turns = {}
    for side in SIDES:
        turns |= arm_turns(bones, side, np.zeros(48), np.full(48, 32.0), np.full(48, 15.0))
    return np.zeros((48, 3)), turns


# What he wears --------------------------------------------------------------------------------------------------------


def dress(body: bpy.types.Object) -> None:
    """A shirt and shorts: the faces of trunk and thighs once more, a centimeter outside, skinned as the body is."""
    for name, color, parts, height, outside in (
        ("Shirt", SHIRT, ("spine", "clavicle", "upperarm", "pelvis"), (0.86, 1.34), 0.014),
        ("Shorts", SHORTS, ("pelvis", "thigh", "spine_01"), (0.52, 0.95), 0.009),
    ):
        worn = part(body, name, belongs(body, parts, height))
        worn.data.materials.clear()
        worn.data.materials.append(add_material(name, color, 0.7))
        for attribute in [*worn.data.color_attributes]:
            worn.data.color_attributes.remove(attribute)
        layer = worn.data.color_attributes.new("Color", "BYTE_COLOR", "POINT")
        layer.data.foreach_set("color", np.tile((*color, 1), len(worn.data.vertices)).astype(np.float32))
        worn.data.color_attributes.active_color = layer
        worn.data.color_attributes.render_color_index = 0
        points, normals = coordinates(worn.data), np.array([each.normal for each in worn.data.vertices])
        worn.data.vertices.foreach_set("co", (points + outside * normals).astype(np.float32).ravel())
    activate(body)


def belongs(body: bpy.types.Object, bones: tuple[str, ...], height: tuple[float, float]) -> np.ndarray:
    """The vertices (V,) that these bones move for the most part, at these heights."""
    chosen = {group.index for group in body.vertex_groups if group.name.startswith(bones)}
    weights = np.array([sum(g.weight for g in each.groups if g.group in chosen) for each in body.data.vertices])
    z = coordinates(body.data)[:, 2]
    return (weights > 0.5) & (z > height[0]) & (z < height[1])


def coordinates(mesh: bpy.types.Mesh) -> np.ndarray:
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3).astype(float)


def part(body: bpy.types.Object, name: str, keep: np.ndarray) -> bpy.types.Object:
    """A copy of the body with the faces alone of which all corners are kept."""
    made = body.copy()
    made.name, made.data = name, body.data.copy()
    made.data.name = name
    bpy.context.scene.collection.objects.link(made)
    delete(made, ~keep)
    return made


def delete(obj: bpy.types.Object, gone: np.ndarray) -> None:
    """Delete the faces that have any of these vertices (V,), and what is then loose."""
    activate(obj)
    mesh = obj.data
    faces = [any(gone[corner] for corner in face.vertices) for face in mesh.polygons]
    mesh.polygons.foreach_set("select", faces)
    for elements in (mesh.vertices, mesh.edges):
        elements.foreach_set("select", np.zeros(len(elements), bool))
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="FACE")
    bpy.ops.object.mode_set(mode="OBJECT")
    mesh.polygons.foreach_set("select", faces)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="FACE")
    bpy.ops.object.mode_set(mode="OBJECT")


# Rigs of others -------------------------------------------------------------------------------------------------------


MIXAMO = {
    "pelvis": "Hips", "spine_01": "Spine", "spine_02": "Spine1", "spine_03": "Spine2", "neck_01": "Neck",
    "head": "Head", "clavicle_*": "*Shoulder", "upperarm_*": "*Arm", "lowerarm_*": "*ForeArm", "hand_*": "*Hand",
    "thigh_*": "*UpLeg", "calf_*": "*Leg", "foot_*": "*Foot", "ball_*": "*ToeBase",
}  # fmt: skip
VRM = {
    "pelvis": "C_Hips", "spine_01": "C_Spine", "spine_02": "C_Chest", "spine_03": "C_UpperChest", "neck_01": "C_Neck",
    "head": "C_Head", "clavicle_*": "*_Shoulder", "upperarm_*": "*_UpperArm", "lowerarm_*": "*_LowerArm",
    "hand_*": "*_Hand", "thigh_*": "*_UpperLeg", "calf_*": "*_LowerLeg", "foot_*": "*_Foot", "ball_*": "*_ToeBase",
}  # fmt: skip
FINGERS = {"thumb": "Thumb", "index": "Index", "middle": "Middle", "ring": "Ring", "pinky": "Pinky"}


def rename(rig: bpy.types.Object, names: dict[str, str], prefix: str, sides: tuple[str, str]) -> None:
    """Give the bones the names that another program has for them; * stands for the side. Groups and curves follow."""
    for side, word in zip(SIDES, sides, strict=True):
        for old, new in names.items():
            if (old := old.replace("*", side)) in rig.data.bones:
                rig.data.bones[old].name = prefix + new.replace("*", word)
        for bone in [each for each in rig.data.bones if each.name.split("_")[0] in FINGERS]:
            finger, number, of = bone.name.split("_")
            if of == side:
                bone.name = prefix + names["hand_*"].replace("*", word) + FINGERS[finger] + str(int(number))


def mixamo() -> bpy.types.Object:
    """Herbert as his FBX file would come in: Mixamo's names, and an armature in centimeters, scaled and turned."""
    body = herbert(hop, "Hop")
    rig = body.parent
    rename(rig, MIXAMO, "mixamorig:", ("Left", "Right"))
    into = Matrix.Rotation(math.pi / 2, 4, "X") @ Matrix.Scale(0.01, 4)
    for data in {rig.data, *(each.data for each in rig.children)}:
        data.transform(into.inverted())
    rig.matrix_world = into
    rig.name = "Armature"
    hips = 'pose.bones["mixamorig:Hips"].location'
    for fcurve in curves_of(rig):
        if fcurve.data_path == hips:
            for key in fcurve.keyframe_points:
                for point in (key.co, key.handle_left, key.handle_right):
                    point.y *= 100
    bpy.context.scene.frame_set(1)
    activate(body)
    return body


def curves_of(obj: bpy.types.Object) -> Iterable:
    data = obj.animation_data
    return data.action.layers[0].strips[0].channelbag(data.action_slot).fcurves


def vrm() -> bpy.types.Object:
    """Herbert with VRM's names, and head and body as the two meshes that share points at the neck."""
    body = herbert(hop, "Hop")
    rig = body.parent
    head = belongs(body, HEAD_BONES, (1.42, 9.0))
    above = np.array([head[[*face.vertices]].all() for face in body.data.polygons])
    in_face, in_body = (np.zeros(len(head), bool) for _ in range(2))
    for face, up in zip(body.data.polygons, above, strict=True):
        (in_face if up else in_body)[[*face.vertices]] = True
    face = part(body, "Face", in_face)
    delete(body, ~in_body)
    face.shape_key_add(name="Basis", from_mix=False)
    face.shape_key_add(name="Fcl_MTH_A", from_mix=False).value = 0.0
    body.name = "Body"
    rename(rig, VRM, "J_Bip_", ("L", "R"))
    rig.name = "Armature"
    activate(body)
    return body


def rigify() -> bpy.types.Object:
    """Herbert on a rig that Blender's Rigify generates, whose controls hop and swing the arms."""
    body = herbert(stand, "Stand")
    old = body.parent
    joints = skeleton(old)
    with quiet():
        assert addon_utils.enable("rigify", default_set=True) is not None
        bpy.ops.object.armature_basic_human_metarig_add()
    meta = bpy.context.object
    fit(meta, joints)
    with quiet():
        bpy.ops.pose.rigify_generate()
    bpy.ops.object.mode_set(mode="OBJECT")
    rig = bpy.context.object
    if rig == meta:
        rig = next(each for each in bpy.context.scene.objects if each.type == "ARMATURE" and each not in (meta, old))
    for obj in [*old.children]:
        carried = obj != body
        obj.vertex_groups.clear()
        obj.modifiers.remove(obj.modifiers["Armature"])
        if carried:
            obj.vertex_groups.new(name="DEF-spine.006").add([*range(len(obj.data.vertices))], 1.0, "REPLACE")
            obj.parent = rig
            obj.modifiers.new("Armature", "ARMATURE").object = rig
    body.parent = None
    activate(rig, body)
    with quiet():
        bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    body.modifiers.move(len(body.modifiers) - 1, 0)
    bpy.data.objects.remove(old)
    meta.hide_set(True)
    key_controls(rig)
    activate(body)
    return body


def fit(meta: bpy.types.Object, joints: Skeleton) -> None:
    """Put the bones of Rigify's basic human on these joints."""
    activate(meta)
    bpy.ops.object.mode_set(mode="EDIT")
    heads, tails = joints.heads, joints.tails
    chin = heads["head"]
    ends = {"spine": (heads["pelvis"], heads["spine_01"]), "spine.001": (heads["spine_01"], heads["spine_02"]),
            "spine.002": (heads["spine_02"], heads["spine_03"]), "spine.003": (heads["spine_03"], heads["neck_01"]),
            "spine.004": (heads["neck_01"], (heads["neck_01"] + chin) / 2),
            "spine.005": ((heads["neck_01"] + chin) / 2, chin), "spine.006": (chin, tails["head"])}  # fmt: skip
    for side, word in zip(SIDES, "LR", strict=True):
        limb = {"shoulder": "clavicle", "upper_arm": "upperarm", "forearm": "lowerarm", "hand": "hand",
                "thigh": "thigh", "shin": "calf", "foot": "foot", "toe": "ball"}  # fmt: skip
        ends |= {f"{new}.{word}": (heads[f"{bone}_{side}"], tails[f"{bone}_{side}"]) for new, bone in limb.items()}
        x, y, _ = heads[f"foot_{side}"]
        ends[f"heel.02.{word}"] = ((x - 0.04, y + 0.06, 0), (x + 0.04, y + 0.06, 0))
        ends[f"pelvis.{word}"] = (heads["pelvis"], heads[f"thigh_{side}"] + [0, -0.05, 0.1])
    bones = meta.data.edit_bones
    for bone in [each for each in bones if each.name.startswith("breast")]:
        bones.remove(bone)
    for name, (head, tail) in ends.items():
        bones[name].head, bones[name].tail = Vector(head), Vector(tail)
    bpy.ops.object.mode_set(mode="OBJECT")


def key_controls(rig: bpy.types.Object) -> None:
    """The hop with Rigify's controls: the torso and both feet, and arms that swing."""
    pose, scene, height = rig.pose.bones, bpy.context.scene, hop_height()
    for frame, up in enumerate(height, 1):
        for name, rise in (("torso", up - KNEES), ("foot_ik.L", max(up, 0)), ("foot_ik.R", max(up, 0))):
            bone = pose[name]
            bone.location = bone.bone.matrix_local.to_3x3().inverted() @ Vector((0, 0, rise))
            bone.keyframe_insert("location", frame=frame)
    for side, sign in (("L", 1), ("R", -1)):
        pose[f"upper_arm_parent.{side}"]["IK_FK"] = 1.0
        bone = pose[f"upper_arm_fk.{side}"]
        bone.rotation_mode = "QUATERNION"
        rest = bone.bone.matrix_local.to_3x3()
        for frame, lift in ((1, 25), (12, 10), (20, 60), (30, 10), (42, 25)):
            turn = Matrix.Rotation(math.radians(sign * (25 - lift)), 3, "Y")
            bone.rotation_quaternion = (rest.inverted() @ turn @ rest).to_quaternion()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
    scene.frame_start, scene.frame_end = 1, len(height)
    scene.frame_set(1)
