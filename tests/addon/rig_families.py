# SPDX-License-Identifier: GPL-3.0-or-later
"""One simple human as several rig families have theirs: with the names, scales, parents, constraints, extra meshes,
shape keys and modifiers that an importer or a rigging add-on leaves behind.

`make(name)` builds one of FAMILIES in the current scene, with a short clip: a hop, and arms that swing. All of it but
Rigify's, which Blender generates, is invented here; only names and structure are those of the families.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import addon_utils
import bpy
import figures
import numpy as np
from builders import activate, make_mesh
from human import TEETH, Bone, Family, Figure, add_shape, animate, armature, around, fuller, humanoid, skin

DRIVEN_KEYS = 200
UNREAL_TRUNK = "pelvis spine_01+spine_02 spine_03+spine_04+spine_05 neck_01+neck_02 head"
UNREAL_LIMBS = "clavicle_* upperarm_* lowerarm_* hand_* thigh_* calf_* foot_* ball_*"
UNREAL_TWISTS = {
    "upper_arm": "upperarm_twist_01_*",
    "lower_arm": "lowerarm_twist_01_*",
    "thigh": "thigh_twist_01_*",
    "shin": "calf_twist_01_*",
}
RIGIFY_RADII = {  # of the first of these with which a bone's name begins
    "spine.006": 0.09,
    "spine.005": 0.055,
    "spine.004": 0.055,
    "spine": 0.12,
    "thigh": 0.08,
    "shin": 0.06,
    "upper_arm": 0.055,
    "forearm": 0.045,
    "shoulder": 0.06,
    "foot": 0.05,
    "hand": 0.04,
    "toe": 0.04,
}


def rigify() -> Figure:
    """The human that Blender's own Rigify generates, skinned with automatic weights: deforming bones that copy
    mechanisms, bendy limbs, a face of many bones.
    """
    assert addon_utils.enable("rigify", default_set=True) is not None
    bpy.ops.object.armature_human_metarig_add()
    meta = bpy.context.object
    segments = []
    for bone in meta.data.bones:
        radius = next((radius for begin, radius in RIGIFY_RADII.items() if bone.name.startswith(begin)), 0.0)
        if radius:
            segments.append((bone.head_local, bone.tail_local, radius))
    points, faces = around(segments)
    activate(meta)
    bpy.ops.pose.rigify_generate()
    bpy.ops.object.mode_set(mode="OBJECT")
    rig = next(obj for obj in bpy.context.scene.objects if obj.type == "ARMATURE" and obj != meta)
    family = Family(rig.name, "Body", "", "", ("L", "R"), hop="torso", swing="upper_arm_fk.*")
    figure = Figure(family, rig, {}, points, faces, make_mesh(bpy.context.scene, "Body", points, faces))
    bpy.ops.object.select_all(action="DESELECT")
    figure.body.select_set(True)
    activate(rig)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    meta.hide_set(True)
    for side in family.sides:
        rig.pose.bones[f"upper_arm_parent.{side}"]["IK_FK"] = 1.0
    return figure


def mixamo() -> Figure:
    """FBX: centimeters and Y up under an armature object that is scaled and turned; clothes and eyes are meshes."""
    figure = humanoid(
        Family(
            "Armature",
            "Body",
            "mixamorig:Hips mixamorig:Spine mixamorig:Spine1+mixamorig:Spine2 mixamorig:Neck mixamorig:Head",
            "mixamorig:*Shoulder mixamorig:*Arm mixamorig:*ForeArm mixamorig:*Hand "
            "mixamorig:*UpLeg mixamorig:*Leg mixamorig:*Foot mixamorig:*ToeBase",
            ("Left", "Right"),
            head="mixamorig:Head",
            more={"mixamorig:HeadTop_End": Bone("mixamorig:Head", (0, -0.01, 1.74), (0, -0.01, 1.8))},
            scale=0.01,
            turned=pi / 2,
        )
    )
    figure.whole()
    figure.shirt("Tops")
    figure.eyes("Eyes")
    return figure


def vrm() -> Figure:
    """Face and body share points at the neck; hair and bust have spring bones; outlines come after the Armature."""
    spring = {
        "J_Sec_Hair1_01": Bone("J_Bip_C_Head", (0, 0.1, 1.64), (0, 0.1, 1.56), 0.03),
        "J_Sec_Hair2_01": Bone("J_Sec_Hair1_01", (0, 0.1, 1.56), (0, 0.1, 1.48), 0.03),
        "J_Sec_Hair3_01": Bone("J_Sec_Hair2_01", (0, 0.1, 1.48), (0, 0.1, 1.4), 0.03),
        "J_Sec_L_Bust1": Bone("J_Bip_C_UpperChest", (0.06, -0.06, 1.3), (0.06, -0.14, 1.3), 0.05),
        "J_Sec_R_Bust1": Bone("J_Bip_C_UpperChest", (-0.06, -0.06, 1.3), (-0.06, -0.14, 1.3), 0.05),
    }
    figure = humanoid(
        Family(
            "Armature",
            "Body",
            "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest+J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head",
            "J_Bip_*_Shoulder J_Bip_*_UpperArm J_Bip_*_LowerArm J_Bip_*_Hand "
            "J_Bip_*_UpperLeg J_Bip_*_LowerLeg J_Bip_*_Foot J_Bip_*_ToeBase",
            ("L", "R"),
            head="J_Bip_C_Head",
            above="Root",
            more=spring,
        )
    )
    figure.face, figure.body = figure.head_and_body("Face", "Body")
    for key in ("Fcl_ALL_Neutral", "Fcl_MTH_A", "Fcl_EYE_Close"):
        add_shape(figure.face, key, 0.0)
    strand, faces = figures.tube_between(1.38, 1.7, 9)
    figure.add("Hair001", strand * [0.06, 0.06, 1.0] + [0, 0.11, 0], faces)
    for obj in (figure.body, figure.face):
        obj.modifiers.new(f"MToon Outline ({obj.name})", "NODES").node_group = passing_on()
    for name in ("J_Bip_C_Head", "J_Bip_C_UpperChest"):
        empty(f"{name}_collider_0", figure.rig, name)
    return figure


def daz() -> Figure:
    """Preserve Volume; an identity key that is on and hundreds that are driven; a geograft with a mask; bones in pairs
    of bend and twist.
    """
    figure = humanoid(
        Family(
            "Genesis 8 Female",
            "Genesis 8 Female Mesh",
            "pelvis abdomenLower+abdomenUpper chestLower+chestUpper neckLower+neckUpper head",
            "*Collar *ShldrBend+*ShldrTwist *ForearmBend+*ForearmTwist *Hand "
            "*ThighBend+*ThighTwist *Shin *Foot *Metatarsals+*Toe",
            ("l", "r"),
            above="hip",
            beside=True,
            hop="hip",
            more={"lowerJaw": Bone("head", (0, -0.03, 1.6), (0, -0.1, 1.57), 0.03)},
        )
    )
    body = figure.whole("Armature SkinBinding")
    full = fuller(body, 0.05)
    add_shape(body, "FBMBodySize", 1.0, full)
    for k in range(DRIVEN_KEYS):
        figure.rig[f"pJCM{k:03d}"] = 0.0
        drive(add_shape(body, f"pJCM{k:03d}", 0.0, 0.1 * full), figure.rig, f'["pJCM{k:03d}"]')
    near = np.linalg.norm(figure.points - [0, -0.1, 1.0], axis=1) < 0.09
    graft = figure.part("Genesis 8 Female Graft", near)
    mask(body, "Graft", near)
    figure.eyes("Genesis 8 Female Eyelashes Mesh")
    for obj in (body, graft):
        obj.modifiers[0].use_deform_preserve_volume = True
    return figure


def mmd() -> Figure:
    """Japanese names; an empty at the top; legs and eyes turn by additional rotation, some through shadow bones; an
    Armature modifier without an armature; rigid bodies.
    """
    more = {
        "両目": Bone("頭", (0, -0.05, 1.8), (0, -0.1, 1.8)),
        "後髪1": Bone("頭", (0, 0.1, 1.6), (0, 0.1, 1.4), 0.03),
    }
    for side, x in ((".L", 0.11), (".R", -0.11)):
        more |= {
            "足" + side: Bone("下半身", (x, 0, 0.93), (x, 0, 0.5)),
            "ひざ" + side: Bone("足" + side, (x, 0, 0.5), (x, 0.01, 0.1)),
            "足首" + side: Bone("ひざ" + side, (x, 0.01, 0.1), (x, -0.12, 0.04)),
            "目" + side: Bone("頭", (x / 3, -0.09, 1.66), (x / 3, -0.11, 1.66)),
            "_dummy_目" + side: Bone("両目", (0, -0.05, 1.8), (0, -0.07, 1.8)),
            "_shadow_目" + side: Bone("頭", (0, -0.05, 1.8), (0, -0.07, 1.8)),
        }
    figure = humanoid(
        Family(
            "Model_arm",
            "Model_mesh",
            "下半身 上半身 上半身2 首 頭",
            "肩* 腕*+腕捩* ひじ*+手捩* 手首* 足D* ひざD* 足首D* 足先EX*",
            (".L", ".R"),
            head="頭",
            above="全ての親 センター",
            beside=True,
            hop="センター",
            more=more,
        )
    )
    root = empty("Model")
    figure.rig.parent = root
    figure.whole("mmd_armature").modifiers.new("mmd_bone_order_override", "ARMATURE")
    figure.body.modifiers.move(1, 0)
    turn = {"map_from": "ROTATION", "map_to": "ROTATION", "target_space": "LOCAL", "owner_space": "LOCAL"}
    for side in figure.family.sides:
        for name in ("足", "ひざ", "足首"):
            figure.constrain(f"{name}D{side}", "TRANSFORM", name + side, **turn)
        figure.constrain(f"_shadow_目{side}", "COPY_TRANSFORMS", f"_dummy_目{side}")
        figure.constrain(f"目{side}", "TRANSFORM", f"_shadow_目{side}", **turn)
    add_rigid_body(figure, empty("rigidbodies", root), "後髪1")
    return figure


def human_generator() -> Figure:
    """Keys that make a man of the Basis are on; masks hide the body below its clothes; eyes and teeth are meshes."""
    figure = humanoid(
        Family(
            "HG_Rig",
            "HG_Body",
            "spine spine.001 spine.002+spine.003 neck head",
            "shoulder* upper_arm* forearm* hand* thigh* shin* foot* toe*",
            (".L", ".R"),
            more={"jaw": Bone("head", (0, -0.03, 1.6), (0, -0.1, 1.57), 0.03)},
        )
    )
    body = figure.whole()
    add_shape(body, "Male", 1.0, fuller(body, 0.04))
    add_shape(body, "LIVE_KEY_PERMANENT", 1.0, fuller(body, 0.02))
    add_shape(body, "LIVE_KEY_TEMP_belly", 0.5, fuller(body, 0.04))
    drive(add_shape(body, "cor_ElbowBend_Lt", 0.0), figure.rig, 'pose.bones["forearm.L"].rotation_euler[0]')
    shirt = figure.shirt("HG_Shirt")
    add_shape(shirt, "Body Proportions", 1.0, fuller(shirt, 0.08))
    height = figure.points[:, 2]
    mask(body, "mask_torso", (height > 1.03) & (height < 1.33))
    figure.eyes("HG_Eyes")
    figure.on_bone("HG_TeethUpper", "head", *figures.ball(TEETH, 0.012))
    figure.on_bone("HG_TeethLower", "jaw", *figures.ball(TEETH, 0.011))
    return figure


def auto_rig_pro() -> Figure:
    """Controls move the bones that deform, which stretch; a second, disabled armature has a modifier of its own;
    Preserve Volume.
    """
    controls = {
        "c_traj": Bone("", (0, 0, 0), (0, -0.1, 0)),
        "c_root_master.x": Bone("c_traj", (0, 0, 0.95), (0, 0, 1.05)),
        "c_head.x": Bone("neck.x", (0, -0.01, 1.53), (0, -0.01, 1.74)),
    }
    for side, sign in ((".l", 1), (".r", -1)):
        controls["c_arm_fk" + side] = Bone("shoulder" + side, (0.16 * sign, 0, 1.41), (0.42 * sign, 0, 1.41))
        controls["c_forearm_fk" + side] = Bone("c_arm_fk" + side, (0.42 * sign, 0, 1.41), (0.66 * sign, 0, 1.41))
    figure = humanoid(
        Family(
            "rig",
            "Body",
            "root.x spine_01.x spine_02.x neck.x head.x",
            "shoulder* arm_twist*+arm_stretch* forearm_stretch*+forearm_twist* hand* "
            "thigh_twist*+thigh_stretch* leg_stretch*+leg_twist* foot* toes_01*",
            (".l", ".r"),
            head="c_head.x",
            hop="c_root_master.x",
            swing="c_arm_fk*",
            more=controls,
        )
    )
    figure.constrain("root.x", "COPY_TRANSFORMS", "c_root_master.x")
    figure.constrain("head.x", "COPY_TRANSFORMS", "c_head.x")
    for side in figure.family.sides:
        figure.constrain("arm_twist" + side, "COPY_ROTATION", "c_arm_fk" + side)
        figure.constrain("arm_stretch" + side, "STRETCH_TO", "c_forearm_fk" + side)
        figure.constrain("forearm_stretch" + side, "COPY_TRANSFORMS", "c_forearm_fk" + side)
    added = Family("rig_add", "", "", "", ("", ""))
    added = armature(added, {"c_spine_01_bend.x": Bone("", (0, 0, 1.05), (0, 0, 1.2), 0.1)})
    added.constraints.new("COPY_SCALE").target = figure.rig
    added.hide_viewport = True
    body = figure.whole("rig")
    body.modifiers["rig"].use_deform_preserve_volume = True
    body.modifiers.new("rig_add", "ARMATURE").object = added
    body.modifiers.move(1, 0)
    figure.eyes("Eyes", "head.x")
    return figure


def mpfb() -> Figure:
    """Helper geometry in the mesh, which a mask hides; the macro's key is on; two modifiers, one with Preserve Volume
    for a vertex group.
    """
    figure = humanoid(
        Family(
            "Human.rig",
            "Human",
            "pelvis spine_01 spine_02+spine_03 neck_01 head",
            UNREAL_LIMBS,
            ("l", "r"),
            above="Root",
        )
    )
    skirt, around_legs = figures.tube_between(0.35, 1.0, 12)
    cube, more = figures.ball((0.42, 0.0, 1.41), 0.01)
    points, faces, parts = figure.points, list(figure.faces), [len(figure.points)]
    for others, their in ((skirt * [0.9, 0.6, 1.0], around_legs), (cube, more)):
        faces += [[corner + len(points) for corner in face] for face in their]
        points = np.concatenate([points, others])
        parts.append(len(points))
    figure.body = body = figure.add("Human", points, faces)
    for name, first, last in zip(("body", "HelperGeometry", "JointCubes"), [0, *parts], parts, strict=False):
        body.vertex_groups.new(name=name).add(list(range(first, last)), 1.0, "REPLACE")
    volume = body.vertex_groups.new(name="mhmask-preserve-volume")
    volume.add(np.flatnonzero(abs(points[:, 0]) > 0.3).tolist(), 1.0, "REPLACE")
    second = body.modifiers.new("Armature PV", "ARMATURE")
    second.object, second.vertex_group = figure.rig, volume.name
    second.use_deform_preserve_volume = second.use_multi_modifier = True
    body.modifiers.new("Hide helpers", "MASK").vertex_group = "body"
    body.modifiers.new("Subdivision", "SUBSURF").levels = 0
    add_shape(body, "$md-universal-female-young-averagemuscle-maxweight", 1.0, fuller(body, 0.05))
    figure.eyes("Human.low-poly")
    return figure


def unreal() -> Figure:
    """FBX: an armature object named root, in centimeters, whose meshes are scaled back; twist bones; IK bones that move
    no skin.
    """
    goals = {
        "ik_foot_root": Bone("", (0, 0, 0), (0, 0.1, 0)),
        "ik_hand_root": Bone("", (0, 0, 0), (0, 0.1, 0)),
        "ik_hand_gun": Bone("ik_hand_root", (-0.66, 0, 1.41), (-0.7, 0, 1.41)),
    }
    figure = humanoid(
        Family(
            "root",
            "SKM_Manny",
            UNREAL_TRUNK,
            UNREAL_LIMBS,
            ("l", "r"),
            twists=UNREAL_TWISTS,
            more=goals,
            scale=0.01,
            body_scale=100.0,
        )
    )
    figure.whole()
    return figure


def character_creator() -> Figure:
    """FBX: centimeters; skin of several materials; eyes, teeth and clothes are meshes; twist bones; face keys."""
    face = {
        "CC_Base_FacialBone": Bone("CC_Base_Head", (0, -0.05, 1.6), (0, -0.1, 1.6)),
        "CC_Base_JawRoot": Bone("CC_Base_FacialBone", (0, -0.03, 1.6), (0, -0.1, 1.57), 0.03),
    }
    parts = {"upper_arm": "Upperarm", "lower_arm": "Forearm", "thigh": "Thigh", "shin": "Calf"}
    figure = humanoid(
        Family(
            "Kevin",
            "CC_Base_Body",
            "CC_Base_Pelvis CC_Base_Waist CC_Base_Spine01+CC_Base_Spine02 "
            "CC_Base_NeckTwist01+CC_Base_NeckTwist02 CC_Base_Head",
            "CC_Base_*_Clavicle CC_Base_*_Upperarm CC_Base_*_Forearm CC_Base_*_Hand "
            "CC_Base_*_Thigh CC_Base_*_Calf CC_Base_*_Foot CC_Base_*_ToeBase",
            ("L", "R"),
            head="CC_Base_Head",
            above="CC_Base_BoneRoot CC_Base_Hip",
            beside=True,
            hop="CC_Base_Hip",
            twists={role: f"CC_Base_*_{part}Twist01 CC_Base_*_{part}Twist02" for role, part in parts.items()},
            more=face,
            scale=0.01,
        )
    )
    body = figure.whole()
    for name in ("Std_Skin_Head", "Std_Skin_Body", "Std_Skin_Arm", "Std_Skin_Leg"):
        body.data.materials.append(bpy.data.materials.new(name))
    for polygon in body.data.polygons:
        x, _, z = figure.points[list(polygon.vertices)].mean(axis=0)
        polygon.material_index = 0 if z > 1.5 else 2 if abs(x) > 0.2 else 3 if z < 0.9 else 1
    for key in ("Eye_Blink_L", "Mouth_Smile_L", "Jaw_Open"):
        add_shape(body, key, 0.0)
    figure.eyes("CC_Base_Eye")
    figure.on_bone("CC_Base_Teeth", "CC_Base_JawRoot", *figures.ball(TEETH, 0.012))
    figure.shirt("Tight_shirt")
    return figure


def metahuman() -> Figure:
    """Head and body are meshes on one armature, with many face joints; other levels of detail are hidden."""
    points, _ = skin()
    front = points[(points[:, 2] > 1.55) & (points[:, 1] < 0.02)] * [0.9, 0.9, 1.0]
    joints = {
        "FACIAL_C_FacialRoot": Bone("head", (0, 0, 1.6), (0, -0.02, 1.6)),
        "FACIAL_C_Neck1Root": Bone("neck_01", (0, 0, 1.45), (0, -0.02, 1.45)),
    }
    for k, (x, y, z) in enumerate(front.tolist()):
        name = f"FACIAL_{'L' if x > 0 else 'R'}_Skin{k}"
        joints[name] = Bone("FACIAL_C_FacialRoot", (x, y, z), (x, y - 0.01, z), 0.015)
    figure = humanoid(
        Family(
            "root",
            "body_lod0_mesh",
            UNREAL_TRUNK,
            UNREAL_LIMBS,
            ("l", "r"),
            twists=UNREAL_TWISTS,
            more=joints,
        )
    )
    figure.face, figure.body = figure.head_and_body("head_lod0_mesh", "body_lod0_mesh")
    for obj in figure.head_and_body("head_lod1_mesh", "body_lod1_mesh"):
        obj.hide_viewport = obj.hide_render = True
    figure.eyes("eyeLeft_lod0_mesh")
    return figure


# What several of them have -------------------------------------------------------------------------------------------


def empty(name: str, parent=None, bone=""):
    made = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(made)
    made.parent = parent
    if bone:
        made.parent_type, made.parent_bone = "BONE", bone
    return made


def mask(body, name: str, hidden: np.ndarray):
    """A modifier that hides these vertices (V,)."""
    body.vertex_groups.new(name=name).add(np.flatnonzero(hidden).tolist(), 1.0, "REPLACE")
    modifier = body.modifiers.new(name, "MASK")
    modifier.vertex_group, modifier.invert_vertex_group = name, True


def drive(block, obj, path: str):
    """Let a property of an object be the value of a shape key."""
    driver = block.driver_add("value").driver
    driver.type = "SUM"
    target = driver.variables.new().targets[0]
    target.id, target.data_path = obj, path


def passing_on():
    """A node group that gives its geometry on."""
    group = bpy.data.node_groups.new("Outline", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    first, last = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(first.outputs[0], last.inputs[0])
    return group


def add_rigid_body(figure: Figure, parent, bone: str):
    """A rigid body whose rotation a bone follows."""
    points, faces = figures.ball(figure.bones[bone].head, 0.03)
    body = make_mesh(bpy.context.scene, f"{bone}_rigid", points, faces)
    body.parent, body.hide_render = parent, True
    with bpy.context.temp_override(object=body, active_object=body, selected_objects=[body]):
        bpy.ops.rigidbody.object_add(type="ACTIVE")
    track = figure.rig.pose.bones[bone].constraints.new("COPY_ROTATION")
    track.name, track.target = "mmd_tools_rigid_track", body


FAMILIES: dict[str, Callable[[], Figure]] = {
    "Rigify": rigify,
    "Mixamo": mixamo,
    "VRM": vrm,
    "Daz": daz,
    "MMD": mmd,
    "Human Generator": human_generator,
    "Auto-Rig Pro": auto_rig_pro,
    "MPFB": mpfb,
    "Unreal": unreal,
    "Character Creator": character_creator,
    "MetaHuman": metahuman,
}


def make(name: str) -> Figure:
    """A human of the family, animated, with its body active."""
    figure = FAMILIES[name]()
    animate(figure)
    bpy.ops.object.select_all(action="DESELECT")
    figure.body.select_set(True)
    activate(figure.body)
    bpy.context.view_layer.update()
    return figure
