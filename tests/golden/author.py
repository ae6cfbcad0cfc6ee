# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes files of a version of the extension for test_old_files.py; run with that version's addon/ on PYTHONPATH:

python tests/golden/author.py tests/golden/arm_COMMIT.blend

arm_COMMIT.blend        the arm of tests/addon/builders.py with 8 modes in a cage of 200 nodes, baked; kept if there
authored_COMMIT.blend   the arm of that file, with settings that are keyed and driven
shot_COMMIT.blend       the same arm linked, and as a library override with settings of its own
setup_COMMIT.json, material_COMMIT.py, setup_COMMIT.py   a saved setup, and presets
authored_COMMIT.json    what all of them say, by the version that wrote them
"""

import json
import os
import sys
from pathlib import Path

import bpy

FRAMES = (1, 10, 20)
KEYED = {"dynamorph.targets[1].influence": (1.0, 0.25), "dynamorph.modes[0].gain": (1.0, 2.0)}
DRIVEN = "dynamorph.targets[1].density"
OVERRIDDEN = {"targets[1].stiffness": 54321.0, "model.cage_nodes": 333, "simulation.substeps": 7}


def said(group) -> dict:
    """All numbers, texts and enums that a property group holds, and those within it."""
    out = {}
    for prop in group.bl_rna.properties:
        if prop.identifier in ("rna_type", "name") or (prop.is_readonly and prop.type not in ("POINTER", "COLLECTION")):
            continue
        value = getattr(group, prop.identifier)
        if prop.type == "COLLECTION":
            out[prop.identifier] = [said(each) | {"name": each.name} for each in value]
        elif prop.type == "POINTER":
            is_group = isinstance(value, bpy.types.PropertyGroup)
            out[prop.identifier] = said(value) if is_group else value and value.name
        else:
            out[prop.identifier] = list(value) if getattr(prop, "is_array", False) else value
    return out


def at_frames(obj) -> dict:
    found = {}
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        found[str(frame)] = said(obj.dynamorph)
    bpy.context.scene.frame_set(1)
    return found


def put(obj, values: dict):
    for path, value in values.items():
        group, _, name = f"dynamorph.{path}".rpartition(".")
        setattr(obj.path_resolve(group), name, value)


def bake(arm: Path):
    sys.path[:0] = [str(arm.parents[1]), str(arm.parents[1] / "addon")]
    from builders import make_arm

    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    obj = make_arm(bpy.context.scene)
    bpy.ops.dynamorph.add_soft_skin()
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    bpy.context.scene.frame_set(1)
    obj.dynamorph.model.modes, obj.dynamorph.model.cage_nodes = 8, 200
    bpy.ops.dynamorph.bake()
    bpy.ops.wm.save_as_mainfile(filepath=str(arm), compress=True)


def main(arm: Path):
    commit, folder = arm.stem.removeprefix("arm_"), arm.parent
    bpy.context.preferences.filepaths.save_version = 0  # no second file beside
    if not arm.exists():
        bake(arm)
    bpy.ops.wm.open_mainfile(filepath=str(arm))
    obj = bpy.data.objects["Arm"]
    bpy.context.view_layer.objects.active = obj
    bpy.context.scene.frame_set(1)
    for path, values in KEYED.items():
        group, _, name = path.rpartition(".")
        for frame, value in zip((1, 20), values, strict=True):
            setattr(obj.path_resolve(group), name, value)
            obj.keyframe_insert(path, frame=frame)
    driver = obj.driver_add(DRIVEN).driver
    driver.type, driver.expression = "SCRIPTED", f"{obj.path_resolve(DRIVEN)} + 0 * frame"
    found = {"local": at_frames(obj)}
    bpy.ops.dynamorph.save_setup(filepath=str(folder / f"setup_{commit}.json"))
    presets = Path(bpy.utils.user_resource("SCRIPTS")) / "presets/dynamorph"
    for kind in ("material", "setup"):
        getattr(bpy.ops.dynamorph, f"{kind}_preset")(name="golden")
        (folder / f"{kind}_{commit}.py").write_bytes((presets / kind / "golden.py").read_bytes())
    source = folder / f"authored_{commit}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source), compress=True)

    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    shot = folder / f"shot_{commit}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))  # so that paths can be relative to it
    with bpy.data.libraries.load(str(source), link=True, relative=True) as (_, linked):
        linked.objects = ["Arm", "Arm Rig"]
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 20
    for each in linked.objects:
        scene.collection.objects.link(each)
    override = linked.objects[0].override_create()
    override.name = "Arm Override"
    scene.collection.objects.link(override)
    put(override, OVERRIDDEN)
    found |= {"linked": at_frames(linked.objects[0]), "override": at_frames(override)}
    bpy.ops.wm.save_mainfile(compress=True)
    (folder / f"authored_{commit}.json").write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    import dynamic_morph_targets

    dynamic_morph_targets.register()
    main(Path(sys.argv[1]).resolve())
    os._exit(0)  # bpy 4.5 may wait for ever as it ends
