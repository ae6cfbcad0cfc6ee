# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model and a bake were made from, and what has changed since, as sentences for the panels.

Only settings are compared, so panels can do it whenever they draw. `storage.show_stale` examines the mesh and
`look_at_animation` the animation, `look_at_colliders` the colliders, and `look_for_caches` the files, a while after an
edit.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path
from zlib import crc32

import bpy
import numpy as np

from ...core import records
from ...core.character import Character
from ...core.errors import RecordError, SceneError, sentence
from ...core.message import Message
from ...core.model.model import CAGE, HOLD, MODES, array_hash, first_part
from ...core.motion.keyed import Setting
from ...core.painted_map import EXCLUDED, MAX_DISTANCE
from ...core.settings import ENGINE, FREE_SETTINGS, SimulationSettings
from ...io import whole
from .. import animation, keyed, skin
from ..motion import collider_state, colliders, run_settings
from ..plain import plain
from ..references import KEY_REFERENCE
from ..skin import attached_meshes, named_targets, own_attachments, shown_attachments
from ..skinning import Skinning

BAKED_MAPS = (MAX_DISTANCE, EXCLUDED)  # on which a bake depends, but no model
SCULPT = "sculpt"  # in the records of targets; identifies a renamed target
STEPS_FOLLOW = {"fps", "speed", "samples"}  # unless the artist set how many substeps there are
PAINTED = ("Firmness changed", "what is rigid changed")  # for both of which a stroke of paint is enough
DEPENDENCY = {"unit_scale": "object scale"}  # of settings that have another name there
# Properties of targets on which no result depends: the stiffness and the region contain them, or they only steer the
# add-on.
UNUSED = ("rig_world", "frequency", "by_hand", "auto_region", "auto_bones")


def look_at_animation(obj: bpy.types.Object) -> None:
    """Examine the animation that moves `obj`, so that `outdated` knows whether it changed since the bake."""
    record = obj.dynamorph.bake
    seen = records.animation_text(animation.animation(Skinning.of(obj))) if record.exists else ""
    if record.animation != seen:
        record.animation = seen


def look_at_map(obj: bpy.types.Object, character: Character) -> None:
    """Note the maps of `obj` that count in a bake alone, so that `outdated` knows whether they changed since.
    character: as it is now.
    """
    record, seen = obj.dynamorph.bake, map_hash(character)
    if record.exists and record.painted != seen:
        record.painted = seen


def look_at_colliders(obj: bpy.types.Object) -> None:
    """Examine the colliders of `obj`, so that `outdated` knows whether they are what the bake met."""
    record, together = obj.dynamorph.bake, list[str]()
    with suppress(RecordError):
        together = records.bake_inputs(record.inputs).get("together", []) if record.inputs else []
    states = collider_state.states(obj, together) if record.exists and obj.dynamorph.collision.use else []
    seen = records.colliders_text(states) if states else ""
    if record.colliders != seen:
        record.colliders = seen


def map_hash(character: Character) -> str:
    """Of BAKED_MAPS, one a line; those that nobody has painted are empty, at the end without a line."""
    maps = [(getattr(character, each.name), each.neutral) for each in BAKED_MAPS]
    return "\n".join(array_hash((w,)) if (w != neutral).any() else "" for w, neutral in maps).rstrip("\n")


def look_for_caches(obj: bpy.types.Object) -> None:
    """Examine the files of the bake's point caches, so that `outdated` knows whether they are there."""
    lost = "\n".join(lost_caches(obj))
    if obj.dynamorph.bake.lost != lost:
        obj.dynamorph.bake.lost = lost


def lost_caches(obj: bpy.types.Object) -> list[Message]:
    """The point caches of the bake of `obj` that are missing or damaged, as sentences."""
    found = []
    for mesh in (obj, *shown_attachments(obj)):
        modifier = skin.cache_modifier(mesh)
        if modifier is None:
            continue
        path = Path(bpy.path.abspath(modifier.filepath, library=mesh.library))
        with suppress(OSError):
            if path.is_file() and path.suffix.lower() in whole.CHECKS and whole.is_whole(path):
                continue
        text = "the point cache '{file}' of '{name}' is missing or damaged"
        found.append(Message(text, file=path.name, name=mesh.name))
    return found


