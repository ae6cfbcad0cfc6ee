# SPDX-License-Identifier: GPL-3.0-or-later
"""What a character loses in the format of another program, listed before it is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import bpy

from ...core.message import Message, listed
from ...scene import animation, keyed
from ...scene.motion import colliders
from ...scene.read import identity
from ...scene.references import armature_modifiers, rig_of
from ...scene.skin import attached_meshes, is_rendered, shown_attachments, unit_scale
from ...scene.skinning import Skinning, deforming_bones
from ...scene.store import staleness
from .exports import FORMATS, left_out, meshes_together, surface_formats

MORPHS = 8  # morph targets that common engines and viewers blend at once
METERS = {"GLTF", "USD"}  # formats that are read as meters, whatever the scene's unit is
SAME_UNIT = 1e-6
INHERITED = {"FULL", "FIX_SHEAR"}  # Inherit Scale of bones as files have it
SUBDIVIDING = {"MULTIRES", "SUBSURF"}  # modifiers with other levels in renders
MOST_BONES = 4  # per vertex that glTF writes


def losses(obj: bpy.types.Object, key: str, takes: str = "SCENE") -> Iterator[str]:
    """What the format will not show as Blender does, as sentences; takes: as for `export`. Reads the scene only."""
    if not FORMATS[key].needs_bake:
        yield from _soft_skin_losses(obj)
        return
    if FORMATS[key].skins:
        planned = _planned_keys(obj) if takes == "ACTIONS" else None
        moved = obj, *shown_attachments(obj)
        for mesh in meshes_together(obj):
            if mesh in moved or armature_modifiers(mesh):
                yield from _skinning_losses(mesh, key)
            else:
                yield from _modifier_losses(mesh, key, ())
            yield from _key_losses(mesh, key, planned if mesh in moved else None)
        if rig_of(obj):
            yield from _scale_losses(rig_of(obj), key)
    else:
        for mesh in meshes_together(obj):
            yield from _render_losses(mesh, key)
    if key == "USD":  # the others write no pictures, or those that are in memory
        for name in _unsaved_images(obj):
            yield Message(
                "Image '{name}' has changes that are not saved: {format} is written without them. Save the image first",
                name=name,
                format=FORMATS[key].label,
            )
    samples = staleness.baked_samples(obj)
    if samples > 1 and not FORMATS[key].samples:
        yield Message(
            "'{name}' is baked with {count} samples per frame, and {format} has those at frames alone, so that motion "
            "blur will be straight. Use {others}",
            name=obj.name,
            count=samples,
            format=FORMATS[key].label,
            others=_formats_with_samples(),
        )
    yield from _unit_losses(key)
    for hidden in left_out(obj):
        yield Message("'{name}' is hidden, so Blender does not export it: unhide it", name=hidden.name)


def _formats_with_samples() -> str:
    labels = [each.label for each in FORMATS.values() if each.samples and each.is_available]
    return " or ".join(labels) or "a Blender that exports Alembic"


def _planned_keys(obj: bpy.types.Object) -> int:
    """The largest number of keys that the clips of all Actions take together."""
    settings = obj.dynamorph
    return settings.output.keys or len(settings.modes) + max(len(settings.targets) - 1, 0)


def _soft_skin_losses(obj: bpy.types.Object) -> Iterator[str]:
    settings, inside = obj.dynamorph, {obj, *attached_meshes(obj)}
    names = ", ".join(f"'{each.name}'" for each in meshes_together(obj) if each not in inside)
    if names:
        yield Message("A soft skin file has the meshes of one body: {names} is left out", names=names)
    known = animation.baked_keys(obj) | identity.shifts(obj).keys() | {target.name for target in settings.targets}
    others = [name for name in animation.moving_keys(obj) if name not in known]
    if others:
        yield Message("A soft skin file has only the targets' keys: {keys} is left out", keys=", ".join(others))
    if settings.collision.use and (settings.collision.use_self or colliders.colliders(obj)):
        yield Message("A soft skin file has no collision: '{name}' passes through what stops it here", name=obj.name)
    amounts, moved = [settings.simulation, *settings.targets], {each.kind for each in keyed.always(obj)}
    if "STIFFNESS" in moved:
        yield Message("A soft skin file has one Stiffness for each target: '{name}' has the first keys'", name=obj.name)
    shown = any(each.amount != 1.0 for each in amounts) or moved & {"AMOUNT", "TARGET_AMOUNT"}
    if shown or any(mode.gain != 1.0 for mode in settings.modes):
        yield Message("A soft skin file has no Amount: all motion of '{name}' shows in full", name=obj.name)


def _skinning_losses(obj: bpy.types.Object, key: str) -> Iterator[str]:
    label, skinning = FORMATS[key].label, Skinning.of(obj)
    modifiers = skinning.modifiers
    if not modifiers:
        yield Message("'{name}' has no Armature modifier: its bones are not written", name=obj.name)
        return
    yield from _modifier_losses(obj, key, modifiers)
    if skinning.beyond_bones:
        yield Message(
            "'{name}' is skinned with {beyond}, but {format} knows only plain bones, so it will differ. Use {others}",
            name=obj.name,
            beyond=skinning.beyond_bones,
            format=label,
            others=surface_formats(),
        )
    crowded = _crowded_vertices(obj)
    if key == "GLTF" and crowded:
        yield Message(
            "'{name}': {count} vertices follow more than {most} bones: the weakest of them are dropped",
            name=obj.name,
            count=crowded,
            most=MOST_BONES,
        )


def _modifier_losses(obj: bpy.types.Object, key: str, skinning: Sequence[bpy.types.Modifier]) -> Iterator[str]:
    """skinning: those of the modifiers that the format has as bones."""
    for modifier in obj.modifiers:
        if modifier in skinning or modifier.type == "COLLISION" or not (modifier.show_viewport or modifier.show_render):
            continue
        if not skinning:
            yield Message(
                "'{name}': modifier '{modifier}' is left out of {format}: apply it, or use {others}",
                name=obj.name,
                modifier=modifier.name,
                format=FORMATS[key].label,
                others=surface_formats(),
            )
            continue
        where = "after" if obj.modifiers.find(modifier.name) > obj.modifiers.find(skinning[-1].name) else "before"
        yield Message(
            "'{name}': modifier '{modifier}' {where} the Armature is left out: {format} takes shape keys or "
            "modifiers, not both. Use {others}",
            name=obj.name,
            modifier=modifier.name,
            where=Message(where),
            format=FORMATS[key].label,
            others=surface_formats(),
        )


def _render_losses(obj: bpy.types.Object, key: str) -> Iterator[str]:
    """Surfaces are written as renders show them, but for the last subdivision."""
    label = FORMATS[key].label
    if not is_rendered(obj):
        yield Message("'{name}' is off in renders, so {format} leaves it out: turn it on", name=obj.name, format=label)
        return
    shown = [modifier for modifier in obj.modifiers if modifier.show_viewport or modifier.show_render]
    for modifier in shown:
        if modifier.type == "SUBSURF" and modifier == shown[-1]:
            yield Message(
                "'{name}': {format} leaves its Subdivision Surface to the program that opens the file: subdivide it "
                "there, or apply it here",
                name=obj.name,
                format=label,
            )
        elif modifier.show_viewport != modifier.show_render:
            yield Message(
                "'{name}': modifier '{modifier}' is on only in viewports or only in renders: {format} has it as "
                "renders do",
                name=obj.name,
                modifier=modifier.name,
                format=label,
            )
        elif modifier.type in SUBDIVIDING and len(set(_levels(modifier))) > 1:
            levels = _levels(modifier)
            yield Message(
                "'{name}': modifier '{modifier}' has {shown} levels in viewports and {rendered} in renders: {format} "
                "has the latter",
                name=obj.name,
                modifier=modifier.name,
                shown=levels[0],
                rendered=levels[1],
                format=label,
            )
    for path in sorted(animation.moved_paths(obj)):
        if path == "hide_render" or path.endswith("].show_render"):
            yield Message(
                "'{name}': '{path}' is keyed or driven, and {format} has one state for all frames: it will differ",
                name=obj.name,
                path=path,
                format=label,
            )


def _levels(modifier: bpy.types.SubsurfModifier | bpy.types.MultiresModifier) -> tuple[int, int]:
    """Of subdivision, in viewports and in renders."""
    render, levels = bpy.context.scene.render, (modifier.levels, modifier.render_levels)
    if not render.use_simplify:
        return levels
    return min(levels[0], render.simplify_subdivision), min(levels[1], render.simplify_subdivision_render)


def _scale_losses(rig: bpy.types.Object, key: str) -> Iterator[str]:
    """Files have each bone's transform within its parent's, so that it inherits all of that one's scale."""
    scaled = _scaled_bones(rig)
    alone = [
        bone.name
        for bone in rig.data.bones
        if bone.inherit_scale not in INHERITED and any(above.name in scaled for above in bone.parent_recursive)
    ]
    if alone:
        yield Message(
            "'{rig}': bones below scaled ones do not inherit their scale, in {format} they do: {bones} will differ. "
            "Set Inherit Scale to Full, or use {others}",
            rig=rig.name,
            format=FORMATS[key].label,
            bones=listed(alone),
            others=surface_formats(),
        )


