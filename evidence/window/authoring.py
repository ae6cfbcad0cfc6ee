# SPDX-License-Identifier: GPL-3.0-or-later
"""Problems and their fixes, the cage, groups that are painted, target weights, targets that are sculpted or driven."""

from __future__ import annotations

import math

import bpy
import driver
import frames
import limb
import numpy as np
from driver import Task, measure, step, until
from editors import (
    addon,
    close,
    differing,
    from_menu,
    job_done,
    key_points,
    keys,
    on_screen,
    physics,
    properties,
    rig,
    settings,
    shown,
    sidebar,
    skin,
    view,
    viewport,
)

BRUSH = 40  # pixels, the radius
MODE = (-60, -35)  # pixels from the mouse to the drop-down in the dialog that a click opens
task: Task  # begun with New from Pose, done when it shows


@step("A problem, with its Fix")
def problem():
    modifier = skin().modifiers["Armature"]
    modifier.use_bone_envelopes = True  # not by hand
    yield from driver.drawn()
    fix = "dynamorph.fix(problem='ENVELOPES')"
    yield from sidebar.find(fix)
    yield from driver.keep("problem", sidebar)
    yield from sidebar.press(fix)
    yield from until(lambda: not modifier.use_bone_envelopes, "the problem to be fixed")
    assert not list(addon("scene.check.checks").problems(addon("scene.skinning").Skinning.of(skin())))


# The cage ------------------------------------------------------------------------------------------------------------


@step("Build Cage")
def build_cage():
    settings().model.hold = "BONES"  # not by hand
    yield from physics("advanced")
    yield from properties.press("dynamorph.reset_setting(setting='hold')")
    yield from until(lambda: settings().model.hold == "THICKNESS", "what a script has set to be reset")
    yield from physics("cage")
    yield from properties.look_into("model.cage_object")
    yield from properties.enter("model.cage_nodes", "800")
    yield from properties.press("dynamorph.build_cage")
    yield from job_done()
    assert settings().model.cage and not settings().model.summary


@step("Show it", picture=view)
def cage():
    before = driver.pixels(viewport.box)
    yield from properties.press("dynamorph.cage")
    yield from driver.drawn()
    assert differing(before) > 0.005, "the viewport shows no cage"


@step("Paint where it is softer", picture=view)
def paint():
    yield from properties.press("dynamorph.cage")
    yield from close("cage", "advanced")
    yield from sidebar.fold("DYNAMORPH_PT_targets")
    yield from sidebar.unfold("DYNAMORPH_PT_firmness")
    yield from sidebar.look_into("dynamorph.firmness_group")
    bpy.context.scene.frame_set(1)
    settings().firmness_group = ""  # a map of its own
    yield from sidebar.press("dynamorph.paint_firmness")
    yield from until(lambda: skin().mode == "WEIGHT_PAINT", "Weight Paint")
    yield from stroke(0.0, 0.56, 0.58)
    assert firmness().min() < 0.25 and firmness().max() == 0.5, "the stroke painted nothing"


def firmness() -> np.ndarray:
    return addon("scene.read.mesh_data").group_weights(skin(), [settings().firmness_group])[:, 0]


def stroke(weight: float, start: float, end: float):
    """Across the wrist, at these places along the arm."""
    tool = bpy.context.scene.tool_settings.weight_paint
    tool.unified_paint_settings.size = 2 * BRUSH
    tool.unified_paint_settings.weight = tool.brush.weight = weight
    wrist = np.linspace((start, -0.03, 0.03), (end, -0.03, -0.03), 6)
    yield from driver.drag([on_screen(point) for point in wrist])


@step("Hold Selected Bones, and blur the border")
def hold_bones():
    painted, forearm = firmness(), addon("scene.read.mesh_data").group_weights(skin(), [limb.BONES[1]])[:, 0]
    for bone in rig().pose.bones:
        bone.select = bone.name == limb.BONES[1]  # not by hand
    yield from sidebar.press("dynamorph.hold_bones")
    yield from until(lambda: (firmness()[forearm > 0.5] == 1.0).all(), "the forearm to be held")
    held = firmness()
    yield from sidebar.press("object.vertex_group_smooth")
    yield from until(lambda: not np.array_equal(firmness(), held), "the blur")
    assert np.abs(firmness() - held).max() < 0.5
    for _ in range(2):
        yield from viewport.key("Z", ctrl=True)
    yield from until(lambda: np.array_equal(firmness(), painted), "both to be undone")