def model_changes(obj: bpy.types.Object) -> list[str]:
    """The settings that have changed since the model of `obj` was built. Reads no mesh: fit for drawing."""
    if not obj.dynamorph.model.built:
        return []
    try:
        return _changes(obj, *_built_and_now(obj))
    except RecordError as error:
        return [sentence(error)]


def _built_and_now(obj: bpy.types.Object) -> tuple[dict, dict]:
    """The settings with which the model of `obj` was built, and as they are. Raises RecordError."""
    then, now = records.build_inputs(obj.dynamorph.model.built), model_inputs(obj)
    if then.get("model", {}).get("solver") == "REDUCED":  # such a model serves unreduced simulations too
        del now["model"]["solver"]
    return then, now


def part_to_build(obj: bpy.types.Object) -> str:
    """The first part of the model of `obj`, which is out of date, that a build makes again: CAGE, HOLD or MODES; ''
    where that is not known. Reads no mesh: fit for drawing.
    """
    settings = obj.dynamorph
    record = settings.model
    if not record.built:
        return record.stale_part
    try:
        then, now = _built_and_now(obj)
    except RecordError:
        return ""
    several = any(each.attached_by == "OWN_CAGE" for each in own_attachments(obj))
    if "STATIC" in (then.get("model", {}).get("method"), record.method):  # which has no cage
        return CAGE
    if several and (record.hold == "BONES" or record.cage_object):  # no model says which nodes are whose
        return CAGE
    known = ((name, then.get(kind, {}), now[kind]) for kind in ("model", "groups", "scene") for name in now[kind])
    changed = [name for name, before, after in known if before.get(name, after[name]) != after[name]]
    parts = [record.stale_part, first_part(DEPENDENCY.get(name, name.replace("_", " ")) for name in changed)]
    return next((part for part in (CAGE, HOLD) if part in parts), MODES)


def model_age(obj: bpy.types.Object) -> list[str]:
    """Why the model of `obj` must be built again: its settings, otherwise the last examination of its mesh."""
    return model_changes(obj) or [text for text in [obj.dynamorph.model.stale] if text]


def live_age(obj: bpy.types.Object) -> list[str]:
    """As `model_age`, without what Live shows at once."""
    age = model_age(obj)
    if obj.dynamorph.model.hold != "THICKNESS":
        return age
    return [text for reason in age for text in str(reason).split("; ") if text not in PAINTED]


def outdated(obj: bpy.types.Object) -> list[str]:
    """What has changed since the bake of `obj`, as sentences. Reads no mesh and no animation: fit for drawing."""
    settings = obj.dynamorph
    record = settings.bake
    if not (record.exists and record.inputs):
        return []
    try:
        then, seen = records.bake_inputs(record.inputs), records.animation(record.animation)
        met = records.colliders(record.colliders)
        now = bake_inputs(Skinning.of(obj), run_settings.simulation_settings(obj, bpy.context.scene))
    except (RecordError, SceneError) as error:
        return [sentence(error)]
    now["simulation"] |= _kept_range(then.get("simulation", {}), now["simulation"], settings.simulation.is_patch)
    touches_itself = [each.get("collision", {}).get("use_self") for each in (then, now)]
    stops = colliders.met(obj, then.get("together", []))
    # Either decides on the quality, and is reported itself.
    if bool(then.get("colliders")) != bool(stops) or touches_itself[0] != touches_itself[1]:
        del now["model"]["solver"]
    found = _changes(obj, then, now)
    if obj.dynamorph.model.content_id != then["content_id"]:
        found.append("the model was built again")
    if obj.dynamorph.model.stale:
        found.append(obj.dynamorph.model.stale)
    found += [text for text in _map_changes(obj, then.get("painted", ""), record.painted) if text not in found]
    found += _piece_changes(obj)
    if "colliders" in then and settings.collision.use:
        found += _collider_changes(then["colliders"], met, stops)
    found += [
        Message('animation of "{name}" changed', name=name)
        for (name, digest), (_, before) in zip(seen, then["animation"], strict=False)
        if digest != before
    ]
    if seen and len(seen) != len(then["animation"]):
        found.append("parents, or what the rig follows, changed")
    return found + record.lost.splitlines()


