# SPDX-License-Identifier: GPL-3.0-or-later
"""What the robustness tests share: coarse bakes, the state that buttons may change, and how to press each button."""

import tempfile
from pathlib import Path

import bpy
import numpy as np
from bl_ext.user_default.dynamic_morph_targets.core.motion.grab import Grab
from bl_ext.user_default.dynamic_morph_targets.core.result.judge import Limits, Verdict
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.properties import target_properties
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from builders import activate, evaluated_points, fingerprint, keys_of, make_box, rig_of
from test_targets import drive

OPS = bpy.ops.dynamorph
DRAGS = {3: {0: Grab(np.array([5]), np.array([[0.4, 0.0, 1.0]]), np.array([100.0]))}}


def coarse(obj):
    """A cage that is built in a fraction of a second."""
    obj.dynamorph.model.cage_nodes = 200
    obj.dynamorph.model.modes = 6
    obj.dynamorph.model.pin_radius = 0.5
    return obj


def bake(obj, **options):
    job = Job(obj, goal="BAKE", **options)
    batch.run(job)
    return job


def names(obj):
    return [block.name for block in keys_of(obj).key_blocks]


def motion(obj, frames=(1, 7, 13, 20)):
    """Where Blender shows the mesh at some frames."""
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated_points(obj))
    return np.array(shown)


def settings(group):
    """All properties of a property group, and of the groups in it, as comparable data."""
    out = {}
    for prop in group.bl_rna.properties:
        value = getattr(group, prop.identifier)
        if prop.identifier == "rna_type":
            continue
        if prop.type == "COLLECTION":
            value = [settings(item) for item in value]
        elif isinstance(value, bpy.types.PropertyGroup):
            gone = isinstance(value, target_properties.DynamorphKey) and not value.name
            value = None if gone else settings(value)  # the former state of a missing key does not matter
        elif prop.type == "POINTER":
            value = value and value.name
        elif getattr(prop, "is_array", False):
            value = tuple(value)
        out[prop.identifier] = value
    return out


def plain(data):
    """The simple properties of something, for example a modifier."""
    given = {prop.identifier: getattr(data, prop.identifier) for prop in data.bl_rna.properties}
    return {name: value for name, value in given.items() if isinstance(value, bool | int | float | str)}


def state():
    """Everything of every mesh and rig in the scene that a button of the add-on may change."""
    out = {"frame": bpy.context.scene.frame_current, "active": bpy.context.object and bpy.context.object.name}
    for obj in bpy.context.scene.objects:
        mine = out[obj.name] = {"mode": obj.mode, "world": [tuple(row) for row in obj.matrix_world]}
        if obj.type == "ARMATURE":
            mine["pose"] = [tuple(map(tuple, bone.matrix_basis)) for bone in obj.pose.bones]
            mine["segments"] = [bone.bbone_segments for bone in obj.data.bones]
        if obj.type == "MESH":
            mine["settings"] = settings(obj.dynamorph)
            mine["modifiers"] = [plain(modifier) for modifier in obj.modifiers]
            mine["pinned"] = obj.show_only_shape_key
            mine["model"] = list(obj.get(model_store.PACKED, ()))
            mine["keys"] = fingerprint(obj) if keys_of(obj) else None
            mine["groups"] = obj.vertex_groups.keys()
            mine["weights"] = [[(g.group, g.weight) for g in vertex.groups] for vertex in obj.data.vertices]
    return out


# Every button ------------------------------------------------------------------------------------------------------


def no_soft_skin(obj):
    obj.dynamorph.targets.clear()


def target_selected(obj):
    obj.dynamorph.active_target_index = 1


def painting(of):
    """One side of a map."""

    def paint(obj):
        activate(obj)
        getattr(bpy.ops.dynamorph, f"paint_{of}")()
        right = [vertex.index for vertex in obj.data.vertices if vertex.co.x < 0.0]
        obj.vertex_groups.active.add(right, 0.25, "REPLACE")

    return paint


def posed(obj):
    target_selected(obj)
    rig_of(obj).pose.bones["upper"].rotation_euler.y = 0.7
    bpy.context.view_layer.update()


