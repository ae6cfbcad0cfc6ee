# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of each panel, with the places of its settings: docs/panels shows them with numbers.

The numbers of a picture are those of the list below it in the page, in the order in which PANELS names the settings.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import driver
import numpy as np
from driver import Region, step, until, window
from editors import addon, job_done, physics, properties, settings, shown, sidebar, skin, view
from mathutils import Euler, Vector

SAMPLE = Path(__file__).parents[2] / "sample_blends/herbert.blend"
FRAME, LAST = 60, 80  # of the pictures; of the bake
ASIDE = 1.4  # meters from the middle of the viewport to the character
FINE = 7  # pixels: a row's middle is known to half of it
LEFT, MIDDLE, RIGHT = 0.2, 0.45, 0.93  # across a panel
TOP, EMPTY = 130, 450  # pixels that the buttons in place take, and without a button: the panel has ended
TABS = 30  # pixels, the column of the sidebar's tabs
BESIDE = 12  # pixels from the panel's edge to the middle of a number

# A section's name, or the buttons on top: the region, and what is numbered, operators and ends of properties' paths.
# One that is not in the middle of its row is given with the column where it is.
PANELS: dict[str, tuple[Region, tuple[str | tuple[str, float], ...]]] = {
    "top": (
        sidebar,
        (
            ("dynamorph.live", LEFT),
            ("dynamorph.bake", RIGHT),
            ("dynamorph.build", LEFT),
            ("dynamorph.delete_bake", RIGHT),
        ),
    ),
    "feel": (
        sidebar,
        ("dynamorph.apply_feel", "simulation.amount", "targets[1].amount", "bounce", "settle_time"),
    ),
    "material": (
        sidebar,
        ("stiffness", "poisson", "density", "mass_damping", "stiffness_damping", "mass", "dynamorph.fit_material"),
    ),
    "firmness": (
        sidebar,
        (
            "parts[0].firmness",
            "firmness_group",
            ("dynamorph.paint_firmness", RIGHT),
            "dynamorph.hold_bones",
            "dynamorph.firmness",
        ),
    ),
    "max_distance": (
        sidebar,
        ("max_distance_group", ("dynamorph.paint_max_distance", RIGHT), "dynamorph.max_distance"),
    ),
    "targets": (
        sidebar,
        (
            "active_target_index",
            ("dynamorph.add_target", RIGHT),
            ("dynamorph.remove_target", RIGHT),
            ("dynamorph.move_target", RIGHT),
            "dynamorph.new_from_pose",
            ("dynamorph.shape_by_physics", RIGHT),
            "dynamorph.capture_pose",
            ("dynamorph.sculpt_target", RIGHT),
            "region",
            ("dynamorph.region_from_sculpt", RIGHT),
            "fade_out_angle",
        ),
    ),
    "bones": (sidebar, ("dynamorph.use_selected_bones", "dynamorph.remove_bone")),
    "target_weights": (
        sidebar,
        ("target_weights", ("dynamorph.update_target_weights", RIGHT), "dynamorph.find_uncovered_pose"),
    ),
    "compare": (
        sidebar,
        (
            "dynamorph.show_plain",
            ("dynamorph.swap_slot", LEFT),
            ("dynamorph.copy_slot", RIGHT),
            "dynamorph.compare_beside",
            "dynamorph.compare_full",
        ),
    ),
    "result": (sidebar, ("influence", "dynamorph.export")),
    "details": (sidebar, (("dynamorph.show_worst", LEFT), ("heat", RIGHT))),
    "attachments": (
        properties,
        (
            ("dynamorph.add_attachment", RIGHT),
            ("dynamorph.remove_attachment", RIGHT),
            ("dynamorph.select_attachment", RIGHT),
            "dynamorph.find_attachments",
            "model.hold_head",
        ),
    ),
    "grips": (properties, (("dynamorph.attach", RIGHT), ("dynamorph.remove_grip", RIGHT), "dynamorph.record_drags")),
    "collision": (
        properties,
        (
            "dynamorph.collide",
            "dynamorph.add_floor",
            "collision.collection",
            "collision.use_self",
            "collision.distance",
            "excluded_group",
            "collision.use_friction",
            "contact",
        ),
    ),
    "bake": (
        properties,
        (
            "model.quality",
            "simulation.max_displacement",
            "simulation.use_scene_range",
            "simulation.frame_start",
            "simulation.frame_end",
            "simulation.keep_outside",
            "simulation.loop",
            "output.format",
            "dynamorph.bake_options",
            "dynamorph.bake_all",
        ),
    ),
    "export": (properties, ()),  # two menus, which Blender does not tell the names of
    "setup": (
        properties,
        ("dynamorph.copy_to_selected", ("dynamorph.save_setup", LEFT), ("dynamorph.load_setup", RIGHT)),
    ),
    "cage": (properties, ("model.cage_nodes", "model.cage_object", "dynamorph.build_cage", "dynamorph.cage")),
    "detail": (properties, ("model.modes", "output.keys", "model.method", "dynamorph.check_targets")),
    "modes": (properties, ("active_mode_index", ("dynamorph.play_mode", LEFT), ("dynamorph.reset_gains", RIGHT))),
    "solver": (
        properties,
        (
            "simulation.speed",
            "simulation.substeps",
            "simulation.samples",
            "simulation.gravity",
            "simulation.initial_state",
        ),
    ),
}
TARGET = (
    ("dynamorph.capture_pose", LEFT),
    ("dynamorph.sculpt_target", RIGHT),
    "region",
    "fade_out_angle",
    "amount",
)  # of the panel below Shape Keys