def baked_samples(obj: bpy.types.Object) -> int:
    """Samples Per Frame of the bake of `obj`; 1 without one."""
    with suppress(RecordError):
        record = obj.dynamorph.bake.inputs
        return int(records.bake_inputs(record).get("simulation", {}).get("samples", 1)) if record else 1
    return 1


def _kept_range(then: dict, now: dict, is_patch: bool) -> dict:
    """The ends of the range that are as good as those of the bake: it has all frames up to there, unless it is a loop,
    which its range is part of. is_patch: the range is that of the next patch.
    """
    loops = then.get("loop") or now["loop"]
    covers = {
        "frame_start": lambda baked: baked <= now["frame_start"],
        "frame_end": lambda baked: baked >= now["frame_end"],
    }
    known = {name: then[name] for name in covers if records.is_number(then.get(name))}
    return {name: baked for name, baked in known.items() if is_patch or (not loops and covers[name](baked))}


def model_inputs(obj: bpy.types.Object) -> dict:
    """The settings that a model depends on, by where they are."""
    settings = obj.dynamorph
    attachments = [
        *([each.attached_by, each.group] for each in own_attachments(obj) if each.attached_by != "WITH_BODY"),
        *([each.attached_by, each.group] for each in settings.attachments if each.object and each.object.users_scene),
    ]
    model = {name: value for name, value in asdict(settings.model.settings()).items() if name not in FREE_SETTINGS}
    targets = {
        name: {"mute": target.mute, "region": target.region, SCULPT: target.key_hash if name else ""}
        for name, target in named_targets(obj)
    }
    scene = {"unit_scale": skin.unit_scale(), "engine": ENGINE}
    return {"targets": targets, "model": model, "groups": {"attachments": attachments}, "scene": scene}


def bake_inputs(skinned: Skinning, simulation: SimulationSettings) -> dict:
    """The settings that a bake depends on, by where they are."""
    obj = skinned.obj
    settings = obj.dynamorph
    inputs = model_inputs(obj)
    inputs["model"] = asdict(settings.model.settings())
    if simulation.collision:
        inputs["model"]["solver"] = run_settings.bake_solver(obj)
    inputs["groups"]["armature_modifiers"] = skinned.settings()
    inputs["simulation"] = asdict(simulation) | {"fields": settings.simulation.fields}
    for name in ("distance", "self_collision", "self_friction"):  # as the artist set them, below
        del inputs["simulation"][name]
    names = ["distance", "use_self", "use_friction", *(["friction"] if settings.collision.use_friction else [])]
    inputs["collision"] = {name: getattr(settings.collision, name) for name in names if settings.collision.use}
    inputs["output"] = asdict(settings.output.settings())
    moved = keyed.recorded(obj)
    for path, kind in keyed.OF_OBJECT.items():
        part, _, name = path.partition(".")
        if name in inputs[part] and Setting(kind) in moved:
            inputs[part][name] = moved[Setting(kind)]
    inputs["grips"] = {grip.name: _grip(grip, moved[Setting("GRIP", grip.name)]) for grip in skin.used_grips(obj)}
    inputs["channels"] = {each.name: value for each, value in moved.items() if each.kind == "CHANNEL"}
    for name, target in named_targets(obj):
        values = plain(target, skip=(*KEY_REFERENCE, *UNUSED))
        values |= {own: moved[Setting(kind, name)] for own, kind in keyed.OF_TARGETS.items() if (kind, name) in moved}
        seen = crc32(target.pose_bytes() + np.array(target.rig_world).tobytes())
        inputs["targets"][name] |= values | {"bones": target.bone_names(), "pose": seen}
    return json.loads(json.dumps(inputs))


def _grip(grip: bpy.types.PropertyGroup, strength: str | float | None) -> list:
    """What a bake notes of a grip, beside the animation of what holds."""
    stands = keyed.stands(grip.object, grip.bone) if grip.object else []
    return [grip.object.name if grip.object else "", grip.bone, crc32(grip.patch.encode()), strength, stands]