@step("A firmer wrist, and its colors")
def firmer():
    yield from stroke(0.9, 0.5, 0.5)
    assert firmness().max() > 0.7, "the stroke painted nothing"
    yield from sidebar.press("dynamorph.paint_firmness")
    yield from until(lambda: skin().mode == "OBJECT", "Object Mode")
    before = driver.pixels(viewport.box)
    yield from sidebar.press("dynamorph.firmness")
    yield from driver.drawn()
    assert differing(before) > 0.01, "the viewport shows no firmness"
    yield from driver.keep("firmness", viewport)
    yield from sidebar.press("dynamorph.firmness")
    skin().vertex_groups.remove(skin().vertex_groups[settings().firmness_group])
    settings().firmness_group = ""  # the next steps are about an arm without a map
    yield from driver.drawn()
    yield from sidebar.fold("DYNAMORPH_PT_firmness")


@step("A map of how far the skin may move")
def max_distance():
    yield from sidebar.unfold("DYNAMORPH_PT_max_distance")
    yield from sidebar.look_into("dynamorph.max_distance_group")
    yield from sidebar.press("dynamorph.paint_max_distance")
    yield from until(lambda: skin().mode == "WEIGHT_PAINT", "Weight Paint")
    yield from stroke(0.0, 0.56, 0.58)
    group = settings().max_distance_group
    painted = addon("scene.read.mesh_data").group_weights(skin(), [group])[:, 0]
    assert painted.min() < 0.5 and painted.max() == 1.0, "the stroke painted nothing"
    yield from sidebar.press("dynamorph.paint_max_distance")
    yield from until(lambda: skin().mode == "OBJECT", "Object Mode")
    before = driver.pixels(viewport.box)
    yield from sidebar.press("dynamorph.max_distance")
    yield from driver.drawn()
    assert differing(before) > 0.01, "the viewport shows no map"
    yield from sidebar.press("dynamorph.max_distance")
    skin().vertex_groups.remove(skin().vertex_groups[group])
    settings().max_distance_group = ""  # the next steps are about an arm without a map
    yield from driver.drawn()
    yield from sidebar.fold("DYNAMORPH_PT_max_distance")


@step("Attachments: find another mesh, and remove it from the list")
def attachments():
    cuff = add_a_cuff()  # not by hand
    yield from physics("attachments")
    yield from properties.press("dynamorph.find_attachments")
    listed = lambda: [piece.object for piece in settings().attachments]  # noqa: E731
    yield from until(lambda: cuff in listed(), "the cuff in the list")
    settings().active_attachment_index = listed().index(cuff)
    yield from driver.keep("attachments", properties)
    yield from properties.choose_other("attachments[0].attached_by")
    yield from properties.look_into("attachments[0].object")
    yield from properties.press("dynamorph.remove_attachment")
    yield from until(lambda: cuff not in listed(), "the cuff to be out of the list")
    yield from properties.press("dynamorph.add_attachment")
    yield from until(lambda: listed() == [None], "an attachment without an object")
    yield from properties.look_into("attachments[0].group")
    yield from properties.press("dynamorph.remove_attachment")
    yield from until(lambda: not listed(), "an empty list")
    yield from close("attachments")
    bpy.data.objects.remove(cuff)


def add_a_cuff():
    """A second mesh on the armature: a copy of the arm's, without its keys."""
    cuff = skin().copy()
    cuff.data = skin().data.copy()
    cuff.name = "Cuff"
    cuff.shape_key_clear()
    cuff.dynamorph.targets.clear()
    bpy.context.scene.collection.objects.link(cuff)
    cuff.select_set(False)
    return cuff


# Target weights and new targets --------------------------------------------------------------------------------------