@step("Open a whole character")
def open_character():
    """Not by hand. What surrounds it would only make drawing slow."""
    with bpy.context.temp_override(window=window()):
        bpy.ops.wm.open_mainfile(filepath=str(SAMPLE), load_ui=False)
    yield 0.5
    bpy.context.view_layer.objects.active = skin()
    bpy.context.scene.frame_set(FRAME)
    for obj in bpy.context.scene.objects:
        obj.hide_set(obj.type == "MESH" and obj != skin() and not is_carried(obj))
    settings().active_target_index = 1
    settings().model.quality = "REDUCED"  # Full Quality takes minutes
    settings().simulation.use_scene_range, settings().simulation.frame_end = False, LAST
    space, turned = view.area.spaces.active, Euler((1.4, 0.0, 0.6)).to_quaternion()
    space.shading.color_type = "MATERIAL"
    space.region_3d.view_rotation, space.region_3d.view_distance = turned, 2.6
    space.region_3d.view_location = Vector(shown().mean(axis=0)) - turned @ Vector((ASIDE, 0.0, 0.0))
    with bpy.context.temp_override(window=window()):
        bpy.ops.ed.undo_push(message="Open a whole character")  # to which the next step goes back
    yield from driver.drawn()


def is_carried(obj) -> bool:
    """Whether it belongs to the character, as its eyes do."""
    return obj.parent is not None and obj.parent.type == "ARMATURE"


@step("A softer belly, by its slider")
def softer_belly():
    before = firmness()
    yield from sidebar.unfold("DYNAMORPH_PT_firmness")
    yield from sidebar.enter("parts[1].firmness", "0.1")
    yield from until(lambda: (firmness() < before - 0.2).any(), "the belly to be softer")
    yield from view.key("Z", ctrl=True)
    yield from until(lambda: np.array_equal(firmness(), before), "it to be undone")
    yield from sidebar.fold("DYNAMORPH_PT_firmness")


def firmness() -> np.ndarray:
    return addon("scene.read.mesh_data").group_weights(skin(), [settings().firmness_group], 0.5)[:, 0]


@step("Bake it")
def bake():
    yield from sidebar.press("dynamorph.bake")
    yield from job_done(900.0)


@step("A picture of the window")
def picture_of_window():
    yield from physics()
    tab, once = (yield from sidebar.find("dynamorph.live")), (yield from properties.find("dynamorph.remove_soft_skin"))
    yield from driver.rest()
    yield from driver.drawn_smoothly()
    left, bottom = view.box[0] + view.box[2] // 2, view.box[1]
    box = left, bottom, window().width - left, view.box[3]
    marks = (
        (sidebar.box[0] - BESIDE, sidebar.top[1]),
        (properties.box[0] - BESIDE, once[1]),
        (sidebar.box[0] - BESIDE, tab[1]),
    )
    keep("window", box, marks)