def _changes(obj: bpy.types.Object, then: dict, now: dict) -> list[str]:
    """The differences between two inputs of `obj`, as sentences. Entries that `then` lacks have not changed."""
    settings = obj.dynamorph
    found = _target_changes(obj, then["targets"], now["targets"])
    known, channels = then.get("channels", {}), now.get("channels", {})
    moved = [name for name in known if name in channels and known[name] != channels[name]]
    found += [Message('channel "{name}" changed', name=name) for name in moved]
    held, holding = then.get("grips", {}), now.get("grips", {})
    let_go = [name for name in held | holding if held.get(name) != holding.get(name)] if "grips" in now else []
    found += [Message('grip "{name}" changed', name=name) for name in let_go]
    known = {"model": settings.model, "simulation": settings.simulation, "output": settings.output}
    known |= {"collision": settings.collision, "groups": settings, "scene": None}
    for part, group in known.items():
        before, after = then.get(part, {}), now.get(part, {})
        changed = [name for name in after if before.get(name, after[name]) != after[name]]
        if part == "simulation" and not settings.simulation.substeps and STEPS_FOLLOW.intersection(changed):
            changed = [name for name in changed if name != "substeps"]
        found += [Message("{setting} changed", setting=_title(group, name)) for name in changed]
    return found


def _target_changes(obj: bpy.types.Object, then: dict, now: dict) -> list[str]:
    lost, new = [name for name in then if name not in now], [name for name in now if name not in then]
    for name in list(new):  # renamed, if it is sculpted alike
        old = next((old for old in lost if then[old].get(SCULPT) == now[name][SCULPT]), None)
        if old is not None:
            then = {**then, name: then[old]}
            new.remove(name)
            lost.remove(old)
    found: list[str] = [Message('target "{name}" is new', name=name) for name in new]
    found += [Message('target "{name}" is gone', name=name) for name in lost]
    for name, target in named_targets(obj):
        before, after = then.get(name, {}), now[name]
        if not (before.get("mute") and after["mute"]):
            reported = [field for field in after if field != SCULPT]  # `watch` compares the sculpts
            changed = [_title(target, field) for field in reported if before.get(field, after[field]) != after[field]]
            found += [Message('{setting} of "{name}" changed', setting=title, name=target.name) for title in changed]
    return found


def _map_changes(obj: bpy.types.Object, then: str, seen: str) -> list[str]:
    """Which of BAKED_MAPS were painted on since the bake, as `map_hash` has them. seen: the last time."""
    hashes = zip_longest(then.split("\n"), seen.split("\n"), fillvalue="")
    changed = [each for each, (was, is_now) in zip(BAKED_MAPS, hashes, strict=False) if was != is_now]
    return [
        Message("{setting} changed", setting=_title(obj.dynamorph, each.group))
        for each in changed
        if each != EXCLUDED or obj.dynamorph.collision.use
    ]


def _piece_changes(obj: bpy.types.Object) -> list[str]:
    """The other meshes that do not show what the bake of `obj` should show."""
    wanted, shown = attached_meshes(obj), shown_attachments(obj)
    new = (mesh.name for mesh in wanted if mesh not in shown)
    found: list[str] = [Message('attachment "{name}" is new', name=name) for name in new]
    return found + [
        Message('attachment "{name}" is not with the body any more', name=mesh.name)
        for mesh in shown
        if mesh not in wanted
    ]


def _collider_changes(then: list[list[str]], seen: list[list[str]], now: list) -> list[str]:
    """What happened to colliders, as `collider_state.states` has them. seen: the last time; now: those objects."""
    before, names = {name: hashes for name, *hashes in then}, [other.name for other in now]
    found: list[str] = [Message("'{name}' collides now", name=name) for name in names if name not in before]
    found += [Message("'{name}' does not collide any more", name=name) for name in before if name not in names]
    for name, *hashes in seen:
        pairs = zip(("'{name}' moved", "'{name}' changed"), before.get(name, hashes), hashes, strict=True)
        found += [Message(text, name=name) for text, was, is_now in pairs if was != is_now]
    return found


def _title(group: bpy.types.PropertyGroup | None, name: str) -> Message:
    """The name of a setting in the panels."""
    prop = group and group.bl_rna.properties.get(name)
    return Message(prop.name if prop else {"fps": "Frame rate"}.get(name, name.replace("_", " ").capitalize()))