@step("Target Weights: bars and graph", picture=view)
def target_weights():
    yield from sidebar.unfold("DYNAMORPH_PT_target_weights")
    yield from sidebar.press("dynamorph.target_weights")
    yield from until(lambda: addon("run.tools.weight_curves").drawn(skin()), "the graph")
    known, graph = addon("run.tools.weight_curves").drawn(skin())
    assert (known.start, known.end) == (1, limb.LAST)
    # The flexed target is the last: its region forms a set of its own, after the body's.
    assert graph.weights[limb.FLEXED - 1, -1] > 0.99 and graph.outside[limb.TURNED - 1].any()
    bpy.context.scene.frame_set((limb.FIRST + limb.FLEXED) // 2)


@step("Find Uncovered Pose")
def find_uncovered_pose():
    yield from sidebar.press("dynamorph.find_uncovered_pose")
    yield from until(lambda: bpy.context.scene.frame_current == limb.TURNED, "the frame that is furthest from targets")
    yield from sidebar.press("dynamorph.target_weights")
    yield from sidebar.fold("DYNAMORPH_PT_target_weights")


@step("What New from Pose asks")
def ask():
    yield from sidebar.unfold("DYNAMORPH_PT_targets")
    x, y = yield from sidebar.pop_up("dynamorph.new_from_pose")
    mode = (x + MODE[0], y + MODE[1])
    yield from driver.drop_down(mode, "DYNAMORPH_OT_new_from_pose.mode")
    yield from driver.tap("ESC", mode)
    yield from driver.tap("ESC", mode)
    yield from sidebar.fold("DYNAMORPH_PT_targets")


@step("New from Pose", picture=view)
def new_from_pose():
    global task
    task = Task("a target from a pose and two strokes, seen in Live", 8)
    yield from frames.click(limb.TURNED)
    yield from sidebar.unfold("DYNAMORPH_PT_targets")
    yield from sidebar.press("dynamorph.new_from_pose")
    yield from sidebar.key("RET")
    yield from until(lambda: skin().mode == "SCULPT", "Sculpt Mode")
    assert keys()[-1] == "Pose 1" == skin().active_shape_key.name
    assert settings().active_target.bone_names() == ("forearm",)
    yield from sculpt()


def sculpt():
    """A stroke across the elbow, which lands where the brush is and moves the posed skin outward."""
    settings_of = bpy.context.scene.tool_settings.sculpt.unified_paint_settings
    settings_of.size = 2 * BRUSH
    yield from driver.settled(viewport)  # the brushes slide in below, and the tools at the left
    posed, bind = shown(), key_points()
    stroke = [on_screen(point) for point in front_of_elbow(posed).tolist()]
    yield from driver.drag(stroke)
    yield from driver.drag(stroke[::-1])
    yield from until(lambda: np.abs(key_points() - bind).max() > 1e-3, "the stroke to land in the shape key")
    yield from driver.drawn()
    moved, sculpted = shown() - posed, key_points() - bind
    skinned = np.einsum("vij,vj->vi", turns(), sculpted)
    length = np.linalg.norm(moved, axis=1)
    touched = length > 0.2 * length.max()
    error = np.abs(moved - skinned).max()
    assert error < 0.02 * length.max(), f"the shape key is off by {error} m in the pose"
    turned = np.linalg.norm(moved - sculpted, axis=1)[touched].max()
    assert turned > 0.2 * length.max(), "the pose turns nothing here: this proves nothing"
    ends = np.array([stroke[0], stroke[-1]])
    on = np.array([on_screen(point) for point in posed[touched].tolist()])
    reach = np.array([[-BRUSH, -BRUSH], [BRUSH, BRUSH]]) * 1.3
    low, high = np.sort(ends, axis=0) + reach
    assert ((low < on) & (on < high)).all(), "the stroke landed elsewhere"
    axis = posed[touched] * (1.0, 0.0, 0.0)
    outward = np.einsum("vi,vi->v", moved[touched], posed[touched] - axis)
    assert (outward > 0).mean() > 0.95, "the brush did not draw the skin outward"
    measure("Sculpted in a pose", f"stroke of {1e3 * length.max():.1f} mm, off by {1e3 * error:.3f} mm in the pose")


def front_of_elbow(posed: np.ndarray) -> np.ndarray:
    """Of the rings of vertices about the elbow that vertex which is nearest to the eye, posed: (R, 3)."""
    eye = view.area.spaces.active.region_3d.view_matrix.inverted().translation
    elbow = limb.RINGS // 2
    rings = posed.reshape(limb.RINGS, limb.AROUND, 3)[elbow - 2 : elbow + 3]
    nearest = np.linalg.norm(rings - np.array(eye), axis=2).argmin(axis=1)
    return rings[np.arange(len(rings)), nearest]


def turns() -> np.ndarray:
    """How the armature turns what moves at each vertex: (V, 3, 3)."""
    found = np.zeros((len(skin().data.vertices), 3, 3))
    for bone in rig().pose.bones:
        turn = np.array((bone.matrix @ bone.bone.matrix_local.inverted()).to_3x3())
        index = skin().vertex_groups[bone.name].index
        for vertex in skin().data.vertices:
            found[vertex.index] += sum(group.weight for group in vertex.groups if group.group == index) * turn
    return found


@step("Finish Sculpting")
def finish_sculpting():
    yield from sidebar.press("dynamorph.finish_sculpt")
    yield from until(lambda: skin().mode == "OBJECT", "Object Mode")
    assert not skin().show_only_shape_key and np.abs(key_points()).max() > 0
    sculpt = skin().active_shape_key
    assert sculpt.value == 1.0, "the sculpt does not show in its pose"
    yield from sidebar.press("dynamorph.live")  # which builds first
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on", 60.0)
    task.done()
    assert not addon("scene.store.staleness").model_age(skin()) and sculpt.value == 0.0 and sculpt.mute
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")
    yield from sidebar.press("dynamorph.go_to_pose")
    yield from until(lambda: sculpt.value == 1.0, "the sculpt in its pose")
    yield from frames.click(limb.FLEXED)
    assert sculpt.value == 0.0, "the sculpt shows in another pose"
    yield from frames.click(limb.TURNED)


@step("Suggest from Drivers")
def suggest_from_drivers():
    drive_a_key()  # not by hand
    before = [tuple(bone.rotation_euler) for bone in rig().pose.bones]
    yield from from_menu("DOWN_ARROW")
    yield from until(lambda: len(settings().targets) == 4, "a target for the driven key")
    target = settings().active_target
    assert target.name == "sideways" and target.bone_names() == ("forearm",)
    assert before == [tuple(bone.rotation_euler) for bone in rig().pose.bones]


def drive_a_key():
    """As a rigger does: a key that is fully on when the forearm is turned sideways by 50 degrees."""
    skin().shape_key_add(name="sideways", from_mix=False)
    block = skin().data.shape_keys.key_blocks["sideways"]
    block.value = 0.0
    driver_of = block.driver_add("value").driver
    variable = driver_of.variables.new()
    variable.targets[0].id = rig()
    variable.targets[0].data_path = 'pose.bones["forearm"].rotation_euler[2]'
    driver_of.expression = f"{variable.name} / {math.radians(50)}"


@step("Go to Pose, and remove that target")
def remove_target():
    yield from sidebar.press("dynamorph.go_to_pose")
    turned = lambda: math.degrees(rig().pose.bones["forearm"].rotation_euler.z)  # noqa: E731
    yield from until(lambda: abs(turned() - 50) < 0.5, "the pose")
    yield from sidebar.press("dynamorph.remove_target")
    yield from until(lambda: len(settings().targets) == 3, "the target to be removed")
    block = skin().data.shape_keys.key_blocks["sideways"]
    block.driver_remove("value")  # Blender goes on evaluating the driver of a key that is removed with it
    skin().shape_key_remove(block)
    bpy.context.scene.frame_set(1)


@step("Shape by Physics")
def shape_by_physics():
    """In two actions: a frame in which the elbow is bent, and the button."""
    before = len(settings().targets)
    bpy.context.scene.frame_set((limb.FIRST + limb.FLEXED) // 2)
    yield from driver.drawn()
    yield from sidebar.press("dynamorph.shape_by_physics")
    yield from until(lambda: len(settings().targets) == before + 1, "the target")
    name, blocks = settings().active_target.name, skin().data.shape_keys.key_blocks
    moved = [(point.co - rest.co).length for point, rest in zip(blocks[name].data, blocks[0].data, strict=True)]
    assert max(moved) > 1e-3
    yield from sidebar.press("dynamorph.remove_target")
    yield from until(lambda: len(settings().targets) == before, "the target to be removed")
    skin().shape_key_remove(blocks[name])
    bpy.context.scene.frame_set(1)


@step("Add Target, with several keys to choose from")
def add_target():
    """Two keys more and a target's many bones, not by hand, so that a menu and a section come."""
    before = len(settings().targets)
    for name in ("first", "second"):
        skin().shape_key_add(name=name, from_mix=False)
    bpy.context.scene.frame_set((limb.FIRST + limb.FLEXED) // 2)
    yield from driver.drawn()
    yield from sidebar.pop_up("dynamorph.add_target")
    yield from driver.tap("DOWN_ARROW", sidebar.seen("dynamorph.add_target"))
    yield 0.1
    yield from driver.tap("RET", sidebar.seen("dynamorph.add_target"))
    yield from until(lambda: len(settings().targets) == before + 1, "the target")
    target = settings().active_target
    assert target.name in ("first", "second")
    target.set_bones([f"bone {i}" for i in range(12)])
    yield from driver.drawn()
    yield from sidebar.unfold("DYNAMORPH_PT_bones")
    yield from sidebar.fold("DYNAMORPH_PT_bones")
    target.set_bones(["forearm"])
    yield from sidebar.press("dynamorph.remove_target")
    yield from until(lambda: len(settings().targets) == before, "the target to be removed")
    for name in ("first", "second"):
        skin().shape_key_remove(skin().data.shape_keys.key_blocks[name])
    bpy.context.scene.frame_set(1)