def bones_selected(obj):
    target_selected(obj)
    for bone in rig_of(obj).pose.bones:
        (bone if hasattr(bone, "select") else bone.bone).select = bone.name == "upper"


def two_targets(obj):
    posed(obj)
    OPS.add_target(key="smile")
    target_selected(obj)


def two_sides(obj):
    """A bone on the other side, and a target whose name says its side."""
    rig = rig_of(obj)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].name = "lower.L"
    other = rig.data.edit_bones.new("lower.R")
    other.head, other.tail, other.parent = (0, 0, 1), (0, 0, 2), rig.data.edit_bones["upper"]
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(obj)
    keys_of(obj).key_blocks["flexed"].name = "flexed.L"
    target_selected(obj)


def driven(obj):
    drive(obj, "smile", "angle", angle=("ROT_X", "upper"))


def enveloped(obj):
    obj.modifiers["Armature"].use_bone_envelopes = True


def scripted(obj):
    obj.dynamorph.model.hold = "BONES"


def sculpting(obj):
    target_selected(obj)
    OPS.sculpt_target(mode="SCULPT")


def built(obj):
    target_selected(obj)
    OPS.build()


def recording(obj):
    """Live, with a drag that was recorded."""
    built(obj)
    OPS.live()
    OPS.record_drags()
    remembered.live.sessions[obj.session_uid].recorded = dict(DRAGS)


def gripped(obj):
    """By an empty, which stays selected."""
    hook = bpy.data.objects.new("Hook", None)
    bpy.context.scene.collection.objects.link(hook)
    hook.location = (0.4, 0.0, 1.0)
    hook.select_set(True)
    activate(obj)
    OPS.attach()


def gripped_elsewhere(obj):
    """What grips it has moved since."""
    gripped(obj)
    bpy.data.objects["Hook"].location.x += 1.0
    bpy.context.view_layer.update()


def with_channel(obj):
    target_selected(obj)
    OPS.add_channel(data_path='bpy.data.objects["Arm"].pass_index')


def baked(obj):
    OPS.bake()


def judged(obj):
    """A bake whose verdict is that it is too soft."""
    baked(obj)
    obj.dynamorph.bake.verdict = Verdict(Limits(0.05), percentile=0.1, frame=7.0, vertices=(3,)).record


def captured_on_the_way(obj):
    """Add a pose so that the end of the shot is far from the target."""
    target_selected(obj)
    bpy.context.scene.frame_set(8)
    OPS.capture_pose()
    bpy.context.scene.frame_set(1)


def gained(obj):
    built(obj)
    obj.dynamorph.modes[1].gain = 2.0


def two_slots(obj):
    OPS.copy_slot()
    obj.dynamorph.targets[0].stiffness *= 2.0


def setup_saved(obj):
    OPS.save_setup(filepath=SETUP)
    obj.dynamorph.targets[0].stiffness *= 2.0


def preset_saved(obj):
    target_selected(obj)
    PRESET.write_text("import bpy\nbpy.context.object.dynamorph.active_target.stiffness = 777.0\n")


def piece_listed(obj):
    """Another mesh on the armature, which is a piece."""
    other_mesh_selected(obj)
    piece = obj.dynamorph.attachments.add()
    piece.object, piece.name = bpy.data.objects["Sleeve"], "Sleeve"


def other_mesh_selected(obj):
    other = bpy.data.objects.new("Sleeve", obj.data.copy())
    bpy.context.scene.collection.objects.link(other)
    other.shape_key_clear()
    for group in obj.vertex_groups:
        other.vertex_groups.new(name=group.name)
    other.modifiers.new("Armature", "ARMATURE").object = rig_of(obj)
    other.select_set(True)
    obj.select_set(True)


def box_selected(obj):
    for selected in (make_box(collision=False), obj):
        selected.select_set(True)


FOLDER = Path(tempfile.mkdtemp(prefix="dynamorph_test_"))
SETUP, PRESET = str(FOLDER / "setup.json"), FOLDER / "preset.py"