def _scaled_bones(rig: bpy.types.Object) -> set[str]:
    """The bones of an armature object that have a scale now, or that curves or drivers scale."""
    paths, still = animation.moved_paths(rig), (1.0, 1.0, 1.0)
    return {
        bone.name for bone in rig.pose.bones if tuple(bone.scale) != still or f"{bone.path_from_id()}.scale" in paths
    }


def _unit_losses(key: str) -> Iterator[str]:
    scale = unit_scale()
    if key in METERS and abs(scale - 1.0) > SAME_UNIT:
        yield Message(
            "{format} is in meters: one Blender unit, {scale:g} m by the scene's Unit Scale, is written as 1 m. Scale "
            "it by {scale:g} where you import it",
            format=FORMATS[key].label,
            scale=scale,
        )


def _key_losses(obj: bpy.types.Object, key: str, planned: int | None) -> Iterator[str]:
    """planned: the number of keys that will replace those of the bake, if any."""
    moving, baked = animation.moving_keys(obj), animation.baked_keys(obj)
    others = [name for name in moving if name not in baked]
    count = len(moving) if planned is None else len(others) + planned
    if count > MORPHS:
        room = MORPHS - len(others)
        again = "bake to Shape Keys again with Key Limit" if planned is None else "set Key Limit to"
        remedy = f"{again} {room}, or use" if room > 0 else "use"
        yield Message(
            "'{name}': {count} keys move, many engines blend {most} at most: {remedy} {others}",
            name=obj.name,
            count=count,
            most=MORPHS,
            remedy=remedy,
            others=surface_formats(),
        )
    driven = [name for name in moving if name in animation.driven_keys(obj)]
    if driven:
        yield Message(
            "'{name}': drivers are not exported; their values are written at each frame: {keys}",
            name=obj.name,
            keys=", ".join(driven),
        )
    blocks: Any = obj.data.shape_keys.key_blocks if moving else ()
    whole = [name for name in moving if blocks[name].vertex_group or blocks[name].relative_key != blocks[0]]
    if key == "GLTF" and whole:
        yield Message(
            "'{name}': glTF knows no vertex groups of shape keys, and none relative to others than '{basis}': "
            "{keys} will differ",
            name=obj.name,
            basis=blocks[0].name,
            keys=", ".join(whole),
        )


def _crowded_vertices(obj: bpy.types.Object) -> int:
    bones = {bone.name for bone in deforming_bones(obj, rig_of(obj))}
    groups = {group.index for group in obj.vertex_groups if group.name in bones}
    return sum(
        sum(element.group in groups and element.weight > 0.0 for element in vertex.groups) > MOST_BONES
        for vertex in obj.data.vertices
    )


def _unsaved_images(obj: bpy.types.Object) -> list[str]:
    slots = [slot for mesh in meshes_together(obj) for slot in mesh.material_slots]
    trees = [slot.material.node_tree for slot in slots if slot.material and slot.material.node_tree]
    images = [getattr(node, "image", None) for tree in trees for node in tree.nodes]
    return sorted({image.name for image in images if image and image.is_dirty})