@step("A picture of each panel")
def pictures_of_panels():
    """The panels alone, because drawing the character takes long."""
    for obj in bpy.context.scene.objects:
        obj.hide_set(True)
    sections = addon("ui.panels.sections")
    tables = (sections.SIDEBAR, sections.SIDEBAR_SECTIONS), (sections.PHYSICS, sections.PHYSICS_SECTIONS)
    registered = [getattr(bpy.types, f"DYNAMORPH_PT_{each.name}") for _, table in tables for each in table]
    for panel, (region, wanted) in PANELS.items():
        for each in reversed(registered):
            bpy.utils.unregister_class(each)
        registered = [each for place, table in tables for each in copies(table, place, panel)]
        for each in registered:
            bpy.utils.register_class(each)
        yield from driver.drawn()
        yield from region.scroll("WHEELDOWNMOUSE", 40)  # what settings of the sample's script make too long
        found = yield from places(region, panel, wanted)
        yield from driver.rest()
        yield from driver.drawn()
        keep(f"panel_{panel}", inner(region), found)


@step("A picture of the target below Shape Keys")
def picture_of_target():
    properties.area.spaces.active.context = "DATA"
    skin().active_shape_key_index = settings().active_target_index
    closed = addon("ui.panels.sections").DYNAMORPH_PT_object_data
    bpy.utils.unregister_class(closed)
    bpy.utils.register_class(type("DYNAMORPH_PT_object_data_open", (closed,), {"bl_options": set()}))
    yield from driver.drawn()
    found = yield from places(properties, "object_data", TARGET)
    yield from driver.rest()
    yield from driver.drawn()
    keep("panel_object_data", properties.box, found)


def copies(table, place: dict, panel: str):
    """The panels of sections under names that Blender has not seen, so that only `panel` and its parents are open."""
    parents = {each.name: each.parent for each in table}
    opened, names = panel, set()
    while opened in parents:
        names.add(opened)
        opened = parents[opened]
    for each in table:
        parent = f"{each.parent}_{panel}" if each.parent in parents else each.parent
        named = replace(each, name=f"{each.name}_{panel}", parent=parent, closed=each.name not in names)
        yield named.panel(place)


def inner(region: Region):
    """The box of a region without the column of tabs."""
    x, y, width, height = region.box
    return x, y, width - (TABS if region is sidebar else 0), height


def places(region: Region, panel: str, wanted):
    """Where the numbers belong in the window: beside the panel, at the height of each thing that is numbered."""
    x, bottom, width, height = inner(region)
    rows: dict[str, list[int]] = {}
    placed = [(each, MIDDLE) if isinstance(each, str) else each for each in wanted]
    for column in dict.fromkeys(column for _, column in placed):
        last = None
        for y in range(bottom + height - (0 if panel == "top" else TOP), bottom, -FINE):
            button = yield from region.look((x + int(width * column), y))
            if button:
                last = y
                rows.setdefault(button, []).append(y)
            elif last and last - y > EMPTY:
                break
    found = []
    for name, column in placed:
        heights = next((ys for button, ys in rows.items() if driver.is_button(button, name)), None)
        assert heights, f"{panel}: no {name}, only {', '.join(rows)}"
        # An operator may have several buttons, one below the other: the first counts.
        one = [y for i, y in enumerate(heights) if heights[0] - y == i * FINE]
        found.append((x + width + BESIDE if column == RIGHT else x - BESIDE, sum(one) / len(one)))
    return found


def keep(name: str, box, marks):
    """WORK/shots/NAME.png of a box in the window, and where its numbers are in it, from its upper left corner."""
    driver.photograph(name, box)
    driver.result["pictures"].append(name)
    driver.result["numbered"][name] = [(round(x - box[0]), round(box[1] + box[3] - y)) for x, y in marks]