CALLS = {  # what a button needs beforehand, and its arguments
    "add_floor": (target_selected, {}),
    "add_attachment": (other_mesh_selected, {}),
    "add_soft_skin": (no_soft_skin, {}),
    "add_target": (posed, {"key": "smile"}),
    "apply_feel": (target_selected, {"feel": "CARTOON"}),
    "apply_material": (target_selected, {"preset": "FAT"}),
    "bake": (target_selected, {}),
    "bake_all": (target_selected, {}),
    "bake_options": (target_selected, {"to_action": True}),
    "build": (target_selected, {}),
    "build_live": (target_selected, {}),
    "build_cage": (target_selected, {}),
    "capture_pose": (posed, {}),
    "check_targets": (built, {}),
    "attach": (gripped, {}),
    "attach_here": (gripped_elsewhere, {}),
    "remove_grip": (gripped, {}),
    "collide": (box_selected, {}),
    "compare_beside": (baked, {}),
    "compare_full": (baked, {}),
    "copy_slot": (target_selected, {}),
    "copy_to_selected": (other_mesh_selected, {}),
    "duplicate_target": (target_selected, {}),
    "find_attachments": (other_mesh_selected, {}),
    "finish_sculpt": (sculpting, {}),
    "fit_bounce": (built, {"frequency": 5.0, "settle_time": 0.5}),
    "fit_material": (built, {"frequency": 5.0, "settle_time": 0.5}),
    "fix": (enveloped, {"problem": "ENVELOPES"}),
    "first_look": (target_selected, {}),
    "delete_bake": (baked, {}),
    "go_to_pose": (target_selected, {}),
    "reset_setting": (scripted, {"setting": "hold"}),
    "hold_bones": (bones_selected, {}),
    "live": (built, {}),
    "load_preset": (preset_saved, {"filepath": str(PRESET), "menu_idname": "DYNAMORPH_PT_material_presets"}),
    "load_setup": (setup_saved, {"filepath": SETUP}),
    "mirror_firmness": (painting("firmness"), {"to": "LEFT"}),
    "mirror_max_distance": (painting("max_distance"), {"to": "LEFT"}),
    "mirror_target": (two_sides, {}),
    "add_channel": (target_selected, {"data_path": 'bpy.data.objects["Arm"].pass_index'}),
    "add_tension": (target_selected, {}),
    "remove_channel": (with_channel, {}),
    "move_target": (two_targets, {"direction": "DOWN"}),
    "new_from_pose": (posed, {"key": "Bent"}),
    "shape_by_physics": (posed, {}),
    "paint_firmness": (target_selected, {}),
    "paint_max_distance": (target_selected, {}),
    "region_from_sculpt": (target_selected, {}),
    "remove_bone": (target_selected, {"bone": "lower"}),
    "remove_attachment": (piece_listed, {}),
    "remove_soft_skin": (target_selected, {}),
    "remove_target": (target_selected, {}),
    "record_drags": (recording, {}),
    "reset_gains": (gained, {}),
    "sculpt_target": (target_selected, {}),
    "select_key": (target_selected, {}),
    "select_target": (built, {}),
    "select_attachment": (piece_listed, {}),
    "show_plain": (baked, {}),
    "show_worst": (judged, {}),
    "stiffen": (judged, {}),
    "find_uncovered_pose": (captured_on_the_way, {}),
    "suggest_targets": (driven, {}),
    "swap_slot": (two_slots, {}),
    "use_selected_bones": (bones_selected, {}),
}
BY_MOUSE = {"let_go", "grab"}  # of a tool
CHANGING_NOTHING = {  # nothing that is saved or undone
    "cancel": (target_selected, {}),
    "export": (baked, {"format": "GLTF", "filepath": str(FOLDER / "clip.glb")}),
    "export_actions": (baked, {"format": "GLTF", "filepath": str(FOLDER / "clips.glb")}),
    "export_check": (baked, {"format": "GLTF"}),
    "material_preset": (target_selected, {"name": "Test"}),
    "play_mode": (built, {}),
    "save_setup": (target_selected, {"filepath": SETUP}),
    "setup_preset": (target_selected, {"name": "Test"}),
    "shake_test": (built, {"kind": "TWIST"}),
    "update_target_weights": (target_selected, {}),
}
